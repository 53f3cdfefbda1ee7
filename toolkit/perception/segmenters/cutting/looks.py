"""What the objects of the current scene look like: a colour histogram each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from toolkit.perception.tabletop.colours import BINS, colour_bins, smooth_histograms
from toolkit.perception.tabletop.pieces import objects_on_table
from toolkit.types import Float, Frame

_FLOOR = 1e-3
_MIN_HEIGHT_M, _MIN_PIXELS = 0.0015, 60


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
    if not count:
        return np.zeros((0, BINS))
    shown = [label > 0 for label in labels]
    owners = np.concatenate([label[where] - 1 for label, where in zip(labels, shown, strict=True)])
    bins = np.concatenate([colour_bins(frame.rgb[where]) for frame, where in zip(frames, shown, strict=True)])
    smooth = smooth_histograms(owners, bins, count)
    shares = smooth / np.maximum(smooth.sum(axis=1, keepdims=True), 1)
    return np.log(shares + _FLOOR)
