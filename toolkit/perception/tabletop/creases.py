"""Where one object may end and the next begin: creases between surfaces, and slopes that no camera sees well.

Objects are mostly convex, and where two of them meet the surface is concave (Stein et al., "Object partitioning using
local convexity", CVPR 2014).
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from toolkit.perception.tabletop.plane import pixel_rays
from toolkit.perception.tabletop.refine import window
from toolkit.perception.tabletop.relief import Relief
from toolkit.types import Float, Image, Mask

_PIXEL_M = 0.0012
"""Finer pixels are joined until they are about this large: close up, noise would have creases of its own."""

_REACH_M = 0.009
"""How far to either side of a crease the surfaces are looked at."""

_CREASE_DEG, _COLOUR_DEG, _LEAST_DEG = 38.0, 20.0, 12.0
"""A concave angle that parts; a change of colour counts for so much of it where there is some angle at all."""

_CONTRAST = 40.0
"""Grey levels between two sides that are a full change of colour."""

_FLATTEST_VIEW = 0.3
"""Cosine between a surface's normal and the ray: flatter is seen too badly, or is smeared depth."""

_DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))
_OPENED_M = 0.003
_MARGIN = 40
"""Pixels around what stands on the table that are looked at with it."""


def smooth_parts(relief: Relief) -> tuple[Mask, Float]:
    """Pixels inside smooth, convex parts of what is not the table's plane.

    Returns:
        (H, W) bool, surfaces without their creases and slopes, also those beyond the table; and (H, W) float32 degrees,
        how concave the surface is at every pixel, a change of colour counted in.
    """
    depth = relief.frame.depth
    assert depth is not None
    smooth, concave = np.zeros(depth.shape, bool), np.zeros(depth.shape, np.float32)
    if not relief.things.any():
        return smooth, concave
    pixel_m = _pixel(relief)
    stride = max(1, round(_PIXEL_M / pixel_m))
    box = window(relief.things, _MARGIN * stride)
    inverse = np.where(depth > 0, 1 / np.maximum(depth, 1e-6), 0).astype(np.float32)[box]
    angle, facing = _shape(_joined(inverse, stride), pixel_rays(relief.frame)[box], relief, stride)
    angle, facing = _spread(angle, stride, inverse.shape), _spread(facing, stride, inverse.shape)
    colour = _contrast(relief.frame.rgb[box], max(3, round(_REACH_M / pixel_m / 2)))
    bent = angle.clip(0, 90) + _COLOUR_DEG * (colour / _CONTRAST).clip(0, 1) * (angle > _LEAST_DEG)
    surface = relief.solid[box] & ~relief.level[box]
    radius = max(1, round(_OPENED_M / pixel_m))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    inner = (surface & (bent < _CREASE_DEG) & (facing > _FLATTEST_VIEW)).astype(np.uint8)
    smooth[box] = cv2.morphologyEx(inner, cv2.MORPH_OPEN, kernel) > 0
    concave[box] = bent
    return smooth, concave


def _pixel(relief: Relief) -> float:
    """Side of a pixel on what stands on the table, metres."""
    depth = relief.frame.depth
    assert depth is not None
    return float(np.median(depth[relief.things]) / relief.frame.camera.K[0, 0])


