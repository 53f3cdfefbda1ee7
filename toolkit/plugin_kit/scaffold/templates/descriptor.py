"""template: a descriptor. A small blurred picture of the object, as a vector."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from pydantic import Field

from toolkit.registry import Plugin, PluginConfig
from toolkit.stages import Descriptor
from toolkit.types import Crop, Float


class TemplateConfig(PluginConfig):
    """Settings of `template`."""

    side: int = Field(8, ge=2, le=32, description="Side of the small picture, pixels.")


class Template(Plugin[TemplateConfig], Descriptor):
    """Thumbnail: the crop shrunk to a few pixels, its colours as one vector of unit length."""

    stage = "descriptor"
    name = "template"

    @property
    def crop_size(self) -> int:
        return 96

    def describe(self, crops: Sequence[Crop]) -> Float:
        """Return (N, 3 * side^2 + 1) float32 rows of unit length."""
        return np.stack([self._row(crop) for crop in crops])

    def _row(self, crop: Crop) -> Float:
        side = self.config.side
        small = cv2.resize(crop.image, (side, side), interpolation=cv2.INTER_AREA).astype(np.float32) / 255
        # The last entry keeps a black crop from being a vector without length.
        row = np.append(small.ravel(), np.float32(0.01))
        return (row / np.linalg.norm(row)).astype(np.float32)
