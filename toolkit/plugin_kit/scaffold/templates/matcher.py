"""template: a matcher. Corners of one crop are sought in the other by normalised correlation of small patches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from pydantic import Field

from toolkit.registry import Plugin, PluginConfig
from toolkit.stages import Matcher
from toolkit.types import Crop, Float, Matches


class TemplateConfig(PluginConfig):
    """Settings of `template`."""

    crop_size: int = Field(256, ge=64, description="Side of the crops, in pixels.")
    max_corners: int = Field(300, ge=8, description="Corners kept per crop.")
    patch_px: int = Field(15, ge=5, description="Side of a patch, pixels; odd.")
    min_correlation: float = Field(0.8, ge=0, le=1, description="Patches that agree less are no match.")


@dataclass(frozen=True, eq=False)
class Corners:
    """(N, 2) float64 corners in crop pixels (x, y), and (N, patch * patch) float32 patches, normalised."""

    xy: Float
    patches: Float


class Template(Plugin[TemplateConfig], Matcher):
    """Corners (Shi and Tomasi, CVPR 1994) matched by correlation, mutually nearest."""

    stage = "matcher"
    name = "template"

    @property
    def crop_size(self) -> int:
        """Side of the crops, in pixels."""
        return self.config.crop_size

    def extract(self, crops: Sequence[Crop]) -> list[Corners]:
        """Find corners on every crop's object; done once for every crop."""
        return [self._corners(crop) for crop in crops]

    def match(self, query: Corners, references: Sequence[Corners]) -> list[Matches]:
        """Match one crop's corners to those of each reference."""
        return [self._match(query, reference) for reference in references]

    def _corners(self, crop: Crop) -> Corners:
        size = self.config.patch_px // 2 * 2 + 1
        gray = cv2.cvtColor(crop.image, cv2.COLOR_RGB2GRAY)
        inside = cv2.erode(crop.mask.astype(np.uint8), np.ones((5, 5), np.uint8))
        found: Any = cv2.goodFeaturesToTrack(gray, self.config.max_corners, 0.01, 3, mask=inside)
        if found is None:
            return Corners(np.zeros((0, 2)), np.zeros((0, size * size), np.float32))
        xy = found.reshape(-1, 2).astype(np.float64)
        patches = np.stack([cv2.getRectSubPix(gray, (size, size), (x, y)) for x, y in xy.tolist()])
        flat = patches.reshape(len(xy), -1).astype(np.float32)
        flat -= flat.mean(axis=1, keepdims=True)
        return Corners(xy, flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-6))

    def _match(self, query: Corners, reference: Corners) -> Matches:
        if not len(query.xy) or not len(reference.xy):
            return Matches.empty()
        correlation = query.patches @ reference.patches.T
        nearest = correlation.argmax(axis=1)
        rows = np.arange(len(nearest))
        best = correlation[rows, nearest].astype(np.float64)
        keep = (correlation.argmax(axis=0)[nearest] == rows) & (best >= self.config.min_correlation)
        return Matches(query.xy[keep], reference.xy[nearest[keep]], best[keep].clip(0, 1))
