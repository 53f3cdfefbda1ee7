"""DISK keypoints (Tyszkiewicz et al., NeurIPS 2020) and LightGlue."""

from __future__ import annotations

from typing import Any

import torch
from kornia.feature import DISK
from torch import Tensor

from toolkit.perception.matchers.shared.lightglue import LightGlueMatcher


class DiskLightGlue(LightGlueMatcher):
    """DISK (Tyszkiewicz et al., NeurIPS 2020) with LightGlue."""

    name = "disk_lightglue"
    weights = ("disk", "disk-lightglue")
    glue = {"input_dim": 128}  # noqa: RUF012

    def checkpoints(self) -> tuple[str, str]:
        """DISK's, trained with depth, and the LightGlue for it."""
        return "disk", "disk-lightglue"

    def build_extractor(self) -> tuple[torch.nn.Module, torch.nn.Module]:
        """kornia's DISK."""
        extractor = DISK()
        return extractor, extractor

    def detect(self, extractor: Any, image: Tensor) -> tuple[Tensor, Tensor]:
        """Keypoints are whole pixels."""
        found = extractor(image, n=self.config.max_features)[0]
        return found.keypoints, found.descriptors
