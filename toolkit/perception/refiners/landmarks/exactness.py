"""How exactly inliers hold a motion."""

from __future__ import annotations

import numpy as np
from scipy.special import erf

from toolkit.geometry import invert, project, transform_points
from toolkit.types import Correspondences, Float, Mask

_LEAST_PX = 0.5
"""No feature is placed more exactly than this."""

_RIGHT_RAD, _RIGHT_M = np.radians(5), 0.02


def covariance(problem: Correspondences, T_goal_current: Float, inliers: Mask, center: Float) -> Float:
    """(6, 6) covariance of (turn, shift) of a motion about a point, by the inliers' errors in the goal image.

    Args:
        problem: the correspondences.
        T_goal_current: (4, 4) that was fitted to them.
        inliers: (N,) bool, at least four.
        center: (3,) point of the current world, metres.
    """
    T = invert(problem.camera.T_world_camera)
    moved = transform_points(T_goal_current, problem.points[inliers])
    seen = transform_points(T, moved)
    focal, z = np.diagonal(problem.K)[:2], seen[:, 2:]
    slope = np.concatenate([np.broadcast_to(np.eye(2), (len(z), 2, 2)), -(seen[:, :2] / z)[..., None]], axis=2)
    by_shift = slope * (focal[:, None] / z[..., None]) @ T[:3, :3]
    by_turn = np.cross((moved - transform_points(T_goal_current, center))[:, None], by_shift)
    J = np.concatenate([by_turn, by_shift], axis=2).reshape(-1, 6)
    errors = project(problem.K, T, moved)[0] - problem.pixels[inliers]
    variance = max(float((errors**2).mean()), _LEAST_PX**2)
    return variance * np.linalg.pinv(J.T @ J, hermitian=True)


def chance(covariance: Float) -> float:
    """Probability 0..1 that a motion of this (6, 6) covariance is within 5 deg and 2 cm, if its inliers are right."""
    sigma = np.sqrt([np.linalg.eigvalsh(covariance[part, part])[-1] for part in (slice(0, 3), slice(3, 6))])
    return float(np.prod(erf(np.array([_RIGHT_RAD, _RIGHT_M]) / np.sqrt(2) / np.maximum(sigma, 1e-9))))
