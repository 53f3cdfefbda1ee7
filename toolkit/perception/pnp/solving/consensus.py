"""MSAC consensus over batched P3P hypotheses with local optimisation: one XLA program from samples to pose.

Everything is fixed in shape: hypotheses are drawn on the host, correspondences are padded and masked, and rounds of
hypotheses run in a `while_loop` that stops when enough have been seen. Chum et al., "Locally Optimized RANSAC" (DAGM
2003); Torr and Zisserman, "MLESAC" (CVIU 2000) for the truncated cost.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from toolkit.perception.compiled import Compiled
from toolkit.perception.pnp.solving.damped import Equations, Pose, descend
from toolkit.perception.pnp.solving.p3p import p3p

_OPTIMISED = 8
"""Best hypotheses of a round that are optimised locally: a minimal sample's pose ranks only roughly under noise."""
_WIDE, _STEPS = 2.0, 4
"""Local optimisation first accepts errors `_WIDE` times as large, so that an inexact start collects its inliers."""
_POLISH_STEPS = 12
_RIDGE = 1e-12
"""Keeps the equations solvable where no point is an inlier."""


class Problem(NamedTuple):
    """Padded correspondences.

    Attributes:
        points: centred and scaled to unit size.
        rays: image points over the focal length: ((x - cx) / fx, (y - cy) / fy).
        valid: False for padding.
        focal: fx and fy, pixels.
        threshold: pixels.
    """

    points: Float[Array, "N 3"]
    rays: Float[Array, "N 2"]
    valid: Bool[Array, " N"]
    focal: Float[Array, " 2"]
    threshold: Float[Array, ""]


class _Search(NamedTuple):
    round: Int[Array, ""]
    cost: Float[Array, ""]
    pose: Pose


@Compiled
def search(
    problem: Problem, samples: Int[Array, "rounds hypotheses 3"], confidence: Float[Array, ""]
) -> tuple[Pose, Float[Array, ""]]:
    """Find the pose of the smallest truncated squared reprojection error.

    Args:
        problem: the correspondences.
        samples: rows of minimal samples.
        confidence: probability with which one sample shall have been free of outliers before the search stops.

    Returns:
        The pose, problem to camera, and its cost in squared pixels: infinite when no sample had a solution.
    """
    rounds, hypotheses, _ = samples.shape
    count = problem.valid.sum()

    def unfinished(search: _Search) -> Bool[Array, ""]:
        # cost / threshold^2 is at least the number of outliers, so this is a lower bound of the inlier share.
        share = jnp.maximum(1 - search.cost / (problem.threshold**2 * count), 0.0)
        needed = jnp.log1p(-confidence) / jnp.log1p(-(jnp.minimum(share, 0.999) ** 3))
        return (search.round < rounds) & ((search.round == 0) | (search.round * hypotheses < needed))

    def one_round(search: _Search) -> _Search:
        pose, cost = _best_of_round(problem, samples[search.round])
        better = cost < search.cost
        pose = jax.tree.map(lambda new, old: jnp.where(better, new, old), pose, search.pose)
        return _Search(search.round + 1, jnp.where(better, cost, search.cost), pose)

    start = _Search(jnp.int32(0), jnp.array(jnp.inf), Pose(jnp.eye(3), jnp.zeros(3)))
    found = jax.lax.while_loop(unfinished, one_round, start)
    return found.pose, found.cost


@Compiled
def polish(problem: Problem, pose: Pose) -> Pose:
    """Take a pose to the nearest minimum of the truncated cost, to convergence."""
    return _refine(problem, pose, jnp.full(_POLISH_STEPS, problem.threshold))


def _best_of_round(problem: Problem, samples: Int[Array, "hypotheses 3"]) -> tuple[Pose, Float[Array, ""]]:
    bearings = jnp.concatenate([problem.rays, jnp.ones_like(problem.rays[:, :1])], axis=1)
    bearings = bearings / jnp.linalg.norm(bearings, axis=1, keepdims=True)
    R, t, real = jax.vmap(p3p)(problem.points[samples], bearings[samples])
    poses = Pose(R.reshape(-1, 3, 3), t.reshape(-1, 3))
    costs = jnp.where(real.ravel(), _cost(problem, poses, problem.threshold), jnp.inf)

    smallest, best = jax.lax.top_k(-costs, _OPTIMISED)
    poses = Pose(poses.R[best], poses.t[best])
    schedule = problem.threshold * jnp.repeat(jnp.array([_WIDE, 1.0]), _STEPS)
    poses = jax.vmap(lambda pose: _refine(problem, pose, schedule))(poses)
    costs = jnp.where(jnp.isfinite(smallest), _cost(problem, poses, problem.threshold), jnp.inf)
    winner = jnp.argmin(costs)
    return Pose(poses.R[winner], poses.t[winner]), costs[winner]


def _cost(problem: Problem, pose: Pose, threshold: Float[Array, ""]) -> Float[Array, "*batch"]:
    """Sum of squared errors, pixels^2, each at most threshold^2; so are points behind the camera."""
    X = pose.R @ problem.points.T + pose.t[..., None]
    _, squared, inlier = _residuals(problem, X, threshold)
    return _total(problem, squared, inlier, threshold)


def _residuals(
    problem: Problem, X: Float[Array, "*batch 3 N"], threshold: Float[Array, ""]
) -> tuple[Float[Array, "*batch 2 N"], Float[Array, "*batch N"], Bool[Array, "*batch N"]]:
    """Of camera points: errors in pixels, squared errors, and which are inliers."""
    errors = (X[..., :2, :] / X[..., 2:, :] - problem.rays.T) * problem.focal[:, None]
    squared = jnp.sum(errors**2, axis=-2)
    return errors, squared, problem.valid & (X[..., 2, :] > 0) & (squared < threshold**2)


def _total(
    problem: Problem, squared: Float[Array, "*batch N"], inlier: Bool[Array, "*batch N"], threshold: Float[Array, ""]
) -> Float[Array, "*batch"]:
    return jnp.sum(jnp.where(inlier, squared, jnp.where(problem.valid, threshold**2, 0.0)), axis=-1)


def _refine(problem: Problem, pose: Pose, thresholds: Float[Array, " steps"]) -> Pose:
    """Least squares on the inliers, which follow the pose: the truncated cost's minimum nearest to a pose.

    Args:
        problem: the correspondences.
        pose: where to start.
        thresholds: inlier threshold of every step, pixels.
    """
    return descend(pose, thresholds, partial(_equations, problem), partial(_cost, problem), _RIDGE)


def _equations(problem: Problem, pose: Pose, threshold: Float[Array, ""]) -> Equations:
    rotated = pose.R @ problem.points.T
    X = rotated + pose.t[:, None]
    residuals, squared, inlier = _residuals(problem, X, threshold)
    # Pixel gradients (a, 0, b) and (0, c, d) by camera coordinates; by w they are the cross product rotated x gradient.
    (x, y, z), (fx, fy), zero = rotated, problem.focal, jnp.zeros_like(squared)
    a, c = fx / X[2], fy / X[2]
    b, d = -a * X[0] / X[2], -c * X[1] / X[2]
    by_x = jnp.stack([y * b, z * a - x * b, -y * a, a, zero, b])
    by_y = jnp.stack([y * d - z * c, -x * d, x * c, zero, c, d])
    J = jnp.where(inlier, jnp.stack([by_x, by_y], axis=1), 0.0).reshape(6, -1)
    gradient = J @ jnp.where(inlier, residuals, 0.0).ravel()
    return Equations(J @ J.T, gradient, _total(problem, squared, inlier, threshold))
