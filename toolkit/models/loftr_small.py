"""The small LoFTR this toolkit trains and ships: kornia's LoFTR, half as deep, over XFeat's backbone.

LoFTR (Sun et al., CVPR 2021) spends most of its time and weights on a ResNet-FPN that learns matching features from
nothing. XFeat's backbone (Potje et al., CVPR 2024; Apache-2.0) costs a fraction, and its published weights, trained for
matching, are a start. What is LoFTR's stays: self- and cross-attention on the coarse map, dual-softmax matching, and
the sub-pixel expectation in a fine window.
"""

from __future__ import annotations

import copy
from typing import Any

import torch
from kornia.feature import LoFTR
from kornia.feature.loftr.loftr import default_cfg
from kornia.feature.xfeat import BasicLayer, XFeatModel
from torch import Tensor, nn
from torch.nn import functional

COARSE_STRIDE, FINE_STRIDE = 8, 2
COARSE_WIDTH, FINE_WIDTH = 96, 32

LEAST_CONFIDENCE = 0.05
"""Dual-softmax confidence from which the small network's matches count: PnP gains more from those on plain surfaces
than it loses by wrong ones (docs/training.md)."""


def make_loftr_small(threshold: float = LEAST_CONFIDENCE) -> LoFTR:
    """Build the network with random weights, in training mode; about 0.9 M parameters.

    Its images come from `standardize`; its masks (N, H, W), given as `mask0` and `mask1`, are the objects' own, so that
    nothing off the object is attended to or matched.
    """
    settings: dict[str, Any] = copy.deepcopy(default_cfg)
    names = ["self", "cross"] * 2
    settings["coarse"] |= {"d_model": COARSE_WIDTH, "d_ffn": COARSE_WIDTH, "layer_names": names, "temp_bug_fix": True}
    settings["fine"] |= {"d_model": FINE_WIDTH, "d_ffn": FINE_WIDTH}
    # The object is masked, so a match may lie anywhere.
    settings["match_coarse"] |= {"thr": threshold, "border_rm": 0}
    # Stands in for the ResNet-FPN, which is made and thrown away; small, so that this takes no time.
    settings["resnetfpn"] = {"initial_dim": 8, "block_dims": [8, 8, 8]}
    model = LoFTR(pretrained=None, config=settings)
    model.backbone = XFeatFPN(COARSE_WIDTH, FINE_WIDTH)  # pyright: ignore[reportAttributeAccessIssue]
    return model


class XFeatFPN(nn.Module):
    """XFeat's backbone with a stride-2 output beside its stride-8 one.

    Args:
        coarse: channels of the stride-8 map.
        fine: channels of the stride-2 map.
    """

    def __init__(self, coarse: int, fine: int) -> None:
        super().__init__()
        trunk = XFeatModel()
        # Its own detector and matcher are not LoFTR's.
        for part in ("norm", "heatmap_head", "keypoint_head", "fine_matcher"):
            delattr(trunk, part)
        self.trunk = trunk
        self.coarse_out = nn.Conv2d(64, coarse, 1)
        self.stem = BasicLayer(1, fine - 8, 5, stride=2, padding=2)
        self.from4 = nn.Conv2d(24, fine, 1)
        self.from8 = nn.Conv2d(64, fine, 1)
        self.fine_out = nn.Sequential(BasicLayer(fine, fine), nn.Conv2d(fine, fine, 1))

    def train(self, mode: bool = True) -> XFeatFPN:
        """As every module's, but the trunk keeps the statistics it was published with: crops are no photographs."""
        super().train(mode)
        self.trunk.eval()
        return self

    def forward(self, image: Tensor) -> list[Tensor]:
        """(N, 1, H, W) images, H and W multiples of 8, to maps (N, coarse, H/8, W/8) and (N, fine, H/2, W/2)."""
        t = self.trunk
        # Edges and corners need no training, and their gradient would cost more than all the rest.
        with torch.no_grad():
            half = t.block1[:3](image)
            x2 = t.block2(t.block1[3](half) + t.skip1(image))
        x3 = t.block3(x2)
        x4 = t.block4(x3)
        x5 = t.block5(x4)
        size = x3.shape[-2:]
        features = t.block_fusion(x3 + _resize(x4, size) + _resize(x5, size))
        detail = torch.cat([half, self.stem(image)], dim=1)
        context = self.from4(x2) + _resize(self.from8(features), x2.shape[-2:])
        return [self.coarse_out(features), self.fine_out(detail + _resize(context, detail.shape[-2:]))]


