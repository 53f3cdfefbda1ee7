"""True masks as segments."""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import Field

from toolkit.errors import ToolkitError
from toolkit.perception.stages import Segmenter
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Frame, Segment


class OracleSegmenterConfig(PluginConfig):
    """Settings of the `oracle` segmenter."""

    min_pixels: int = Field(1, ge=1, description="Objects with fewer visible pixels are left out.")


class OracleSegmenter(Plugin[OracleSegmenterConfig], Segmenter):
    """The true visible masks (mask_visib), in order of object id: what a perfect segmenter would return."""

    stage = "segmenter"
    name = "oracle"

    def segment(self, frame: Frame, current: Sequence[Frame]) -> list[Segment]:
        """Return the frame's true masks; raises ToolkitError where the truth is not known."""
        if frame.true_masks is None:
            raise ToolkitError(
                f"the oracle segmenter needs true masks (mask_visib/), and frame {frame.index} has none; "
                "choose another one, e.g. --segmenter masks for masks of your own in mask_visib/, "
                "or --segmenter depth_plane --goal-segmenter table_appearance"
            )
        masks = [frame.true_masks[key] for key in sorted(frame.true_masks)]
        return [Segment(mask) for mask in masks if mask.sum() >= self.config.min_pixels]
