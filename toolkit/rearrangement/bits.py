"""Sets of small numbers as the bits of an integer."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np


def bits(mask: int) -> Iterator[int]:
    """Positions of the bits that are set, ascending."""
    while mask:
        lowest = mask & -mask
        yield lowest.bit_length() - 1
        mask ^= lowest


def any_bit(mask: int, rng: np.random.Generator) -> int:
    """Position of one of the bits that are set, at random."""
    rank, position, width = int(rng.integers(mask.bit_count())), 0, mask.bit_length()
    while width > 1:
        half = width // 2
        low = mask & (1 << half) - 1
        if rank < low.bit_count():
            mask, width = low, half
        else:
            rank -= low.bit_count()
            mask, width, position = mask >> half, width - half, position + half
    return position