def _joined(inverse: Float, stride: int) -> Float:
    """Medians of what is measured in blocks of pixels; 0 where less than half is."""
    if stride == 1:
        return inverse
    height, width = (side // stride for side in inverse.shape)
    blocks = inverse[: height * stride, : width * stride].reshape(height, stride, width, stride)
    ordered = np.sort(blocks.swapaxes(1, 2).reshape(height, width, -1), axis=2)
    count = (ordered > 0).sum(axis=2)
    middle = (ordered.shape[2] - 1 - (count - 1) // 2).clip(0, ordered.shape[2] - 1)
    median = np.take_along_axis(ordered, middle[..., None], axis=2)[..., 0]
    return np.where(2 * count >= ordered.shape[2], median, 0)


def _spread(image: Float, stride: int, shape: tuple[int, ...]) -> Float:
    """An image of joined pixels in the pixels they were joined from."""
    if stride == 1:
        return image
    large = np.repeat(np.repeat(image, stride, axis=0), stride, axis=1)
    return np.pad(large, [(0, a - b) for a, b in zip(shape, large.shape, strict=True)], mode="edge")


def _shape(inverse: Float, rays: Float, relief: Relief, stride: int) -> tuple[Float, Float]:
    """How concave the surface is, degrees (-180 where that cannot be seen), and the cosine it is seen under."""
    if not inverse.any():
        return np.full(inverse.shape, -180, np.float32), np.zeros(inverse.shape, np.float32)
    reach = 3 * relief.plane.noise / stride + 0.004 * float(np.median(inverse[inverse > 0]))
    smooth = cv2.bilateralFilter(cv2.bilateralFilter(inverse, 7, reach, 1.5), 7, reach, 1.5)
    measured = (inverse > 0) & (smooth > 0)
    depth = np.where(measured, 1 / np.maximum(smooth, 1e-6), 0).astype(np.float32)
    rays = rays[stride // 2 :: stride, stride // 2 :: stride][: depth.shape[0], : depth.shape[1]]
    # Coordinates come first, so that NumPy adds whole planes.
    points = np.ascontiguousarray(np.moveaxis(rays, -1, 0)) * depth
    normal = np.cross(
        _moved(points, 0, 2) - _moved(points, 0, -2), _moved(points, 2, 0) - _moved(points, -2, 0), axis=0
    )
    normal /= np.maximum(_length(normal), 1e-9)
    toward = (normal * points).sum(axis=0)
    normal *= -np.sign(toward)
    facing = np.abs(toward) / np.maximum(_length(points), 1e-6)
    pixel_m = stride * float(np.median(depth[measured])) / relief.frame.camera.K[0, 0]
    step = int(np.clip(round(_REACH_M / pixel_m), 3, 12))
    sine = np.full(depth.shape, -1.0, np.float32)
    for y, x in _DIRECTIONS:
        away = step if x * y == 0 else max(2, round(0.75 * step))
        one, other = _moved(points, y * away, x * away) - points, _moved(points, -y * away, -x * away) - points
        seen = measured & _moved(measured, y * away, x * away) & _moved(measured, -y * away, -x * away)
        bend = one / np.maximum(_length(one), 1e-9) + other / np.maximum(_length(other), 1e-9)
        half = _length(bend) / 2 * np.sign((bend * normal).sum(axis=0))
        sine = np.maximum(sine, np.where(seen, half, -1.0))
    return np.degrees(2 * np.arcsin(sine.clip(-1, 1))).astype(np.float32), facing.astype(np.float32)


def _length(vectors: Float) -> Float:
    """(H, W) of (3, H, W)."""
    return np.sqrt((vectors * vectors).sum(axis=0))


def _contrast(rgb: Image, step: int) -> Float:
    """(H, W) float32 grey levels between what lies to either side of a pixel, brightness at half weight."""
    r, g, b = np.moveaxis(cv2.GaussianBlur(rgb, (0, 0), 1.5).astype(np.float32), -1, 0)
    colours = np.stack([(r + g + b) / 6, (r - g) / 2, (r + g) / 4 - b / 2])
    most = np.zeros(rgb.shape[:2], np.float32)
    for y, x in _DIRECTIONS:
        away = step if x * y == 0 else max(2, round(0.75 * step))
        gap = np.abs(_moved(colours, y * away, x * away) - _moved(colours, -y * away, -x * away)).sum(axis=0)
        most = np.maximum(most, gap)
    return most


def _moved(image: Any, y: int, x: int) -> Any:
    """(..., H, W) as seen from (y, x) pixels further on; what comes in over the border is from the other side."""
    return np.roll(image, (-y, -x), axis=(-2, -1))
