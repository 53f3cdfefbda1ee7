"""What the objects of the current scene look like: a colour histogram each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from toolkit.perception.tabletop.pieces import objects_on_table
from toolkit.types import Float, Frame, Image

_LEVELS = 8
_SMOOTH_BINS = 0.7
_FLOOR = 1e-3
_MIN_HEIGHT_M, _MIN_PIXELS = 0.0015, 60


def colour_bins(rgb: Image) -> NDArray[np.int64]:
    """(H, W) index of every pixel's colour bin."""
    levels = rgb.astype(np.int64) * _LEVELS // 256
    return (levels[..., 0] * _LEVELS + levels[..., 1]) * _LEVELS + levels[..., 2]


def object_looks(current: Sequence[Frame]) -> Float:
    """(K, B) float64 log-probability of every colour bin for every object that the current frames show.

    Raises:
        ToolkitError: no frame's depth shows a table.
    """
    labels = objects_on_table(current, _MIN_HEIGHT_M, _MIN_PIXELS).labels
    return learn_looks(current, [labels[frame.index] for frame in current])


def learn_looks(frames: Sequence[Frame], labels: Sequence[NDArray[np.int32]]) -> Float:
    """Learn what each object of the current scene looks like.

    Args:
        frames: of the current scene.
        labels: (H, W) label image of every frame, the objects by the same numbers 1..K in all of them.

    Returns:
        (K, B) float64 log-probability of every colour bin for every object.
    """
    count = max((int(label.max()) for label in labels), default=0)
    counts = np.zeros((count, _LEVELS**3))
    for frame, label in zip(frames, labels, strict=True):
        shown = label > 0
        np.add.at(counts, (label[shown] - 1, colour_bins(frame.rgb)[shown]), 1)
    if not count:
        return counts
    cubes = counts.reshape(-1, _LEVELS, _LEVELS, _LEVELS)
    smooth = gaussian_filter(cubes, (0, _SMOOTH_BINS, _SMOOTH_BINS, _SMOOTH_BINS)).reshape(counts.shape)
    shares = smooth / np.maximum(smooth.sum(axis=1, keepdims=True), 1)
    return np.log(shares + _FLOOR)
