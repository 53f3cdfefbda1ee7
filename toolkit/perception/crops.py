"""Masked square crops of regions: pad_and_resize of Eq. global_description, resize of Eq. 2D_match."""

from __future__ import annotations

import cv2
import numpy as np

from toolkit.types import Crop, Image, Segment


def crop_region(rgb: Image, segment: Segment, size: int, margin: float = 0.05) -> Crop:
    """Cut the square around a segment's box, padded and never distorted, black outside the mask.

    Args:
        rgb: (H, W, 3) uint8.
        segment: the region.
        size: side S of the crop, pixels.
        margin: free border on every side, as a part of the box's longer side.

    Returns:
        The crop; `Crop.to_image` undoes the resampling exactly.
    """
    x0, y0, x1, y1 = segment.bbox_xyxy
    side = max(x1 - x0, y1 - y0) + 1
    side *= 1 + 2 * margin
    scale = size / side
    # Pixel centres: the crop's first pixel covers [origin - 0.5 / scale, origin + 0.5 / scale] of the image.
    center = np.array([x0 + x1, y0 + y1]) / 2
    origin = center - (size - 1) / 2 / scale
    inside = segment.mask.astype(np.uint8)
    masked = cv2.bitwise_and(rgb, rgb, mask=inside)
    if scale < 1:
        # Averages what falls between the crop's samples, which would alias otherwise.
        masked = cv2.GaussianBlur(masked, (0, 0), 0.5 * np.sqrt(1 / scale**2 - 1))
    to_crop = np.array([[scale, 0, -origin[0] * scale], [0, scale, -origin[1] * scale]])
    interpolation = cv2.INTER_LINEAR if scale < 1 else cv2.INTER_CUBIC
    image = cv2.warpAffine(masked, to_crop, (size, size), flags=interpolation)
    covered = cv2.warpAffine(inside, to_crop, (size, size), flags=cv2.INTER_NEAREST)
    cut = np.asarray(cv2.bitwise_and(image, image, mask=covered), np.uint8)
    return Crop(cut, np.asarray(covered > 0), scale, origin)
