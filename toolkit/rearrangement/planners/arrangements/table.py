"""A table as planners search it: every item stands where it was, at its goal, or at one of its spots.

Spots are places and turns drawn once per item, and the places of the others. Which of them an item, a goal or another
spot makes unusable is a set of bits, so that a search asks for free places without any geometry.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from toolkit.geometry import invert
from toolkit.rearrangement.bits import bits
from toolkit.rearrangement.dependencies import dependencies
from toolkit.rearrangement.footprints import DIRECTIONS, Footprint, directions, gaps, planar_motion
from toolkit.rearrangement.moves import Layout, Move
from toolkit.types import Float

SPOTS = 2000
"""Places drawn for every item that may have to stand aside."""

_TURNS = DIRECTIONS * np.arange(8) // 8
"""Turns tried where others stand, in steps of a footprint: every 45 deg."""

GOAL = -1


class Step(NamedTuple):
    """A move: the position of an item, and the number of its spot, or `GOAL`."""

    item: int
    to: int


class Arrangement(NamedTuple):
    """What stands where, as bits of the items' positions.

    Attributes:
        here: items where they were at first.
        there: items at their goals.
        aside: (item, spot) of all others, ascending.
    """

    here: int
    there: int
    aside: tuple[tuple[int, int], ...]

    def after(self, *steps: Step) -> Arrangement:
        """The arrangement when steps were carried out."""
        here, there, aside = self.here, self.there, dict(self.aside)
        for item, to in steps:
            here &= ~(1 << item)
            aside.pop(item, None)
            if to == GOAL:
                there |= 1 << item
            else:
                aside[item] = to
        return Arrangement(here, there, tuple(sorted(aside.items())))


class Table:
    """A screened layout, and the spots of its items.

    Attributes:
        layout: the goals that can be reached do not overlap each other or what stays.
        wanted: bits of the items that are to be brought to a goal.
        start: the arrangement of the layout.
    """

    def __init__(self, layout: Layout, seed: int) -> None:
        self.layout = layout
        graph = dependencies(layout)
        self.wanted = sum(1 << i for i in graph.wanted)
        self.start = Arrangement((1 << len(layout.items)) - 1, 0, ())
        self._leave_first = graph.leave_first
        self._seed = seed
        self._spots: dict[int, _Spots] = {}

    def waiting(self, arrangement: Arrangement) -> int:
        """Bits of the wanted items that are not at their goals."""
        return self.wanted & ~arrangement.there

    def in_goal(self, item: int, arrangement: Arrangement) -> int:
        """Bits of the other items that stand in the goal of a wanted one."""
        found = self._leave_first[item] & arrangement.here
        for other, spot in arrangement.aside:
            if other != item and self._of(other).in_goal(item) >> spot & 1:
                found |= 1 << other
        return found

    def nearest_in_goal(self, item: int, arrangement: Arrangement) -> int:
        """Of the items that stand in a goal, the one whose middle is nearest to the goal's."""
        goal = self.layout.items[item].goal
        assert goal is not None
        aside, middle = dict(arrangement.aside), goal.center

        def distance(other: int) -> float:
            footprint = self.layout.items[other].footprint
            if other in aside:
                _, footprint = self._of(other).placed(aside[other])
            return float(np.linalg.norm(footprint.center - middle))

        return min(bits(self.in_goal(item, arrangement)), key=distance)

    def free(self, item: int, arrangement: Arrangement) -> int:
        """Bits of an item's spots at which it touches nothing that stands."""
        spots = self._of(item)
        taken = 0
        for other in bits(arrangement.here & ~(1 << item)):
            taken |= spots.onto(other)
        for other in bits(arrangement.there):
            taken |= spots.in_goal(other)
        for other, spot in arrangement.aside:
            if other != item:
                taken |= self.clash(item, other, spot)
        return spots.all & ~taken

    def in_goals(self, item: int, goals: int) -> int:
        """Bits of an item's spots that reach into any goal of the items `goals` (bits), its own not counted."""
        taken = 0
        for other in bits(goals & ~(1 << item)):
            taken |= self._of(item).in_goal(other)
        return taken

    def clash(self, item: int, other: int, spot: int) -> int:
        """Bits of an item's spots that touch one spot of another."""
        return self._of(item).touching(other, spot, self._of(other).support(spot))

    def moves(self, steps: Iterable[Step]) -> tuple[Move, ...]:
        """The moves that carry out steps from the start."""
        moves: list[Move] = []
        layout, arrangement = self.layout, self.start
        shifted: dict[int, Float] = {}
        for step in steps:
            item = layout.items[step.item]
            if step.to == GOAL:
                move = item.to_goal()
            else:
                T, footprint = self._of(step.item).placed(step.to)
                T_move = T @ invert(shifted[step.item]) if step.item in shifted else T
                move = Move(item.object, T_move, footprint, "buffer", self._why(step.item, arrangement))
                shifted[step.item] = T
            moves.append(move)
            layout, arrangement = layout.after(move), arrangement.after(step)
        return tuple(moves)

    def _why(self, item: int, arrangement: Arrangement) -> str:
        blocked = [i for i in bits(self.waiting(arrangement)) if self.in_goal(i, arrangement) >> item & 1]
        names = ", ".join(str(self.layout.items[i].object) for i in blocked)
        return f"it stands in the goal of object {names}" if names else "to make room"

    def _of(self, item: int) -> _Spots:
        if item not in self._spots:
            self._spots[item] = _Spots(self.layout, item, np.random.default_rng([self._seed, item]))
        return self._spots[item]


