"""Histograms of oriented gradients of a region."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from toolkit.registry import Plugin
from toolkit.types import Crop, Float


class Hog(Plugin):
    """Histograms of oriented gradients on the masked crop (Dalal and Triggs, CVPR 2005), by OpenCV."""

    stage = "descriptor"
    name = "hog"
    crop_size = 64

    def describe(self, crops: Sequence[Crop]) -> Float:
        """Return (N, 1764) float32 unit rows."""
        hog = cv2.HOGDescriptor((64, 64), (16, 16), (8, 8), (8, 8), 9)
        rows = np.stack([hog.compute(cv2.cvtColor(crop.image, cv2.COLOR_RGB2GRAY)).ravel() for crop in crops])
        # A crop without any gradient still needs a direction.
        rows += 1e-6
        return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)
