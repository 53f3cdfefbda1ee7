"""Objects as clusters of depth above the table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from toolkit.errors import ToolkitError
from toolkit.perception.segmenters.cutting.clusters import cluster_above_plane, is_noisy
from toolkit.perception.stages import Segmenter
from toolkit.perception.tabletop.labels import keep
from toolkit.perception.tabletop.plane import fit_near
from toolkit.perception.tabletop.refine import snap_to_colour
from toolkit.perception.tabletop.table import find_table
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Frame, Segment

_NEAR_M = 0.012
"""A frame's own plane lies this near to the table of all frames."""


class DepthPlaneConfig(PluginConfig):
    """Settings of the `depth_plane` segmenter."""

    min_height_mm: float = Field(
        1.5,
        gt=0,
        description="What is lower than this above the table counts as table; where depth is noisy, the limit is "
        "higher.",
    )
    cell_mm: float = Field(
        5.0,
        gt=0,
        description="Side of the cells in which the scene is seen from above; parts that are two cells apart are two "
        "objects.",
    )
    min_pixels: int = Field(60, ge=1, description="Clusters with fewer pixels are dropped.")


class DepthPlaneSegmenter(Plugin[DepthPlaneConfig], Segmenter):
    """Table plane by RANSAC; what stands above it, clustered in plan; borders moved to where the colour changes.

    The threshold above the table follows the plane's own noise, so that a fork is found in clean depth and no bump in
    noisy depth. Segments come in row-major order of their first pixel.
    """

    stage = "segmenter"
    name = "depth_plane"

    def segment(self, frame: Frame, current: Sequence[Frame]) -> list[Segment]:
        """Return the clusters above the table; raises ToolkitError without depth or where no table is in it."""
        settings = self.config
        labels = cluster_labels(
            frame, current, settings.min_height_mm / 1e3, settings.cell_mm / 1e3, settings.min_pixels
        )
        return [Segment(labels == k) for k in range(1, int(labels.max()) + 1)]


def cluster_labels(
    frame: Frame, current: Sequence[Frame], min_height: float = 0.0015, cell: float = 0.005, min_pixels: int = 60
) -> NDArray[np.int32]:
    """(H, W) int32 labels of the clusters above the table, with crisp borders.

    Args:
        frame: one of the current frames.
        current: all of them; the table is found in them together.
        min_height: as for `cluster_above_plane`, as are the others.
        cell: side of the plan's cells, metres.
        min_pixels: smaller clusters are dropped.

    Raises:
        ToolkitError: the frame has no depth, or no table is in it.
    """
    if frame.depth is None:
        raise ToolkitError(f"frame {frame.index} has no depth, and depth clusters are found in it")
    table = find_table(current)
    plane = fit_near(frame, table.T_world_table, _NEAR_M)
    if plane is None:
        raise ToolkitError(f"frame {frame.index} does not see the table that the current frames show")
    labels = cluster_above_plane(frame, plane, table, min_height, cell, min_pixels)
    if is_noisy(frame, plane, min_height):
        refined = snap_to_colour(frame.rgb, labels)
        labels = keep(refined, np.ones(int(labels.max()) + 1, bool), min_pixels)
    return labels
