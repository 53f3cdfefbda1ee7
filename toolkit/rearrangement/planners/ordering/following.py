"""Carrying out a plan of all moves one at a time, while things may not go as planned."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from pydantic import Field

from toolkit.rearrangement.footprints import Footprint
from toolkit.rearrangement.moves import Finished, Layout, Move, Solution
from toolkit.rearrangement.stages import Schedule
from toolkit.registry import PluginConfig
from toolkit.types import Failure

_SAME_PLACE_M = 0.01
"""An object this near to where it was expected is there."""


class FollowingConfig(PluginConfig):
    """Settings of planners that plan all moves at once."""

    tries: int = Field(2, ge=1, description="Failed moves of an object after which it counts as one that cannot move.")


class Following(Schedule):
    """Follows a plan as long as things are where they should be, and plans anew where not."""

    def __init__(self, plan: Callable[[Layout], Solution], tries: int) -> None:
        self._plan = plan
        self._tries = tries
        self._failed: dict[int, int] = {}
        self._postponed: set[int] = set()
        self._queue: list[Move] = []
        self._expected: Layout | None = None
        self._last: Move | None = None
        self._failures: dict[int, Failure] = {}

    def next(self, layout: Layout) -> Move | Finished:
        self._look_at_last(layout)
        while True:
            held = self._hold(layout)
            if self._expected is None or not _as_expected(held, self._expected):
                found = self._plan(held)
                self._queue, self._failures = list(found.moves), dict(found.failures)
            if self._queue:
                return self._take(held)
            if not self._postponed:
                return Finished(self._failures)
            self._postponed.clear()
            self._expected = None

    def _take(self, layout: Layout) -> Move:
        move = self._queue.pop(0)
        if move.to == "goal":
            move = layout.item(move.object).to_goal(move.reason)
        self._expected, self._last = layout.after(move), move
        return move

    def _look_at_last(self, layout: Layout) -> None:
        """An object that is not where it was put has failed; it is tried again when nothing else is left to do.

        Where a turn leaves the footprint as it was, its goal tells: it has it no more once it is there.
        """
        last, self._last = self._last, None
        if last is None:
            return
        now = layout.item(last.object)
        if not _same_place(now.footprint, last.footprint) or (last.to == "goal" and now.wanted):
            self._failed[last.object] = self._failed.get(last.object, 0) + 1
            self._postponed.add(last.object)

    def _hold(self, layout: Layout) -> Layout:
        """The layout with the objects fixed that are postponed, or have failed too often."""
        for object_id, count in self._failed.items():
            if count >= self._tries:
                self._postponed.discard(object_id)
            if count >= self._tries or object_id in self._postponed:
                layout = layout.with_item(replace(layout.item(object_id), fixed=True))
        return layout


def _as_expected(layout: Layout, expected: Layout) -> bool:
    return all(
        a.object == b.object and a.wanted == b.wanted and _same_place(a.footprint, b.footprint)
        for a, b in zip(layout.items, expected.items, strict=True)
    )


def _same_place(a: Footprint, b: Footprint) -> bool:
    return bool(np.abs(a.support - b.support).max() <= _SAME_PLACE_M)
