"""Work in processes, through joblib; the same results for any number of them."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import joblib

ResultT = TypeVar("ResultT")


def run_parallel(
    function: Callable[..., ResultT], arguments: Iterable[tuple[Any, ...]], workers: int, backend: str = "loky"
) -> Iterator[ResultT]:
    """Call `function` with every tuple of arguments; results come in the order in which they get done."""
    # One thread a process, or the workers fight for cores.
    threads = {"inner_max_num_threads": 1} if backend == "loky" else {}
    with joblib.parallel_config(backend=backend, n_jobs=workers, **threads):
        if backend == "loky" and workers > 1:
            _start_workers(workers)
        parallel: Any = joblib.Parallel(return_as="generator_unordered")
        yield from parallel(joblib.delayed(function)(*values) for values in arguments)


def _start_workers(workers: int) -> None:
    """Start the processes while Ctrl-C is ignored, which they inherit: it is the main process's to answer."""
    with _without_interrupts():
        joblib.Parallel()(joblib.delayed(int)() for _ in range(workers))


@contextmanager
def _without_interrupts() -> Generator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
