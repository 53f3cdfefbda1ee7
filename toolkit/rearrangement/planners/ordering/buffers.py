"""Free places on the table for objects that must stand aside."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from toolkit.rearrangement.footprints import DIRECTIONS, Footprint, directions, gaps, planar_motion
from toolkit.rearrangement.moves import Item, Layout, Move
from toolkit.types import Float

_GRID_M = 0.02
_SPARE_M = 0.01
"""Room left around an object that stands aside, beyond the layout's clearance."""

_TURNS = tuple(DIRECTIONS * part // 8 for part in (0, 2, 1, 3))
"""Turns tried, in steps of a footprint: none, 90, 45 and 135 deg."""


def nearest_spot(item: Item, layout: Layout, taken: Sequence[Footprint], reason: str) -> Move | None:
    """The free place that costs an item the shortest way there and on to its goal.

    Args:
        item: what stands aside.
        layout: gives the area and the clearance.
        taken: what the place must keep clear of.
        reason: put into the move.

    Returns:
        The move there, turned only where that is needed; None where nothing is free.
    """
    shifts = _grid(layout) - item.footprint.center
    for steps in _TURNS:
        turned = item.footprint.moved(np.zeros(2), steps)
        free = _free(turned, shifts, layout, taken, _SPARE_M)
        if len(free):
            there = np.linalg.norm(free, axis=1)
            if item.goal is not None:
                there = there + np.linalg.norm(free + item.footprint.center - item.goal.center, axis=1)
            return aside(item, free[int(there.argmin())], steps, reason)
    return None


def random_spot(item: Item, layout: Layout, rng: np.random.Generator, tries: int, reason: str) -> Move | None:
    """A place drawn at random where the item collides with nothing that stands now (Algorithm 1, line 15)."""
    taken = [other.footprint for other in layout.items if other.object != item.object]
    distance, angle = layout.radius * np.sqrt(rng.random(tries)), 2 * np.pi * rng.random(tries)
    places = np.array(layout.center) + np.stack([distance * np.cos(angle), distance * np.sin(angle)], axis=1)
    free = _free(item.footprint, places - item.footprint.center, layout, taken, 0.0)
    return aside(item, free[0], 0, reason) if len(free) else None


def aside(item: Item, shift: Float, steps: int, reason: str) -> Move:
    """The move that puts an item aside by (2,) `shift`, turned by `steps` of a footprint."""
    T = planar_motion(item.footprint.center, shift, steps)
    return Move(item.object, T, item.footprint.moved(shift, steps), "buffer", reason)


def _grid(layout: Layout) -> Float:
    """(N, 2) places on the table, metres."""
    count = int(layout.radius / _GRID_M)
    ticks = _GRID_M * np.arange(-count, count + 1)
    places = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
    return places[np.linalg.norm(places, axis=1) <= layout.radius] + np.array(layout.center)


def _free(footprint: Footprint, shifts: Float, layout: Layout, taken: Sequence[Footprint], spare: float) -> Float:
    """The (N, 2) shifts that keep a footprint on the table and clear of what is taken, in their order."""
    moved = footprint.support + shifts @ directions().T
    inside = (moved - directions() @ np.array(layout.center)).max(axis=1) <= layout.radius
    shifts, moved = shifts[inside], moved[inside]
    for other in taken:
        free = gaps(moved, other.support) >= layout.clearance + spare
        shifts, moved = shifts[free], moved[free]
    return shifts
