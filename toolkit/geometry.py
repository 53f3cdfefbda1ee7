"""SE(3), pinhole projection and lifting, points by the cubes of a grid, in NumPy.

Metres, radians and pixels unless a name says otherwise.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Float = NDArray[np.floating[Any]]

_RIGID_TOLERANCE = 1e-5


def is_rigid(T: Float) -> bool:
    """Say whether T is a finite (4, 4) rigid transform: orthonormal, right-handed, last row (0, 0, 0, 1)."""
    if T.shape != (4, 4) or not np.isfinite(T).all():
        return False
    R = T[:3, :3]
    orthonormal = np.allclose(R @ R.T, np.eye(3), atol=_RIGID_TOLERANCE)
    return bool(orthonormal and np.linalg.det(R) > 0 and np.allclose(T[3], [0, 0, 0, 1], atol=1e-9))


def make_transform(R: Float, t: Float) -> Float:
    """Join a (3, 3) rotation and a (3,) translation into a (4, 4) float64 transform."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T


def invert(T: Float) -> Float:
    """Invert (..., 4, 4) rigid transforms."""
    R_inverse = np.swapaxes(T[..., :3, :3], -1, -2)
    inverse = np.zeros_like(T)
    inverse[..., :3, :3] = R_inverse
    inverse[..., :3, 3] = -(R_inverse @ T[..., :3, 3, None])[..., 0]
    inverse[..., 3, 3] = 1
    return inverse


def orthonormalize(T: Float) -> Float:
    """Return the rigid (4, 4) float64 transform nearest to T: rounding in files leaves rotations slightly off."""
    U, _, Vt = np.linalg.svd(np.asarray(T[:3, :3], np.float64))
    return make_transform(U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt, T[:3, 3])


def transform_points(T: Float, points: Float) -> Float:
    """Apply a (4, 4) transform to (..., 3) points."""
    return points @ T[:3, :3].T + T[:3, 3]


def rotation_z(angle: float) -> Float:
    """(4, 4) rotation by `angle` radians about z."""
    return make_transform(Rotation.from_euler("z", angle).as_matrix(), np.zeros(3))


def rotation_angle(R: Float) -> float:
    """Geodesic angle, radians in [0, pi], of a (3, 3) rotation; accurate near zero, where arccos is not."""
    return float(Rotation.from_matrix(R).magnitude())


def is_same_motion(a: Float, b: Float, at: Float, angle: float, shift: float) -> bool:
    """Say whether (4, 4) motions turn alike within `angle` radians and take point `at` (3,) within `shift` metres."""
    apart = np.linalg.norm(transform_points(a, at) - transform_points(b, at))
    return bool(apart < shift and rotation_angle(a[:3, :3].T @ b[:3, :3]) < angle)


def look_at(eye: Float, target: Float, up: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> Float:
    """(4, 4) T_world_camera, OpenCV axes, of a camera at `eye` (3,) that looks at `target` (3,).

    Raises:
        ValueError: the view direction is parallel to `up`, or eye and target coincide.
    """
    forward = np.asarray(target, np.float64) - np.asarray(eye, np.float64)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-9:
        raise ValueError("look_at needs a view direction that is not parallel to `up`")
    forward /= np.linalg.norm(forward)
    right /= np.linalg.norm(right)
    return make_transform(np.stack([right, np.cross(forward, right), forward], axis=1), np.asarray(eye))


def project(K: Float, T_camera_world: Float, points: Float) -> tuple[Float, Float]:
    """Project (N, 3) world points to (N, 2) pixels and (N,) depths in metres; pixels are NaN behind the camera."""
    in_camera = transform_points(T_camera_world, points)
    depth = in_camera[:, 2]
    safe = np.where(depth > 1e-9, depth, np.nan)
    return (in_camera[:, :2] / safe[:, None]) @ K[:2, :2].T + K[:2, 2], depth


def lift(K: Float, T_world_camera: Float, pixels: Float, depth: Float) -> Float:
    """Lift (N, 2) pixels with (N,) depths (metres along z) to (N, 3) float64 world points."""
    rays = (np.asarray(pixels, np.float64) - K[:2, 2]) / np.array([K[0, 0], K[1, 1]])
    in_camera = np.concatenate([rays, np.ones((len(rays), 1))], axis=1) * np.asarray(depth, np.float64)[:, None]
    return transform_points(T_world_camera, in_camera)


def observation_vector(T_world_camera: Float, points: Float) -> Float:
    """(3,) unit vector from the mean of (N, 3) world points to the camera centre (Eq. obs_pose)."""
    direction = T_world_camera[:3, 3] - points.mean(axis=0, dtype=np.float64)
    return np.asarray(direction / np.linalg.norm(direction))


CUBE_STEPS = (1, 1 << 20, 1 << 40)
"""What the number of a cube (`cubes`) rises by from one to the next, along x, y and z."""


def cubes(points: Float, side: float) -> NDArray[np.int64]:
    """(N,) the cube of a grid of `side` that each of (N, 3) points lies in; the grid has a corner at the origin.

    Cubes rise by their last coordinate, then by the one before it. Good for half a million cubes each way.
    """
    return np.floor(points / side).astype(np.int64) @ CUBE_STEPS


def group_means(values: NDArray[Any], groups: NDArray[np.int64], counts: NDArray[np.int64]) -> Float:
    """(G, C) float64 means of (N, C) values over their (N,) groups 0..G-1, of which there are (G,) `counts`."""
    sums = np.stack([np.bincount(groups, column, len(counts)) for column in values.T], axis=1)
    return sums / counts[:, None]
