"""What one frame's depth says about the table: how high every pixel is, and which pixels stand on it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from toolkit.geometry import invert, transform_points
from toolkit.perception.robust import deviation
from toolkit.perception.tabletop.plane import Plane, pixel_rays
from toolkit.perception.tabletop.table import Table
from toolkit.types import Float, Frame, Mask

_STEP_NOISES, _STEEPEST = 4.0, 0.012
"""Neighbouring pixels of one surface differ by this many deviations and by this part of their inverse depth at most."""

_LEAST_NEIGHBOURS = 6
"""Of the eight around a pixel that are to lie on its surface: along an edge five do, and fewer where a pixel flies."""

_SMOOTH_PX = 1.5
_HIGH, _LOW = 5.0, 2.5
"""Hysteresis, in deviations of the smoothed table: something stands here, and it reaches as far as this."""

_TALLEST_M = 0.5


@dataclass(frozen=True, eq=False)
class Relief:
    """One frame against the table.

    Attributes:
        frame: with depth.
        plane: the table before its camera.
        places: (H, W, 3) float32 in the table's frame, metres; z is the height above the frame's own plane.
        solid: (H, W) bool, measured and on a surface.
        things: (H, W) bool, solid, within the table's outline, and higher than its noise.
        certain: (H, W) bool, those of them that are clearly higher.
        bare: (H, W) bool, the table itself.
        level: (H, W) bool, what lies on its plane, within the outline and beyond.
        unsure: (H, W) bool, not measured, or flying above the table: it may belong to what is beside it.
    """

    frame: Frame
    plane: Plane
    places: Float
    solid: Mask
    things: Mask
    certain: Mask
    bare: Mask
    level: Mask
    unsure: Mask


@lru_cache(maxsize=4)
def survey(table: Table, min_height: float) -> tuple[Relief, ...]:
    """One relief for each frame that sees the table; arguments as `relief`. Those of the last tables are kept."""
    return tuple(relief(frame, plane, table, min_height) for frame, plane in table.seen())


def relief(frame: Frame, plane: Plane, table: Table, min_height: float) -> Relief:
    """Measure a frame against the table.

    Args:
        frame: with depth.
        plane: the table before its camera.
        table: the table.
        min_height: metres; what is lower is table, also where depth is less noisy than that.
    """
    assert frame.depth is not None
    depth, rays = frame.depth, pixel_rays(frame)
    measured = depth > 0
    T = invert(table.T_world_table) @ frame.camera.T_world_camera
    places = transform_points(T, rays * depth[..., None]).astype(np.float32)
    raw = np.where(measured, plane.heights(rays, depth), 0).astype(np.float32)
    places[..., 2] = raw
    solid = measured & surfaces(depth, plane.noise)
    inside = measured & table.holds(places[..., :2])
    spread = plane.noise * plane.camera_height * depth
    # Far below the table is background, whose size must not bleed into what stands before it.
    height = _smoothed(raw.clip(-0.05, None), solid)
    flat = solid & inside & (np.abs(raw) < 3 * spread)
    left = float(deviation(height[flat] / spread[flat])) if flat.any() else 1.0
    low, high = np.maximum(min_height, _LOW * left * spread), np.maximum(min_height, _HIGH * left * spread)
    # Beside an object the table's smoothed height is in part the object's, but not the height that was measured.
    above = solid & (height > low) & (height < _TALLEST_M) & (raw > low - 3 * spread)
    things = above & inside
    flat = solid & (np.abs(height) < low)
    unsure = ~measured | (~solid & (raw > low))
    return Relief(frame, plane, places, solid, things, things & (height > high), flat & inside, flat, unsure)


def surfaces(depth: Float, noise: float) -> Mask:
    """(H, W) bool: pixels that lie on a surface, most of their neighbours on it too; the others fly between two.

    Args:
        depth: (H, W) metres, 0 where nothing was measured.
        noise: deviation of the inverse depth, 1/m.
    """
    inverse = np.where(depth > 0, 1 / np.maximum(depth, 1e-6), np.inf).astype(np.float32)
    reach = (_STEP_NOISES * noise + _STEEPEST * inverse).astype(np.float32)
    padded = np.pad(inverse, 1, constant_values=np.inf)
    height, width = depth.shape
    near = np.zeros(depth.shape, np.int8)
    with np.errstate(invalid="ignore"):
        for y in range(3):
            for x in range(3):
                near += np.abs(padded[y : y + height, x : x + width] - inverse) < reach
    return near - 1 >= _LEAST_NEIGHBOURS


def _smoothed(height: Float, where: Mask) -> Float:
    weight = where.astype(np.float32)
    total = cv2.GaussianBlur(height * weight, (0, 0), _SMOOTH_PX)
    return total / np.maximum(cv2.GaussianBlur(weight, (0, 0), _SMOOTH_PX), 1e-3)
