"""Depth images as they are stored -> metres, with 0 where nothing was measured."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.errors import ToolkitError
from toolkit.types import Float

NOT_MEASURED = 65535
"""What cameras write, besides 0, where they measured nothing."""

_NEAR_M, _FAR_M = 0.02, 100.0
"""Nothing that a depth camera measures is nearer, and nothing on a table is farther."""

_ALONE = 1.2
"""A far plane is so many times as far away as all that was measured."""

_LEAST_SHARE = 0.001
_PIECES = 20
"""A far plane fills at least so many holes in what was measured, where a wall would be a few large pieces."""


def metres(raw: NDArray[Any], scale_mm: float, path: Path, where: str) -> Float:
    """Scale a depth image; what is no length (0, 65535, NaN, infinite, negative) was not measured.

    Args:
        raw: (H, W) as it is stored.
        scale_mm: millimetres of one unit.
        path: its file, for the answer.
        where: file and image that state the scale, for the answer.

    Returns:
        (H, W) float32 metres.

    Raises:
        ToolkitError: most of it is nearer than 2 cm or farther than 100 m, so the scale is not that of the file.
    """
    kind = raw.dtype.kind
    values = raw.astype(np.float64)
    measured = np.isfinite(values) & (values > 0)
    if kind == "f" or raw.dtype == np.uint16:
        measured &= values != NOT_MEASURED
    with np.errstate(over="ignore"):
        depth = np.where(measured, np.where(measured, values, 0) * (scale_mm / 1e3), 0).astype(np.float32)
    middle = float(np.median(depth[measured])) if measured.any() else 1.0
    if not _NEAR_M <= middle < _FAR_M:
        stored = (
            "floats in metres need 1000, in millimetres 1"
            if kind == "f"
            else "whole millimetres need 1, tenths of them 0.1"
        )
        raise ToolkitError(
            f"'{path}' measures {middle:.3g} m in the middle, by the depth_scale {scale_mm:g} (millimetres per unit) "
            f"of {where}; {stored}"
        )
    return depth


def far_plane(depth: Float) -> float | None:
    """The one value that stands for "nothing measured" in an image, if there is one.

    It is the farthest, far behind all others, in at least 0.1 % of the pixels, and in many pieces.

    Args:
        depth: (H, W) float32 metres, 0 where nothing was measured.
    """
    farthest = float(depth.max(initial=0))
    plane = depth == depth.max(initial=0)
    others = (depth > 0) & ~plane
    if farthest == 0 or not others.any() or plane.mean() < _LEAST_SHARE or farthest < _ALONE * depth[others].max():
        return None
    pieces = cv2.connectedComponents(plane.astype(np.uint8))[0] - 1
    return farthest if pieces >= _PIECES else None