class _Spots:
    """Spots of one item, those first that cost it the shortest way there and on to its goal."""

    def __init__(self, layout: Layout, item: int, rng: np.random.Generator) -> None:
        self._layout = layout
        self._footprint = footprint = layout.items[item].footprint
        places, turns = _drawn(layout, rng)
        turned = (footprint.support - directions() @ footprint.center)[(np.arange(DIRECTIONS) - turns[:, None])]
        supports = turned + places @ directions().T
        inside = (supports - directions() @ np.array(layout.center)).max(axis=1) <= layout.radius
        goal = layout.items[item].goal
        way = np.linalg.norm(places - footprint.center, axis=1)
        if goal is not None:
            way += np.linalg.norm(places - goal.center, axis=1)
        order = np.flatnonzero(inside)[np.argsort(way[inside], kind="stable")]
        self._places, self._turns, self._supports = places[order], turns[order], supports[order]
        self.all = (1 << len(order)) - 1
        self._onto: dict[int, int] = {}
        self._in_goal: dict[int, int] = {}
        self._touching: dict[tuple[int, int], int] = {}

    def onto(self, other: int) -> int:
        """Bits of the spots that touch another item where it was at first."""
        if other not in self._onto:
            self._onto[other] = self._hits(self._layout.items[other].footprint.support)
        return self._onto[other]

    def in_goal(self, other: int) -> int:
        """Bits of the spots that reach into a wanted item's goal."""
        if other not in self._in_goal:
            goal = self._layout.items[other].goal
            assert goal is not None
            self._in_goal[other] = self._hits(goal.support)
        return self._in_goal[other]

    def touching(self, other: int, spot: int, support: Float) -> int:
        """Bits of the spots that touch another item's spot."""
        if (other, spot) not in self._touching:
            self._touching[other, spot] = self._hits(support)
        return self._touching[other, spot]

    def support(self, spot: int) -> Float:
        """(D,) of the item at a spot."""
        return self._supports[spot]

    def placed(self, spot: int) -> tuple[Float, Footprint]:
        """(4, 4) motion from where the item was at first to a spot, and its footprint there."""
        center = self._footprint.center
        T = planar_motion(center, self._places[spot] - center, int(self._turns[spot]))
        return T, Footprint(self._supports[spot])

    @cached_property
    def _reach(self) -> float:
        return self._footprint.reach(self._footprint.center)

    def _hits(self, support: Float) -> int:
        other = Footprint(support)
        distance = np.linalg.norm(self._places - other.center, axis=1)
        near = np.flatnonzero(distance < self._reach + other.reach(other.center) + self._layout.clearance)
        hit = np.zeros(len(self._places), bool)
        hit[near] = gaps(self._supports[near], support) < self._layout.clearance
        return _packed(hit)


def _drawn(layout: Layout, rng: np.random.Generator) -> tuple[Float, NDArray[np.int64]]:
    """(K, 2) places and (K,) turns: any, and those where others stand or will stand, which is where room gets free."""
    distance, angle = layout.radius * np.sqrt(rng.random(SPOTS)), 2 * np.pi * rng.random(SPOTS)
    anywhere = np.array(layout.center) + distance[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    outlines = [item.footprint for item in layout.items]
    outlines += [item.goal for item in layout.items if item.goal is not None]
    others = np.repeat([outline.center for outline in outlines], len(_TURNS), axis=0)
    turns = np.concatenate([rng.integers(0, DIRECTIONS, SPOTS), np.tile(_TURNS, len(outlines))])
    return np.concatenate([anywhere, others]), turns


def _packed(hit: NDArray[np.bool_]) -> int:
    return int.from_bytes(np.packbits(hit, bitorder="little").tobytes(), "little")
