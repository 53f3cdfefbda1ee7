"""Rearrangement puzzles that cannot be solved by moving every object once: swaps, cycles, dense layouts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from toolkit.geometry import make_transform, rotation_z, transform_points
from toolkit.rearrangement.footprints import Footprint, gaps, supports
from toolkit.rearrangement.moves import Item, Layout
from toolkit.types import Float

_AREA_RADIUS_M = 0.40
_TABLE_RADIUS_M = 0.50
"""Puzzles fill the inner disc; the ring around it is where objects can stand aside."""

_GAP_M = 0.01
_TRIES = 200
_RESTARTS = 200


@dataclass(frozen=True)
class Puzzle:
    """A layout to rearrange.

    Attributes:
        kind: swaps, cycles of 3, cycles of 4, or dense.
        layout: its items all have goals that do not overlap.
    """

    kind: str
    layout: Layout

    @property
    def name(self) -> str:
        """Kind and number of objects."""
        return f"{self.kind}, {len(self.layout.items)}"


def suite(seed: int, repeats: int = 10) -> list[Puzzle]:
    """The puzzles that planners are compared on, with up to 9 objects and with 30.

    Args:
        seed: of all shapes and places.
        repeats: puzzles of every kind and size.
    """
    puzzles: list[Puzzle] = []
    for k in range(repeats):
        rng = np.random.default_rng([seed, k])
        for kind, length, counts in (
            ("swaps", 2, (2, 4, 8)),
            ("cycles of 3", 3, (3, 6, 9)),
            ("cycles of 4", 4, (4, 8)),
        ):
            puzzles += [Puzzle(kind, cycles(count, length, rng)) for count in counts]
        puzzles += [Puzzle("dense", dense(count, rng)) for count in (5, 7, 9, 30)]
    return puzzles


def cycles(count: int, length: int, rng: np.random.Generator) -> Layout:
    """`count` objects of like size in cycles of `length`: each one's goal is the place of the next in its cycle."""
    size = 0.45 * np.sqrt(0.25 * _AREA_RADIUS_M**2 / count)
    shapes = [_box(rng, size, spread=0.1) for _ in range(count)]
    current = _arrange(shapes, rng)
    following = [i - i % length + (i + 1) % length for i in range(count)]
    goals = [(current[j][0], current[j][1] + rng.uniform(-0.2, 0.2)) for j in following]
    return _layout(shapes, current, goals)


def dense(count: int, rng: np.random.Generator, fill: float = 0.25) -> Layout:
    """`count` boxes of many sizes that cover a share `fill` of the area, before and after at independent places."""
    size = np.sqrt(fill * np.pi * _AREA_RADIUS_M**2 / count) / 2
    shapes = [_box(rng, size, spread=0.4) for _ in range(count)]
    return _layout(shapes, _arrange(shapes, rng), _arrange(shapes, rng))


Pose = tuple[Float, float]
"""(2,) place of the centre, and yaw."""


def _box(rng: np.random.Generator, size: float, spread: float) -> Float:
    """(4, 3) corners of a box of half sides around `size` metres."""
    half = size * (1 + spread * rng.uniform(-1, 1, 2))
    corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return np.concatenate([corners, np.zeros((4, 1))], axis=1)


def _pose(pose: Pose) -> Float:
    return make_transform(rotation_z(pose[1])[:3, :3], np.array([*pose[0], 0.0]))


def _arrange(shapes: Sequence[Float], rng: np.random.Generator) -> list[Pose]:
    """Places without overlap, large objects first."""
    order = np.argsort([-np.linalg.norm(shape, axis=1).max() for shape in shapes], kind="stable")
    for _ in range(_RESTARTS):
        poses: dict[int, Pose] = {}
        taken: list[Footprint] = []
        for i in map(int, order):
            found = _place(shapes[i], taken, rng)
            if found is None:
                break
            poses[i], footprint = found
            taken.append(footprint)
        if len(poses) == len(shapes):
            return [poses[i] for i in range(len(shapes))]
    raise ValueError(f"no arrangement of {len(shapes)} objects was found; ask for a smaller fill")


def _place(shape: Float, taken: Sequence[Footprint], rng: np.random.Generator) -> tuple[Pose, Footprint] | None:
    others = supports(list(taken))
    for _ in range(_TRIES):
        distance, angle, yaw = _AREA_RADIUS_M * np.sqrt(rng.random()), *(2 * np.pi * rng.random(2))
        pose = (distance * np.array([np.cos(angle), np.sin(angle)]), float(yaw))
        footprint = Footprint.of(transform_points(_pose(pose), shape))
        inside = footprint.reach(np.zeros(2)) <= _AREA_RADIUS_M
        if inside and (gaps(footprint.support, others) >= _GAP_M).all():
            return pose, footprint
    return None


def _layout(shapes: Sequence[Float], current: Sequence[Pose], goals: Sequence[Pose]) -> Layout:
    items: list[Item] = []
    for i, (shape, before, after) in enumerate(zip(shapes, current, goals, strict=True)):
        T_before, T_after = _pose(before), _pose(after)
        motion = T_after @ np.linalg.inv(T_before)
        items.append(Item.seen(i, transform_points(T_before, shape), motion))
    return Layout(tuple(items), radius=_TABLE_RADIUS_M)
