"""Segments with depth -> regions with point clouds in world coordinates (Sec. Method A)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

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


def followed_instances(regions: Sequence[Region]) -> NDArray[np.int64] | None:
    """(R,) instance ids 0..K-1, numbered by first occurrence, where the segmenter followed every region's object.

    None where it did not say of each of R >= 1 regions which instance it shows.
    """
    named = [region.segment.instance for region in regions if region.segment.instance is not None]
    return numbered_by_occurrence(np.array(named)) if named and len(named) == len(regions) else None


def numbered_by_occurrence(labels: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
    """(R,) labels as ids 0..K-1, in the order in which they first occur."""
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[inverse].astype(np.int64)


def true_owner(true_masks: Mapping[int, Mask], where: Any) -> int:
    """The object whose true mask holds most of the pixels `where`, a (H, W) mask or rows and columns; -1 for none."""
    overlaps = {key: int(mask[where].sum()) for key, mask in true_masks.items()}
    owner = max(sorted(overlaps), key=overlaps.__getitem__, default=-1)
    return owner if overlaps.get(owner, 0) > 0 else -1
