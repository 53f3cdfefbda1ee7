"""Processes on this machine, by the standard library: they live, and stay warm, as long as the run.

The backend keeps the name of loky, the library that used to start these processes. loky ends a process that has grown
by 300 MB (joblib 1.6) and warns of it, and the new process has to load every network again.

On Linux a server that has imported what this process has imported forks them, which spares each of them the two to four
seconds that torch and JAX take to import. Nothing computes in the server, so that no thread is lost by its forks.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import threading
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from itertools import islice
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext
from types import ModuleType
from typing import Any, TypeVar

from toolkit.parallel.call import LOSSES, call, gave_up
from toolkit.parallel.interrupts import without_interrupts

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")

_ONE_THREAD: dict[str, Any] = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""One thread per process, or the workers fight for cores."""

_NO_MAIN = {"__main__": ModuleType("__main__")}
"""The main module is a user's script, and may have no guard against being run by a process that starts."""

_HEAVY = (
    "torch",
    "jax",
    "cv2",
    "scipy.optimize",
    "scipy.spatial",
    "scipy.stats",
    "sklearn",
    "trimesh",
    "kornia",
    "faiss",
)
"""What takes long to import, beside the toolkit's own modules."""


@contextmanager
def process_workers(count: int, prepare: Callable[[], None], say: Callable[[str], None]) -> Generator[ProcessWorkers]:
    """`count` processes, started when they are first needed; an exception that leaves the block ends them at once."""
    workers = ProcessWorkers(count, prepare, say)
    try:
        yield workers
    except BaseException:
        workers.stop(at_once=True)
        raise
    workers.stop()


class ProcessWorkers:
    """`count` processes; where one is lost, all are started anew with the tasks that are left."""

    def __init__(self, count: int, prepare: Callable[[], None], say: Callable[[str], None]) -> None:
        self._count, self._prepare, self._say = count, prepare, say
        self._pool: ProcessPoolExecutor | None = None
        self._line: Connection | None = None

    def map(self, function: Callable[[TaskT], ResultT], tasks: Sequence[TaskT]) -> Iterator[ResultT]:
        """As `Workers.map`. A single task is done in this process."""
        if len(tasks) < 2:
            yield from map(function, tasks)
            return
        left = dict(enumerate(tasks))
        lost = 0
        while True:
            before = len(left)
            for number, result in self._results(function, left):
                del left[number]
                yield result
            if not left:
                return
            self.stop(at_once=True)
            lost = lost + 1 if len(left) == before else 1
            if lost > LOSSES:
                raise gave_up()
            self._say(f"A worker process was lost; new ones do the {len(left)} of {len(tasks)} tasks that are left.")

    def _results(
        self, function: Callable[[TaskT], ResultT], tasks: Mapping[int, TaskT]
    ) -> Iterator[tuple[int, ResultT]]:
        """Results as they come, with the numbers of their tasks; fewer than tasks where a process is lost."""
        pool = self._start()
        running: dict[Future[ResultT], int] = {}
        waiting = iter(list(tasks.items()))

        def submit() -> None:
            # No more than there are processes. A task that nobody takes may lie half in a pipe, and pools of an older
            # CPython, 3.11.2 among them, never end where their processes do meanwhile (python/cpython#94777).
            with suppress(BrokenProcessPool):
                for number, task in islice(waiting, self._count - len(running)):
                    with _starting():
                        running[pool.submit(call, self._prepare, function, task)] = number

        submit()
        try:
            while running:
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    number = running.pop(future)
                    submit()
                    if not isinstance(future.exception(), BrokenProcessPool):
                        yield number, future.result()
        finally:
            for future in running:
                future.cancel()

    def _start(self) -> ProcessPoolExecutor:
        if self._pool is None:
            end, self._line = Pipe(duplex=False)
            environment = {**os.environ, **_ONE_THREAD}
            self._pool = ProcessPoolExecutor(self._count, _context(), _begin, (end, environment))
        return self._pool

    def stop(self, *, at_once: bool = False) -> None:
        """End the processes, in the middle of their tasks where that is asked for."""
        if self._pool is None or self._line is None:
            return
        if at_once:
            self._line.close()
        self._pool.shutdown(cancel_futures=True)
        self._line.close()
        self._pool = self._line = None


def _context() -> BaseContext:
    """How processes start. A server that already runs is kept, with what it has imported."""
    if sys.platform != "linux":
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    own = [name for name in sys.modules if name.partition(".")[0] == "toolkit"]
    context.set_forkserver_preload([name for name in _HEAVY if name in sys.modules] + own)
    return context


@contextmanager
def _starting() -> Generator[None]:
    """Processes, and their server, that start meanwhile find the same modules as this one, and no main module."""
    same_modules = {"PYTHONPATH": os.pathsep.join(sys.path), "PYTHONSAFEPATH": "1"}
    with without_interrupts(), _replaced(os.environ, {**_ONE_THREAD, **same_modules}), _replaced(sys.modules, _NO_MAIN):
        yield


def _begin(line: Connection, environment: Mapping[str, str]) -> None:
    """Take over the main process's environment, and end when it lets go of the line, also by being killed."""
    os.environ.clear()
    os.environ.update(environment)

    def end_with_it() -> None:
        with suppress(EOFError, OSError):
            line.recv_bytes()
        os._exit(1)

    threading.Thread(target=end_with_it, daemon=True).start()


@contextmanager
def _replaced(mapping: Any, entries: Mapping[str, Any]) -> Generator[None]:
    """Other entries in a mapping meanwhile."""
    before = {name: mapping.get(name) for name in entries}
    mapping.update(entries)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del mapping[name]
            else:
                mapping[name] = value
