"""Histograms of oriented gradients of a region."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from pydantic import Field

from toolkit.perception.stages import Descriptor
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Crop, Float, Image


class HogConfig(PluginConfig):
    """Settings of `hog`."""

    cells: int = Field(8, ge=2, le=32, description="Number of cells per side.")
    orientations: int = Field(9, ge=2, le=36, description="Number of bins over 180 degrees.")


class Hog(Plugin[HogConfig], Descriptor):
    """Histograms of oriented gradients on the masked crop (Dalal and Triggs, CVPR 2005), blocks of 2 x 2 cells."""

    stage = "descriptor"
    name = "hog"

    @property
    def crop_size(self) -> int:
        return 64

    def describe(self, crops: Sequence[Crop]) -> Float:
        """Return (N, (cells - 1)^2 * 4 * orientations) float32 unit rows."""
        return np.stack([hog(crop.image, self.config.cells, self.config.orientations) for crop in crops])


def hog(image: Image, cells: int, orientations: int) -> Float:
    """Block-normalised gradient histograms of an (S, S, 3) image as one float32 unit vector."""
    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    dx = cv2.Sobel(gray, cv2.CV_32F, 1, 0, ksize=1)
    dy = cv2.Sobel(gray, cv2.CV_32F, 0, 1, ksize=1)
    strength = np.hypot(dx, dy)
    # Each gradient is shared by the two nearest orientations, so that a small turn changes little.
    place = (np.arctan2(dy, dx) % np.pi) / np.pi * orientations
    low = np.floor(place).astype(np.int64)
    part = place - low
    layers = np.zeros((orientations, *gray.shape), np.float32)
    rows, columns = np.indices(gray.shape)
    np.add.at(layers, (low % orientations, rows, columns), strength * (1 - part))
    np.add.at(layers, ((low + 1) % orientations, rows, columns), strength * part)
    stacked = np.ascontiguousarray(layers.transpose(1, 2, 0))
    grid = np.asarray(cv2.resize(stacked, (cells, cells), interpolation=cv2.INTER_AREA))
    blocks = np.concatenate([grid[:-1, :-1], grid[1:, :-1], grid[:-1, 1:], grid[1:, 1:]], axis=-1)
    # The floor keeps a crop without any gradient a direction of its own.
    blocks = blocks + 1e-3
    flat = (blocks / np.linalg.norm(blocks, axis=-1, keepdims=True)).ravel()
    return (flat / np.linalg.norm(flat)).astype(np.float32)
