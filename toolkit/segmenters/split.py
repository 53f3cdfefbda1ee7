"""Touching objects, parted at their necks."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.segmenters.labels import keep, nearest_label
from toolkit.types import Mask

_NECK = 0.65
"""A neck is where the blob is narrower than this part of the narrower side's own width."""


def split_touching(labels: NDArray[np.int32], wanted: int, min_pixels: int) -> NDArray[np.int32]:
    """Split blobs, the clearest neck first, until there are `wanted` or no clear neck is left.

    Args:
        labels: (H, W) int32 label image.
        wanted: how many objects there are.
        min_pixels: no part may be smaller.
    """
    labels = labels.copy()
    count = int(labels.max())
    cuts = {k: best_cut(labels == k, min_pixels) for k in range(1, count + 1)} if count < wanted else {}
    while count < wanted:
        blob = min(cuts, key=lambda k: cuts[k][0], default=None)
        if blob is None or cuts[blob][0] > _NECK:
            break
        count += 1
        labels[cuts[blob][1]] = count
        for k in (blob, count):
            cuts[k] = best_cut(labels == k, min_pixels)
    return keep(labels, np.ones(count + 1, bool), 1)


def best_cut(mask: Mask, min_pixels: int) -> tuple[float, Mask]:
    """Return the neck's width relative to the narrower part's, inf without a neck, and the part (H, W) to cut off.

    Level sets of the distance to the border come apart at necks: this is the watershed of the distance transform,
    level by level (Vincent and Soille, PAMI 1991), with the depth of each saddle at hand.
    """
    distance = cv2.distanceTransform(np.pad(mask.astype(np.uint8), 1), cv2.DIST_L2, 5)[1:-1, 1:-1]
    best, part = np.inf, mask
    for level in np.arange(0.5, float(distance.max()), 0.5):
        _, cores = cv2.connectedComponents((distance > level).astype(np.uint8), connectivity=8)
        n = int(cores.max())
        if n < 2:
            continue
        peaks = np.zeros(n + 1)
        np.maximum.at(peaks, cores.ravel(), distance.ravel())
        order = np.argsort(-peaks[1:]) + 1
        ratio = float(level / peaks[order[1]])
        if ratio < best:
            cut = mask & (nearest_label(np.where(cores == order[1], 2, (cores > 0).astype(np.int32))) == 2)
            if min_pixels <= cut.sum() <= mask.sum() - min_pixels:
                best, part = ratio, cut
    return best, part
