"""Gauss-Newton on poses: locally normalised intensities and silhouette together, all hypotheses in one batch (JAX)."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from toolkit.perception.jax_geometry import rotation_exp, skew

_PHOTO_SIGMA, _PHOTO_SHARE = 0.4, 0.25
"""Deviation of normalised intensities that agree, and the share of them that is independent (they are blurred)."""

_EDGE_SIGMA_PX, _EDGE_REACH_PX = 0.8, 4.0
_DAMPING = 1e-3
_MOST_TURN, _MOST_SHIFT_M = 0.15, 0.02
"""Largest step of one iteration, radians and metres."""

_CONTACT_M = 0.001
"""How exactly the lowest point of an object that rests on the table is known to be on it."""

_FAR_PX = 10.0
_SPILL_PART = 50
"""One point in so many, the furthest off, says how far the model spills over."""

_SAMPLES_PX = 0.5
"""The outermost projected point lies about this far inside the true silhouette."""


class GoalImage(NamedTuple):
    """A crop of the goal around one object.

    Attributes:
        values: normalised intensities, coarse to fine.
        outside: distance in pixels to the nearest pixel where the object may be.
        contour: pixels of the object's own outline, in the crop.
        normals: outward unit normals there.
        contour_weight: 0 for padding.
        K: intrinsics of the crop.
        R: rotation, world to camera.
        t: translation, world to camera, metres.
    """

    values: Float[Array, "L S S 3"]
    outside: Float[Array, "S S"]
    contour: Float[Array, "C 2"]
    normals: Float[Array, "C 2"]
    contour_weight: Float[Array, " C"]
    K: Float[Array, "3 3"]
    R: Float[Array, "3 3"]
    t: Float[Array, " 3"]


class Source(NamedTuple):
    """What a hypothesis is compared with.

    Attributes:
        points: of the chosen patches, centred, metres.
        values: their normalised intensities, coarse to fine.
        weights: 0 for padding.
        shape: points of the whole model, centred, metres; padding repeats points.
    """

    points: Float[Array, "*batch M 3"]
    values: Float[Array, "*batch L M 3"]
    weights: Float[Array, "*batch M"]
    shape: Float[Array, "*batch N 3"]


class Aligned(NamedTuple):
    """Refined poses of centred model points in the goal's world.

    Attributes:
        R: rotations.
        t: places of the centre, metres.
        information: of (turn, shift), inverse covariance in 1/rad^2 and 1/m^2.
        correlation: -1..1, of the intensities at the finest level.
        spill: how far the part of the model that lies furthest off the object does, pixels.
    """

    R: Float[Array, "*batch 3 3"]
    t: Float[Array, "*batch 3"]
    information: Float[Array, "*batch 6 6"]
    correlation: Float[Array, "*batch"]
    spill: Float[Array, "*batch"]


class Freedom(NamedTuple):
    """What a refinement may change.

    Attributes:
        moves: 1 for each of (turn xyz, shift xyz) that may change, else 0.
        rests: 1 where the object's lowest point stays on the table, else 0.
        table: the table's height, metres.
    """

    moves: Float[Array, " 6"]
    rests: Float[Array, ""]
    table: Float[Array, ""]


@partial(jax.jit, static_argnums=5)
def align(
    R: Float[Array, "B 3 3"], t: Float[Array, "B 3"], source: Source, goal: GoalImage, free: Freedom, iterations: int
) -> Aligned:
    """Refine poses, each with its own Source (leading axis B).

    Args:
        R: rotations.
        t: places of the model's centre, metres.
        source: batched.
        goal: shared.
        free: shared.
        iterations: per level.
    """
    return jax.vmap(lambda R, t, source: _align(R, t, source, goal, free, iterations))(R, t, source)


def _align(
    R: Float[Array, "3 3"], t: Float[Array, " 3"], source: Source, goal: GoalImage, free: Freedom, iterations: int
) -> Aligned:
    levels = goal.values.shape[0]

    def step(
        level: int, R: Float[Array, "3 3"], t: Float[Array, " 3"]
    ) -> tuple[Float[Array, "3 3"], Float[Array, " 3"]]:
        H, g = _normal_equations(R, t, source, goal, level, free)
        damped = H + jnp.diag(_DAMPING * jnp.diag(H) + 1e-6 + (1 - free.moves))
        delta = -jnp.linalg.solve(damped, g)
        turn, shift = _clipped(delta[:3], _MOST_TURN), _clipped(delta[3:], _MOST_SHIFT_M)
        return rotation_exp(turn) @ R, t + shift

    turn, place = R, t
    for level in range(levels):
        turn, place = jax.lax.fori_loop(0, iterations, lambda _, pose, level=level: step(level, *pose), (turn, place))
    information, _ = _normal_equations(turn, place, source, goal, levels - 1, free)
    correlation, spill = _correlation(turn, place, source, goal), _spill(turn, place, source, goal)
    return Aligned(turn, place, information, correlation, spill)


Equations = tuple[Float[Array, "6 6"], Float[Array, " 6"]]
"""Gauss-Newton matrix and gradient."""


def _normal_equations(
    R: Float[Array, "3 3"], t: Float[Array, " 3"], source: Source, goal: GoalImage, level: int, free: Freedom
) -> Equations:
    turned = source.shape @ R.T
    uv, duv = _project(turned + t, goal)
    motion = _motion(turned) * free.moves
    moved = duv @ motion
    terms = (
        _photometric(R, t, source, goal, level, free.moves),
        _inside(uv, moved, goal),
        _outline(uv, moved, goal),
        _contact((turned + t)[:, 2] - free.table, motion[:, 2], free.rests),
    )
    matrices, gradients = zip(*terms, strict=True)
    return sum(matrices[1:], matrices[0]), sum(gradients[1:], gradients[0])


def _photometric(
    R: Float[Array, "3 3"],
    t: Float[Array, " 3"],
    source: Source,
    goal: GoalImage,
    level: int,
    moves: Float[Array, " 6"],
) -> Equations:
    """The goal shows at each point what the patch showed there."""
    turned = source.points @ R.T
    uv, duv = _project(turned + t, goal)
    value, gradient, inside = _sample(goal.values[level], uv)
    residual = value - source.values[level]
    J = jnp.einsum("mcu,muk->mck", gradient, duv @ _motion(turned)) * moves
    robust = 1 / (1 + (residual**2).sum(axis=1) / (3 * _PHOTO_SIGMA) ** 2) ** 2
    weight = robust * inside * source.weights * _PHOTO_SHARE / _PHOTO_SIGMA**2
    return jnp.einsum("m,mck,mcl->kl", weight, J, J), jnp.einsum("m,mck,mc->k", weight, J, residual)


def _inside(uv: Float[Array, "N 2"], moved: Float[Array, "N 2 6"], goal: GoalImage) -> Equations:
    """No point of the model lies where the object is not."""
    distance, slope, near = _sample(goal.outside[..., None], uv)
    J = jnp.einsum("mcu,muk->mck", slope, moved)[:, 0]
    residual = jnp.maximum(distance[:, 0] - _SAMPLES_PX, 0) * near
    # All points together count as much as the outline.
    share = goal.contour_weight.sum() / len(uv)
    return _weighted(J, residual, share * (residual > 0))


def _outline(uv: Float[Array, "N 2"], moved: Float[Array, "N 2 6"], goal: GoalImage) -> Equations:
    """Every pixel of the object's outline has a point of the model close to it."""
    nearest = _nearest(goal.contour, uv)
    residual = (goal.normals * (goal.contour - uv[nearest])).sum(axis=1) - _SAMPLES_PX
    J = -jnp.einsum("cu,cuk->ck", goal.normals, moved[nearest])
    return _weighted(J, residual, goal.contour_weight)


