"""Plans whose buffers are placed lazily, once it is known what comes into their way.

Gao, Lau, Huang, Bekris and Yu, "Fast high-quality tabletop rearrangement in bounded workspace", ICRA 2022.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from toolkit.rearrangement.bits import any_bit, bits
from toolkit.rearrangement.planners.arrangements.growth import grow
from toolkit.rearrangement.planners.arrangements.running import fewest_running
from toolkit.rearrangement.planners.arrangements.table import GOAL, Arrangement, Step, Table

_TRIES = 20
"""Times that all places are drawn anew where one is taken."""

_ORDERS = 5
_TREES = 3
"""Of the searches of `fewest_buffers`, the one with the shortest way counts."""


def running_buffers(table: Table, rng: np.random.Generator, plans: int) -> list[Step]:
    """Search over arrangements: a plan with the fewest running buffers is carried out for as long as they find places.

    Args:
        table: where.
        rng: decides between orders that are equally good, and draws places.
        plans: after which the search ends.
    """

    def expand(arrangement: Arrangement) -> list[Step]:
        return _placed(table, arrangement, _primitive(table, arrangement, ~0, rng), rng)

    return grow(table, expand, plans)


def fewest_buffers(table: Table, waiting: int, rng: np.random.Generator, plans: int) -> list[Step]:
    """Steps in which only given items stand aside, once each; where no places are found for that, as few as can be.

    Args:
        table: where.
        waiting: bits of the items that may stand aside, without which there is no cycle.
        rng: as for `running_buffers`.
        plans: the same.
    """
    for _ in range(_ORDERS):
        steps = _placed(table, table.start, _primitive(table, table.start, waiting, rng), rng)
        if not table.waiting(table.start.after(*steps)):
            return steps
    trees = [running_buffers(table, rng, plans) for _ in range(_TREES)]
    return min(trees, key=lambda steps: (table.waiting(table.start.after(*steps)).bit_count(), len(steps)))


@dataclass(frozen=True)
class _Action:
    item: int
    to_goal: bool


def _primitive(table: Table, arrangement: Arrangement, may_wait: int, rng: np.random.Generator) -> list[_Action]:
    """All moves, before it is known where objects stand aside."""
    waiting = table.waiting(arrangement)
    rows = [table.in_goal(i, arrangement) if waiting >> i & 1 else 0 for i in range(len(table.layout.items))]
    priority = rng.random(len(rows)).tolist()
    actions: list[_Action] = []
    gone = 0
    for item in fewest_running(rows, waiting, may_wait, lambda i: priority[i]):
        for other in bits(rows[item] & ~gone):
            actions.append(_Action(other, False))
        gone |= rows[item] | 1 << item
        actions.append(_Action(item, True))
    return actions


@dataclass(eq=False)
class _Stay:
    """An object that stands aside. Its spot may change until it leaves.

    Attributes:
        item: which.
        allowed: bits of the spots at which nothing has come into its way so far.
        spot: one of them.
    """

    item: int
    allowed: int
    spot: int = GOAL


def _placed(table: Table, arrangement: Arrangement, actions: Sequence[_Action], rng: np.random.Generator) -> list[Step]:
    """Steps for actions, up to the first for which no place is left."""
    done: list[tuple[_Action, _Stay | None]] = []
    aside: dict[int, _Stay] = {}
    for action in actions:
        if action.to_goal:
            own = aside.pop(action.item, None)
            for stay in aside.values():
                stay.allowed &= ~table.in_goals(stay.item, 1 << action.item)
                if own is not None:
                    stay.allowed &= ~table.clash(stay.item, own.item, own.spot)
            stays = list(aside.values())
            entry = None
        else:
            own = None
            entry = _Stay(action.item, table.free(action.item, arrangement))
            stays = [*aside.values(), entry]
        spots = _spots(table, stays, rng)
        if spots is None:
            break
        for stay, spot in zip(stays, spots, strict=True):
            stay.spot = spot
        if entry is not None:
            aside[action.item] = entry
        done.append((action, entry))
        arrangement = _without(arrangement, action)
    return [Step(action.item, GOAL if stay is None else stay.spot) for action, stay in done]


def _without(arrangement: Arrangement, action: _Action) -> Arrangement:
    """The arrangement after an action, in which objects that went aside are nowhere yet."""
    if action.to_goal:
        return arrangement.after(Step(action.item, GOAL))
    moved = arrangement.after(Step(action.item, 0))
    return moved._replace(aside=tuple(pair for pair in moved.aside if pair[0] != action.item))


def _spots(table: Table, stays: Sequence[_Stay], rng: np.random.Generator) -> list[int] | None:
    """A spot for each that touches no other's: as they are where that does, and all drawn anew where not."""
    chosen = _choose(table, stays, None)
    for _ in range(_TRIES):
        if chosen is not None:
            break
        chosen = _choose(table, stays, rng)
    return chosen


def _choose(table: Table, stays: Sequence[_Stay], rng: np.random.Generator | None) -> list[int] | None:
    """One after another, the one with the fewest places first."""
    chosen: dict[int, int] = {}
    left = {stay.item: stay.allowed for stay in stays}
    spots = {stay.item: stay.spot for stay in stays}
    while left:
        item = min(left, key=lambda i: left[i].bit_count())
        allowed = left.pop(item)
        if not allowed:
            return None
        if rng is not None:
            spot = any_bit(allowed, rng)
        elif spots[item] >= 0 and allowed >> spots[item] & 1:
            spot = spots[item]
        else:
            spot = next(bits(allowed))
        chosen[item] = spot
        for other in left:
            left[other] &= ~table.clash(other, item, spot)
    return [chosen[stay.item] for stay in stays]
