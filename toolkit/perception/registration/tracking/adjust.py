"""Camera poses from points of one plane: what two images show of a point must lie at one place on the table.

Gauss-Newton over the cameras' poses; the points themselves, where a ray meets the plane, are eliminated. How far stated
poses are to be believed is a Gaussian prior, which also holds what the images leave open, such as a common shift.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from toolkit.geometry import invert, make_transform
from toolkit.perception.registration.tracking.tracks import Tracks
from toolkit.types import Camera, Float

_ITERATIONS = 8
_SIGMA_M = 0.001
"""How exactly a point is followed, on the table."""
_TOLERATED = 2.0


def adjust(
    cameras: Sequence[Camera],
    tracks: Tracks,
    T_world_table: Float,
    free: Sequence[bool],
    sigma: Float,
) -> list[Camera]:
    """Correct the poses of the free cameras.

    Args:
        cameras: N cameras with their stated poses.
        tracks: points of the table seen by two of them each.
        T_world_table: (4, 4), z = 0 is the table.
        free: N, which poses may change.
        sigma: (6,) expected errors of a stated pose: turn xyz, radians, and shift xyz of the camera, metres.

    Returns:
        N cameras.
    """
    stated = [invert(T_world_table) @ camera.T_world_camera for camera in cameras]
    poses: list[Float] = list(stated)
    moving = np.flatnonzero(free)
    columns = {n: slice(6 * i, 6 * i + 6) for i, n in enumerate(moving)}
    for _ in range(_ITERATIONS):
        X0, J0 = _on_table(cameras, poses, tracks.first, tracks.first_xy)
        X1, J1 = _on_table(cameras, poses, tracks.second, tracks.second_xy)
        residual = (X0 - X1) / _SIGMA_M
        J = np.zeros((len(residual), 2, 6 * len(moving)))
        for n, own in columns.items():
            J[tracks.first == n, :, own] += J0[tracks.first == n] / _SIGMA_M
            J[tracks.second == n, :, own] -= J1[tracks.second == n] / _SIGMA_M
        # Cauchy's weights: what moved between the images, or was followed wrongly, drops out.
        weighted = J / (1 + (residual**2).sum(axis=1) / _TOLERATED**2)[:, None, None]
        prior = np.tile(1 / sigma**2, len(moving))
        off = np.concatenate([_moved(stated[n], poses[n]) for n in moving])
        H = np.einsum("mik,mil->kl", weighted, J, optimize=True) + np.diag(prior)
        step = -np.linalg.solve(H, np.einsum("mik,mi->k", weighted, residual) + prior * off)
        for n, own in columns.items():
            turn, shift = step[own].reshape(2, 3)
            R = Rotation.from_rotvec(turn).as_matrix() @ poses[n][:3, :3]
            poses[n] = make_transform(R, poses[n][:3, 3] + shift)
    return [
        Camera(camera.K, T_world_table @ pose, camera.width, camera.height) if may_move else camera
        for camera, pose, may_move in zip(cameras, poses, free, strict=True)
    ]


def _on_table(
    cameras: Sequence[Camera], poses: Sequence[Float], owner: NDArray[np.int64], xy: Float
) -> tuple[Float, Float]:
    """(M, 2) where the pixels' rays meet the table, and (M, 2, 6) its derivative by (turn, shift) of their camera."""
    K = np.array([camera.K for camera in cameras])[owner]
    T = np.array(poses)[owner]
    rays = np.column_stack([(xy - K[:, :2, 2]) / np.diagonal(K, axis1=1, axis2=2)[:, :2], np.ones(len(xy))])
    d = np.einsum("mij,mj->mi", T[:, :3, :3], rays)
    origin = T[:, :3, 3]
    reach = -d * (origin[:, 2] / d[:, 2])[:, None]
    # A shift moves the ray; a turn w moves its meeting point by w x reach; both slide back to the plane along the ray.
    x, y, z = reach.T
    zero = np.zeros_like(x)
    turned = np.stack([np.stack([zero, z, -y], 1), np.stack([-z, zero, x], 1), np.stack([y, -x, zero], 1)], axis=1)
    moved = np.concatenate([turned, np.broadcast_to(np.eye(3), turned.shape)], axis=2)
    slide = d[:, :2] / d[:, 2:]
    return (origin + reach)[:, :2], moved[:, :2] - slide[:, :, None] * moved[:, 2:]


def _moved(stated: Float, pose: Float) -> Float:
    """(6,) turn and shift from the stated pose."""
    turn = Rotation.from_matrix(pose[:3, :3] @ stated[:3, :3].T).as_rotvec()
    return np.concatenate([turn, pose[:3, 3] - stated[:3, 3]])
