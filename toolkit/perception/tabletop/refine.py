"""Borders of labelled regions, moved to where the colour changes."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.types import Image, Mask

_BAND_PX = 4
_MARGIN_PX = 12


def snap_to_colour(rgb: Image, labels: NDArray[np.int32], iterations: int = 1) -> NDArray[np.int32]:
    """Let GrabCut decide the band around each region's border; (H, W) int32 labels in and out."""
    refined = labels.copy()
    for label in range(1, int(labels.max(initial=0)) + 1):
        mask = labels == label
        others = (labels > 0) & ~mask
        box = window(mask, _MARGIN_PX)
        cut = grabcut(rgb[box], mask[box], others[box], iterations)
        refined[box][mask[box]] = 0
        refined[box][cut] = label
    return refined


def window(mask: Mask, margin: int) -> tuple[slice, slice]:
    """The rows and columns of a mask's box, `margin` pixels wider."""
    x, y, width, height = cv2.boundingRect(mask.astype(np.uint8))
    return slice(max(y - margin, 0), y + height + margin), slice(max(x - margin, 0), x + width + margin)


def grabcut(rgb: Image, mask: Mask, never: Mask, iterations: int) -> Mask:
    """Refine a mask within _BAND_PX of its border (Rother et al., "GrabCut", SIGGRAPH 2004).

    Args:
        rgb: (H, W, 3).
        mask: (H, W) the first guess.
        never: (H, W) pixels that belong to something else.
        iterations: of GrabCut.
    """
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _BAND_PX + 1, 2 * _BAND_PX + 1))
    inner = cv2.erode(mask.astype(np.uint8), kernel) > 0
    outer = cv2.dilate(mask.astype(np.uint8), kernel) > 0
    marks = np.where(mask, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    marks[inner] = cv2.GC_FGD
    marks[~outer | never] = cv2.GC_BGD
    if not (marks == cv2.GC_BGD).any() or not ((marks & 1) == 1).any():
        return mask
    # OpenCV starts its colour models from its own generator, which is global.
    cv2.setRNGSeed(0)
    cv2.grabCut(
        np.ascontiguousarray(rgb),
        marks,
        (0, 0, 0, 0),
        np.zeros((1, 65)),
        np.zeros((1, 65)),
        iterations,
        cv2.GC_INIT_WITH_MASK,
    )
    return (marks & 1) == 1
