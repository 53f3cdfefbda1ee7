"""Where an object of the current scene stands, and what it covers."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from toolkit.geometry import invert, make_transform, transform_points
from toolkit.types import Float


@dataclass(frozen=True, eq=False)
class Extent:
    """The upright box around what was seen of an object, and its outline from above.

    Attributes:
        T_world_box: (4, 4) float64 pose: the origin the box's middle, z up from the table, x and y so that it covers
            least of the table.
        size: (3,) float64 along its own axes, metres.
        footprint: (N, 3) float64 world points of the convex outline, at the lowest point, counter-clockwise from above.
    """

    T_world_box: Float
    size: Float
    footprint: Float


def measure_extent(points: Float, T_world_level: Float) -> Extent:
    """Measure an object.

    Args:
        points: (N, 3) world points of it, at least one.
        T_world_level: (4, 4) from a frame with z up from the table (`Database.T_world_level`).
    """
    level = transform_points(invert(T_world_level), np.asarray(points, np.float64))
    middle, low, high = level[:, :2].mean(axis=0), level[:, 2].min(), level[:, 2].max()
    flat = (level[:, :2] - middle).astype(np.float32)
    (x, y), (width, depth), degrees = cv2.minAreaRect(flat)
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    center = np.array([middle[0] + x, middle[1] + y, (low + high) / 2])
    outline = cv2.convexHull(flat)[:, 0].astype(np.float64) + middle
    footprint = np.column_stack([outline, np.full(len(outline), low)])
    return Extent(
        T_world_level @ make_transform(turn, center),
        np.array([width, depth, high - low], np.float64),
        transform_points(T_world_level, footprint),
    )
