"""The perspective-three-point problem in JAX, free of branches so that `vmap` turns it into one batched solver.

The three unknown depths lie on two conics; a degenerate member of their pencil is a pair of lines, and each line meets
a conic in two points. Persson and Nordberg, "Lambda Twist" (ECCV 2018), in the form of Ding et al., "Revisiting the P3P
Problem" (CVPR 2023).
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from toolkit.perception.jax_geometry import skew

_NEWTON_STEPS = 2


def p3p(
    points: Float[Array, "3 3"], bearings: Float[Array, "3 3"]
) -> tuple[Float[Array, "4 3 3"], Float[Array, "4 3"], Bool[Array, " 4"]]:
    """Solve for the up to four poses that take three points onto three rays.

    Args:
        points: one world point in every row, not collinear.
        bearings: one unit viewing ray in every row, camera coordinates.

    Returns:
        Rotations and translations, world to camera, and which of them are real solutions; the others hold arbitrary
        numbers.
    """
    i, j = jnp.array([0, 0, 1]), jnp.array([1, 2, 2])
    squared = jnp.sum((points[i] - points[j]) ** 2, axis=1)
    # |l_i y_i - l_j y_j|^2 = l^T M l = squared distance, for every pair of points.
    cosine = jnp.sum(bearings[i] * bearings[j], axis=1)
    pair = jnp.arange(3)
    M = (
        jnp.zeros((3, 3, 3))
        .at[pair, i, i]
        .set(1.0)
        .at[pair, j, j]
        .set(1.0)
        .at[pair, i, j]
        .set(-cosine)
        .at[pair, j, i]
        .set(-cosine)
    )

    D1 = squared[2] * M[0] - squared[0] * M[2]
    D2 = squared[2] * M[1] - squared[1] * M[2]
    adj1, adj2 = _adjugate(D1), _adjugate(D2)
    gamma = _real_root(jnp.sum(D2 * adj2) / 3, jnp.sum(D1 * adj2), jnp.sum(adj1 * D2), jnp.sum(D1 * adj1) / 3)
    lines, lines_real = _split(D1 + gamma * D2)
    cross = skew(lines)
    depths, points_real = jax.vmap(_split)(jnp.swapaxes(cross, 1, 2) @ D1 @ cross)

    depths = depths.reshape(4, 3)
    depths = depths * jnp.sqrt(squared.sum() / jnp.einsum("si,pij,sj->s", depths, M, depths))[:, None]
    depths = depths * jnp.sign(depths[:, :1])

    rotations = jax.vmap(lambda ends: _frame(ends) @ _frame(points).T)(depths[:, :, None] * bearings)
    translations = depths[:, :1] * bearings[0] - rotations @ points[0]
    valid = lines_real & jnp.repeat(points_real, 2) & jnp.all(depths > 0, axis=1)
    return rotations, translations, valid & jnp.all(jnp.isfinite(translations), axis=1)


def _real_root(a: Float[Array, ""], b: Float[Array, ""], c: Float[Array, ""], d: Float[Array, ""]) -> Float[Array, ""]:
    """One real root of a x^3 + b x^2 + c x + d (Cardano), polished by Newton's method."""
    shift = b / (3 * a)
    p = c / a - 3 * shift**2
    q = 2 * shift**3 - shift * c / a + d / a
    discriminant = (q / 2) ** 2 + (p / 3) ** 3
    # One real root: of the two cube roots take the one without cancellation.
    u = -jnp.sign(q) * jnp.cbrt(jnp.abs(q) / 2 + jnp.sqrt(jnp.maximum(discriminant, 0.0)))
    single = u - p / (3 * u)
    # Three real roots: the outermost one, farthest from a double root.
    r = jnp.sqrt(jnp.maximum(-p / 3, 0.0))
    largest = 2 * r * jnp.cos(jnp.arccos(jnp.clip(jnp.abs(q) / (2 * r**3), 0.0, 1.0)) / 3)
    triple = -jnp.sign(q) * largest
    x = jnp.where(discriminant > 0, single, triple) - shift
    for _ in range(_NEWTON_STEPS):
        x = x - (((a * x + b) * x + c) * x + d) / ((3 * a * x + 2 * b) * x + c)
    return x


def _split(conic: Float[Array, "3 3"]) -> tuple[Float[Array, "2 3"], Bool[Array, ""]]:
    """Factor a symmetric matrix of rank two, l m^T + m l^T: rows l and m, and whether they are real.

    A degenerate conic becomes its two lines; the dual conic of a line's two points becomes the points.
    """
    crossed = -_adjugate(conic)
    k = jnp.argmax(jnp.diagonal(crossed))
    square = crossed[k, k]
    rank_one = conic + skew(crossed[:, k] / jnp.sqrt(jnp.abs(square)))
    row, column = jnp.divmod(jnp.argmax(jnp.abs(rank_one)), 3)
    return jnp.stack([rank_one[row], rank_one[:, column]]), square > 0


def _adjugate(A: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Adjugate of a symmetric matrix."""
    return jnp.stack([jnp.cross(A[1], A[2]), jnp.cross(A[2], A[0]), jnp.cross(A[0], A[1])])


def _frame(triangle: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Orthonormal axes, as columns, of a triangle's rows."""
    x = triangle[1] - triangle[0]
    z = jnp.cross(x, triangle[2] - triangle[0])
    axes = jnp.stack([x / jnp.linalg.norm(x), z / jnp.linalg.norm(z)])
    return jnp.stack([axes[0], jnp.cross(axes[1], axes[0]), axes[1]], axis=1)
