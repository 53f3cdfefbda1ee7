"""Rearrangement puzzles that cannot be solved by moving every object once: swaps, cycles, dense layouts, shelves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from toolkit.geometry import make_transform, rotation_z, transform_points
from toolkit.rearrangement.footprints import Footprint
from toolkit.rearrangement.moves import Item, Layout
from toolkit.rearrangement.planners.puzzles.packing import Pose, pack
from toolkit.types import Float

_AREA_RADIUS_M = 0.40
_RING_M = 0.10
"""Roomy puzzles leave a ring of the table empty, where objects can stand aside."""

_SHELF_HALF_M = 0.12
_TURN_RAD = 0.2


@dataclass(frozen=True)
class Puzzle:
    """A layout to rearrange.

    Attributes:
        kind: of the puzzle.
        layout: its items have goals that do not overlap, or are walls.
    """

    kind: str
    layout: Layout

    @property
    def name(self) -> str:
        """Kind and number of objects."""
        return f"{self.kind}, {sum(item.wanted for item in self.layout.items)}"


def suite(seed: int, repeats: int = 10, most: int = 60) -> list[Puzzle]:
    """All puzzles that planners are compared on, arguments as for `roomy`."""
    return roomy(seed, repeats, most) + cramped(seed, repeats, most)


def roomy(seed: int, repeats: int = 10, most: int = 60) -> list[Puzzle]:
    """Puzzles with an empty ring around, where objects can stand aside: up to 9 objects, and 30.

    Args:
        seed: of all shapes and places.
        repeats: puzzles of every kind and size.
        most: objects of a puzzle; larger ones are left out.
    """
    recipes = [_Recipe("swaps", count, partial(cycles, length=2)) for count in (2, 4, 8)]
    recipes += [_Recipe("cycles of 3", count, partial(cycles, length=3)) for count in (3, 6, 9)]
    recipes += [_Recipe("cycles of 4", count, partial(cycles, length=4)) for count in (4, 8)]
    recipes += [_Recipe("25 % full, ring", count, dense) for count in (5, 7, 9, 30)]
    return _made(recipes, (seed, 0), repeats, most)


def cramped(seed: int, repeats: int = 10, most: int = 60) -> list[Puzzle]:
    """Puzzles in which objects can stand aside between the others only: 30 to 50 % full, up to 60 objects, and shelves.

    Arguments as for `roomy`.
    """
    recipes = [
        _Recipe(f"{100 * fill:.0f} % full", count, partial(dense, fill=fill, ring=0.0))
        for fill in (0.3, 0.4, 0.5)
        for count in (10, 30, 60)
    ]
    recipes += [_Recipe("shelf, 30 % full", count, shelf) for count in (6, 12)]
    return _made(recipes, (seed, 1), repeats, most)


@dataclass(frozen=True)
class _Recipe:
    kind: str
    count: int
    make: Callable[..., Layout]


def _made(recipes: Sequence[_Recipe], seed: tuple[int, int], repeats: int, most: int) -> list[Puzzle]:
    """Each from a generator of its own."""
    return [
        Puzzle(recipe.kind, recipe.make(recipe.count, rng=np.random.default_rng([*seed, k, number])))
        for k in range(repeats)
        for number, recipe in enumerate(recipes)
        if recipe.count <= most
    ]


def cycles(count: int, length: int, rng: np.random.Generator) -> Layout:
    """`count` objects of like size in cycles of `length`: each one's goal is the place of the next in its cycle."""
    size = 0.45 * np.sqrt(0.25 * _AREA_RADIUS_M**2 / count)
    shapes = [_box(rng, size, spread=0.1) for _ in range(count)]
    holding = (
        1.1 * size * (np.cos(_TURN_RAD) + np.sin(_TURN_RAD))
    )  # half side of a square that holds any of them, turned
    current = pack([_corners(np.array([holding, holding]))] * count, _AREA_RADIUS_M, (), rng)
    following = [i - i % length + (i + 1) % length for i in range(count)]
    goals = [(current[j][0], current[j][1] + rng.uniform(-_TURN_RAD, _TURN_RAD)) for j in following]
    return Layout(_items(shapes, current, goals), radius=_AREA_RADIUS_M + _RING_M)


def dense(count: int, rng: np.random.Generator, fill: float = 0.25, ring: float = _RING_M) -> Layout:
    """`count` boxes of many sizes that cover a share `fill` of a disc, before and after at independent places.

    The table is larger than the disc by a `ring`, metres.
    """
    shapes = _boxes(count, fill * np.pi * _AREA_RADIUS_M**2, rng)
    current, goals = (pack(shapes, _AREA_RADIUS_M, (), rng) for _ in range(2))
    return Layout(_items(shapes, current, goals), radius=_AREA_RADIUS_M + ring)


def shelf(count: int, rng: np.random.Generator, fill: float = 0.3) -> Layout:
    """`count` boxes of many sizes between two walls, objects that cannot be moved; they cover a share `fill` of it."""
    radius, half = _AREA_RADIUS_M, _SHELF_HALF_M
    area = 2 * (half * np.sqrt(radius**2 - half**2) + radius**2 * np.arcsin(half / radius))
    shapes = _boxes(count, fill * area, rng)
    wall = _corners(np.array([radius, (radius - half) / 2]))
    sides = [transform_points(_pose((np.array([0, side * (radius + half) / 2]), 0.0)), wall) for side in (-1, 1)]
    walls = [Item(count + i, Footprint.of(points), fixed=True) for i, points in enumerate(sides)]
    current, goals = (pack(shapes, radius, [wall.footprint for wall in walls], rng) for _ in range(2))
    return Layout((*_items(shapes, current, goals), *walls), radius=radius)


def _boxes(count: int, area: float, rng: np.random.Generator) -> list[Float]:
    """Boxes of many sizes that cover `area` square metres together."""
    shapes = [_box(rng, 1.0, spread=0.4) for _ in range(count)]
    covered = sum(4 * np.prod(shape[2, :2]) for shape in shapes)
    return [shape * np.sqrt(area / covered) for shape in shapes]


def _box(rng: np.random.Generator, size: float, spread: float) -> Float:
    """(4, 3) corners of a box of half sides around `size` metres."""
    return _corners(size * (1 + spread * rng.uniform(-1, 1, 2)))


def _corners(half: Float) -> Float:
    return np.concatenate([half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]), np.zeros((4, 1))], axis=1)


def _pose(pose: Pose) -> Float:
    return make_transform(rotation_z(pose[1])[:3, :3], np.array([*pose[0], 0.0]))


def _items(shapes: Sequence[Float], current: Sequence[Pose], goals: Sequence[Pose]) -> tuple[Item, ...]:
    items: list[Item] = []
    for i, (shape, before, after) in enumerate(zip(shapes, current, goals, strict=True)):
        T_before, T_after = _pose(before), _pose(after)
        motion = T_after @ np.linalg.inv(T_before)
        items.append(Item.seen(i, transform_points(T_before, shape), motion))
    return tuple(items)
