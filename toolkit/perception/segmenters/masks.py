"""Masks that come with the images: a user's own."""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import Field

from toolkit.errors import ToolkitError
from toolkit.perception.stages import Segmenter
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Frame, Segment


class MasksConfig(PluginConfig):
    """Settings of the `masks` segmenter."""

    instances: bool = Field(
        False,
        description="Whether a mask's number (N of IMAGE_N.png, or the value in a label image) is the same object in "
        "every frame. If not, the associator finds out which masks show one object.",
    )
    min_pixels: int = Field(1, ge=1, description="Masks with fewer pixels are left out.")


class MasksSegmenter(Plugin[MasksConfig], Segmenter):
    """The masks of mask_visib/, or of the folder that `toolkit estimate --masks` names, in order of their numbers."""

    stage = "segmenter"
    name = "masks"

    def segment(self, frame: Frame, current: Sequence[Frame]) -> list[Segment]:
        """Return the masks that came with the frame; raises ToolkitError where none did."""
        if frame.own_masks is None:
            raise ToolkitError(
                f"the segmenter 'masks' needs masks of your own, and frame {frame.index} has none; put them into "
                "mask_visib/ as IMAGE_N.png, one per object, or name their folder with --masks"
            )
        return [
            Segment(mask, instance=number if self.config.instances else None)
            for number, mask in sorted(frame.own_masks.items())
            if mask.sum() >= self.config.min_pixels
        ]
