"""Space that no camera saw into: behind, below and inside what stands on the table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial import KDTree

from toolkit.geometry import invert, project
from toolkit.sim.cubes import FINE_M, around, underside
from toolkit.types import Float, Frame

_SIDE_M = 0.01
_BEHIND_M = 0.005
"""Space this far behind a surface is hidden by it; measured depths are no truer than that."""

_THROUGH_M = 0.004
"""A frame that measured this much further away than a point looked through it."""

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
        further = _beyond(frame, space)
        behind |= further < -_BEHIND_M
        empty |= further >= -_BEHIND_M
    space = space[behind & ~empty]
    distances, nearest = KDTree(points).query(space) if len(space) else (np.zeros(0), np.zeros(0, np.int64))
    owners = np.repeat(list(clouds), [len(cloud) for cloud in clouds.values()])[nearest]
    near = distances <= _OWN_M
    return {instance: space[near & (owners == instance)] for instance in clouds}, space[~near]


def empty_below(frames: Sequence[Frame], points: Float) -> Float:
    """Where there is nothing of an object although it lies just below what was seen of it, as under the rim of a bowl.

    Args:
        frames: of the table as it is, with depth.
        points: (N, 3) seen points of the object, world coordinates, z up from the table.

    Returns:
        (K, 3) middles of the cubes of its underside that some frame looked through.
    """
    below = underside(around(points, FINE_M)) if len(points) else None
    if below is None:
        return np.zeros((0, 3))
    return below.centers[np.logical_or.reduce([_beyond(frame, below.centers) > _THROUGH_M for frame in frames])]


def _beyond(frame: Frame, points: Float) -> Float:
    """(N,) metres by which what a frame measured lies further away than a point; NaN where it measured nothing."""
    assert frame.depth is not None
    camera = frame.camera
    pixels, away = project(camera.K, invert(camera.T_world_camera), points)
    columns, rows = np.rint(np.nan_to_num(pixels, nan=-1.0)).astype(np.int64).T
    inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
    measured = np.zeros(len(points))
    measured[inside] = frame.depth[rows[inside], columns[inside]]
    return np.where(measured > 0, measured - away, np.nan)
