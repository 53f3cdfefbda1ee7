"""PointNet++ (Qi et al., NeurIPS 2017): sets of points abstracted to fewer centres, and features brought back to all.

One cloud at a time, no batches: positions are (N, 3), features (N, C).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

_CHUNK = 256
"""Centres whose distances to the whole cloud are held at once."""


def farthest_points(points: Tensor, count: int, start: int = 0) -> Tensor:
    """(min(count, N),) indices: each the point farthest from those before it, beginning with `start`."""
    chosen = torch.empty(min(count, len(points)), dtype=torch.long)
    columns = points.T.contiguous()
    nearest = torch.full((len(points),), torch.inf)
    current = torch.tensor(start)
    for i in range(len(chosen)):
        chosen[i] = current
        offsets = columns - columns[:, current, None]
        torch.minimum(nearest, offsets.square_().sum(dim=0), out=nearest)
        current = nearest.argmax()
    return chosen


def balls(points: Tensor, centers: Tensor, radii: Sequence[float], most: int) -> list[Tensor]:
    """For every radius, the (M, most) indices of the first points within it of (M, 3) centres.

    Where a ball holds fewer, its first point fills the row. Every ball must hold one, as those around points do.
    """
    found = [torch.empty(len(centers), most, dtype=torch.long) for _ in radii]
    for begin in range(0, len(centers), _CHUNK):
        squared = _squared_distances(centers[begin : begin + _CHUNK], points)
        for radius, own in zip(radii, found, strict=True):
            row, column = (squared <= radius**2).nonzero(as_tuple=True)
            counts = torch.bincount(row, minlength=len(squared))
            place = torch.arange(len(row)) - (counts.cumsum(0) - counts)[row]
            first = column[place == 0]
            part = own[begin : begin + _CHUNK]
            part.copy_(first[:, None].expand(-1, most))
            fits = place < most
            part[row[fits], place[fits]] = column[fits]
    return found


def interpolate(features: Tensor, points: Tensor, wanted: Tensor) -> Tensor:
    """(M, C) features at (M, 3) points: of the three nearest of (N, 3) points, by inverse squared distance."""
    squared, nearest = _squared_distances(wanted, points).topk(min(3, len(points)), largest=False)
    weights = 1 / squared.clamp(min=1e-16)
    return (features[nearest] * (weights / weights.sum(dim=1, keepdim=True))[..., None]).sum(dim=1)


def _squared_distances(a: Tensor, b: Tensor) -> Tensor:
    """(M, N) of (M, 3) and (N, 3). Differences are squared, since products cancel for what is near."""
    return sum(((a[:, i, None] - b[None, :, i]).square_() for i in range(3)), torch.zeros(()))


def shared_mlp(widths: Sequence[int]) -> nn.Sequential:
    """Linear, ReLU and batch norm, in this order, once for every further width."""
    blocks = (nn.Sequential(nn.Linear(a, b), nn.ReLU(inplace=True), nn.BatchNorm1d(b)) for a, b in pairwise(widths))
    return nn.Sequential(*blocks)
