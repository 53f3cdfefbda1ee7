"""A pretrained backbone's feature map, pooled: what a descriptor gives without any training for the task."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import torch
from pydantic import Field

from toolkit.models.efficientnet_lite import DEVIATION, MEAN, EfficientNetLite0, load_efficientnet
from toolkit.models.images import color_tensor
from toolkit.models.mixvpr import gem
from toolkit.perception.stages import Descriptor
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Crop, Float
from toolkit.weights.resolve import file_digest, resolve_weights

_BATCH = 32


class GemConfig(PluginConfig):
    """Settings of `gem`."""

    power: float = Field(
        3.0, ge=1, description="Power of the generalised mean: 1 gives the mean, and a large power the maximum."
    )
    backbone_file: Path | None = Field(
        None, description="A file with weights of EfficientNet-Lite0, used instead of those of the weight card."
    )
    device: str = Field("cpu", description="Torch device.")


class Gem(Plugin[GemConfig], Descriptor):
    """EfficientNet-Lite0 (ImageNet) with generalised-mean pooling (Radenovic et al., TPAMI 2019)."""

    stage = "descriptor"
    name = "gem"
    weights = ("efficientnet-lite0",)

    @property
    def crop_size(self) -> int:
        return 160

    def check_ready(self) -> None:
        """Load the backbone, so that a missing or foreign file stops the command before any work."""
        _ = self._backbone

    def digests(self) -> dict[str, str]:
        """The backbone's digest by its file name."""
        return {self._path.name: file_digest(self._path)}

    @torch.inference_mode()
    def describe(self, crops: Sequence[Crop]) -> Float:
        """Return (N, 112) float32 unit rows."""
        rows: list[torch.Tensor] = []
        for i in range(0, len(crops), _BATCH):
            images = color_tensor([crop.image for crop in crops[i : i + _BATCH]], MEAN, DEVIATION)
            rows.append(gem(self._backbone(images.to(self.config.device)), self.config.power))
        return torch.cat(rows).cpu().numpy()

    @cached_property
    def _path(self) -> Path:
        return resolve_weights("efficientnet-lite0", self.config.backbone_file)

    @cached_property
    def _backbone(self) -> EfficientNetLite0:
        return load_efficientnet(self._path).to(self.config.device)
