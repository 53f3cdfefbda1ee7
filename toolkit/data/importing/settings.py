"""Numbers that people give on the command line: intrinsics, and poses of one thing on another."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field
from scipy.spatial.transform import Rotation

from toolkit.data.bop.poses import rigid
from toolkit.errors import ToolkitError
from toolkit.files import read_json
from toolkit.geometry import make_transform
from toolkit.types import Float


def _numbers(*counts: int) -> BeforeValidator:
    """Numbers as a list, or as text with spaces or semicolons between them, since commas part the values of --set."""

    def read(value: Any) -> tuple[float, ...]:
        parts = value.replace(";", " ").split() if isinstance(value, str) else value
        numbers = tuple(float(part) for part in parts)
        if len(numbers) not in counts or not np.isfinite(numbers).all():
            raise ValueError(f"{' or '.join(map(str, counts))} numbers are wanted, with spaces between them")
        return numbers

    return BeforeValidator(read)


Intrinsics = Annotated[
    tuple[float, ...],
    _numbers(4),
    Field(description="`fx fy cx cy` in pixels, the centre of the top-left pixel at 0 0"),
]
Distortion = Annotated[
    tuple[float, ...],
    _numbers(0, 4, 5, 8, 12, 14),
    Field(description="lens distortion in OpenCV's order `k1 k2 p1 p2 ...`"),
]
HandEye = Annotated[
    tuple[float, ...],
    _numbers(7, 16),
    Field(
        description="pose of the colour camera (OpenCV axes) on the body that the poses are of, metres: "
        "`x y z qx qy qz qw`, or 16 numbers row by row"
    ),
]
DepthScale = Annotated[float, Field(gt=0, description="millimetres of one unit of the depth images")]


def matrix(intrinsics: tuple[float, ...]) -> Float:
    """(3, 3) camera matrix of fx, fy, cx, cy."""
    fx, fy, cx, cy = intrinsics
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])


def pose(numbers: tuple[float, ...], where: str) -> Float:
    """(4, 4) pose of x y z qx qy qz qw, or of 16 numbers row by row; raises ToolkitError where it is not rigid."""
    if len(numbers) == 16:
        return rigid(np.array(numbers).reshape(4, 4), where)
    turn = np.array(numbers[3:])
    if not 0.9 < np.linalg.norm(turn) < 1.1:
        raise ToolkitError(f"{where}: qx qy qz qw is not of length 1, got {' '.join(map(str, turn.tolist()))}")
    return make_transform(Rotation.from_quat(turn).as_matrix(), np.array(numbers[:3]))


def body_to_camera(hand_eye: tuple[float, ...] | None) -> Float:
    """(4, 4) T_body_camera of the setting `hand_eye`; the camera is the body where it is left out."""
    return np.eye(4) if hand_eye is None else pose(hand_eye, "hand_eye")


def told_pose(text: str, where: str) -> Float:
    """(4, 4) pose of text, `x y z qx qy qz qw` or 16 numbers row by row; raises ToolkitError where it is none."""
    try:
        numbers = tuple(map(float, text.replace(",", " ").split()))
    except ValueError:
        numbers = ()
    if len(numbers) not in (7, 16):
        raise ToolkitError(f"{where} must be `x y z qx qy qz qw` or 16 numbers row by row, got '{text.strip()}'")
    return pose(numbers, where)


def open3d_intrinsics(path: Path) -> Float:
    """(3, 3) camera matrix of Open3D's PinholeCameraIntrinsic as JSON, which stores it column by column.

    Raises:
        ToolkitError: it is no such file.
    """
    data = read_json(path)
    values = data.get("intrinsic_matrix") if isinstance(data, dict) else None
    if not isinstance(values, list) or len(values) != 9 or not all(isinstance(v, int | float) for v in values):
        raise ToolkitError(f"'{path}' holds no intrinsic_matrix of 9 numbers, as Open3D writes it")
    return np.array(values, np.float64).reshape(3, 3).T
