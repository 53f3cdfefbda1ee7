"""From a difference image to blobs with crisp borders."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.perception.tabletop.appearance import TableView
from toolkit.perception.tabletop.labels import keep
from toolkit.perception.tabletop.refine import snap_to_colour
from toolkit.types import Float, Image, Mask

_GROW = 0.5
_EDGE_PX = 5
_HOLE_SHARE = 0.02


def find_blobs(rgb: Image, score: Float, view: TableView, threshold: float, min_pixels: int) -> NDArray[np.int32]:
    """Label what differs from the table.

    Args:
        rgb: (H, W, 3) the image.
        score: (H, W) from `difference`.
        view: the empty table in the same camera.
        threshold: a blob is real with a pixel above it, and reaches down to half of it.
        min_pixels: smaller blobs are dropped.

    Returns:
        (H, W) int32: 0 for none, else 1..n in row-major order of the blobs' first pixels.
    """
    low = (score > _GROW * threshold).astype(np.uint8)
    low = cv2.morphologyEx(low, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    labels = cv2.connectedComponents(low, connectivity=8)[1].astype(np.int32)
    count = int(labels.max()) + 1
    strong = np.bincount(labels[score > threshold], minlength=count) >= min(min_pixels, 20)
    labels = keep(labels, strong & ~_clutter(labels, view), min_pixels)
    refined = snap_to_colour(rgb, _fill_holes(labels), iterations=2)
    # A refined blob may have come apart; its crumbs are dropped and its parts stay together.
    return keep(refined, np.ones(int(refined.max()) + 1, bool), min_pixels)


def _clutter(labels: NDArray[np.int32], view: TableView) -> Mask:
    """(n + 1,) blobs that are not on the table: no part on it, or nothing but a thin line along its edge."""
    count = int(labels.max()) + 1
    sizes = np.maximum(np.bincount(labels.ravel(), minlength=count), 1)
    kernel = np.ones((2 * _EDGE_PX + 1,) * 2, np.uint8)
    # Where the image ends, the table does not.
    padded = np.pad(view.table.astype(np.uint8), _EDGE_PX, mode="edge")
    trim = slice(_EDGE_PX, -_EDGE_PX)
    edge = (cv2.dilate(padded, kernel) > cv2.erode(padded, kernel))[trim, trim]
    on_table = np.bincount(labels[view.table], minlength=count) / sizes
    on_edge = np.bincount(labels[edge], minlength=count) / sizes
    return (on_table < 0.1) | (on_edge > 0.6)


def _fill_holes(labels: NDArray[np.int32]) -> NDArray[np.int32]:
    """Close holes that are small beside their blob: print that looks like the table, not a mug's handle."""
    filled = labels.copy()
    for label in range(1, int(labels.max()) + 1):
        mask = (labels == label).astype(np.uint8)
        contours, tree = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        area = int(mask.sum())
        for contour, (_, _, _, parent) in zip(contours, [] if tree is None else tree[0], strict=False):
            if parent >= 0 and cv2.contourArea(contour) < _HOLE_SHARE * area:
                cv2.drawContours(mask, [contour], -1, 1, cv2.FILLED)
        filled[(mask > 0) & (labels == 0)] = label
    return filled
