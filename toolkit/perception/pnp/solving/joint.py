"""Robust weighted least squares on all correspondences of an instance at once, freely or on the table (JAX).

The unknown is the motion in the goal's world, a pose (R, t) with q = R (p - o) + t and o the points' mean, so that the
planar prior holds three of six parameters fixed. Hypotheses under the prior come from two points each: with the turn
about the vertical written as (cos, sin), every pixel gives two equations that are linear in (cos, sin, x, y).
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from toolkit.perception.compiled import Compiled
from toolkit.perception.jax_geometry import rotated
from toolkit.perception.pnp.solving.damped import Equations, Pose, descend

_OPTIMISED = 8
"""Best hypotheses that are refined: a minimal sample's pose ranks only roughly under noise."""

_TESTED, _PROMISING = 256, 64
"""Correspondences by which all hypotheses are compared first, and the best of them that are compared by all."""

_WIDE, _STEPS = 3.0, 8
"""Refinement first weights errors at `_WIDE` times the scale, so that an inexact start collects its inliers."""

_POLISH_STEPS = 15
_RIDGE = 1e-9
"""Keeps the equations solvable where no point counts."""


class Evidence(NamedTuple):
    """Padded correspondences and the camera that sees the moved points.

    Attributes:
        points: world, less their mean, metres.
        rays: image points over the focal length: ((x - cx) / fx, (y - cy) / fy).
        weights: 0..1, 0 for padding.
        focal: fx and fy, pixels.
        R: rotation, goal world to camera.
        t: translation, goal world to camera, metres.
        scale: pixels: errors of this size count half.
    """

    points: Float[Array, "N 3"]
    rays: Float[Array, "N 2"]
    weights: Float[Array, " N"]
    focal: Float[Array, " 2"]
    R: Float[Array, "3 3"]
    t: Float[Array, " 3"]
    scale: Float[Array, ""]


@Compiled
def search_planar(evidence: Evidence, samples: Int[Array, "hypotheses 2"], height: Float[Array, ""]) -> Pose:
    """The best motion on the table of samples of two rows; `height` is that of the points' mean, metres.

    Samples are drawn by weight, so that their first rows stand for all correspondences, each as good as the next.
    """
    motions = jax.vmap(lambda rows: _from_two_points(evidence, rows, height))(samples)
    tested = samples[:_TESTED, 0]
    few = evidence._replace(points=evidence.points[tested], rays=evidence.rays[tested], weights=jnp.ones(len(tested)))
    motions = _best(few, motions, _PROMISING)
    motions = _best(evidence, motions, _OPTIMISED)
    free = jnp.array([0.0, 0.0, 1.0, 1.0, 1.0, 0.0])
    scales = evidence.scale * jnp.repeat(jnp.array([_WIDE, 1.0]), _STEPS)
    refined = jax.vmap(lambda motion: _refine(evidence, motion, free, scales))(motions)
    winner = jnp.argmin(jax.vmap(lambda motion: _cost(evidence, motion, evidence.scale))(refined))
    return jax.tree.map(lambda part: part[winner], refined)


@Compiled
def polish(evidence: Evidence, start: Pose, free: Float[Array, " 6"]) -> Pose:
    """Take a motion to the nearest minimum of the robust cost; `free` is 1 for what of (turn, shift) may change."""
    return _refine(evidence, start, free, jnp.full(_POLISH_STEPS, evidence.scale))


@Compiled
def covariance(evidence: Evidence, motion: Pose, free: Float[Array, " 6"]) -> Float[Array, "6 6"]:
    """Covariance in rad^2 and m^2: the residuals' variance over the information; what is held fixed has 0."""
    H = _equations(evidence, free, motion, evidence.scale).H
    squared, robust = _squared(evidence, motion), _robust(evidence, motion, evidence.scale)
    freedom = jnp.maximum(2 * robust.sum() - free.sum(), 1.0)
    variance = (robust * squared).sum() / freedom
    held = jnp.diag(1 - free)
    return variance * jnp.linalg.inv(H + held) * jnp.outer(free, free)


