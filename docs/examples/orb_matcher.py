"""A matcher in under forty lines: ORB keypoints, matched both ways. Try it:

toolkit ablate --plugin docs/examples/orb_matcher.py --matcher orb --matcher sift --scenes 4
"""

import cv2
import numpy as np
from pydantic import Field

from toolkit.registry import Plugin, PluginConfig
from toolkit.stages import Matcher
from toolkit.types import Matches


class OrbConfig(PluginConfig):
    """Settings of `orb`."""

    crop_size: int = Field(320, ge=64, description="Side of the crops, pixels.")
    max_features: int = Field(800, ge=8, description="Keypoints kept per crop.")


class OrbMatcher(Plugin[OrbConfig], Matcher):
    """ORB (Rublee et al., ICCV 2011), mutual nearest neighbours in Hamming distance."""

    stage, name = "matcher", "orb"

    @property
    def crop_size(self):
        return self.config.crop_size

    def extract(self, crops):
        orb = cv2.ORB.create(self.config.max_features, fastThreshold=5)
        return [orb.detectAndCompute(crop.image, crop.mask.astype(np.uint8)) for crop in crops]

    def match(self, query, references):
        return [self._match_pair(query, reference) for reference in references]

    def _match_pair(self, query, reference):
        if query[1] is None or reference[1] is None:
            return Matches.empty()
        found = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(query[1], reference[1])
        pairs = [(query[0][m.queryIdx].pt, reference[0][m.trainIdx].pt, 1 - m.distance / 256) for m in found]
        table = np.array([(*q, *r, s) for q, r, s in pairs], float).reshape(-1, 5)
        return Matches(table[:, :2], table[:, 2:4], table[:, 4])
