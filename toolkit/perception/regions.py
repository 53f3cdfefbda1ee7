"""Segments with depth -> regions with point clouds in world coordinates (Sec. Method A)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from toolkit.errors import ToolkitError
from toolkit.geometry import lift, observation_vector
from toolkit.types import Failure, Frame, Mask, Region, Segment

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


def true_owner(true_masks: Mapping[int, Mask], where: Any) -> int:
    """The object whose true mask holds most of the pixels `where`, a (H, W) mask or rows and columns; -1 for none."""
    overlaps = {key: int(mask[where].sum()) for key, mask in true_masks.items()}
    owner = max(sorted(overlaps), key=overlaps.__getitem__, default=-1)
    return owner if overlaps.get(owner, 0) > 0 else -1
