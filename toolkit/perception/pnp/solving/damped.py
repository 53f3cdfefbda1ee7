"""Levenberg-Marquardt on SE(3), for whoever can linearise a cost at a pose."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from toolkit.perception.jax_geometry import rotation_exp

_FIRST_DAMPING = 1e-4
_EASED, _STIFFENED = 0.1, 10.0
"""What the damping is multiplied by after a step that lowered the cost, and after one that did not."""


class Pose(NamedTuple):
    """Rotation (..., 3, 3) and translation (..., 3)."""

    R: Array
    t: Array


class Equations(NamedTuple):
    """A cost linearised at a pose, for steps (w, v) that take R to exp(w) R and t to t + v.

    Attributes:
        H: (6, 6) Gauss-Newton matrix.
        gradient: (6,).
        cost: () at the pose.
    """

    H: Array
    gradient: Array
    cost: Array


def descend(
    pose: Pose,
    scales: Array,
    linearise: Callable[[Pose, Array], Equations],
    cost: Callable[[Pose, Array], Array],
    ridge: Array | float,
) -> Pose:
    """Take one damped step for every scale; those that do not lower the cost are taken back.

    Args:
        pose: where to start.
        scales: (S,) of every step, whatever the cost takes them for.
        linearise: the cost's equations at a pose, at a scale.
        cost: () at a pose, at a scale.
        ridge: () or (6,) added to the diagonal of H: what keeps the system solvable where nothing counts, and large
            for what must not move.
    """

    def step(state: tuple[Pose, Array], scale: Array) -> tuple[tuple[Pose, Array], None]:
        pose, damping = state
        H, gradient, before = linearise(pose, scale)
        delta = -jnp.linalg.solve(H + jnp.diag(damping * jnp.diagonal(H) + ridge), gradient)
        trial = Pose(rotation_exp(delta[:3]) @ pose.R, pose.t + delta[3:])
        better = cost(trial, scale) < before
        pose = jax.tree.map(lambda new, old: jnp.where(better, new, old), trial, pose)
        return (pose, damping * jnp.where(better, _EASED, _STIFFENED)), None

    return jax.lax.scan(step, (pose, jnp.array(_FIRST_DAMPING)), scales)[0][0]
