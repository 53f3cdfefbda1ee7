"""Poses from files: millimetres and rounded numbers -> rigid transforms in metres."""

from __future__ import annotations

import numpy as np

from toolkit.data.bop.schemas import CameraEntry
from toolkit.errors import ToolkitError
from toolkit.geometry import is_rigid, make_transform, orthonormalize
from toolkit.types import Float

_TOLERANCE = 1e-3
"""Poses rounded in files are this far from orthonormal at most."""


def rigid(T: Float, where: str) -> Float:
    """(4, 4) the nearest rigid transform; raises ToolkitError where that is farther than rounding explains."""
    with np.errstate(all="ignore"):
        nearest = orthonormalize(T)
        off = np.abs(nearest - T).max()
    if not off <= _TOLERANCE or not is_rigid(nearest):
        raise ToolkitError(
            f"{where}: the pose is not rigid (its rotation is not orthonormal); write all its digits, row by row"
        )
    return T if is_rigid(T) else nearest


def world_to_camera(entry: CameraEntry, where: str) -> Float:
    """(4, 4) T_camera_world of an entry of scene_camera.json, metres; raises ToolkitError where it is not rigid."""
    return rigid(make_transform(np.array(entry.cam_R_w2c).reshape(3, 3), np.array(entry.cam_t_w2c) / 1e3), where)