def _resize(x: Tensor, size: Any) -> Tensor:
    return functional.interpolate(x, size, mode="bilinear", align_corners=False)


def load_xfeat(model: LoFTR, state: dict[str, Tensor]) -> None:
    """Start the backbone from XFeat's published weights, and attention near the identity, so that these still match.

    Raises:
        RuntimeError: the state is not XFeat's.
    """
    trunk: XFeatModel = model.backbone.trunk  # pyright: ignore[reportAssignmentType]
    wanted = trunk.state_dict()
    trunk.load_state_dict({key: value for key, value in state.items() if key in wanted})
    coarse: nn.Conv2d = model.backbone.coarse_out  # pyright: ignore[reportAssignmentType]
    with torch.no_grad():
        # An isometry, a little shortened, keeps XFeat's inner products and is not sure of its mistakes.
        nn.init.orthogonal_(coarse.weight.view(COARSE_WIDTH, 64), gain=0.8)
        coarse.bias.zero_()  # pyright: ignore[reportOptionalMemberAccess]
        # Short fine features make a flat heatmap, whose mean is the window's centre: better than any random place.
        fine: nn.Conv2d = model.backbone.fine_out[-1]  # pyright: ignore[reportAssignmentType, reportIndexIssue, reportCallIssue, reportArgumentType]
        fine.weight.mul_(0.1)
        for transformer in (model.loftr_coarse, model.loftr_fine):
            for layer in transformer.layers:
                layer.norm2.weight.fill_(0.1)  # pyright: ignore[reportCallIssue, reportAttributeAccessIssue]


def standardize(gray: Tensor, mask: Tensor) -> Tensor:
    """Zero mean and unit deviation over the mask, zero outside.

    Args:
        gray: (N, S, S) float32.
        mask: (N, S, S) bool.

    Returns:
        (N, 1, S, S) float32.
    """
    weight = mask.to(gray.dtype)
    count = weight.sum(dim=(1, 2), keepdim=True).clamp(min=1)
    mean = (gray * weight).sum(dim=(1, 2), keepdim=True) / count
    centred = (gray - mean) * weight
    deviation = (centred.square().sum(dim=(1, 2), keepdim=True) / count).sqrt()
    # A floor of one grey level keeps a plain surface from becoming its own noise.
    return (centred / deviation.clamp(min=1.0))[:, None]


def masked_tokens(masks: Tensor) -> tuple[Tensor, Tensor]:
    """List the coarse cells that sit on the objects, so that attention skips the rest: two thirds of a usual crop.

    Args:
        masks: (N, S, S) bool.

    Returns:
        (N, K) int64 row-major cells in rising order, K the largest number in a row; and (N, K) bool, False where a row
        is filled up (with cell 0). A crop without any cell on its object keeps cell 0.
    """
    on = masks[:, ::COARSE_STRIDE, ::COARSE_STRIDE].flatten(1)
    counts = on.sum(dim=1)
    valid = torch.arange(max(int(counts.max()), 1), device=masks.device) < counts[:, None]
    tokens = torch.zeros(valid.shape, dtype=torch.int64, device=masks.device)
    tokens[valid] = on.nonzero()[:, 1]
    valid[:, 0] = True
    return tokens, valid


def scatter_tokens(features: Tensor, tokens: Tensor, valid: Tensor, cells: int) -> Tensor:
    """(N, K, C) features of tokens back to (N, cells + 1, C) by cell; the last row takes what only fills up."""
    grid = features.new_zeros(len(features), cells + 1, features.shape[-1])
    rows = torch.arange(len(features), device=features.device)[:, None]
    return grid.index_put((rows, torch.where(valid, tokens, cells)), features)
