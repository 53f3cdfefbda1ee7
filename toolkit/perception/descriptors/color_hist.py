"""The colour histogram of a region."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from pydantic import Field

from toolkit.perception.stages import Descriptor
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Crop, Float, Image, Mask


class ColorHistogramConfig(PluginConfig):
    """Settings of `color_hist`."""

    bins: int = Field(8, ge=2, le=32, description="Number of bins of each Lab channel.")
    smooth: float = Field(
        0.7,
        ge=0,
        le=4,
        description="Blur of the histogram, in bins, so that colours near the edge of a bin count in the next one too.",
    )


class ColorHistogram(Plugin[ColorHistogramConfig], Descriptor):
    """Joint Lab histogram over the mask, square-rooted (Hellinger kernel; Swain and Ballard, IJCV 1991)."""

    stage = "descriptor"
    name = "color_hist"

    @property
    def crop_size(self) -> int:
        return 96

    def describe(self, crops: Sequence[Crop]) -> Float:
        """Return (N, bins^3) float32 unit rows."""
        return np.stack([lab_histogram(c.image, c.mask, self.config.bins, self.config.smooth) for c in crops])


def lab_histogram(image: Image, mask: Mask, bins: int, smooth: float) -> Float:
    """(bins^3,) float32 unit vector: root of the joint Lab histogram of an (S, S, 3) image over its mask.

    An empty mask gives the uniform vector.
    """
    lab = cv2.cvtColor(image, cv2.COLOR_RGB2LAB).astype(np.float32)[mask]
    # a and b fill the middle half of their range on real objects; L its whole.
    spread = (np.stack([lab[:, 0], 2 * lab[:, 1] - 128, 2 * lab[:, 2] - 128], axis=1) / 256).clip(0, 1 - 1e-6)
    counts, _ = np.histogramdd(spread, bins=bins, range=[(0, 1)] * 3)
    if smooth > 0:
        for axis in range(3):
            counts = _blur(counts, axis, smooth)
    root = np.sqrt(counts.ravel() + 1e-9)
    return (root / np.linalg.norm(root)).astype(np.float32)


def _blur(counts: Float, axis: int, sigma: float) -> Float:
    offsets = np.arange(counts.shape[axis])
    kernel = np.exp(-0.5 * ((offsets[:, None] - offsets[None]) / sigma) ** 2)
    return np.moveaxis(np.tensordot(kernel / kernel.sum(axis=0), counts, axes=(1, axis)), 0, axis)
