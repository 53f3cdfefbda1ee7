"""Space that no camera saw into: behind, below and inside what stands on the table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial import KDTree

from toolkit.geometry import invert, project
from toolkit.types import Float, Frame, Mask

_SIDE_M = 0.01
_BEHIND_M = 0.005
"""Space this far behind a surface is hidden by it; measured depths are no truer than that."""

_AROUND_M = 0.25
_OWN_M = 0.05


def hidden_space(frames: Sequence[Frame], clouds: Mapping[int, Float]) -> tuple[dict[int, Float], Float]:
    """What lies behind a surface in some frame, and is seen to be empty in none.

    Args:
        frames: of the table as it is, with depth.
        clouds: by instance, (N, 3) seen points of it, world coordinates, z up; what is looked at is their
            surroundings, 25 cm to every side and up to the highest of them.

    Returns:
        By instance, the (M, 3) middles of such space within 5 cm of its points, nearest instance first served, every
        centimetre; and those of all other such space, which may be of things that are no instance.
    """
    nothing = np.zeros((0, 3))
    if not clouds:
        return {}, nothing
    points = np.concatenate(list(clouds.values()))
    around = np.array([_AROUND_M, _AROUND_M, -_SIDE_M])
    low, high = points.min(axis=0) - around, points.max(axis=0) + np.abs(around)
    axes = [np.arange(a, b, _SIDE_M) for a, b in zip(low, high, strict=True)]
    space = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    behind, empty = np.zeros(len(space), bool), np.zeros(len(space), bool)
    for frame in frames:
        hides, shows = _looks_into(frame, space)
        behind |= hides
        empty |= shows
    space = space[behind & ~empty]
    distances, nearest = KDTree(points).query(space) if len(space) else (np.zeros(0), np.zeros(0, np.int64))
    owners = np.repeat(list(clouds), [len(cloud) for cloud in clouds.values()])[nearest]
    near = distances <= _OWN_M
    return {instance: space[near & (owners == instance)] for instance in clouds}, space[~near]


def _looks_into(frame: Frame, points: Float) -> tuple[Mask, Mask]:
    """Which of (N, 3) points lie behind what a frame measured, and which in front of it or in it."""
    assert frame.depth is not None
    camera = frame.camera
    pixels, away = project(camera.K, invert(camera.T_world_camera), points)
    measured = np.zeros(len(points))
    columns, rows = np.rint(np.nan_to_num(pixels, nan=-1.0)).astype(np.int64).T
    inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
    measured[inside] = frame.depth[rows[inside], columns[inside]]
    known = measured > 0
    hides = measured < away - _BEHIND_M
    return known & hides, known & ~hides
