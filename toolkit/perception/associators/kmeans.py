"""K-means over the regions' centres, as in the paper, with K found from the data."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from toolkit.perception.regions import followed_instances, numbered_by_occurrence
from toolkit.perception.stages import Associator
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Float, Frame, Region


class KMeansConfig(PluginConfig):
    """Settings of `kmeans`."""

    k: Literal["data", "max_per_frame"] = Field(
        "data",
        description="How the number of clusters K is found: `max_per_frame` takes the largest number of regions in "
        "one frame, and `data` raises it until no cluster holds two regions of one frame.",
    )
    center: Literal["box", "mean"] = Field(
        "box",
        description="The centre of a region: the middle of its cloud's box seen from above, or the mean of its "
        "points as in the paper.",
    )


class KMeansAssociator(Plugin[KMeansConfig], Associator):
    """K-means on region centres (Sec. Method A).

    The paper does not say how K is found. One frame never shows an object twice, so K is at least the largest number
    of regions in a frame. From there `data` raises K until no cluster holds two regions of one frame, and keeps that
    K: an object that some frame does not see then still gets its own cluster, and none is split without need.

    The cloud's mean lies towards the camera, by centimetres on large objects; the middle of the cloud's box in plan
    moves less from view to view (`center: box`).

    Where the segmenter followed every object from frame to frame, its word is taken.
    """

    stage = "associator"
    name = "kmeans"

    def associate(self, regions: Sequence[Region], frames: Sequence[Frame]) -> NDArray[np.int64]:
        """Return (R,) instance ids 0..K-1, numbered by first occurrence."""
        if not regions:
            return np.zeros(0, np.int64)
        followed = followed_instances(regions)
        if followed is not None:
            return followed
        centers = np.array([_center(region, self.config.center) for region in regions])
        frame_of = np.array([region.frame_index for region in regions])
        least = max(Counter(frame_of.tolist()).values())
        labels = _cluster(centers, frame_of, least)
        if self.config.k == "data":
            for k in range(least + 1, len(regions) + 1):
                if _conflicts(labels, frame_of) == 0:
                    break
                labels = _cluster(centers, frame_of, k)
        return numbered_by_occurrence(labels)


def _center(region: Region, how: str) -> Float:
    if how == "mean":
        return region.centroid
    # A few stray depths must not stretch the box.
    low, high = np.percentile(region.points[:, :2], [2, 98], axis=0)
    return np.asarray((low + high) / 2)


def _cluster(centers: Float, frame_of: NDArray[np.int64], k: int) -> NDArray[np.int64]:
    """K-means started from the regions of the fullest frame, topped up with the farthest centres."""
    from sklearn.cluster import KMeans  # here, since it takes half a second to load

    fullest = Counter(frame_of.tolist()).most_common(1)[0][0]
    seeds = [centers[i] for i in np.flatnonzero(frame_of == fullest)]
    while len(seeds) < k:
        gaps = np.min([np.linalg.norm(centers - seed, axis=1) for seed in seeds], axis=0)
        seeds.append(centers[int(gaps.argmax())])
    # scikit-learn's stubs know `init` and `n_init` as strings only.
    kmeans: Any = KMeans(k, init=np.array(seeds), n_init=1, random_state=0)  # pyright: ignore[reportArgumentType]
    return np.asarray(kmeans.fit(centers).labels_, np.int64)


def _conflicts(labels: NDArray[np.int64], frame_of: NDArray[np.int64]) -> int:
    """How many regions share a cluster with another one of their own frame."""
    return len(labels) - len(set(zip(labels.tolist(), frame_of.tolist(), strict=True)))