def _contact(height: Float[Array, " N"], moved: Float[Array, "N 6"], rests: Float[Array, ""]) -> Equations:
    """The lowest points, of heights with derivatives, are on the table."""
    low = jax.nn.softmax(-height / _CONTACT_M)
    J, residual = low @ moved, low @ height
    weight = rests / _CONTACT_M**2
    return weight * jnp.outer(J, J), weight * J * residual


def _nearest(queries: Float[Array, "Q 2"], points: Float[Array, "P 2"]) -> Int[Array, " Q"]:
    """Rows of the points nearest to the queries.

    XLA's argmin is not vectorised on a CPU, its minimum of integers is, and takes a hundredth of the time: the bits of
    a distance that is not negative order as it does, and the last ones make room for the row.
    """
    dx, dy = queries[:, :1] - points[:, 0], queries[:, 1:] - points[:, 1]
    rows = (1 << (len(points) - 1).bit_length()) - 1
    distance = jax.lax.bitcast_convert_type(dx * dx + dy * dy, jnp.int32)
    return ((distance & ~rows) | jnp.arange(len(points))).min(axis=1) & rows


def _weighted(J: Float[Array, "M 6"], residual: Float[Array, " M"], weight: Float[Array, " M"]) -> Equations:
    """Equations of residuals in pixels, Geman-McClure weights."""
    robust = weight / (1 + (residual / _EDGE_REACH_PX) ** 2) ** 2 / _EDGE_SIGMA_PX**2
    return jnp.einsum("m,mk,ml->kl", robust, J, J), jnp.einsum("m,mk,m->k", robust, J, residual)


