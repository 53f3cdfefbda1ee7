"""RootSIFT with mutual nearest neighbours and the ratio test."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from pydantic import Field

from toolkit.perception.rootsift import SiftFeatures, root_sift
from toolkit.perception.stages import Matcher
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Crop, Matches


class SiftConfig(PluginConfig):
    """Settings of `sift`."""

    crop_size: int = Field(320, ge=32, description="Side of the crops, in pixels.")
    ratio: float = Field(
        0.9, gt=0, le=1, description="Largest ratio of the distances to the nearest and the second-nearest keypoint."
    )
    max_features: int = Field(1000, ge=8, description="Number of keypoints kept per crop, the strongest first.")
    contrast: float = Field(
        0.004, ge=0, description="SIFT's contrast threshold, which is low because objects are small."
    )
    border_px: int = Field(
        2,
        ge=0,
        description="Keypoints nearer to the silhouette than this are dropped, since the silhouette moves with the "
        "view.",
    )


class SiftMatcher(Plugin[SiftConfig], Matcher):
    """SIFT (Lowe, IJCV 2004) with RootSIFT (Arandjelovic and Zisserman, CVPR 2012), mutual and ratio tests."""

    stage = "matcher"
    name = "sift"

    @property
    def crop_size(self) -> int:
        return self.config.crop_size

    def extract(self, crops: Sequence[Crop]) -> list[SiftFeatures]:
        """Detect and describe keypoints inside every crop's mask."""
        c = self.config
        sift = cv2.SIFT.create(nfeatures=c.max_features, contrastThreshold=c.contrast, edgeThreshold=20)
        return [root_sift(sift, crop, c.border_px) for crop in crops]

    def match(self, query: SiftFeatures, references: Sequence[SiftFeatures]) -> list[Matches]:
        """Match one crop's keypoints to each of the references'."""
        return [mutual_ratio(query, reference, self.config.ratio) for reference in references]


def mutual_ratio(query: SiftFeatures, reference: SiftFeatures, ratio: float) -> Matches:
    """Mutual nearest neighbours that pass the ratio test; a match's score is 1 - ratio."""
    if len(query.xy) < 2 or len(reference.xy) < 2:
        return Matches.empty()
    similarity = query.descriptors @ reference.descriptors.T
    distance = np.sqrt(np.maximum(2 - 2 * similarity, 0))
    nearest = distance.argmin(axis=1)
    rows = np.arange(len(nearest))
    mutual = distance.argmin(axis=0)[nearest] == rows
    two = np.partition(distance, 1, axis=1)[:, :2]
    ratios = two[:, 0] / np.maximum(two[:, 1], 1e-9)
    keep = mutual & (ratios <= ratio)
    return Matches(query.xy[keep], reference.xy[nearest[keep]], 1.0 - ratios[keep].astype(np.float64))
