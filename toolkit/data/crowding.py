"""Objects that stand against each other, or behind each other as seen from home. Metres, radians."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from toolkit.data.cameras import HOME_AZIMUTH
from toolkit.data.layout import Placement, RestingObject
from toolkit.types import Float

_TOUCHING_M = 0.005
"""Two that touch are at most this far apart."""

_BEHIND_RAD = np.radians(35)
"""How far to the side of straight behind an object may stand."""

_HIDES = 0.7
"""Behind an object, within this part of its height, another is partly hidden: cameras look down at about 45 deg."""

_TALL_M = 0.05
"""Lower objects hide nothing."""


class Crowd:
    """Half of those that are crowded stand side by side with another, the other half behind one.

    Footprints are compared exactly, so that what touches does not cut into what it touches.

    Args:
        share: of the objects that are crowded, 0 to 1.
        rng: the source of chance.
    """

    def __init__(self, share: float, rng: np.random.Generator) -> None:
        self._share = share
        self._rng = rng

    def anchor(self, objects: Sequence[RestingObject], placed: Mapping[int, Placement]) -> int | None:
        if not placed or self._rng.random() >= self._share:
            return None
        return int(self._rng.choice(sorted(placed)))

    def place(self, resting: RestingObject, yaw: float, anchor: RestingObject, at: Placement) -> Placement:
        if anchor.height > _TALL_M and self._rng.random() < 0.5:
            # Home looks along +y: behind is further along.
            angle = HOME_AZIMUTH + np.pi + self._rng.uniform(-_BEHIND_RAD, _BEHIND_RAD)
            gap = self._rng.uniform(_TOUCHING_M, _HIDES * anchor.height)
        else:
            angle = self._rng.uniform(-np.pi, np.pi)
            gap = self._rng.uniform(0, _TOUCHING_M)
        direction = np.array([np.cos(angle), np.sin(angle)])
        way = _reach(_turned(anchor.outline, at.yaw), _turned(resting.outline, yaw), direction, gap)
        return Placement(at.x + way * float(direction[0]), at.y + way * float(direction[1]), yaw)

    def collides(self, a: RestingObject, at: Placement, b: RestingObject, b_at: Placement) -> bool:
        offset = np.array([b_at.x - at.x, b_at.y - at.y])
        normals, sums = _separations(_turned(a.outline, at.yaw), _turned(b.outline, b_at.yaw))
        return bool((normals @ offset - sums).max() < 0)


def _turned(outline: Float, yaw: float) -> Float:
    c, s = np.cos(yaw), np.sin(yaw)
    return outline @ np.array([[c, s], [-s, c]])


def _separations(a: Float, b: Float) -> tuple[Float, Float]:
    """Unit normals (N, 2) of all edges, and how far along each b's origin must be from a's for them to be apart.

    Two convex polygons are apart exactly where one of their edges separates them (separating axis theorem).
    """
    normals = np.concatenate([_normals(a), -_normals(b)])
    return normals, (a @ normals.T).max(axis=0) + (-b @ normals.T).max(axis=0)


def _normals(outline: Float) -> Float:
    edges = np.roll(outline, -1, axis=0) - outline
    edges = edges[np.linalg.norm(edges, axis=1) > 1e-9]
    outward = np.stack([edges[:, 1], -edges[:, 0]], axis=1)
    return outward / np.linalg.norm(outward, axis=1, keepdims=True)


def _reach(a: Float, b: Float, direction: Float, gap: float) -> float:
    """How far along a direction b's origin must be from a's for an edge to keep them `gap` apart."""
    normals, sums = _separations(a, b)
    along = normals @ direction
    forward = along > 1e-6
    return float(((sums[forward] + gap) / along[forward]).min())
