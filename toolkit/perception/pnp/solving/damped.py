"""Levenberg-Marquardt on SE(3), for whoever can linearise a cost at a pose."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from toolkit.perception.compiled import kept_type
from toolkit.perception.jax_geometry import rotation_exp

_FIRST_DAMPING = 1e-4
_EASED, _STIFFENED = 0.1, 10.0
"""What the damping is multiplied by after a step that lowered the cost, and after one that did not."""


@kept_type
class Pose(NamedTuple):
    """Rotation and translation."""

    R: Float[Array, "*batch 3 3"]
    t: Float[Array, "*batch 3"]


class Equations(NamedTuple):
    """A cost linearised at a pose, for steps (w, v) that take R to exp(w) R and t to t + v.

    Attributes:
        H: Gauss-Newton matrix.
        gradient: half the cost's.
        cost: at the pose.
    """

    H: Float[Array, "6 6"]
    gradient: Float[Array, " 6"]
    cost: Float[Array, ""]


def descend(
    pose: Pose,
    scales: Float[Array, " steps"],
    linearise: Callable[[Pose, Float[Array, ""]], Equations],
    cost: Callable[[Pose, Float[Array, ""]], Float[Array, ""]],
    ridge: Float[Array, " 6"] | float,
) -> Pose:
    """Take one damped step for every scale; those that do not lower the cost are taken back.

    Args:
        pose: where to start.
        scales: of every step, whatever the cost takes them for.
        linearise: the cost's equations at a pose, at a scale.
        cost: at a pose, at a scale.
        ridge: added to the diagonal of H: what keeps the system solvable where nothing counts, and large
            for what must not move.
    """

    def step(state: tuple[Pose, Float[Array, ""]], scale: Float[Array, ""]) -> tuple[tuple[Pose, Array], None]:
        pose, damping = state
        H, gradient, before = linearise(pose, scale)
        delta = -jnp.linalg.solve(H + jnp.diag(damping * jnp.diagonal(H) + ridge), gradient)
        trial = Pose(rotation_exp(delta[:3]) @ pose.R, pose.t + delta[3:])
        better = cost(trial, scale) < before
        pose = jax.tree.map(lambda new, old: jnp.where(better, new, old), trial, pose)
        return (pose, damping * jnp.where(better, _EASED, _STIFFENED)), None

    return jax.lax.scan(step, (pose, jnp.array(_FIRST_DAMPING)), scales)[0][0]
