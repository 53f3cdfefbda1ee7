"""What of `geometry` is needed inside compiled code, for JAX."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float


def skew(v: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """The matrices of the cross product with vectors."""
    return jnp.cross(v[..., None, :], jnp.eye(3), axisc=-2)


def rotation_exp(w: Float[Array, " 3"]) -> Float[Array, "3 3"]:
    """The rotation exp([w]_x) of a rotation vector in radians (Rodrigues), safe at zero."""
    angle = jnp.linalg.norm(w)
    W = skew(w)
    return jnp.eye(3) + jnp.sinc(angle / jnp.pi) * W + 0.5 * jnp.sinc(angle / (2 * jnp.pi)) ** 2 * (W @ W)
