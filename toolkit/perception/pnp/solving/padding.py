"""Correspondences in few fixed sizes: a compiled program has one shape, and every further shape costs a second."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Shaped
from numpy.typing import NDArray

SMALLEST = 128
_SIZES = tuple(SMALLEST * 4**k for k in range(8))


def pad_rows(rows: Shaped[NDArray[Any], "N ..."]) -> Shaped[jax.Array, "padded ..."]:
    """Fill rows up with zeros to the next of the sizes."""
    size = next((size for size in _SIZES if size >= len(rows)), len(rows))
    padded = np.zeros((size, *rows.shape[1:]), rows.dtype)
    padded[: len(rows)] = rows
    return jnp.asarray(padded)
