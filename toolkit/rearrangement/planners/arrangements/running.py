"""An order of goals for which the fewest objects stand aside at a time: running buffers.

Gao, Feng and Yu, "On minimizing the number of running buffers for tabletop rearrangement", RSS 2021.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from toolkit.rearrangement.bits import bits

EXPANSIONS = 2000
"""Sets of items at their goals from which a search for so many buffers goes on, before it tries with one more."""


def fewest_running(leave_first: Sequence[int], wanted: int, may_wait: int, prefer: Callable[[int], float]) -> list[int]:
    """Order items, each of which enters its goal after those in it have gone aside.

    Depth-first over sets of items at their goals, for one buffer more at a time, until there is an order.

    Args:
        leave_first: by item, bits of the items that stand in its goal.
        wanted: bits of the items to order.
        may_wait: bits of the items that may go aside, without which the rest has no cycle.
        prefer: of an item; smaller ones are tried first among those that send equally many aside.

    Returns:
        The wanted items in order.
    """
    buffers = 0
    while (order := _Search(leave_first, wanted, may_wait, prefer, buffers).run(0, 0)) is None:
        buffers += 1
    return order


class _Search:
    """For a number of buffers."""

    def __init__(
        self,
        leave_first: Sequence[int],
        wanted: int,
        may_wait: int,
        prefer: Callable[[int], float],
        buffers: int,
    ) -> None:
        self._leave_first = leave_first
        self._items = list(bits(wanted))
        self._wanted = wanted
        self._may_wait = may_wait
        self._prefer = prefer
        self._buffers = buffers
        self._hopeless: set[int] = set()

    def run(self, done: int, aside: int) -> list[int] | None:
        """The rest of the order, with the items `done` at their goals and those `aside` out of the way."""
        first: list[int] = []
        while (free := self._free(done | aside, done)) is not None:
            first.append(free)
            done, aside = done | 1 << free, aside & ~(1 << free)
        if done == self._wanted:
            return first
        if done in self._hopeless or len(self._hopeless) >= EXPANSIONS:
            return None
        self._hopeless.add(done)
        for peak, _, item in self._choices(done, aside):
            if peak > self._buffers:
                break
            gone = (aside | self._leave_first[item]) & ~done & ~(1 << item)
            rest = self.run(done | 1 << item, gone)
            if rest is not None:
                return [*first, item, *rest]
        return None

    def _free(self, gone: int, done: int) -> int | None:
        """An item whose goal is free: it goes there at once, which leaves no fewer buffers to any other."""
        return next((i for i in self._items if not done >> i & 1 and not self._leave_first[i] & ~gone), None)

    def _choices(self, done: int, aside: int) -> list[tuple[int, float, int]]:
        """Items with the number that is aside while each of them moves, fewest first."""
        must_stay = ~(done | aside | self._may_wait)
        waiting = [i for i in self._items if not done >> i & 1 and not self._leave_first[i] & must_stay]
        peaks = [((aside | self._leave_first[i]) & ~done).bit_count() for i in waiting]
        return sorted((peak, self._prefer(i), i) for peak, i in zip(peaks, waiting, strict=True))
