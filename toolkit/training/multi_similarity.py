"""Multi-similarity loss (Wang et al., CVPR 2019), over masks that say which pairs are alike and which are not."""

from __future__ import annotations

import torch
from torch import Tensor

ALPHA, BETA, BASE, MARGIN = 1.0, 50.0, 0.0, 0.1
"""As in the MixVPR paper: alpha 1, beta 50, base 0, mining margin 0.1."""


def multi_similarity(similarity: Tensor, positive: Tensor, negative: Tensor) -> Tensor:
    """The loss with its hard-pair mining.

    A positive counts when some negative of its row is not less similar by more than the margin, and vice versa.

    Args:
        similarity: (N, N) float32 inner products of unit vectors.
        positive: (N, N) bool, no entry of the diagonal.
        negative: (N, N) bool; pairs in neither are left out.

    Returns:
        A scalar, the mean over rows; 0 where nothing is hard.
    """
    hardest_negative = similarity.masked_fill(~negative, -2.0).amax(dim=1, keepdim=True)
    hardest_positive = similarity.masked_fill(~positive, 2.0).amin(dim=1, keepdim=True)
    both = positive.any(dim=1, keepdim=True) & negative.any(dim=1, keepdim=True)
    positive = positive & both & (similarity - MARGIN < hardest_negative)
    negative = negative & both & (similarity + MARGIN > hardest_positive)
    pull = torch.log1p((torch.exp(-ALPHA * (similarity - BASE)) * positive).sum(dim=1)) / ALPHA
    push = torch.log1p((torch.exp(BETA * (similarity - BASE)) * negative).sum(dim=1)) / BETA
    return (pull + push).mean()
