"""LoFTR's two losses (Sun et al., CVPR 2021, Sec. 3.5), on masked coarse cells."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

_OFF = -1e4
"""Similarity of cells off the object: out of every softmax, and finite."""


def coarse_log_confidence(features0: Tensor, features1: Tensor, mask0: Tensor, mask1: Tensor, scale: float) -> Tensor:
    """Logarithm of the dual-softmax confidence.

    Args:
        features0: (N, L, C) transformed coarse features of the first crops.
        features1: (N, S, C) of the second.
        mask0: (N, L) bool, cells on the object.
        mask1: (N, S) bool.
        scale: inner products are divided by C times this temperature.

    Returns:
        (N, L, S) float32.
    """
    # A softmax over logits of 40 needs more than bfloat16's eight bits.
    with torch.autocast(features0.device.type, enabled=False):
        similarity = torch.einsum("nlc,nsc->nls", features0.float(), features1.float())
        similarity = similarity / (features0.shape[-1] * scale)
        similarity = similarity.masked_fill(~(mask0[:, :, None] & mask1[:, None]), _OFF)
        return functional.log_softmax(similarity, 1) + functional.log_softmax(similarity, 2)


def focal_loss(
    log_confidence: Tensor, matched: tuple[Tensor, Tensor, Tensor], negative: Tensor, gamma: float, weight: float
) -> Tensor:
    """Focal loss (Lin et al., ICCV 2017) over the dual-softmax confidence.

    Args:
        log_confidence: (N, L, S).
        matched: batch, first and second cell of every true match, (M,) each.
        negative: (N, L, S) bool, pairs of cells known not to match.
        gamma: the focal exponent.
        weight: of the negatives. Theirs is a sum over the row of a cell, averaged over cells that have a true match, so
            that it weighs the same however many cells there are.

    Returns:
        A scalar.
    """
    log_p = log_confidence[matched]
    positive = -((1 - log_p.exp()) ** gamma) * log_p
    p = log_confidence.exp().clamp(max=1 - 1e-4)
    away = -(p**gamma) * torch.log1p(-p)
    count = max(len(log_p), 1)
    return (positive.sum() + weight * (away * negative).sum()) / count


def fine_loss(expectation: Tensor, target: Tensor) -> Tensor:
    """Squared distance in units of the window, each match weighted by how sure its heatmap is.

    Args:
        expectation: (M, 3) the heatmap's mean (x, y) in -1..1 and its standard deviation.
        target: (M, 2) where the match really is, in -1..1.
    """
    inverse = 1 / expectation[:, 2].detach().clamp(min=1e-3)
    weights = inverse / inverse.mean()
    inside = (target.abs().amax(dim=1) < 1).float()
    distance = (expectation[:, :2] - target).square().sum(dim=1)
    return (weights * inside * distance).sum() / inside.sum().clamp(min=1)
