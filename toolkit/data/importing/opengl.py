"""What recordings of phones and radiance fields have in common: OpenGL's axes, and depth of low resolution."""

from __future__ import annotations

import cv2
import numpy as np

from toolkit.errors import ToolkitError
from toolkit.types import Float

_SAME_SHAPE = 0.02
"""Part by which the sides' ratios of depth and colour may differ: rounding to whole pixels."""


def from_opengl(T_world_camera: Float) -> Float:
    """(4, 4) pose with OpenCV's axes of one with OpenGL's (x right, y up, z backward)."""
    return T_world_camera @ np.diag([1.0, -1.0, -1.0, 1.0])


def low_resolution(depth: Float, size: tuple[int, ...]) -> Float:
    """Depth of lower resolution than its colour image, enlarged to (H, W) `size`: every pixel the nearest one's.

    Raises:
        ToolkitError: it is no smaller picture of the same.
    """
    height, width = size
    if depth.shape == (height, width):
        return depth
    ratio = (depth.shape[1] / depth.shape[0]) / (width / height)
    if depth.shape[0] > height or abs(ratio - 1) > _SAME_SHAPE:
        raise ToolkitError(
            f"depth of {depth.shape[1]}x{depth.shape[0]} is not a smaller picture of colour of {width}x{height}; "
            "align depth to colour"
        )
    return np.asarray(cv2.resize(depth, (width, height), interpolation=cv2.INTER_NEAREST_EXACT), np.float32)
