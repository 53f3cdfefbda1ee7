"""RootSIFT: keypoints of a crop and their descriptors (Lowe, IJCV 2004; Arandjelovic and Zisserman, CVPR 2012)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from toolkit.types import Crop, Float


@dataclass(frozen=True, eq=False)
class SiftFeatures:
    """(N, 2) float64 keypoints in crop pixels and (N, 128) float32 RootSIFT rows of unit length."""

    xy: Float
    descriptors: Float


def root_sift(sift: cv2.SIFT, crop: Crop, border_px: int) -> SiftFeatures:
    """RootSIFT features of one crop, away from the silhouette."""
    gray = cv2.cvtColor(crop.image, cv2.COLOR_RGB2GRAY)
    mask = crop.mask.astype(np.uint8)
    if border_px:
        kernel = np.ones((2 * border_px + 1, 2 * border_px + 1), np.uint8)
        mask = cv2.erode(mask, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    keypoints, descriptors = sift.detectAndCompute(gray, mask)
    if not len(keypoints):
        return SiftFeatures(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    rooted = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9))
    return SiftFeatures(np.array([k.pt for k in keypoints], np.float64), rooted.astype(np.float32))
