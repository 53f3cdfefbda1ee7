"""Gauss-Newton on poses: locally normalised intensities and silhouette together, all hypotheses in one batch (JAX)."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from toolkit.perception.compiled import Compiled, kept_type
from toolkit.perception.jax_geometry import rotated, rotation_exp

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


@kept_type
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


@Compiled
def align(
    R: Float[Array, "B 3 3"],
    t: Float[Array, "B 3"],
    source: Source,
    goal: GoalImage,
    free: Freedom,
    iterations: Int[Array, ""] | int,
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
    R: Float[Array, "3 3"],
    t: Float[Array, " 3"],
    source: Source,
    goal: GoalImage,
    free: Freedom,
    iterations: Int[Array, ""] | int,
) -> Aligned:
    def settled(pose: _Pose, level: _Level) -> tuple[_Pose, None]:
        return jax.lax.fori_loop(0, iterations, lambda _, now: step(level, *now), pose), None

    def step(level: _Level, R: Float[Array, "3 3"], t: Float[Array, " 3"]) -> _Pose:
        H, g = _normal_equations(R, t, source, goal, level, free)
        damped = H + jnp.diag(_DAMPING * jnp.diag(H) + 1e-6 + (1 - free.moves))
        delta = -jnp.linalg.solve(damped, g)
        turn, shift = _clipped(delta[:3], _MOST_TURN), _clipped(delta[3:], _MOST_SHIFT_M)
        return rotation_exp(turn) @ R, t + shift

    # Level by level in a loop: written out, each would be compiled and loaded on its own.
    (turn, place), _ = jax.lax.scan(settled, (R, t), (goal.values, source.values))
    information, _ = _normal_equations(turn, place, source, goal, (goal.values[-1], source.values[-1]), free)
    correlation, spill = _correlation(turn, place, source, goal), _spill(turn, place, source, goal)
    return Aligned(turn, place, information, correlation, spill)


_Pose = tuple[Float[Array, "3 3"], Float[Array, " 3"]]
_Level = tuple[Float[Array, "S S 3"], Float[Array, "M 3"]]
"""Normalised intensities of the goal and of the source at one level."""

Equations = tuple[Float[Array, "6 6"], Float[Array, " 6"]]
"""Gauss-Newton matrix and gradient."""


class _Seen(NamedTuple):
    """Points in the goal's picture, one array per coordinate (`rotated`).

    Attributes:
        u: pixels, and how they change with (turn, shift) in the camera's axes.
        v: the same, downwards.
    """

    u: Float[Array, " M"]
    v: Float[Array, " M"]
    by_u: Float[Array, "6 M"]
    by_v: Float[Array, "6 M"]


def _normal_equations(
    R: Float[Array, "3 3"], t: Float[Array, " 3"], source: Source, goal: GoalImage, level: _Level, free: Freedom
) -> Equations:
    shape = _seen(source.shape, R, t, goal)
    photometric = _photometric(_seen(source.points, R, t, goal), source.weights, level)
    matrices, gradients = zip(photometric, _inside(shape, goal), _outline(shape, goal), strict=True)
    # Turns and shifts along the camera's axes are those along the world's, turned.
    axes = jnp.kron(jnp.eye(2), goal.R)
    nothing = (jnp.zeros((6, 6)), jnp.zeros(6))
    resting, pull = jax.lax.cond(free.rests > 0, lambda: _contact(source.shape, R, t, free), lambda: nothing)
    H, gradient = axes.T @ sum(matrices) @ axes + resting, axes.T @ sum(gradients) + pull
    return H * jnp.outer(free.moves, free.moves), gradient * free.moves


def _seen(points: Float[Array, "M 3"], R: Float[Array, "3 3"], t: Float[Array, " 3"], goal: GoalImage) -> _Seen:
    """Centred points, turned and placed, as the goal's camera sees them."""
    (x, y, z), (tx, ty, tz) = rotated(goal.R @ R, points), goal.R @ t + goal.t
    fx, fy = goal.K[0, 0], goal.K[1, 1]
    ahead = jnp.maximum(z + tz, 1e-2)
    flat_x, flat_y = (x + tx) / ahead, (y + ty) / ahead
    # Pixel gradients (a, 0, b) and (0, c, d) by camera coordinates; by the turn they are (x, y, z) x gradient.
    a, b, c, d = fx / ahead, -fx * flat_x / ahead, fy / ahead, -fy * flat_y / ahead
    zero = jnp.zeros_like(a)
    by_u = jnp.stack([y * b, z * a - x * b, -y * a, a, zero, b])
    by_v = jnp.stack([y * d - z * c, -x * d, x * c, zero, c, d])
    return _Seen(flat_x * fx + goal.K[0, 2], flat_y * fy + goal.K[1, 2], by_u, by_v)


def _photometric(seen: _Seen, weights: Float[Array, " M"], level: _Level) -> Equations:
    """The goal shows at each point what the patch showed there."""
    values, by_u, by_v, inside = _sample(level[0], seen.u, seen.v)
    residual = [value - wanted for value, wanted in zip(values, level[1].T, strict=True)]
    robust = 1 / (1 + _dot(residual, residual) / (3 * _PHOTO_SIGMA) ** 2) ** 2
    weight = robust * inside * weights * _PHOTO_SHARE / _PHOTO_SIGMA**2
    uu, uv, vv = weight * _dot(by_u, by_u), weight * _dot(by_u, by_v), weight * _dot(by_v, by_v)
    ru, rv = weight * _dot(by_u, residual), weight * _dot(by_v, residual)
    H = (uu * seen.by_u + uv * seen.by_v) @ seen.by_u.T + (uv * seen.by_u + vv * seen.by_v) @ seen.by_v.T
    return H, seen.by_u @ ru + seen.by_v @ rv


