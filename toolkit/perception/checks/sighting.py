"""What one current frame sees on its own: a table, and what stands on it. No pose has a say in it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from toolkit.errors import ToolkitError
from toolkit.geometry import invert
from toolkit.perception.tabletop.plane import Plane, pixel_rays
from toolkit.perception.tabletop.table import find_table
from toolkit.types import Float, Frame

_ACROSS = 160
"""Points across an image that are looked at, whatever its size."""

_FLAT, _RAISED, _HIGH = 0.008, 0.025, 0.5
_SMOOTH = 0.02
"""Parts of the camera's height, so that wrong units change nothing."""

_THINNED = 7

_NEAR_M, _FAR_M = 0.15, 4.0


@dataclass(frozen=True, eq=False)
class Sighting:
    """A frame and the table it sees.

    Attributes:
        frame: the frame.
        plane: the table before its camera.
        flat: (M, 3) points of the bare table, camera coordinates, metres.
        raised: (N, 3) points of what stands on it, away from the edges of depth.
    """

    frame: Frame
    plane: Plane
    flat: Float
    raised: Float

    def scaled(self, unit: float, frame: Frame) -> Sighting:
        """What is seen, `unit` times as far away, in the frame that has it so."""
        plane = Plane(self.plane.coefficients / unit, self.plane.noise / unit)
        return Sighting(frame, plane, self.flat * unit, self.raised * unit)


def sight(frame: Frame) -> Sighting | None:
    """Find the table in one RGB-D frame; None where it shows none."""
    assert frame.depth is not None
    measured = frame.depth[frame.depth > 0]
    unit = float(np.median(measured)) if len(measured) else 1.0
    if not _NEAR_M < unit < _FAR_M:
        # A table is looked for by metres; in wrong ones it is found by bringing it as near as tables are.
        near = sight(replace(frame, depth=(frame.depth / unit).astype(np.float32)))
        return None if near is None else near.scaled(unit, frame)
    try:
        table = find_table((frame,))
    except ToolkitError:
        return None
    (plane,) = table.planes
    assert plane is not None
    step = max(frame.camera.width // _ACROSS, 1)
    kernel = np.ones((3, 3), np.uint8)
    jump = (cv2.dilate(frame.depth, kernel) - cv2.erode(frame.depth, kernel))[::step, ::step].ravel()
    depth, rays = frame.depth[::step, ::step], pixel_rays(frame)[::step, ::step]
    points = (rays * depth[..., None]).reshape(-1, 3)
    height = plane.heights(rays, depth).ravel() / plane.camera_height
    smooth = (depth.ravel() > 0) & (jump < _SMOOTH * depth.ravel())
    T = invert(table.T_world_table) @ frame.camera.T_world_camera
    on_it = smooth & table.holds(points @ T[:2, :3].T + T[:2, 3])
    flat, raised = on_it & (np.abs(height) < _FLAT), on_it & (height > _RAISED) & (height < _HIGH)
    return Sighting(frame, plane, points[flat][::_THINNED].astype(np.float64), points[raised].astype(np.float64))
