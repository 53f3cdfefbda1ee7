"""What Segment Anything calls objects inside a foreground: a grid of points, filtered as its authors do."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.perception.segmenters.networks.sam import Sam, SamMask
from toolkit.types import Float, Image, Mask

_LEAST_STABILITY, _LEAST_QUALITY = 0.9, 0.8
_SAME = 0.8
"""IoU above which two masks are one."""


def propose(sam: Sam, rgb: Image, labels: NDArray[np.int32], step: int, min_pixels: int) -> list[Mask]:
    """Ask for the object at every point of a grid inside the labels.

    Args:
        sam: the network.
        rgb: (H, W, 3) the image.
        labels: (H, W) int32, 0 for the background.
        step: pixels between the grid's points; every label gets one at least, where it is deepest.
        min_pixels: smaller masks are dropped.

    Returns:
        (H, W) bool masks inside the foreground, none like another, the most stable first.
    """
    if not labels.any():
        return []
    image, foreground = sam.encode(rgb), labels > 0
    found = [sam.at_points(image, point[None]) for point in grid_points(labels, step)]
    sharp = [f for f in found if f.stability >= _LEAST_STABILITY and f.quality >= _LEAST_QUALITY]
    inside = [SamMask(f.mask & foreground, f.quality, f.stability) for f in sharp]
    return suppress([f for f in inside if f.mask.sum() >= min_pixels])


def grid_points(labels: NDArray[np.int32], step: int) -> Float:
    """(N, 2) pixels (x, y): a grid over the labels, away from their borders, and the deepest pixel of each."""
    points: list[tuple[int, int]] = []
    for label in range(1, int(labels.max()) + 1):
        depth = cv2.distanceTransform(np.pad((labels == label).astype(np.uint8), 1), cv2.DIST_L2, 5)[1:-1, 1:-1]
        y, x = np.unravel_index(int(depth.argmax()), depth.shape)
        points.append((int(x), int(y)))
        rows, columns = np.nonzero(depth[step // 2 :: step, step // 2 :: step] > step / 6)
        points += zip((columns * step + step // 2).tolist(), (rows * step + step // 2).tolist(), strict=True)
    return np.array(points, np.float64)


def suppress(found: list[SamMask]) -> list[Mask]:
    """The most stable masks first, without those that a better one covers as well (non-maximum suppression)."""
    kept: list[Mask] = []
    for candidate in sorted(found, key=lambda f: -f.stability):
        if all((candidate.mask & m).sum() < _SAME * (candidate.mask | m).sum() for m in kept):
            kept.append(candidate.mask)
    return kept