def _inside(seen: _Seen, goal: GoalImage) -> Equations:
    """No point of the model lies where the object is not."""
    (distance,), (by_u,), (by_v,), near = _sample(goal.outside[..., None], seen.u, seen.v)
    residual = jnp.maximum(distance - _SAMPLES_PX, 0) * near
    # All points together count as much as the outline.
    share = goal.contour_weight.sum() / len(distance)
    return _weighted(by_u * seen.by_u + by_v * seen.by_v, residual, share * (residual > 0))


def _outline(seen: _Seen, goal: GoalImage) -> Equations:
    """Every pixel of the object's outline has a point of the model close to it."""
    rows = _nearest(goal.contour, seen.u, seen.v)
    (x, y), (nx, ny) = goal.contour.T, goal.normals.T
    residual = nx * (x - seen.u[rows]) + ny * (y - seen.v[rows]) - _SAMPLES_PX
    return _weighted(-(nx * seen.by_u[:, rows] + ny * seen.by_v[:, rows]), residual, goal.contour_weight)


def _contact(shape: Float[Array, "N 3"], R: Float[Array, "3 3"], t: Float[Array, " 3"], free: Freedom) -> Equations:
    """The lowest points are on the table."""
    turned = shape @ R.T
    height = turned[:, 2] + t[2] - free.table
    low = jax.nn.softmax(-height / _CONTACT_M)
    x, y, _ = low @ turned
    J, residual = jnp.array([y, -x, 0, 0, 0, 1]), low @ height
    weight = free.rests / _CONTACT_M**2
    return weight * jnp.outer(J, J), weight * J * residual


def _nearest(queries: Float[Array, "Q 2"], u: Float[Array, " P"], v: Float[Array, " P"]) -> Int[Array, " Q"]:
    """Rows of the points nearest to the queries, pixels.

    XLA's argmin is not vectorised on a CPU, its minimum of integers is, and takes a hundredth of the time: the bits of
    a distance that is not negative order as it does, and the last ones make room for the row.
    """
    dx, dy = queries[:, :1] - u, queries[:, 1:] - v
    rows = (1 << (len(u) - 1).bit_length()) - 1
    distance = jax.lax.bitcast_convert_type(dx * dx + dy * dy, jnp.int32)
    return ((distance & ~rows) | jnp.arange(len(u))).min(axis=1) & rows


def _weighted(J: Float[Array, "6 M"], residual: Float[Array, " M"], weight: Float[Array, " M"]) -> Equations:
    """Equations of residuals in pixels, Geman-McClure weights."""
    robust = weight / (1 + (residual / _EDGE_REACH_PX) ** 2) ** 2 / _EDGE_SIGMA_PX**2
    weighted = robust * J
    return weighted @ J.T, weighted @ residual


def _correlation(R: Float[Array, "3 3"], t: Float[Array, " 3"], source: Source, goal: GoalImage) -> Float[Array, ""]:
    seen = _seen(source.points, R, t, goal)
    values, _, _, inside = _sample(goal.values[-1], seen.u, seen.v)
    a, b = jnp.stack(values) * (inside * source.weights), source.values[-1].T * (inside * source.weights)
    # Points that fall off the object count as disagreeing.
    return (a * b).sum() / jnp.sqrt(((a**2).sum() + 1) * (((source.values[-1] ** 2).sum(1) * source.weights).sum() + 1))


def _spill(R: Float[Array, "3 3"], t: Float[Array, " 3"], source: Source, goal: GoalImage) -> Float[Array, ""]:
    """Mean of the largest distances of the model off the object: a handle on the wrong side shows here."""
    seen = _seen(source.shape, R, t, goal)
    (distance,), _, _, inside = _sample(goal.outside[..., None], seen.u, seen.v)
    off = jnp.where(inside > 0, jnp.minimum(distance, _FAR_PX), _FAR_PX)
    return jax.lax.top_k(off, max(len(off) // _SPILL_PART, 1))[0].mean()


_Channels = list[Float[Array, " M"]]


def _dot(a: _Channels, b: _Channels) -> Float[Array, " M"]:
    """Sum over channels, without an array of them."""
    return sum((p * q for p, q in zip(a, b, strict=True)), jnp.zeros(()))


def _sample(
    image: Float[Array, "S S C"], u: Float[Array, " M"], v: Float[Array, " M"]
) -> tuple[_Channels, _Channels, _Channels, Float[Array, " M"]]:
    """Bilinear values of an image's channels, their slopes to the right and downwards, and 1 where inside."""
    size = image.shape[0]
    inside = (u >= 0) & (u < size - 1.001) & (v >= 0) & (v < size - 1.001)
    u, v = jnp.where(inside, u, 0.0), jnp.where(inside, v, 0.0)
    left, top = jnp.floor(u), jnp.floor(v)
    fx, fy = u - left, v - top
    flat = image.reshape(size * size, -1)
    start = top.astype(jnp.int32) * size + left.astype(jnp.int32)
    corners = (flat[start + step] for step in (0, 1, size, size + 1))
    values, by_u, by_v = [], [], []
    for a, b, c, d in zip(*(corner.T for corner in corners), strict=True):
        above, below = a + fx * (b - a), c + fx * (d - c)
        values.append(above + fy * (below - above))
        by_u.append((1 - fy) * (b - a) + fy * (d - c))
        by_v.append(below - above)
    return values, by_u, by_v, inside.astype(jnp.float32)


def _clipped(step: Float[Array, " 3"], most: float) -> Float[Array, " 3"]:
    return step * jnp.minimum(1.0, most / jnp.maximum(jnp.linalg.norm(step), 1e-12))
