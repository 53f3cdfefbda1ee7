"""2D-2D correspondences to 2D-3D: depth at sub-pixel positions, pixels off the object dropped (Sec. Method A)."""

from __future__ import annotations

import numpy as np

from toolkit.errors import ToolkitError
from toolkit.geometry import lift
from toolkit.types import Camera, Correspondences, Crop, Float, Frame, Mask, Matches

_MAX_DEPTH_STEP_M = 0.01
"""Neighbouring pixels further apart than this lie on different surfaces: interpolating would invent a point."""


def lift_pixels(frame: Frame, mask: Mask, xy: Float) -> tuple[Float, Mask]:
    """Lift sub-pixel positions of a current frame to world points.

    Inverse depth is interpolated bilinearly (exact on planes). A position counts only where all four neighbours are
    on the object, measured, and on one surface.

    Args:
        frame: a frame with depth.
        mask: (H, W) bool, the object.
        xy: (M, 2) pixels.

    Returns:
        (M, 3) float64 world points in metres (rows not kept are meaningless but finite) and (M,) bool kept.

    Raises:
        ToolkitError: the frame has no depth.
    """
    if frame.depth is None:
        raise ToolkitError(f"frame {frame.index} has no depth to lift pixels with")
    height, width = mask.shape
    corner = np.floor(xy).astype(np.int64)
    inside = (corner >= 0).all(axis=1) & (corner[:, 0] < width - 1) & (corner[:, 1] < height - 1)
    x, y = np.where(inside[:, None], corner, 0).T
    rows, columns = y[:, None] + [0, 0, 1, 1], x[:, None] + [0, 1, 0, 1]
    depths = frame.depth[rows, columns].astype(np.float64)
    kept = inside & mask[rows, columns].all(axis=1) & (depths > 0).all(axis=1)
    kept &= np.ptp(depths, axis=1) < _MAX_DEPTH_STEP_M
    fx, fy = (np.asarray(xy, np.float64) - corner).T
    weights = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], axis=1)
    inverse = np.where(kept, (weights / np.where(depths > 0, depths, 1.0)).sum(axis=1), 1.0)
    return lift(frame.camera.K, frame.camera.T_world_camera, xy, 1.0 / inverse), kept


def lift_matches(
    matches: Matches, query: Crop, reference: Crop, frame: Frame, mask: Mask, camera: Camera
) -> Correspondences:
    """Turn matches between a goal crop and a candidate crop into 2D-3D correspondences (M_3D).

    Args:
        matches: crop pixels; the query is the goal.
        query: the goal crop.
        reference: the candidate crop.
        frame: the current frame the candidate was cut from.
        mask: (H, W) bool, the candidate's mask in that frame.
        camera: the goal camera.
    """
    points, kept = lift_pixels(frame, mask, reference.to_image(matches.reference_xy))
    return Correspondences(points[kept], query.to_image(matches.query_xy)[kept], matches.scores[kept], camera)


def merge(parts: list[Correspondences]) -> Correspondences:
    """Join the correspondences of several candidates of one instance into one problem; parts must not be empty."""
    return Correspondences(
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.pixels for part in parts]),
        np.concatenate([part.weights for part in parts]),
        parts[0].camera,
    )
