"""RootSIFT with mutual nearest neighbours and the ratio test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from pydantic import Field

from toolkit.perception.stages import Matcher
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Crop, Float, Matches


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


@dataclass(frozen=True, eq=False)
class SiftFeatures:
    """(N, 2) float64 keypoints in crop pixels and (N, 128) float32 RootSIFT rows of unit length."""

    xy: Float
    descriptors: Float


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


def root_sift(sift: cv2.SIFT, crop: Crop, border_px: int) -> SiftFeatures:
    """RootSIFT features of one crop, away from the silhouette."""
    gray = cv2.cvtColor(crop.image, cv2.COLOR_RGB2GRAY)
    mask = crop.mask.astype(np.uint8)
    if border_px:
        kernel = np.ones((2 * border_px + 1, 2 * border_px + 1), np.uint8)
        mask = cv2.erode(mask, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    keypoints, descriptors = sift.detectAndCompute(gray, mask)
    if not len(keypoints):
        return SiftFeatures(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    rooted = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9))
    return SiftFeatures(np.array([k.pt for k in keypoints], np.float64), rooted.astype(np.float32))


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
