"""How the table lies in the user's world.

Stages take the table for level: objects turn about z and slide along x and y. No world has to be so, and most arms',
trackers' and cameras' are not. So the pipeline works in the table's own frame, and motions are taken back at the end.
This frame is near, too: points are kept as float32, good for a tenth of a micrometre within two metres of the origin.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from toolkit.errors import ToolkitError
from toolkit.geometry import make_transform, orthonormalize
from toolkit.perception.tabletop.table import Table, find_table
from toolkit.types import Float, Frame

_LEAST_SLOPE = 0.2


def measure_level(frames: Sequence[Frame]) -> Float | None:
    """Measure how the table lies in the world of RGB-D frames.

    Returns:
        (4, 4) T_world_table: z up from the table, y the way the first camera looks, the origin where that meets the
        table. It depends on nothing but the frames, so that captures that differ only in their world are the same in
        it. None where no table is found.
    """
    try:
        table = find_table(frames)
    except ToolkitError:
        return None
    normal, height = _plane(table)
    eye, right, ahead = (frames[0].camera.T_world_camera[:3, i] for i in (3, 0, 2))
    # `right` serves where the camera looks straight down; it never points along the normal then.
    x = np.cross(ahead, normal)
    x = x if np.linalg.norm(x) > _LEAST_SLOPE else right - (right @ normal) * normal
    x = x / np.linalg.norm(x)
    above = float(eye @ normal) - height
    met = eye + ahead * above / max(-float(ahead @ normal), _LEAST_SLOPE)
    origin = met - (float(met @ normal) - height) * normal
    return orthonormalize(make_transform(np.stack([x, np.cross(normal, x), normal], axis=1), origin))


def _plane(table: Table) -> tuple[Float, float]:
    """The plane as the frames have it on average: its normal (3,), and its level along that.

    Every frame's plane is fitted to the bare table alone; the one of all frames has feet of objects in it.
    """
    seen = table.seen()
    normal = np.mean([frame.camera.T_world_camera[:3, :3] @ plane.normal for frame, plane in seen], axis=0)
    normal /= np.linalg.norm(normal)
    heights = [frame.camera.T_world_camera[:3, 3] @ normal - plane.camera_height for frame, plane in seen]
    return normal, float(np.median(heights))