def _best(evidence: Evidence, motions: Pose, count: int) -> Pose:
    """Those `count` of a batch of motions that cost least."""
    costs = jax.vmap(lambda motion: _cost(evidence, motion, evidence.scale))(motions)
    _, best = jax.lax.top_k(-jnp.nan_to_num(costs, nan=jnp.inf), count)
    return Pose(motions.R[best], motions.t[best])


def _from_two_points(evidence: Evidence, rows: Int[Array, " 2"], height: Float[Array, ""]) -> Pose:
    points, rays = evidence.points[rows], evidence.rays[rows]
    # a . q + d = 0 for every pixel coordinate.
    a = (evidence.R[:2] - rays[..., None] * evidence.R[2]).reshape(4, 3)
    d = (evidence.t[:2] - rays * evidence.t[2]).reshape(4)
    x, y, z = jnp.repeat(points, 2, axis=0).T
    A = jnp.stack([a[:, 0] * x + a[:, 1] * y, a[:, 1] * x - a[:, 0] * y, a[:, 0], a[:, 1]], axis=1)
    cos, sin, tx, ty = jnp.linalg.solve(A + 1e-12 * jnp.eye(4), -(a[:, 2] * (z + height) + d))
    length = jnp.hypot(cos, sin)
    cos, sin = cos / length, sin / length
    return Pose(jnp.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]), jnp.stack([tx, ty, height]))


def _squared(evidence: Evidence, motion: Pose) -> Float[Array, " N"]:
    """Squared errors in pixels, huge behind the camera."""
    shift = evidence.R @ motion.t + evidence.t
    x, y, z = (turned + t for turned, t in zip(rotated(evidence.R @ motion.R, evidence.points), shift, strict=True))
    u = (x / z - evidence.rays[:, 0]) * evidence.focal[0]
    v = (y / z - evidence.rays[:, 1]) * evidence.focal[1]
    return jnp.where(z > 0, u * u + v * v, 1e12)


def _robust(evidence: Evidence, motion: Pose, scale: Float[Array, ""]) -> Float[Array, " N"]:
    """Geman-McClure weights times the correspondences' own."""
    return evidence.weights / (1 + _squared(evidence, motion) / scale**2) ** 2


def _cost(evidence: Evidence, motion: Pose, scale: Float[Array, ""]) -> Float[Array, ""]:
    """Geman-McClure cost."""
    squared = _squared(evidence, motion)
    return (evidence.weights * squared / (squared + scale**2)).sum()


def _equations(evidence: Evidence, free: Float[Array, " 6"], motion: Pose, scale: Float[Array, ""]) -> Equations:
    turned = evidence.points @ motion.R.T
    camera = (turned + motion.t) @ evidence.R.T + evidence.t
    errors = (camera[:, :2] / camera[:, 2:] - evidence.rays) * evidence.focal
    z = jnp.maximum(camera[:, 2:], 1e-6)
    flat = camera[:, :2] / z
    by_camera = jnp.concatenate([jnp.broadcast_to(jnp.eye(2), (len(z), 2, 2)), -flat[..., None]], axis=2)
    by_world = by_camera * (evidence.focal[:, None] / z[..., None]) @ evidence.R
    by_turn = jnp.cross(turned[:, None], by_world)
    J = (jnp.concatenate([by_turn, by_world], axis=2) * free).reshape(-1, 6)
    weighted = (J * jnp.repeat(_robust(evidence, motion, scale), 2)[:, None]).T
    return Equations(weighted @ J, weighted @ errors.ravel(), _cost(evidence, motion, scale))


def _refine(evidence: Evidence, motion: Pose, free: Float[Array, " 6"], scales: Float[Array, " steps"]) -> Pose:
    """Iteratively reweighted least squares from a motion; one scale in pixels for every step."""
    linearise = partial(_equations, evidence, free)
    return descend(motion, scales, linearise, partial(_cost, evidence), _RIDGE + (1 - free))
