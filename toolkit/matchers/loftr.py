"""LoFTR on masked crops; what does not depend on the partner is computed once per crop (Eq. 2D_match)."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import torch
from kornia.feature import LoFTR
from kornia.feature.loftr.loftr import default_cfg
from pydantic import Field

from toolkit.errors import ToolkitError
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Crop, Float, Matches
from toolkit.weights.resolve import file_digest, resolve_weights

_PIXEL_CENTER = 0.5
"""The pretrained models put the centre of the top-left pixel at (0.5, 0.5); ours is at (0, 0)."""


class LoftrConfig(PluginConfig):
    """Settings of `loftr`."""

    weights: Literal["outdoor", "indoor_new"] = Field("outdoor", description="Official checkpoint.")
    file: Path | None = Field(None, description="A checkpoint of your own, instead of the official one.")
    crop_size: int = Field(320, ge=32, multiple_of=8, description="Side of the crops, pixels.")
    threshold: float = Field(0.2, ge=0, le=1, description="Least dual-softmax confidence of a match.")
    device: str = Field("cpu", description="Torch device.")


class LoftrMatcher(Plugin):
    """LoFTR (Sun et al., CVPR 2021), kornia's implementation, the paper's matcher."""

    stage = "matcher"
    name = "loftr"
    Config = LoftrConfig
    config: LoftrConfig

    @property
    def crop_size(self) -> int:
        """Side of the crops, pixels."""
        return self.config.crop_size

    def check_ready(self) -> None:
        """Load the checkpoint, so that a missing or foreign file stops the command before any work."""
        _ = self._model

    def digests(self) -> dict[str, str]:
        """The checkpoint's digest by its file name."""
        return {self._path.name: file_digest(self._path)}

    @torch.inference_mode()
    def extract(self, crops: Sequence[Crop]) -> list[dict[str, torch.Tensor]]:
        """Backbone features of every crop: `coarse` (1, C, S/8, S/8), `fine` (1, C', S/2, S/2)."""
        gray = np.stack([cv2.cvtColor(crop.image, cv2.COLOR_RGB2GRAY) for crop in crops])[:, None]
        images = torch.from_numpy(gray).to(self.config.device, torch.float32) / 255
        features = self._model.extract_features(images)
        masks = torch.from_numpy(np.stack([crop.mask for crop in crops])).to(self.config.device)
        parts = {**features, "mask": masks}
        return [{name: part[i : i + 1] for name, part in parts.items()} for i in range(len(crops))]

    @torch.inference_mode()
    def match(self, query: dict[str, torch.Tensor], references: Sequence[dict[str, torch.Tensor]]) -> list[Matches]:
        """Match one crop to all references in one batch; matches off either object are dropped."""
        n = len(references)
        joined = {name: torch.cat([reference[name] for reference in references]) for name in query}
        repeated = {name: part.expand(n, *part.shape[1:]) for name, part in query.items()}
        found = self._model({"features0": _maps(repeated), "features1": _maps(joined)})
        pair = found["batch_indexes"].cpu().numpy()
        xy0, xy1 = (found[f"keypoints{i}"].cpu().numpy().astype(np.float64) - _PIXEL_CENTER for i in (0, 1))
        scores = found["confidence"].cpu().numpy().astype(np.float64)
        kept = _on_mask(repeated["mask"], pair, xy0) & _on_mask(joined["mask"], pair, xy1)
        return [Matches(xy0[rows], xy1[rows], scores[rows]) for rows in (kept & (pair == i) for i in range(n))]

    @cached_property
    def _path(self) -> Path:
        return resolve_weights(f"loftr-{self.config.weights}", self.config.file)

    @cached_property
    def _model(self) -> Any:
        settings: dict[str, Any] = copy.deepcopy(default_cfg)
        settings["coarse"]["temp_bug_fix"] = self.config.weights == "indoor_new"
        settings["match_coarse"]["thr"] = self.config.threshold
        model = LoFTR(pretrained=None, config=settings)
        try:
            state = torch.load(self._path, map_location="cpu", weights_only=True)
            model.load_state_dict(state.get("state_dict", state))
        except Exception as error:
            # Torch reports a damaged or foreign file in a dozen ways and over many lines.
            raise ToolkitError(f"'{self._path}' is not a checkpoint of kornia's LoFTR, or is damaged") from error
        return model.eval().to(self.config.device)


def _maps(features: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    return {name: features[name] for name in ("coarse", "fine")}


def _on_mask(masks: torch.Tensor, pair: np.ndarray, xy: Float) -> np.ndarray:
    """(M,) bool: whether the pixel under each position is on its pair's mask (N, S, S)."""
    array = masks.cpu().numpy()
    x, y = np.rint(xy).astype(np.int64).clip(0, array.shape[-1] - 1).T
    return array[pair, y, x]
