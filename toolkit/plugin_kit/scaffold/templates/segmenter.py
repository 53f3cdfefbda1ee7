"""template: a segmenter. What stands higher than most of what the depth image shows."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from pydantic import Field

from toolkit.errors import ToolkitError
from toolkit.geometry import lift
from toolkit.registry import Plugin, PluginConfig
from toolkit.stages import Segmenter
from toolkit.types import Frame, Segment


class TemplateConfig(PluginConfig):
    """Settings of `template`."""

    min_height_m: float = Field(0.006, gt=0, description="Lower points belong to the table.")
    min_pixels: int = Field(60, ge=1, description="Segments with fewer pixels are dropped.")


class Template(Plugin[TemplateConfig], Segmenter):
    """Connected pixels above the table, whose height is that of most points; z is up in the world. Needs depth."""

    stage = "segmenter"
    name = "template"

    def segment(self, frame: Frame, current: Sequence[Frame]) -> list[Segment]:
        """Return one Segment an object, from left to right; raises ToolkitError where the frame has no depth."""
        if frame.depth is None:
            raise ToolkitError(f"the template segmenter needs depth, and frame {frame.index} has none")
        y, x = np.nonzero(frame.depth > 0)
        if not len(x):
            return []
        pixels = np.stack([x, y], axis=1).astype(np.float64)
        heights = lift(frame.camera.K, frame.camera.T_world_camera, pixels, frame.depth[y, x])[:, 2]
        high = np.zeros(frame.depth.shape, np.uint8)
        high[y, x] = heights > np.median(heights) + self.config.min_height_m
        _, labels, stats, _ = cv2.connectedComponentsWithStats(high, connectivity=4)
        order = np.argsort(stats[1:, cv2.CC_STAT_LEFT], kind="stable") + 1
        kept = [label for label in order if stats[label, cv2.CC_STAT_AREA] >= self.config.min_pixels]
        return [Segment(labels == label) for label in kept]
