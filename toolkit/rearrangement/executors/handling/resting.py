"""How a released object comes to rest: gravity turns it to the nearest pose it can stand in."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from toolkit.data.layout import RestingObject
from toolkit.geometry import make_transform
from toolkit.types import Float


def settle(T_world_model: Float, rests: Sequence[RestingObject]) -> Float:
    """Where an object comes to rest that is let go at a (4, 4) pose just above the table.

    It tips over the shortest way to the nearest of its resting poses, about the middle of what it then stands on, and
    keeps its yaw and place.
    """
    up = T_world_model[2, :3]  # the world's vertical, in the model's coordinates
    nearest = min(rests, key=lambda rest: _angle(rest.T_rest_model[2, :3], up))
    tip = _shortest_turn(T_world_model[:3, :3] @ nearest.T_rest_model[2, :3])
    R = tip @ T_world_model[:3, :3]
    # The resting pose has its lowest point at z = 0 and its box centre above the origin.
    origin = nearest.T_rest_model[:3, :3].T @ -nearest.T_rest_model[:3, 3]
    foot = T_world_model[:3, :3] @ origin + T_world_model[:3, 3]
    return make_transform(R, np.array([foot[0], foot[1], 0.0]) - R @ origin)


def _angle(a: Float, b: Float) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def _shortest_turn(a: Float) -> Float:
    """(3, 3) rotation that takes the unit vector `a` to the vertical the shortest way."""
    up = np.array([0.0, 0.0, 1.0])
    axis = np.cross(a, up)
    length = np.linalg.norm(axis)
    if length < 1e-12:
        return np.eye(3) if a[2] > 0 else np.diag([1.0, -1.0, -1.0])
    return Rotation.from_rotvec(axis / length * _angle(a, up)).as_matrix()
