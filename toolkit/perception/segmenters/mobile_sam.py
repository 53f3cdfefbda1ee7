"""Table blobs and depth clusters, parted along the masks of a small Segment Anything."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

from pydantic import Field

from toolkit.perception.segmenters.cutting.looks import object_looks
from toolkit.perception.segmenters.cutting.split import split_touching
from toolkit.perception.segmenters.depth_plane import cluster_labels
from toolkit.perception.segmenters.networks.proposals import propose
from toolkit.perception.segmenters.networks.sam import Sam
from toolkit.perception.segmenters.table_appearance import blob_labels
from toolkit.perception.stages import Segmenter
from toolkit.perception.tabletop.appearance import scan_table
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Frame, Segment
from toolkit.weights.resolve import file_digest, resolve_weights


class MobileSamConfig(PluginConfig):
    """Settings of the `mobile_sam` segmenter."""

    threshold: float = Field(
        8.0,
        gt=0,
        description="What deviates from the look of the table by more standard deviations than this is an object.",
    )
    min_pixels: int = Field(60, ge=1, description="Segments with fewer pixels are dropped.")
    grid_px: int = Field(24, ge=4, description="Distance between the points at which the network is asked, in pixels.")
    encoder: Path | None = Field(None, description="An ONNX image encoder of your own, instead of MobileSAM's.")
    decoder: Path | None = Field(None, description="An ONNX mask decoder of your own, instead of MobileSAM's.")


class MobileSamSegmenter(Plugin[MobileSamConfig], Segmenter):
    """MobileSAM (Zhang et al., 2023) on onnxruntime, asked inside what stands on the table.

    In an RGB-D frame that is what `depth_plane` finds, in a colour image what `table_appearance` finds. Where these are
    fewer than the objects the current frames show, the network is asked at a grid of points inside them, and its
    stable masks are where touching objects are parted. Borders are GrabCut's, which measure better than the
    network's own (docs/results.md). Segments come in row-major order of their first pixel.
    """

    stage = "segmenter"
    name = "mobile_sam"
    weights = ("mobile_sam-encoder", "mobile_sam-decoder")

    def check_ready(self) -> None:
        """Open both networks, so that a missing or foreign file stops the command before any work."""
        _ = self._sam

    def digests(self) -> dict[str, str]:
        """The networks' digests by file name."""
        return {path.name: file_digest(path) for path in self._paths}

    def segment(self, frame: Frame, current: Sequence[Frame]) -> list[Segment]:
        """Return what stands on the table; raises ToolkitError where no depth shows a table."""
        settings = self.config
        if frame.depth is None:
            labels = blob_labels(frame, scan_table(current), settings.threshold, settings.min_pixels)
        else:
            labels = cluster_labels(frame, current, min_pixels=settings.min_pixels)
        looks = object_looks(current)
        if labels.max() < len(looks):
            proposals = propose(self._sam, frame.rgb, labels, settings.grid_px, settings.min_pixels)
            labels = split_touching(frame.rgb, labels, looks, settings.min_pixels, proposals)
        return [Segment(labels == k) for k in range(1, int(labels.max()) + 1)]

    @cached_property
    def _paths(self) -> tuple[Path, Path]:
        settings = self.config
        return (
            resolve_weights("mobile_sam-encoder", settings.encoder),
            resolve_weights("mobile_sam-decoder", settings.decoder),
        )

    @cached_property
    def _sam(self) -> Sam:
        return Sam(*self._paths)
