"""MixVPR (Ali-bey, Chaib-draa, Giguere, WACV 2023): a frozen backbone's map, mixed by stacked MLPs into one vector.

Layers are named as in the official checkpoints: `backbone.model.conv1.weight`, `aggregator.mix.0.mix.1.weight`.
"""

from __future__ import annotations

from typing import Any, cast

from torch import Tensor, nn
from torch.nn import functional

from toolkit.models.efficientnet_lite import EfficientNetLite0, StackedStages

IMAGENET_MEAN, IMAGENET_DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


class FeatureMixer(nn.Module):
    """X + W2 relu(W1 norm(X)) over the positions of every channel's map (the paper's Eq. 1 and Fig. 2)."""

    def __init__(self, positions: int) -> None:
        super().__init__()
        self.mix = nn.Sequential(
            nn.LayerNorm(positions), nn.Linear(positions, positions), nn.ReLU(), nn.Linear(positions, positions)
        )
        for layer in self.mix:
            if isinstance(layer, nn.Linear):
                nn.init.trunc_normal_(layer.weight, std=0.02)
                nn.init.zeros_(layer.bias)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, P) to the same."""
        return x + self.mix(x)


class MixVPR(nn.Module):
    """Feature maps to unit vectors.

    Args:
        channels: of the map.
        side: of the map, cells.
        out_channels: channels after the depth-wise projection.
        out_rows: rows after the row-wise projection; the vector has out_channels x out_rows values.
        depth: feature mixers.
    """

    def __init__(self, channels: int, side: int, out_channels: int, out_rows: int, depth: int = 4) -> None:
        super().__init__()
        self.mix = nn.Sequential(*(FeatureMixer(side * side) for _ in range(depth)))
        self.channel_proj = nn.Linear(channels, out_channels)
        self.row_proj = nn.Linear(side * side, out_rows)

    def forward(self, maps: Tensor) -> Tensor:
        """(N, channels, side, side) to (N, out_channels * out_rows) rows of unit length."""
        mixed = self.mix(maps.flatten(2))
        projected = self.channel_proj(mixed.transpose(1, 2)).transpose(1, 2)
        return functional.normalize(self.row_proj(projected).flatten(1), dim=1)


class MixVPRNet(nn.Module):
    """Backbone and aggregator: (N, 3, S, S) normalised colours to unit vectors."""

    def __init__(self, backbone: nn.Module, aggregator: MixVPR) -> None:
        super().__init__()
        self.backbone = backbone
        self.aggregator = aggregator

    def forward(self, image: Tensor) -> Tensor:
        """(N, 3, S, S) to (N, d) rows of unit length."""
        return self.aggregator(self.backbone(image))


def mixer_lite() -> MixVPR:
    """The light variant's mixer: 168 channels of 10 x 10 cells to 512 values."""
    return MixVPR(channels=168, side=10, out_channels=128, out_rows=4)


def mixvpr_lite(backbone: EfficientNetLite0) -> MixVPRNet:
    """The light variant, on 160 px crops."""
    return MixVPRNet(StackedStages(backbone), mixer_lite())


def mixvpr_resnet50() -> MixVPRNet:
    """The official one: ResNet50 without its last stage on 320 px images, 4096 values."""
    return MixVPRNet(_Backbone(), MixVPR(channels=1024, side=20, out_channels=1024, out_rows=4))


class _Backbone(nn.Module):
    """The level of names the official checkpoints put around the ResNet."""

    def __init__(self) -> None:
        super().__init__()
        self.model = ResNet50Layer3()

    def forward(self, image: Tensor) -> Tensor:
        return self.model(image)


class ResNet50Layer3(nn.Module):
    """ResNet50 (He et al., CVPR 2016) up to its third stage, with torchvision's layer names and strides."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 64, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(64)
        self.layer1 = _stage(64, 64, 3, 1)
        self.layer2 = _stage(256, 128, 4, 2)
        self.layer3 = _stage(512, 256, 6, 2)

    def forward(self, image: Tensor) -> Tensor:
        """(N, 3, H, W) to (N, 1024, H/16, W/16)."""
        x = functional.relu(self.bn1(self.conv1(image)), inplace=True)
        x = functional.max_pool2d(x, 3, 2, 1)
        return self.layer3(self.layer2(self.layer1(x)))


class _Bottleneck(nn.Module):
    def __init__(self, width: int, inner: int, stride: int) -> None:
        super().__init__()
        out = 4 * inner
        self.conv1 = nn.Conv2d(width, inner, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(inner)
        self.conv2 = nn.Conv2d(inner, inner, 3, stride, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(inner)
        self.conv3 = nn.Conv2d(inner, out, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(out)
        self.downsample: nn.Module | None = None
        if stride != 1 or width != out:
            self.downsample = nn.Sequential(nn.Conv2d(width, out, 1, stride, bias=False), nn.BatchNorm2d(out))

    def forward(self, x: Tensor) -> Tensor:
        y = functional.relu(self.bn1(self.conv1(x)), inplace=True)
        y = functional.relu(self.bn2(self.conv2(y)), inplace=True)
        skip = x if self.downsample is None else self.downsample(x)
        return functional.relu(self.bn3(self.conv3(y)) + skip, inplace=True)


def _stage(width: int, inner: int, blocks: int, stride: int) -> nn.Sequential:
    following = (_Bottleneck(4 * inner, inner, 1) for _ in range(blocks - 1))
    return nn.Sequential(_Bottleneck(width, inner, stride), *following)


def gem(maps: Tensor, power: float = 3.0) -> Tensor:
    """Generalised-mean pooling (Radenovic et al., TPAMI 2019): (N, C, H, W) to (N, C) rows of unit length."""
    pooled = maps.clamp(min=1e-6).pow(power).mean(dim=(2, 3)).pow(1 / power)
    return functional.normalize(cast(Any, pooled), dim=1)
