"""LoFTR on masked crops; what does not depend on the partner is computed once per crop (Eq. 2D_match)."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import torch
from kornia.feature import LoFTR
from kornia.feature.loftr.loftr import default_cfg
from pydantic import Field

from toolkit.models.loftr import Encoded, encode, match_encoded
from toolkit.models.loftr_small import LEAST_CONFIDENCE, make_loftr_small, standardize
from toolkit.perception.matchers.shared.on_mask import on_mask
from toolkit.perception.matchers.shared.quarter_turns import TurningConfig, TurningMatcher
from toolkit.types import Crop, Mask, Matches
from toolkit.weights.load import fill, read_tensors
from toolkit.weights.resolve import file_digest, resolve_weights

_PIXEL_CENTER = 0.5
"""The models put the centre of the top-left pixel at (0.5, 0.5); ours is at (0, 0)."""

_BATCH = 16
"""Candidates matched together: enough to fill a processor, and a bound on memory."""


def best_precision() -> Literal["float32", "bfloat16"]:
    """bfloat16 where the processor multiplies it: about twice as fast there, and slower elsewhere."""
    return "bfloat16" if torch.cpu._is_avx512_bf16_supported() else "float32"  # pyright: ignore[reportPrivateUsage]


class LoftrConfig(TurningConfig):
    """Settings of `loftr`."""

    weights: Literal["tabletop", "outdoor", "indoor_new"] = Field(
        "tabletop", description="The weights: the small LoFTR that comes with this package, or an official checkpoint."
    )
    file: Path | None = Field(None, description="Your own checkpoint, of the same architecture as `weights`.")
    crop_size: int = Field(320, ge=32, multiple_of=8, description="Side of the crops, in pixels.")
    threshold: float | None = Field(
        None,
        ge=0,
        le=1,
        description="Least dual-softmax confidence of a match; when left out, 0.05 for `tabletop`, and 0.2, as "
        "published, for the others.",
    )
    precision: Literal["float32", "bfloat16"] = Field(
        default_factory=best_precision,
        description="Number format of convolutions and attention; the default is bfloat16 where that is faster.",
    )
    device: str = Field("cpu", description="Torch device.")


@dataclass(frozen=True, eq=False)
class LoftrFeatures:
    """A crop's half of LoFTR, and its (S, S) mask."""

    encoded: Encoded
    mask: Mask


class LoftrMatcher(TurningMatcher[LoftrConfig]):
    """LoFTR (Sun et al., CVPR 2021), kornia's implementation, the paper's matcher."""

    stage = "matcher"
    name = "loftr"
    weights = ("loftr-tabletop", "loftr-outdoor", "loftr-indoor_new")

    @property
    def crop_size(self) -> int:
        return self.config.crop_size

    def check_ready(self) -> None:
        """Load the checkpoint, so that a missing or foreign file stops the command before any work."""
        _ = self._model

    def digests(self) -> dict[str, str]:
        """The checkpoint's digest by its file name."""
        return {self._path.name: file_digest(self._path)}

    @torch.inference_mode()
    def extract_upright(self, crops: Sequence[Crop]) -> list[LoftrFeatures]:
        """Backbone and first self-attention of every crop."""
        found: list[LoftrFeatures] = []
        for start in range(0, len(crops), _BATCH):
            some = crops[start : start + _BATCH]
            gray = np.stack([cv2.cvtColor(crop.image, cv2.COLOR_RGB2GRAY) for crop in some])
            images = torch.from_numpy(gray).to(self.config.device, torch.float32)
            masks = torch.from_numpy(np.stack([crop.mask for crop in some])).to(self.config.device)
            # The official checkpoints were never shown masks; the black around the object is part of their image.
            small = self.config.weights == "tabletop"
            images = standardize(images, masks) if small else images[:, None] / 255
            with self._autocast():
                encoded = encode(
                    self._model, images.contiguous(memory_format=torch.channels_last), masks if small else None
                )
            found += [LoftrFeatures(e, crop.mask) for e, crop in zip(encoded, some, strict=True)]
        return found

    @torch.inference_mode()
    def match_upright(self, query: LoftrFeatures, references: Sequence[LoftrFeatures]) -> list[Matches]:
        """Match one crop to all references in batches; matches off either object are dropped."""
        found: list[Matches] = []
        for start in range(0, len(references), _BATCH):
            some = references[start : start + _BATCH]
            with self._autocast():
                result = match_encoded(self._model, query.encoded, [reference.encoded for reference in some])
            pair = result.pair.cpu().numpy()
            xy0, xy1 = (xy.cpu().numpy().astype(np.float64) - _PIXEL_CENTER for xy in (result.xy0, result.xy1))
            scores = result.confidence.cpu().numpy().astype(np.float64).clip(0, 1)
            for i, reference in enumerate(some):
                rows = np.flatnonzero(pair == i)
                rows = rows[on_mask(query.mask, xy0[rows]) & on_mask(reference.mask, xy1[rows])]
                found.append(Matches(xy0[rows], xy1[rows], scores[rows]))
        return found

    @cached_property
    def _path(self) -> Path:
        return resolve_weights(f"loftr-{self.config.weights}", self.config.file)

    @cached_property
    def _model(self) -> LoFTR:
        chosen = self.config.threshold
        if self.config.weights == "tabletop":
            least = LEAST_CONFIDENCE if chosen is None else chosen
            model, architecture = make_loftr_small(least), "the toolkit's small LoFTR"
        else:
            settings: dict[str, Any] = copy.deepcopy(default_cfg)
            settings["coarse"]["temp_bug_fix"] = self.config.weights == "indoor_new"
            if chosen is not None:
                settings["match_coarse"]["thr"] = chosen
            model, architecture = LoFTR(pretrained=None, config=settings), "kornia's LoFTR"
        fill(model, read_tensors(self._path), self._path, architecture)
        return model.to(self.config.device, memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]

    def _autocast(self) -> torch.autocast:
        kind = torch.device(self.config.device).type
        return torch.autocast(kind, torch.bfloat16, enabled=self.config.precision == "bfloat16")
