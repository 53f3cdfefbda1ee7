"""XFeat*: every cell of XFeat's map is matched, and a small network finds the place in it (Potje et al., CVPR 2024)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from kornia.feature import XFeat
from pydantic import Field
from torch import Tensor

from toolkit.perception.matchers.shared.on_mask import on_mask
from toolkit.perception.matchers.shared.quarter_turns import TurningConfig, TurningMatcher
from toolkit.types import Crop, Float, Mask, Matches
from toolkit.weights.load import fill, read_tensors
from toolkit.weights.resolve import file_digest, resolve_weights

_EVERY_CELL = 0
"""kornia's word for it, where a number of keypoints is asked for."""

_SHARPER = 3.0
"""Factor of the 64 places' values before their softmax, as published."""

_MIDDLE = 4.0
"""From a cell's corner, where kornia puts it, to its middle, in pixels of the scale at which it was found."""

_BEHIND = 1.0
"""The published network's places lie this far before those meant, in the same pixels: measured on pictures of real
cameras, matched with themselves under known turns and scales (the test does the same)."""


class XFeatStarConfig(TurningConfig):
    """Settings of `xfeat_star`."""

    crop_size: int = Field(320, ge=32, multiple_of=32, description="Side of the crops, in pixels.")
    threshold: float = Field(
        0.25, ge=0, le=1, description="Least share of the likeliest of a cell's 64 places, as published."
    )
    file: Path | None = Field(None, description="Your own checkpoint of XFeat.")
    device: str = Field("cpu", description="Torch device.")


@dataclass(frozen=True, eq=False)
class Cells:
    """The cells whose middles lie on an object.

    Attributes:
        corners: (K, 2) float32 pixels of the crop.
        scales: (K,) float32 pixels of the crop to one of the size at which a cell was found.
        descriptors: (K, 64) float32.
        mask: (S, S) bool of the crop.
    """

    corners: Tensor
    scales: Tensor
    descriptors: Tensor
    mask: Mask


class XFeatStar(TurningMatcher[XFeatStarConfig]):
    """XFeat* (Potje et al., CVPR 2024): matches nearly everywhere on an object, at two scales."""

    stage = "matcher"
    name = "xfeat_star"
    weights = ("xfeat",)

    @property
    def crop_size(self) -> int:
        return self.config.crop_size

    def check_ready(self) -> None:
        """Load the checkpoint, so that a missing or foreign file stops the command before any work."""
        _ = self._xfeat

    def digests(self) -> dict[str, str]:
        """The checkpoint's digest by its file name."""
        return {self._path.name: file_digest(self._path)}

    @torch.inference_mode()
    def extract_upright(self, crops: Sequence[Crop]) -> list[Cells]:
        """The cells on every crop's object."""
        return [self._cells(crop) for crop in crops]

    @torch.inference_mode()
    def match_upright(self, query: Cells, references: Sequence[Cells]) -> list[Matches]:
        """Mutual nearest neighbours among the cells; the query's place is refined, the reference's is its cell's."""
        return [self._match(query, reference) for reference in references]

    def _cells(self, crop: Crop) -> Cells:
        image = torch.from_numpy(crop.image.copy()).to(self.config.device)[None].permute(0, 3, 1, 2).float() / 255
        found = self._xfeat.detectAndComputeDense(image, _EVERY_CELL)
        corners, scales, descriptors = (found[name][0] for name in ("keypoints", "scales", "descriptors"))
        kept = torch.from_numpy(on_mask(crop.mask, _middles(corners, scales))).to(corners.device)
        return Cells(corners[kept], scales[kept], descriptors[kept], crop.mask)

    def _match(self, query: Cells, reference: Cells) -> Matches:
        rows, columns = self._xfeat._match_mnn(query.descriptors, reference.descriptors, -1)  # pyright: ignore[reportPrivateUsage]
        if len(rows) == 0:
            return Matches.empty()
        both = torch.cat([query.descriptors[rows], reference.descriptors[columns]], dim=-1)
        places = _SHARPER * self._xfeat.net.fine_matcher(both)
        off = self._xfeat._subpix_softmax2d(places.view(-1, 8, 8), 1.0) + _BEHIND  # pyright: ignore[reportPrivateUsage]
        here = _middles(query.corners[rows] + off * query.scales[rows, None], query.scales[rows])
        there = _middles(reference.corners[columns], reference.scales[columns])
        scores = places.softmax(dim=-1).amax(dim=-1).cpu().numpy().astype(np.float64).clip(0, 1)
        kept = (scores > self.config.threshold) & on_mask(query.mask, here)
        return Matches(here[kept], there[kept], scores[kept])

    @cached_property
    def _path(self) -> Path:
        return resolve_weights("xfeat", self.config.file)

    @cached_property
    def _xfeat(self) -> XFeat:
        xfeat = XFeat()
        fill(xfeat.net, read_tensors(self._path), self._path, "XFeat's network")
        return xfeat.eval().to(self.config.device, memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]


def _middles(corners: Tensor, scales: Tensor) -> Float:
    """(K, 2) pixels of the middles of cells with (K, 2) corners, found at 1 / (K,) scales of the image's size."""
    return (corners + _MIDDLE * scales[:, None] - 0.5).cpu().numpy().astype(np.float64)
