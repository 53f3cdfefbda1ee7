"""Arrays in few fixed sizes: a compiled program has one shape, and every further shape costs a second."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
from jaxtyping import Shaped
from numpy.typing import NDArray

SMALLEST = 128
_STEPS = 8


def pad_rows(rows: Shaped[NDArray[Any], "N ..."], least: int = SMALLEST) -> Shaped[jax.Array, "padded ..."]:
    """Fill rows up with zeros to the next of the sizes: `least`, and four times as many again and again."""
    size = next((least * 4**k for k in range(_STEPS) if least * 4**k >= len(rows)), len(rows))
    padded = np.zeros((size, *rows.shape[1:]), rows.dtype)
    padded[: len(rows)] = rows
    return jax.device_put(padded)  # `jnp.asarray` compiles a program for every shape
