"""Contact-GraspNet (Sundermeyer et al., ICRA 2021): a grasp for every point that could be a finger's contact.

Layers are named as in the retraining with PyTorch that PyPI's `cgn-pytorch` carries. It differs from the paper, and so
does this, since the weights demand it: coordinates of the world instead of a camera's, one width instead of bins of
widths, 64 neighbours at every scale, and a far-off point among them (see `_Abstraction`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from toolkit.models.pointnet2 import balls, farthest_points, interpolate, shared_mlp

_NEIGHBOURS = 64
_CENTERS = (2048, 512, 128)
_RADII_M = ((0.02, 0.04, 0.08), (0.04, 0.08, 0.16), (0.08, 0.16, 0.32))
_WIDTHS = (
    ((32, 32, 64), (64, 64, 128), (64, 96, 128)),
    ((64, 64, 128), (128, 128, 256), (128, 128, 256)),
    ((64, 64, 128), (128, 128, 256), (128, 128, 256)),
)
_UNUSED = "set_abstract_final."
"""Layers of the checkpoint whose output its network never used."""

_Scales = Iterable[nn.Module]
_Blocks = Iterable[Iterable[nn.Module]]


@dataclass(frozen=True, eq=False)
class ContactGrasps:
    """One grasp a contact.

    Attributes:
        contacts: (M,) int64 numbers of points of the input cloud.
        baselines: (M, 3) unit vectors of the line to the opposite contact; which way is little better than a guess.
        approaches: (M, 3) unit vectors, upright on the baselines.
        widths: (M,) distances of the contacts, metres, not negative.
        scores: (M,) 0..1, how likely the grasp holds.
    """

    contacts: Tensor
    baselines: Tensor
    approaches: Tensor
    widths: Tensor
    scores: Tensor


class ContactGraspNet(nn.Module):
    """Points around the origin, z up, to grasps; built for some 20,000 points of a table of 1 m and what is on it."""

    def __init__(self) -> None:
        super().__init__()
        inputs = (0, *(sum(own[-1] for own in level) for level in _WIDTHS))
        self.set_abstract_msg = nn.ModuleList(
            nn.ModuleList(_Abstraction(inputs[level], widths) for widths in _WIDTHS[level])
            for level in range(len(_WIDTHS))
        )
        self.feat_prop = nn.ModuleList(
            _Propagation(*widths)
            for widths in ((640 + 640, 256, 256), (256 + 640, 256, 128), (128 + 320, 128, 128, 128))
        )
        self.multihead = nn.ModuleList(_head(outputs) for outputs in (1, 3, 3, 1))

    def forward(self, points: Tensor, generator: torch.Generator) -> ContactGrasps:
        """Grasps at 2048 of (N, 3) points, or at all where there are fewer.

        Args:
            points: float32, metres, centred.
            generator: the only source of chance: the points' order, and where farthest point sampling begins.
        """
        order = torch.randperm(len(points), generator=generator)
        where, features = points[order], points.new_zeros(len(points), 0)
        levels: list[tuple[Tensor, Tensor]] = []
        for scales, radii, count in zip(self.set_abstract_msg, _RADII_M, _CENTERS, strict=True):
            start = int(torch.randint(len(where), (), generator=generator))
            chosen = farthest_points(where, count, start)
            if not levels:
                order = order[chosen]
            centers = where[chosen]
            near = balls(where, centers, radii, _NEIGHBOURS)
            parts = [
                scale(features, where, centers, own) for scale, own in zip(cast(_Scales, scales), near, strict=True)
            ]
            where, features = centers, torch.cat(parts, dim=1)
            levels.append((where, features))
        for propagation, (wanted, skipped) in zip(self.feat_prop, reversed(levels), strict=True):
            features, where = propagation(features, where, wanted, skipped), wanted
        score, baseline, approach, width = (
            head(torch.cat([where, features], dim=1).T[None])[0].T for head in self.multihead
        )
        baseline = functional.normalize(baseline)
        approach = functional.normalize(approach - (approach * baseline).sum(dim=1, keepdim=True) * baseline)
        return ContactGrasps(order, baseline, approach, width[:, 0].relu(), score[:, 0].sigmoid())


def used(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """A checkpoint's tensors without those that no output depends on."""
    return {name: tensor for name, tensor in tensors.items() if not name.startswith(_UNUSED)}


class _Abstraction(nn.Module):
    """One scale: every centre's neighbours through an MLP, and their largest values.

    Beside those within reach, the point of the centre's own number is a neighbour. Points and centres are not numbered
    alike, so it is one of chance; but the library the network was trained with adds such loops to every graph, and
    without them it is worse: 0.92 instead of 0.98 of the area under the ROC curve on a scene of its own.
    """

    def __init__(self, features: int, widths: tuple[int, ...]) -> None:
        super().__init__()
        self.conv = nn.ModuleDict({"local_nn": shared_mlp((features + 3, *widths))})

    def forward(self, features: Tensor, points: Tensor, centers: Tensor, near: Tensor) -> Tensor:
        """(N, C), (N, 3), (M, 3) and (M, K) indices of points to (M, C')."""
        near = torch.cat([near, torch.arange(len(centers))[:, None]], dim=1)
        first, *following = (layer for block in cast(_Blocks, self.conv["local_nn"]) for layer in block)
        assert isinstance(first, nn.Linear)
        # The first layer is linear in features and offsets: once a point and once a centre, not once a neighbour.
        x = first(torch.cat([features, points], dim=1))[near] - (centers @ first.weight[:, -3:].T)[:, None]
        x = x.flatten(0, 1)
        for layer in following:
            x = layer(x)
        return x.unflatten(0, near.shape).amax(dim=1)


class _Propagation(nn.Module):
    """Features of few points brought to more, beside those these had, through an MLP."""

    def __init__(self, *widths: int) -> None:
        super().__init__()
        self.nn = shared_mlp(widths)

    def forward(self, features: Tensor, points: Tensor, wanted: Tensor, skipped: Tensor) -> Tensor:
        """(N, C), (N, 3), (M, 3) and (M, C') to (M, C'')."""
        return self.nn(torch.cat([interpolate(features, points, wanted), skipped], dim=1))


def _head(outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv1d(131, 128, 1), nn.BatchNorm1d(128), nn.Dropout(), nn.Conv1d(128, outputs, 1))
