"""Label images: (H, W) int32, 0 for none, objects 1..n in row-major order of their first pixels."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def keep(labels: NDArray[np.int32], wanted: NDArray[np.bool_], min_pixels: int) -> NDArray[np.int32]:
    """Drop labels that are not wanted or small, and number the rest by their first pixel in row-major order.

    Args:
        labels: (H, W) of values 0..n.
        wanted: (n + 1,).
        min_pixels: fewer make a label small.
    """
    values, first, sizes = np.unique(labels, return_index=True, return_counts=True)
    good = (values > 0) & wanted[values] & (sizes >= min_pixels)
    ranked = values[good][np.argsort(first[good])]
    table = np.zeros(int(values.max(initial=0)) + 1, np.int32)
    table[ranked] = np.arange(1, len(ranked) + 1)
    return table[labels]


def nearest_label(labels: NDArray[np.int32]) -> NDArray[np.int32]:
    """(H, W) int32: for every pixel the label of the nearest labelled pixel; all 0 where there is none."""
    if not labels.any():
        return labels
    _, owners = cv2.distanceTransformWithLabels(
        (labels == 0).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    known = labels > 0
    table = np.zeros(int(owners.max()) + 1, np.int32)
    table[owners[known]] = labels[known]
    return table[owners]
