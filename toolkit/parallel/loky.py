"""Processes on this machine, through joblib's loky."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import joblib
from joblib.externals.loky.process_executor import BrokenProcessPool

from toolkit.parallel.call import LOSSES, call, gave_up
from toolkit.parallel.interrupts import without_interrupts

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")


@dataclass(frozen=True)
class LokyWorkers:
    """`count` processes; where one is lost, all are started anew with the tasks that are left."""

    count: int
    prepare: Callable[[], None]
    say: Callable[[str], None]

    def map(self, function: Callable[[TaskT], ResultT], tasks: Sequence[TaskT]) -> Iterator[ResultT]:
        """As `Workers.map`. A single task is done in this process."""
        if len(tasks) < 2:
            yield from map(function, tasks)
            return
        left = dict(enumerate(tasks))
        lost = 0
        while left:
            try:
                for number, result in self._start(function, list(left.items())):
                    del left[number]
                    lost = 0
                    yield result
            except BrokenProcessPool as error:
                lost += 1
                if lost > LOSSES:
                    raise gave_up() from error
                self.say(f"A worker process was lost; new ones do the {len(left)} of {len(tasks)} tasks that are left.")

    def _start(
        self, function: Callable[[TaskT], ResultT], tasks: list[tuple[int, TaskT]]
    ) -> Iterator[tuple[int, ResultT]]:
        # One thread a process, or the workers fight for cores.
        with joblib.parallel_config(backend="loky", n_jobs=self.count, inner_max_num_threads=1):
            with without_interrupts():
                joblib.Parallel()(joblib.delayed(int)() for _ in range(self.count))
            parallel: Any = joblib.Parallel(return_as="generator_unordered")
            yield from parallel(joblib.delayed(_numbered)(self.prepare, function, *item) for item in tasks)


def _numbered(
    prepare: Callable[[], None], function: Callable[[TaskT], ResultT], number: int, task: TaskT
) -> tuple[int, ResultT]:
    return number, call(prepare, function, task)
