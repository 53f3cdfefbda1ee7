"""XFeat keypoints and LighterGlue (Potje et al., CVPR 2024)."""

from __future__ import annotations

from typing import Any

import torch
from kornia.feature import XFeat
from torch import Tensor

from toolkit.perception.matchers.shared.lightglue import LightGlueMatcher


class XFeatLighterGlue(LightGlueMatcher):
    """XFeat with LighterGlue (Potje et al., CVPR 2024): the fastest of the learned matchers on a CPU."""

    name = "xfeat_lighterglue"
    weights = ("xfeat", "xfeat-lighterglue")
    glue = {  # noqa: RUF012
        "input_dim": 64,
        "descriptor_dim": 96,
        "n_layers": 6,
        "num_heads": 1,
        "depth_confidence": -1,
        "width_confidence": 0.95,
    }

    def checkpoints(self) -> tuple[str, str]:
        """XFeat's and LighterGlue's."""
        return "xfeat", "xfeat-lighterglue"

    def build_extractor(self) -> tuple[torch.nn.Module, torch.nn.Module]:
        """kornia's XFeat; the checkpoint fills its network."""
        extractor = XFeat(top_k=self.config.max_features)
        return extractor, extractor.net

    def detect(self, extractor: Any, image: Tensor) -> tuple[Tensor, Tensor]:
        """Keypoints are whole pixels."""
        found = extractor.detectAndCompute(image)[0]
        return found["keypoints"], found["descriptors"]
