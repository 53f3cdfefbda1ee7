"""What objects cover of the table, seen from above: convex outlines, their distances and where they fit. Metres."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from toolkit.geometry import make_transform, rotation_z
from toolkit.types import Float

DIRECTIONS = 180
"""Supporting lines of an outline: a box's edge is at most 1 deg off the nearest, 2 mm on a side of 20 cm."""


@lru_cache(maxsize=1)
def directions() -> Float:
    """(D, 2) unit vectors in counter-clockwise order from x, evenly spaced."""
    angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


@dataclass(frozen=True, eq=False)
class Footprint:
    """A convex outline by its support function.

    Attributes:
        support: (D,) float64, by direction u the largest u . p over the object's points p, world coordinates.
    """

    support: Float

    @classmethod
    def of(cls, points: Float) -> Footprint:
        """The outline around (N, 2) or (N, 3) points, seen from above."""
        return cls((np.asarray(points, np.float64)[:, :2] @ directions().T).max(axis=0))

    @property
    def center(self) -> Float:
        """(2,) middle of the outline's box along x and y."""
        quarter = DIRECTIONS // 4
        right, top, left, bottom = self.support[::quarter]
        return np.array([right - left, top - bottom]) / 2

    @property
    def width(self) -> float:
        """Least distance of two parallel lines with the outline between them: what a gripper must span."""
        return float((self.support + np.roll(self.support, DIRECTIONS // 2)).min())

    def reach(self, center: Float) -> float:
        """Distance of the outline's furthest point from (2,) `center`."""
        return float((self.support - directions() @ center).max())

    def moved(self, shift: Float, steps: int = 0) -> Footprint:
        """The outline turned about its centre by `steps` of 360 / D degrees, then moved by (2,) `shift`."""
        center = self.center
        turned = np.roll(self.support - directions() @ center, steps)
        return Footprint(turned + directions() @ (center + shift))


def planar_motion(center: Float, shift: Float, steps: int = 0) -> Float:
    """(4, 4) motion that does to points what `Footprint.moved` does to an outline with that (2,) centre."""
    turn = rotation_z(2 * np.pi * steps / DIRECTIONS)
    pivot = np.array([*center, 0.0])
    T = make_transform(turn[:3, :3], pivot - turn[:3, :3] @ pivot)
    T[:2, 3] += shift
    return T


def gaps(a: Float, b: Float) -> Float:
    """Distances of outlines, negative where they overlap; never more than the true distance.

    Args:
        a: (..., D) supports.
        b: (..., D) supports, broadcast against `a`.

    Returns:
        (...) the widest gap along any direction: the separating axis, sampled.
    """
    return (-a - np.roll(b, DIRECTIONS // 2, axis=-1)).max(axis=-1)


def supports(footprints: list[Footprint]) -> Float:
    """(N, D) supports of footprints."""
    return np.array([footprint.support for footprint in footprints]).reshape(-1, DIRECTIONS)
