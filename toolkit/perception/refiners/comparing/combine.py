"""Two routes to one motion, joined by how exact each is: matched points place an object, its image turns it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from toolkit.geometry import is_same_motion, make_transform, transform_points
from toolkit.perception.fusion import Start
from toolkit.types import Float

_AGREE_RAD, _AGREE_M = np.radians(3), 0.01
"""Motions closer than this are one, found twice."""

_PNP_INFLATION = 4.0
"""Matches in neighbouring views err together: the variance that their number promises is too small by about this."""

_BIAS_RAD, _BIAS_M = np.radians(0.1), 0.0007
"""What the image's fit is off by however much texture there is: silhouettes are known to half a pixel."""


def agreeing(T_goal_current: Float, center: Float, starts: Sequence[Start]) -> list[Start]:
    """The starts that are the (4, 4) motion found again, judged at the (3,) centre of the object."""
    return [s for s in starts if is_same_motion(T_goal_current, s.T_goal_current, center, _AGREE_RAD, _AGREE_M)]


def combine(T_goal_current: Float, covariance: Float, center: Float, start: Start, free: Float) -> tuple[Float, Float]:
    """The most likely motion, given what the image says and what the matches say, as two Gaussians.

    Args:
        T_goal_current: (4, 4) the image's answer.
        covariance: (6, 6) its covariance of (turn, shift) about `center`.
        center: (3,) the object's centre in the current world.
        start: the matches' answer, with its covariance.
        free: (6,) 1 for what of (turn, shift) is not known beforehand.

    Returns:
        (4, 4) motion and its (6, 6) covariance about `center`.
    """
    assert start.covariance is not None
    rows = np.flatnonzero(free)
    here = (covariance + np.diag(np.repeat([_BIAS_RAD, _BIAS_M], 3) ** 2))[np.ix_(rows, rows)]
    there = (_PNP_INFLATION * _about(start, center))[np.ix_(rows, rows)]
    place = transform_points(T_goal_current, center)
    turn = Rotation.from_matrix(start.T_goal_current[:3, :3] @ T_goal_current[:3, :3].T).as_rotvec()
    gap = np.concatenate([turn, transform_points(start.T_goal_current, center) - place])
    # The gain of a Kalman filter: how far to go from the one towards the other.
    gain = here @ np.linalg.inv(here + there)
    step = np.zeros(6)
    step[rows] = gain @ gap[rows]
    R = Rotation.from_rotvec(step[:3]).as_matrix() @ T_goal_current[:3, :3]
    joint = np.zeros((6, 6))
    joint[np.ix_(rows, rows)] = here - gain @ here
    return make_transform(R, place + step[3:] - R @ center), joint


def _about(start: Start, center: Float) -> Float:
    """(6, 6) covariance of a start, about another point: that moves with every turn."""
    assert start.covariance is not None
    x, y, z = start.T_goal_current[:3, :3] @ (center - start.center)
    J = np.eye(6)
    J[3:, :3] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
    return J @ start.covariance @ J.T
