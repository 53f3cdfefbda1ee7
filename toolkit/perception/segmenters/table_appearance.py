"""Objects in a colour image as what differs from the empty table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from toolkit.perception.segmenters.cutting.blobs import find_blobs
from toolkit.perception.segmenters.cutting.looks import object_looks
from toolkit.perception.segmenters.cutting.split import split_touching
from toolkit.perception.stages import Segmenter
from toolkit.perception.tabletop.appearance import TableScan, scan_table
from toolkit.perception.tabletop.difference import against_table
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Frame, Segment


class TableAppearanceConfig(PluginConfig):
    """Settings of the `table_appearance` segmenter."""

    threshold: float = Field(
        8.0,
        gt=0,
        description="What deviates from the look of the table by more standard deviations than this is an object.",
    )
    min_pixels: int = Field(60, ge=1, description="Blobs with fewer pixels are dropped.")
    split: bool = Field(
        True,
        description="Whether touching objects are split while there are fewer of them than the current frames show.",
    )


class TableAppearanceSegmenter(Plugin[TableAppearanceConfig], Segmenter):
    """What differs from the table's look, learnt from the current frames, where depth says what is table (RGB only).

    The empty table is drawn in the image's camera, compared after a photometric fit, and the borders of what differs
    are refined by GrabCut. Touching objects are split while there are fewer than the current frames
    show and two of those explain a blob's colours better than one.
    Segments come in row-major order of their first pixel.
    """

    stage = "segmenter"
    name = "table_appearance"

    def segment(self, frame: Frame, current: Sequence[Frame]) -> list[Segment]:
        """Return what stands on the table; raises ToolkitError where no current frame's depth shows a table."""
        settings = self.config
        scan = scan_table(current)
        labels = blob_labels(frame, scan, settings.threshold, settings.min_pixels)
        if settings.split:
            labels = split_touching(frame.rgb, labels, object_looks(current), settings.min_pixels)
        return [Segment(labels == k) for k in range(1, int(labels.max()) + 1)]


def blob_labels(frame: Frame, scan: TableScan, threshold: float, min_pixels: int) -> NDArray[np.int32]:
    """(H, W) int32 labels of what differs from the table's look; arguments as `find_blobs`."""
    view, found = against_table(frame, scan)
    return find_blobs(frame.rgb, found.score, view, threshold, min_pixels)
