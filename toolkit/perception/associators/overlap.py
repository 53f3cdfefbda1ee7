"""Regions of one object overlap in space: as many objects as there are when those that do are joined."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from toolkit.perception.regions import followed_instances, numbered_by_occurrence
from toolkit.perception.stages import Associator
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Float, Frame, Region

_POINTS, _ASKED = 4000, 200
"""Points of a region's cloud that are kept, and those of them that are looked for in other clouds."""


class OverlapConfig(PluginConfig):
    """Settings of `overlap`."""

    reach_mm: float = Field(10.0, gt=0, description="Points nearer to each other than this lie at one place.")
    share: float = Field(0.3, gt=0, le=1, description="Part of the smaller region that must lie on the larger one.")


class OverlapAssociator(Plugin[OverlapConfig], Associator):
    """Regions of different frames are one object where their clouds overlap; the number of objects is what comes out.

    Where the segmenter follows objects from frame to frame, its word is taken. Else two regions are joined when a part
    of the smaller one lies on the larger one, so that views that share no surface are joined by the views between them.
    """

    stage = "associator"
    name = "overlap"

    def associate(self, regions: Sequence[Region], frames: Sequence[Frame]) -> NDArray[np.int64]:
        """Return (R,) instance ids 0..K-1, numbered by first occurrence."""
        if not regions:
            return np.zeros(0, np.int64)
        followed = followed_instances(regions)
        return numbered_by_occurrence(self._overlapping(regions)) if followed is None else followed

    def _overlapping(self, regions: Sequence[Region]) -> NDArray[np.int64]:
        clouds = [_thinned(region.points) for region in regions]
        trees = [KDTree(cloud) for cloud in clouds]
        reach = self.config.reach_mm / 1e3
        pairs = [
            (i, j)
            for i, j in combinations(range(len(regions)), 2)
            if regions[i].frame_index != regions[j].frame_index
            and max(_on(clouds[i], trees[j], reach), _on(clouds[j], trees[i], reach)) >= self.config.share
        ]
        n = len(regions)
        links = np.array(pairs, np.int64).reshape(-1, 2)
        graph = coo_matrix((np.ones(len(links)), links.T), shape=(n, n))
        return np.asarray(connected_components(graph, directed=False)[1], np.int64)


def _thinned(points: Float) -> Float:
    return points[np.linspace(0, len(points) - 1, min(_POINTS, len(points))).astype(np.int64)]


def _on(points: Float, tree: KDTree, reach: float) -> float:
    """Share of the points that lie on the cloud of a tree."""
    some = points[:: max(len(points) // _ASKED, 1)]
    return float(np.isfinite(tree.query(some, distance_upper_bound=reach)[0]).mean())
