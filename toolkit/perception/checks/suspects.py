"""What people often write into scene_camera.json instead of what is meant, undone, and how to say so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from toolkit.geometry import invert
from toolkit.types import Camera, Float

_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])

_BODY_OPTICAL = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""From a camera's optical axes into those of ROS's bodies (REP 103): x forward, y left, z up."""


@dataclass(frozen=True)
class Suspect:
    """One mistake.

    Attributes:
        undo: from a stated (4, 4) T_world_camera to the one that was meant.
        cause: what it is.
        remedy: what to do about it.
    """

    undo: Callable[[Float], Float]
    cause: str
    remedy: str

    @property
    def sentence(self) -> str:
        """Cause and remedy."""
        return f"{self.cause}{' ' if self.cause.endswith('?') else '; '}{self.remedy}"


def _unturn(T: Float) -> Float:
    V = invert(T)
    V[:3, :3] = V[:3, :3].T
    return invert(V)


_SIGN = "multiply each camera-to-world pose by diag(1, -1, -1, 1) from the right before it is inverted and written"
_SWAP = "cam_R_w2c and cam_t_w2c take world points into the camera: invert the poses before they are written"

AXES = (
    Suspect(lambda T: T @ _FLIP, "the cameras' axes look like OpenGL's, with y up and z backwards", _SIGN),
    Suspect(invert, "the poses look like camera-to-world ones", _SWAP),
    Suspect(
        lambda T: invert(T) @ _FLIP,
        "the poses look like camera-to-world ones in OpenGL's axes",
        f"{_SWAP}, and {_SIGN}",
    ),
    Suspect(
        lambda T: T @ _BODY_OPTICAL,
        "the cameras' axes look like those of a body in ROS, with x forward and z up",
        "give the poses of the optical frames",
    ),
    Suspect(_unturn, "cam_R_w2c looks transposed", "write it row by row"),
)

FLIPS = {"mirrored left to right": (1,), "upside down": (0, 1)}
"""What cameras' programs do to images for people to look at: axes to flip them along."""

STORE = "store images as the camera's lens projects them, colour and depth alike"

_FACTORS = (1000.0, 100.0, 10.0, 4.0, 2.54, 2.5, 2.0, 0.5, 0.4, 0.25, 0.1, 0.01, 0.001)


def resized(camera: Camera, factor: float) -> Camera:
    """A camera whose cam_K was given for pictures `factor` times as small."""
    K = camera.K.copy()
    K[:2] *= factor
    return replace(camera, K=K)


SIZES = {2.0: "half", 0.5: "twice"}
"""By how much a cam_K of pictures of another size is wrong, and what size that is."""

CAM_K = "give the cam_K of the pictures as they are stored"


def rescaled(factor: float) -> Callable[[Float], Float]:
    """Poses with places `factor` times as far from the world's origin."""

    def undo(T: Float) -> Float:
        scaled = T.copy()
        scaled[:3, 3] *= factor
        return scaled

    return undo


def scales(height: float, baseline: float) -> tuple[Suspect, ...]:
    """Wrong units. Whether poses or depth have them shows in how far the table is, `height` metres.

    Args:
        height: of the cameras above the table, by depth.
        baseline: largest distance between two cameras, metres, by their poses.
    """
    measured = f"the cameras are up to {length(baseline)} apart and see a table {length(height)} away"
    return tuple(Suspect(rescaled(factor), f"{measured}: {_unit(factor, height)}", _REMEDY) for factor in _FACTORS)


_REMEDY = "cam_t_w2c is in millimetres, and depth_scale in millimetres per unit of the depth images"
_NEAREST_M, _FURTHEST_M = 0.1, 4.0
_UNITS = {1000.0: "metres", 100.0: "decimetres", 10.0: "centimetres"}


def _unit(factor: float, height: float) -> str:
    if not _NEAREST_M < height < _FURTHEST_M:
        return f"is depth_scale {max(factor, 1 / factor):g} times too {'large' if factor > 1 else 'small'}?"
    if factor in _UNITS:
        return f"are the poses in {_UNITS[factor]}?"
    return f"depth is {factor:g} times what the poses say, is depth_scale right?"


def length(metres: float) -> str:
    """A distance as a person would say it."""
    if metres < 0.01:
        return f"{metres * 1000:.2g} mm"
    return f"{metres * 100:.0f} cm" if metres < 1 else f"{metres:.1f} m"
