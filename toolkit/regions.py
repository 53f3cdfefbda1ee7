"""Segments with depth -> regions with point clouds in world coordinates (Sec. Method A)."""

from __future__ import annotations

import numpy as np

from toolkit.errors import ToolkitError
from toolkit.geometry import lift, observation_vector
from toolkit.types import Failure, Frame, Region, Segment

MIN_POINTS = 10
"""A region with fewer measured points says nothing about where its object is."""


def lift_segment(frame: Frame, segment: Segment) -> Region | Failure:
    """Lift the measured pixels of a segment to world points.

    Returns:
        The region, or a Failure where fewer than MIN_POINTS pixels have depth.

    Raises:
        ToolkitError: the frame has no depth at all.
    """
    if frame.depth is None:
        raise ToolkitError(f"frame {frame.index} has no depth to lift a segment with")
    rows, columns = np.nonzero(segment.mask & (frame.depth > 0))
    if len(rows) < MIN_POINTS:
        return Failure("segmenter", f"frame {frame.index}: only {len(rows)} of a region's pixels have depth")
    pixels = np.stack([columns, rows], axis=1).astype(np.int32)
    camera = frame.camera
    points = lift(camera.K, camera.T_world_camera, pixels.astype(np.float64), frame.depth[rows, columns])
    observation = observation_vector(camera.T_world_camera, points)
    return Region(frame.index, segment, points.astype(np.float32), pixels, observation)
