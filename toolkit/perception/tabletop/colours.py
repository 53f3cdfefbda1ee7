"""Colours counted in bins: what tells objects apart, and pieces of one object alike."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from toolkit.types import Float

_LEVELS = 8
BINS = _LEVELS**3
_SMOOTH_BINS = 0.7


def colour_bins(rgb: NDArray[Any]) -> NDArray[np.int64]:
    """(...) index of the bin, below BINS, of each of (..., 3) RGB colours, 0 to 255."""
    levels = rgb.astype(np.int64) * _LEVELS // 256
    return (levels[..., 0] * _LEVELS + levels[..., 1]) * _LEVELS + levels[..., 2]


def smooth_histograms(owners: NDArray[np.integer[Any]], bins: NDArray[np.int64], count: int) -> Float:
    """(count, BINS) float64 colour histograms, each bin shared with those beside it.

    Args:
        owners: (P,) whose colour each is, 0 to count - 1.
        bins: (P,) its bin.
        count: number of histograms.
    """
    counts = np.bincount(owners * BINS + bins, minlength=count * BINS).astype(np.float64)
    cubes = counts.reshape(count, _LEVELS, _LEVELS, _LEVELS)
    return gaussian_filter(cubes, (0, *[_SMOOTH_BINS] * 3)).reshape(count, BINS)
