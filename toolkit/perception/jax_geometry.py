"""What of `geometry` is needed inside compiled code, for JAX."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array


def rotation_exp(w: Array) -> Array:
    """(3, 3) rotation exp([w]_x) of a (3,) rotation vector in radians (Rodrigues), safe at zero."""
    angle = jnp.linalg.norm(w)
    W = jnp.cross(w, jnp.eye(3), axisb=0, axisc=0)
    return jnp.eye(3) + jnp.sinc(angle / jnp.pi) * W + 0.5 * jnp.sinc(angle / (2 * jnp.pi)) ** 2 * (W @ W)
