"""MixVPR: a vector that a network mixes from a crop's feature map (Eq. global_description, the paper's descriptor)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Literal

import torch
from pydantic import Field

from toolkit.models.efficientnet_lite import DEVIATION, MEAN, load_efficientnet
from toolkit.models.images import color_tensor
from toolkit.models.mixvpr import IMAGENET_DEVIATION, IMAGENET_MEAN, MixVPRNet, mixvpr_lite, mixvpr_resnet50
from toolkit.perception.stages import Descriptor
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Crop, Float
from toolkit.weights.load import fill, read_tensors
from toolkit.weights.resolve import file_digest, resolve_weights

_BATCH = 32


class MixvprConfig(PluginConfig):
    """Settings of `mixvpr`."""

    backbone: Literal["efficientnet_lite0", "resnet50"] = Field(
        "efficientnet_lite0",
        description="The backbone: the light one, with the mixer that is shipped and was trained on object crops, or "
        "the official ResNet50.",
    )
    file: Path | None = Field(
        None, description="A file with your own weights: those of the mixer, or a whole official checkpoint."
    )
    backbone_file: Path | None = Field(
        None, description="A file with weights of EfficientNet-Lite0, used instead of those of the weight card."
    )
    device: str = Field("cpu", description="Torch device.")


class Mixvpr(Plugin[MixvprConfig], Descriptor):
    """MixVPR (Ali-bey et al., WACV 2023) over EfficientNet-Lite0 or ResNet50."""

    stage = "descriptor"
    name = "mixvpr"
    weights = ("mixvpr-tabletop", "efficientnet-lite0", "mixvpr-resnet50")

    @property
    def crop_size(self) -> int:
        """Side of the crops, pixels: what the mixer was trained on, since it has a weight for every cell."""
        return 160 if self._light else 320

    def check_ready(self) -> None:
        """Load the network, so that a missing or foreign file stops the command before any work."""
        _ = self._net

    def digests(self) -> dict[str, str]:
        """The files' digests by their names."""
        return {path.name: file_digest(path) for path in self._paths}

    @torch.inference_mode()
    def describe(self, crops: Sequence[Crop]) -> Float:
        """Return (N, 512) float32 unit rows; (N, 4096) with ResNet50."""
        mean, deviation = (MEAN, DEVIATION) if self._light else (IMAGENET_MEAN, IMAGENET_DEVIATION)
        rows = [
            self._net(color_tensor([c.image for c in crops[i : i + _BATCH]], mean, deviation).to(self.config.device))
            for i in range(0, len(crops), _BATCH)
        ]
        return torch.cat(rows).cpu().numpy()

    @property
    def _light(self) -> bool:
        return self.config.backbone == "efficientnet_lite0"

    @cached_property
    def _paths(self) -> tuple[Path, ...]:
        if self._light:
            mixer = resolve_weights("mixvpr-tabletop", self.config.file)
            return mixer, resolve_weights("efficientnet-lite0", self.config.backbone_file)
        return (resolve_weights("mixvpr-resnet50", self.config.file),)

    @cached_property
    def _net(self) -> MixVPRNet:
        tensors = read_tensors(self._paths[0])
        if self._light:
            net = mixvpr_lite(load_efficientnet(self._paths[1]))
            fill(net.aggregator, tensors, self._paths[0], "the mixer over EfficientNet-Lite0")
        else:
            net = mixvpr_resnet50()
            fill(net, tensors, self._paths[0], "MixVPR over ResNet50 with 4096 values")
        return net.eval().to(self.config.device, memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
