"""ALIKED keypoints (Zhao et al., TIM 2023) and LightGlue."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import torch
from kornia.feature import ALIKED
from pydantic import Field
from torch import Tensor

from toolkit.perception.matchers.shared.lightglue import LightGlueConfig, LightGlueMatcher


class AlikedConfig(LightGlueConfig):
    """Settings of `aliked_lightglue`."""

    model: Literal["n16", "n16rot"] = Field(
        "n16", description="ALIKED's model; n16rot was trained with in-plane rotations."
    )


class AlikedLightGlue(LightGlueMatcher[AlikedConfig]):
    """ALIKED (Zhao et al., TIM 2023) with LightGlue."""

    name = "aliked_lightglue"
    weights = ("aliked-n16", "aliked-n16rot", "aliked-lightglue")
    glue: ClassVar = {"input_dim": 128}
    derived = ("dkd.hw_grid",)

    def checkpoints(self) -> tuple[str, str]:
        """The chosen model's and the LightGlue for it."""
        return self._model, "aliked-lightglue"

    def build_extractor(self) -> tuple[torch.nn.Module, torch.nn.Module]:
        """kornia's ALIKED."""
        extractor = ALIKED(self._model, max_num_keypoints=self.config.max_features)
        return extractor, extractor

    def detect(self, extractor: Any, image: Tensor) -> tuple[Tensor, Tensor]:
        """Keypoints are finer than a pixel."""
        found = extractor(image)[0]
        return found.keypoints, found.descriptors

    @property
    def _model(self) -> str:
        return f"aliked-{self.config.model}"
