"""Seen points as full cubes: all that an arm knows of what it must keep clear of."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from toolkit.geometry import CUBE_STEPS
from toolkit.types import Cubes, Float

FINE_M = 0.002
"""Side of the cubes of what is taken and carried."""

_UNDERSIDE_M = 0.02
_SAME_PLACE_M = FINE_M * np.sqrt(3)
"""The middles of the cubes that hold one point, before and after a motion, are at most this far apart."""


def around(points: Float, side: float, margin: float = 0.0) -> Cubes:
    """The cubes of a side that hold (N, 3) points, N > 0, and what lies within `margin` metres along the axes."""
    steps = np.linspace(-margin, margin, 2 * int(np.ceil(margin / side)) + 1)
    margins = np.array(list(product(steps, repeat=3)))
    return Cubes(_distinct(np.concatenate([_cells(points + by, side) for by in margins])), side)


def standing(cubes: Cubes, floor: float = 0.0) -> Cubes:
    """The cubes with all those that lie between them and a table at height `floor`: nobody saw that they are empty."""
    top, bottom = cubes.cells[:, 2], int(np.floor(floor / cubes.side))
    by_column = np.lexsort((top, cubes.cells[:, 1], cubes.cells[:, 0]))
    ordered = cubes.cells[by_column]
    last = np.append((np.diff(ordered[:, :2], axis=0) != 0).any(axis=1), True)
    highest = ordered[last]
    heights = np.maximum(highest[:, 2] - bottom + 1, 1)
    cells = np.repeat(highest, heights, axis=0)
    cells[:, 2] -= np.arange(len(cells)) - np.repeat(np.cumsum(heights) - heights, heights)
    return Cubes(cells, cubes.side)


def deepened(cubes: Cubes, depth: float, floor: float = 0.0) -> Cubes:
    """The cubes with those below the lowest of each column, `depth` metres down or to a table at height `floor`."""
    by_column = np.lexsort((cubes.cells[:, 2], cubes.cells[:, 1], cubes.cells[:, 0]))
    ordered = cubes.cells[by_column]
    lowest = ordered[np.append(True, (np.diff(ordered[:, :2], axis=0) != 0).any(axis=1))]
    steps = round(depth / cubes.side)
    below = np.repeat(lowest, steps, axis=0)
    below[:, 2] -= np.tile(np.arange(1, steps + 1), len(lowest))
    below = below[below[:, 2] >= int(np.floor(floor / cubes.side))]
    return Cubes(np.concatenate([cubes.cells, below]), cubes.side)


def underside(seen: Cubes) -> Cubes | None:
    """What no camera sees of an object: at most 2 cm below the cubes of what was seen of it, and above the table."""
    return without(deepened(seen, _UNDERSIDE_M), seen)


def with_underside(points: Float, empty: Float) -> Cubes:
    """Fine cubes of an object and of its underside.

    Args:
        points: (N, 3) of the object, N > 0.
        empty: (K, 3) middles of cubes, in any orientation, where the underside is not.
    """
    seen = around(points, FINE_M)
    below = underside(seen)
    if below is None:
        return seen
    cells = below.cells
    if len(empty):
        away, _ = KDTree(empty).query(below.centers)
        cells = cells[away > _SAME_PLACE_M]
    return Cubes(np.concatenate([seen.cells, cells]), FINE_M)


def without(cubes: Cubes, other: Cubes) -> Cubes | None:
    """The cubes that `other`, of the same side, does not have; None where none are left."""
    kept = cubes.cells[~np.isin(_numbers(cubes.cells), _numbers(other.cells))]
    return Cubes(kept, cubes.side) if len(kept) else None


def any_inside(cubes: Cubes, points: Float) -> bool:
    """Say whether any of (N, 3) points lies in a cube."""
    return bool(np.isin(_numbers(_cells(points, cubes.side)), _numbers(cubes.cells)).any())


def _cells(points: Float, side: float) -> NDArray[np.int64]:
    return np.floor(np.asarray(points, np.float64) / side).astype(np.int64)


def _numbers(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    return cells @ np.array(CUBE_STEPS)


def _distinct(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    return cells[np.unique(_numbers(cells), return_index=True)[1]]
