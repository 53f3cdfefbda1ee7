"""What the objects of the current scene look like: a colour histogram each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from toolkit.types import Float, Frame, Image

_LEVELS = 8
_SMOOTH_BINS = 0.7
_FLOOR = 1e-3
_SAME_PLACE_M = 0.05
_SIGHTINGS = 1 / 3
"""A fragment of an object is a cluster of its own in few frames only."""


def colour_bins(rgb: Image) -> NDArray[np.int64]:
    """(H, W) index of every pixel's colour bin."""
    levels = rgb.astype(np.int64) * _LEVELS // 256
    return (levels[..., 0] * _LEVELS + levels[..., 1]) * _LEVELS + levels[..., 2]


def learn_looks(frames: Sequence[Frame], labels: Sequence[NDArray[np.int32]], places: Sequence[Float]) -> Float:
    """Learn the objects of the frame that shows most, from all frames.

    Args:
        frames: of the current scene.
        labels: (H, W) label image of every frame, 1..n.
        places: (n, 2) plan position of every label, metres, one array per frame.

    Returns:
        (K, B) float64 log-probability of every colour bin for every object.
    """
    fullest = int(np.argmax([len(place) for place in places]))
    known = places[fullest]
    counts = np.zeros((len(known), _LEVELS**3))
    sightings = np.zeros(len(known))
    if not len(known):
        return counts
    for frame, label, place in zip(frames, labels, places, strict=True):
        bins = colour_bins(frame.rgb)
        gaps = np.linalg.norm(place[:, None] - known[None], axis=2) if len(place) else np.zeros((0, len(known)))
        for k, row in enumerate(gaps, start=1):
            if row.min() < _SAME_PLACE_M:
                counts[row.argmin()] += np.bincount(bins[label == k], minlength=_LEVELS**3)
                sightings[row.argmin()] += 1
    counts = counts[sightings > _SIGHTINGS * len(frames)]
    cubes = counts.reshape(-1, _LEVELS, _LEVELS, _LEVELS)
    smooth = gaussian_filter(cubes, (0, _SMOOTH_BINS, _SMOOTH_BINS, _SMOOTH_BINS)).reshape(counts.shape)
    shares = smooth / np.maximum(smooth.sum(axis=1, keepdims=True), 1)
    return np.log(shares + _FLOOR)
