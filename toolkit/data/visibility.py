"""How much of every object a camera sees, from outlines alone: quick enough to draw scenes again until all are seen."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from toolkit.geometry import invert, project
from toolkit.types import Camera, Float, Image

_SCALE = 0.25
_MARGIN = 0.5
"""Outlines are drawn on a sheet this much larger on every side, so that what leaves the picture counts as unseen."""


def visible_shares(bodies: Sequence[Float], camera: Camera, veils: Sequence[Float] = ()) -> Float:
    """Share of every body's outline that is in the picture and not hidden by a nearer body.

    Args:
        bodies: (N, 3) points of each in world coordinates; the outline is that of their convex hull.
        camera: that looks.
        veils: (N, 3) points of what hides all bodies and is none itself.

    Returns:
        (B,) 0 to 1; 0 for a body that reaches behind the camera.
    """
    sheets = [_outline(points, camera) for points in bodies]
    distances = [float(np.linalg.norm(points.mean(axis=0) - camera.T_world_camera[:3, 3])) for points in bodies]
    owner = np.full(sheets[0].shape, -1) if sheets else np.zeros((0, 0), int)
    for i in sorted(range(len(bodies)), key=lambda i: -distances[i]):
        owner[sheets[i] > 0] = i
    for points in veils:
        owner[_outline(points, camera) > 0] = -1
    top, left = round(_MARGIN * camera.height * _SCALE), round(_MARGIN * camera.width * _SCALE)
    inside = owner[top : top + round(camera.height * _SCALE), left : left + round(camera.width * _SCALE)]
    return np.array([(inside == i).sum() / max(int((sheet > 0).sum()), 1) for i, sheet in enumerate(sheets)])


def _outline(points: Float, camera: Camera) -> Image:
    """(H, W) sheet, 1 inside the outline."""
    size = np.array([camera.height, camera.width]) * (1 + 2 * _MARGIN) * _SCALE
    sheet = np.zeros(np.rint(size).astype(int), np.uint8)
    pixels, depth = project(camera.K, invert(camera.T_world_camera), points)
    if (depth > 0).all():
        moved = (pixels + _MARGIN * np.array([camera.width, camera.height])) * _SCALE
        cv2.fillConvexPoly(sheet, cv2.convexHull(np.rint(moved).astype(np.int32)), 1)
    return sheet
