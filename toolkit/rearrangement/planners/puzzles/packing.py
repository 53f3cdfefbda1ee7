"""Arrangements at random that may be dense: objects grow while they are shaken (Lubachevsky and Stillinger, 1990)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from toolkit.rearrangement.footprints import DIRECTIONS, Footprint, directions, gaps, supports
from toolkit.types import Float

_GAP_M = 0.002
_FIRST_SCALE = 0.5
_SWEEPS = 1000
_RESTARTS = 20

Pose = tuple[Float, float]
"""(2,) place of the centre, and yaw."""


def pack(shapes: Sequence[Float], radius: float, walls: Sequence[Footprint], rng: np.random.Generator) -> list[Pose]:
    """Poses in a disc around the origin without overlap.

    Objects of half their size are put at random places. Then each in turn is moved and turned a little and grows a
    little, where there is room for that, until all have their sizes. Where they jam, it begins anew.

    Args:
        shapes: (V, 2) or (V, 3) corners of each, around its centre, metres.
        radius: of the disc, metres.
        walls: what stands in it for good.
        rng: draws everything.

    Raises:
        ValueError: they have not grown to their sizes in time.
    """
    for _ in range(_RESTARTS):
        packing = _Packing([shape[:, :2] for shape in shapes], radius, supports(list(walls)))
        for i in range(len(shapes)):
            while not packing.put(i, (radius * rng.uniform(-1, 1, 2), 2 * np.pi * rng.random()), _FIRST_SCALE):
                pass
        if _grow(packing, rng):
            return packing.poses
    raise ValueError(f"no arrangement of {len(shapes)} objects was found; ask for a smaller fill")


def _grow(packing: _Packing, rng: np.random.Generator) -> bool:
    """Shake until all objects have their sizes; say whether they got there."""
    for _ in range(_SWEEPS):
        if (packing.scales == 1.0).all():
            return True
        for i in range(len(packing.poses)):
            size = 10 ** rng.uniform(-2.5, -0.5)
            x, y, turn, growth = size * rng.normal(size=4)
            place, yaw = packing.poses[i]
            shifted = place + packing.scales[i] * packing.reach[i] * np.array([x, y])
            packing.put(i, (shifted, yaw + turn), min(1.0, packing.scales[i] * (1 + abs(growth))))
    return False


class _Packing:
    """Objects at some scale each, without overlap. Those that were not put yet have none."""

    def __init__(self, shapes: Sequence[Float], radius: float, walls: Float) -> None:
        self._shapes, self._radius, self._walls = shapes, radius, walls
        self.poses: list[Pose] = [(np.zeros(2), 0.0)] * len(shapes)
        self.scales = np.zeros(len(shapes))
        self.reach = np.array([np.linalg.norm(shape, axis=1).max() for shape in shapes])
        self._places = np.full((len(shapes), 2), np.inf)
        self._supports = np.zeros((len(shapes), DIRECTIONS))

    def put(self, i: int, pose: Pose, scale: float) -> bool:
        """Put an object somewhere if it fits there; say whether it does."""
        place, yaw = pose
        near = np.linalg.norm(self._places - place, axis=1) < self.scales * self.reach + scale * self.reach[i] + _GAP_M
        near[i] = False
        cos, sin = np.cos(yaw), np.sin(yaw)
        corners = scale * self._shapes[i] @ np.array([[cos, sin], [-sin, cos]]) + place
        support = (corners @ directions().T).max(axis=0)
        others = np.concatenate([self._supports[near], self._walls])
        if support.max() > self._radius or (gaps(others, support) < _GAP_M).any():
            return False
        self.poses[i], self.scales[i], self._places[i], self._supports[i] = pose, scale, place, support
        return True