def _correlation(R: Float[Array, "3 3"], t: Float[Array, " 3"], source: Source, goal: GoalImage) -> Float[Array, ""]:
    uv, _ = _project(source.points @ R.T + t, goal)
    value, _, inside = _sample(goal.values[-1], uv)
    weight = (inside * source.weights)[:, None]
    a, b = value * weight, source.values[-1] * weight
    # Points that fall off the object count as disagreeing.
    return (a * b).sum() / jnp.sqrt(((a**2).sum() + 1) * (((source.values[-1] ** 2).sum(1) * source.weights).sum() + 1))


def _spill(R: Float[Array, "3 3"], t: Float[Array, " 3"], source: Source, goal: GoalImage) -> Float[Array, ""]:
    """Mean of the largest distances of the model off the object: a handle on the wrong side shows here."""
    uv, _ = _project(source.shape @ R.T + t, goal)
    distance, _, inside = _sample(goal.outside[..., None], uv)
    off = jnp.where(inside > 0, jnp.minimum(distance[:, 0], _FAR_PX), _FAR_PX)
    return jax.lax.top_k(off, max(len(off) // _SPILL_PART, 1))[0].mean()


def _project(world: Float[Array, "M 3"], goal: GoalImage) -> tuple[Float[Array, "M 2"], Float[Array, "M 2 3"]]:
    """Pixels of world points, and their derivatives."""
    camera = world @ goal.R.T + goal.t
    z = jnp.maximum(camera[:, 2], 1e-2)
    focal = jnp.array([goal.K[0, 0], goal.K[1, 1]])
    flat = camera[:, :2] / z[:, None]
    across = jnp.broadcast_to(jnp.diag(focal), (len(world), 2, 2))
    derivative = jnp.concatenate([across, -(flat * focal)[..., None]], axis=2) / z[:, None, None]
    return flat * focal + goal.K[:2, 2], derivative @ goal.R


def _motion(turned: Float[Array, "M 3"]) -> Float[Array, "M 3 6"]:
    """Derivative of moved points by (turn, shift)."""
    turn = skew(-turned)
    return jnp.concatenate([turn, jnp.broadcast_to(jnp.eye(3), turn.shape)], axis=2)


def _sample(
    image: Float[Array, "S S C"], uv: Float[Array, "M 2"]
) -> tuple[Float[Array, "M C"], Float[Array, "M C 2"], Float[Array, " M"]]:
    """Bilinear values and gradients of an image, and 1 where inside."""
    size = image.shape[0]
    inside = ((uv >= 0) & (uv < size - 1.001)).all(axis=1)
    safe = jnp.where(inside[:, None], uv, 0.0)
    corner = jnp.floor(safe).astype(jnp.int32)
    fx, fy = (safe - corner).T[..., None]
    flat = image.reshape(size * size, -1)
    start = corner[:, 1] * size + corner[:, 0]
    a, b, c, d = flat[start], flat[start + 1], flat[start + size], flat[start + size + 1]
    top, bottom = a + fx * (b - a), c + fx * (d - c)
    gradient = jnp.stack([(1 - fy) * (b - a) + fy * (d - c), bottom - top], axis=-1)
    return top + fy * (bottom - top), gradient, inside.astype(jnp.float32)


def _clipped(step: Float[Array, " 3"], most: float) -> Float[Array, " 3"]:
    return step * jnp.minimum(1.0, most / jnp.maximum(jnp.linalg.norm(step), 1e-12))
