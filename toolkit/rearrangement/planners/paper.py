"""Algorithm 1 of the paper (Sec. Method B), line by line."""

from __future__ import annotations

from collections.abc import Generator

import numpy as np
from pydantic import Field

from toolkit.rearrangement.moves import Finished, Item, Layout, Move
from toolkit.rearrangement.planners.ordering.buffers import random_spot
from toolkit.rearrangement.stages import Planner, Schedule
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Failure


class PaperConfig(PluginConfig):
    """Settings of `paper`, which the paper leaves open."""

    max_failures: int = Field(
        2, ge=0, description="Collisions of an object after which it moves aside (Thres, line 14)."
    )
    max_tries: int = Field(20, ge=1, description="Passes over the remaining objects (TryCnt, line 20).")
    samples: int = Field(200, ge=1, description="Random places tried for a collision-free one.")


class Paper(Plugin[PaperConfig], Planner):
    """The paper's greedy loop: fixed order, failure counts, random free places (Algorithm 1)."""

    stage = "planner"
    name = "paper"

    def start(self, seed: int) -> PaperSchedule:
        return PaperSchedule(self.config, np.random.default_rng(seed))


class PaperSchedule(Schedule):
    """Algorithm 1, suspended where it moves an object: the next layout is line 7's current observation."""

    def __init__(self, config: PaperConfig, rng: np.random.Generator) -> None:
        self._config = config
        self._rng = rng
        self._steps: Generator[Move, Layout, Finished] | None = None
        self._finished: Finished | None = None

    def next(self, layout: Layout) -> Move | Finished:
        if self._finished is not None:
            return self._finished
        try:
            if self._steps is None:
                self._steps = self._algorithm_1(layout)
                return next(self._steps)
            return self._steps.send(layout)
        except StopIteration as end:
            self._finished = end.value
            return end.value

    def _algorithm_1(self, layout: Layout) -> Generator[Move, Layout, Finished]:
        """The comments give the algorithm's lines. TryCnt, which it never counts, counts its passes (lines 4 to 19)."""
        remaining = [item.object for item in layout.items if item.wanted]  # 2
        failures = dict.fromkeys(remaining, 0)  # 3
        tries = 0
        while True:  # 4
            for object_id in list(remaining):  # 5
                item = layout.item(object_id)  # 6, 7: `layout` is the newest observation
                if item.goal is None:
                    continue
                collision = layout.in_the_way(item.goal, of=object_id)  # 8
                if not collision:  # 9
                    layout = yield item.to_goal()  # 10
                    remaining.remove(object_id)  # 11
                else:  # 12
                    failures[object_id] += 1  # 13
                    if failures[object_id] > self._config.max_failures:  # 14
                        spot = random_spot(item, layout, self._rng, self._config.samples, _reason(collision))
                        if spot is not None:
                            layout = yield spot  # 15
            tries += 1
            if not remaining or tries > self._config.max_tries:  # 20
                break
        return Finished({i: _left_over(layout.item(i), layout, self._config.max_tries) for i in remaining})


def _reason(collision: list[int]) -> str:
    return f"its goal is taken by object {', '.join(map(str, collision))}, again"


def _left_over(item: Item, layout: Layout, tries: int) -> Failure:
    if item.goal is None:
        return Failure("planner", "its goal was no longer known when its turn came")
    taken = layout.in_the_way(item.goal, of=item.object)
    return Failure("planner", f"given up after {tries} passes: {_reason(taken)}")
