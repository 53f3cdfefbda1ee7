"""Objects as all current frames together see them: one cut through their joined depth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import Field

from toolkit.errors import ToolkitError
from toolkit.perception.stages import Segmenter
from toolkit.perception.tabletop.pieces import objects_on_table
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Frame, Segment


class MultiviewConfig(PluginConfig):
    """Settings of the `multiview` segmenter."""

    min_height_mm: float = Field(1.5, gt=0, description="What is lower than this is table; more where depth is noisy.")
    min_pixels: int = Field(60, ge=1, description="Objects of fewer pixels, all frames together, are dropped.")


class MultiviewSegmenter(Plugin[MultiviewConfig], Segmenter):
    """What stands on the table, joined over all posed RGB-D frames, parted at creases, cut out of every frame.

    Objects are mostly convex, so they part where the surface is concave (Stein et al., CVPR 2014) or ends; colours join
    what one object shows in two parts. What the frames do not agree on is noise. Every segment says which object it is
    of, by the same numbers in all frames, and by its score how likely that is a whole one. One frame alone works as far
    as it can.
    """

    stage = "segmenter"
    name = "multiview"

    def segment(self, frame: Frame, current: Sequence[Frame]) -> list[Segment]:
        """Return the objects in one of the current frames.

        Raises:
            ToolkitError: the frame is none of the current ones, or no table is in their depth.
        """
        if not any(frame is other for other in current):
            raise ToolkitError(
                f"multiview joins the depth of the current frames, and frame {frame.index} is none of them;"
                " choose a segmenter for colour images as goal_segmenter, such as table_appearance"
            )
        found = objects_on_table(current, self.config.min_height_mm / 1e3, self.config.min_pixels)
        labels = found.labels[frame.index]
        return [Segment(labels == k, float(found.whole[k - 1]), int(k) - 1) for k in np.unique(labels[labels > 0])]
