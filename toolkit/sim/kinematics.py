"""A chain of revolute joints: where its end is, and which angles bring it somewhere. Radians, metres."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from toolkit.types import Float

_DAMPING = 1e-3
_STEPS = 60
_MOST_RAD = 0.3
"""Longest step of one joint in one iteration."""

_CLOSE_M, _CLOSE_RAD = 2e-4, 1e-3


@dataclass(frozen=True, eq=False)
class Chain:
    """Joints in a row.

    Attributes:
        T_base: (4, 4) world pose of the chain's root.
        T_joints: (J, 4, 4) pose of every joint's frame in the one before it, at angle zero.
        axes: (J, 3) unit axis of every joint in its own frame.
        T_end: (4, 4) the end in the last joint's frame.
        lower: (J,) smallest angles.
        upper: (J,) largest angles.
    """

    T_base: Float
    T_joints: Float
    axes: Float
    T_end: Float
    lower: Float
    upper: Float

    def frames(self, q: Float) -> tuple[Float, Float]:
        """(S, J, 4, 4) world frames of the joints, and (S, 4, 4) of the end, for (S, J) angles."""
        angle = q[..., None, None]
        constant, sine, cosine = self._joint_terms
        steps = constant + np.sin(angle) * sine + np.cos(angle) * cosine
        joints = np.empty_like(steps)
        frame = self.T_base
        for i in range(q.shape[1]):
            frame = np.matmul(frame, steps[:, i], out=joints[:, i])
        return joints, frame @ self.T_end

    def end(self, q: Float) -> Float:
        """(4, 4) world frame of the end at (J,) angles."""
        return self.frames(q[None])[1][0]

    @property
    def longest(self) -> float:
        """No angles bring the end further from the first joint than this, metres."""
        links = np.concatenate([self.T_joints[1:], self.T_end[None]])
        return float(np.linalg.norm(links[:, :3, 3], axis=1).sum())

    @cached_property
    def _joint_terms(self) -> tuple[Float, Float, Float]:
        """(J, 4, 4) each: a joint's frame in the one before it is the first, plus sine and cosine times the others."""
        K = np.zeros((len(self.axes), 4, 4))
        K[:, :3, :3] = _cross_matrices(self.axes)
        turned, back = self.T_joints @ K, self.T_joints @ K @ K
        return self.T_joints + back, turned, -back  # Rodrigues

    def solve(self, T_world_end: Float, starts: Float) -> Float:
        """(K, J) angles within the limits that bring the end to a (4, 4) pose, from (S, J) starts; K <= S.

        Damped least squares from all starts at once; in the order of the starts (Wampler, IEEE T-SMC 1986).
        """
        q = np.array(starts, np.float64)
        away = np.arange(len(q))
        for taken in range(_STEPS + 1):
            error, jacobian = self._linearize(q[away], T_world_end)
            on = ~self._there(error)
            away, error, jacobian = away[on], error[on], jacobian[on]
            if not len(away) or taken == _STEPS:
                break
            transposed = np.swapaxes(jacobian, 1, 2)
            step = transposed @ np.linalg.solve(jacobian @ transposed + _DAMPING * np.eye(6), error[..., None])
            step = step[..., 0]
            step *= np.minimum(1, _MOST_RAD / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-12))
            q[away] = np.clip(q[away] + step, self.lower, self.upper)
        return np.delete(q, away, axis=0)

    def _linearize(self, q: Float, target: Float) -> tuple[Float, Float]:
        """(S, 6) what is missing, and (S, 6, J) how the joints change it; metres first, then radians."""
        joints, end = self.frames(q)
        turn = _rotation_vectors(target[:3, :3] @ np.swapaxes(end[:, :3, :3], 1, 2))
        axes = (joints[..., :3, :3] @ self.axes[None, :, :, None])[..., 0]
        arms = end[:, None, :3, 3] - joints[..., :3, 3]
        (ax, ay, az), (x, y, z) = np.moveaxis(axes, 2, 0), np.moveaxis(arms, 2, 0)
        jacobian = np.stack([ay * z - az * y, az * x - ax * z, ax * y - ay * x, ax, ay, az], axis=1)
        return np.concatenate([target[:3, 3] - end[:, :3, 3], turn], axis=1), jacobian

    @staticmethod
    def _there(error: Float) -> np.ndarray:
        return (np.linalg.norm(error[:, :3], axis=1) < _CLOSE_M) & (np.linalg.norm(error[:, 3:], axis=1) < _CLOSE_RAD)


def _cross_matrices(vectors: Float) -> Float:
    """(N, 3, 3) matrices whose product with x is the cross product of (N, 3) vectors with x."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def _rotation_vectors(R: Float) -> Float:
    """(N, 3) rotation vectors of (N, 3, 3) rotations; of half turns, some vector that is not zero."""
    vee = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1) / 2
    sine = np.linalg.norm(vee, axis=1)
    angle = np.arctan2(sine, (np.trace(R, axis1=1, axis2=2) - 1) / 2)
    return vee * (angle / np.maximum(sine, 1e-9))[:, None]
