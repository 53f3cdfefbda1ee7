"""What of `geometry` is needed inside compiled code, for JAX, and the way into it."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float


def on_device(values: Any) -> Float[Array, ...]:
    """Numbers as a float32 array of JAX's; unlike `jnp.asarray`, without a program compiled for every shape."""
    return jax.device_put(np.asarray(values, np.float32))


def rotated(R: Float[Array, "3 3"], points: Float[Array, "N 3"]) -> tuple[Float[Array, " N"], ...]:
    """x, y and z of R p for all points p.

    One array per coordinate: XLA fuses what is so with what comes after it into one loop, and products of small
    matrices not at all.
    """
    x, y, z = points.T
    return tuple(R[i, 0] * x + R[i, 1] * y + R[i, 2] * z for i in range(3))


def skew(v: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """The matrices of the cross product with vectors."""
    return jnp.cross(v[..., None, :], jnp.eye(3), axisc=-2)


def rotation_exp(w: Float[Array, " 3"]) -> Float[Array, "3 3"]:
    """The rotation exp([w]_x) of a rotation vector in radians (Rodrigues), safe at zero."""
    angle = jnp.linalg.norm(w)
    W = skew(w)
    return jnp.eye(3) + jnp.sinc(angle / jnp.pi) * W + 0.5 * jnp.sinc(angle / (2 * jnp.pi)) ** 2 * (W @ W)
