"""Keypoints of a network, matched by LightGlue (Lindenberger et al., ICCV 2023); networks are kornia's."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from kornia.feature import LightGlue
from pydantic import Field
from torch import Tensor
from typing_extensions import TypeVar

from toolkit.perception.matchers.shared.on_mask import on_mask
from toolkit.perception.matchers.shared.quarter_turns import TurningConfig, TurningMatcher
from toolkit.types import Crop, Matches
from toolkit.weights.load import fill, read_tensors
from toolkit.weights.resolve import file_digest, resolve_weights


class LightGlueConfig(TurningConfig):
    """Settings of the matchers with LightGlue."""

    crop_size: int = Field(320, ge=32, multiple_of=32, description="Side of the crops, in pixels.")
    max_features: int = Field(1024, ge=8, description="Number of keypoints kept per crop, the strongest first.")
    threshold: float = Field(0.1, ge=0, le=1, description="Least confidence of a match.")
    extractor_file: Path | None = Field(None, description="Your own checkpoint for the keypoints.")
    glue_file: Path | None = Field(None, description="Your own checkpoint for LightGlue.")
    device: str = Field("cpu", description="Torch device.")


@dataclass(frozen=True, eq=False)
class Keypoints:
    """Keypoints inside a crop's mask: (N, 2) float32 pixels, (N, d) float32 descriptors, and the crop's side."""

    xy: Tensor
    descriptors: Tensor
    size: int


LightGlueConfigT = TypeVar("LightGlueConfigT", bound=LightGlueConfig, default=LightGlueConfig, covariant=True)


class LightGlueMatcher(TurningMatcher[LightGlueConfigT]):
    """Shared by the adapters below: which checkpoints, which extractor, which LightGlue."""

    stage = "matcher"
    glue: ClassVar[dict[str, Any]]
    """What kornia's LightGlue is made with."""

    derived: ClassVar[tuple[str, ...]] = ()
    """Buffers that the extractor makes itself and no checkpoint holds."""

    @property
    def crop_size(self) -> int:
        return self.config.crop_size

    @abstractmethod
    def checkpoints(self) -> tuple[str, str]:
        """Names of the weight cards of extractor and LightGlue."""

    @abstractmethod
    def build_extractor(self) -> tuple[torch.nn.Module, torch.nn.Module]:
        """The extractor, and the part of it that the checkpoint fills."""

    @abstractmethod
    def detect(self, extractor: Any, image: Tensor) -> tuple[Tensor, Tensor]:
        """(N, 2) keypoints in pixels and (N, d) descriptors of one (1, 3, S, S) image in 0..1."""

    def check_ready(self) -> None:
        """Load both checkpoints, so that a missing or foreign file stops the command before any work."""
        _ = self._extractor, self._glue

    def digests(self) -> dict[str, str]:
        """Both checkpoints' digests by file name."""
        return {path.name: file_digest(path) for path in self._paths}

    @torch.inference_mode()
    def extract_upright(self, crops: Sequence[Crop]) -> list[Keypoints]:
        """Keypoints on every crop's object."""
        return [self._keypoints(crop) for crop in crops]

    @torch.inference_mode()
    def match_upright(self, query: Keypoints, references: Sequence[Keypoints]) -> list[Matches]:
        """Match one crop's keypoints to each of the references'; LightGlue prunes points, so pairs go one by one."""
        return [self._match(query, reference) for reference in references]

    def _keypoints(self, crop: Crop) -> Keypoints:
        # Channels last, as the crop is: ALIKED, which normalises a map of 128 channels, is a third faster for it.
        image = torch.from_numpy(crop.image.copy()).to(self.config.device)[None].permute(0, 3, 1, 2).float() / 255
        xy, descriptors = self.detect(self._extractor, image)
        kept = torch.from_numpy(on_mask(crop.mask, xy.cpu().numpy())).to(xy.device)
        return Keypoints(xy[kept].float(), descriptors[kept].float(), crop.image.shape[0])

    def _match(self, query: Keypoints, reference: Keypoints) -> Matches:
        if len(query.xy) < 2 or len(reference.xy) < 2:
            return Matches.empty()
        found = self._glue({"image0": _batch(query), "image1": _batch(reference)})
        pairs, scores = found["matches"][0].cpu(), found["scores"][0].cpu().numpy().astype(np.float64)
        rows, columns = pairs[:, 0], pairs[:, 1]
        here, there = query.xy.cpu()[rows].numpy(), reference.xy.cpu()[columns].numpy()
        return Matches(here.astype(np.float64), there.astype(np.float64), scores.clip(0, 1))

    @cached_property
    def _paths(self) -> tuple[Path, Path]:
        extractor, glue = self.checkpoints()
        return resolve_weights(extractor, self.config.extractor_file), resolve_weights(glue, self.config.glue_file)

    @cached_property
    def _extractor(self) -> torch.nn.Module:
        path = self._paths[0]
        extractor, filled = self.build_extractor()
        tensors: Any = read_tensors(path)
        tensors = _made(filled, *self.derived) | tensors.get("extractor", tensors)
        fill(filled, tensors, path, f"the keypoints of {self.name}")
        return extractor.eval().to(self.config.device, memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]

    @cached_property
    def _glue(self) -> LightGlue:
        path = self._paths[1]
        # No name: with one, kornia would download the checkpoint itself.
        glue = LightGlue(None, filter_threshold=self.config.threshold, **self.glue)  # pyright: ignore[reportArgumentType]
        tensors = {
            "confidence_thresholds": glue.state_dict()["confidence_thresholds"],
            **glue_names(read_tensors(path)),
        }
        fill(glue, tensors, path, f"the LightGlue of {self.name}")
        return glue.to(self.config.device)


def glue_names(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """The names of the authors' checkpoints as kornia's module has them; what is not LightGlue's is left out."""
    named: dict[str, Tensor] = {}
    for name, tensor in tensors.items():
        # DISK's checkpoint holds a scalar a layer that no published LightGlue reads.
        if name.startswith("extractor.") or name.endswith(".r"):
            continue
        part, _, rest = name.removeprefix("matcher.").partition(".")
        if part in ("self_attn", "cross_attn"):
            layer, _, rest = rest.partition(".")
            part, rest = f"transformers.{layer}.{part}", rest
        named[f"{part}.{rest}" if rest else part] = tensor
    return named


def _made(module: torch.nn.Module, *names: str) -> dict[str, Tensor]:
    """The module's own values of these tensors."""
    return {name: module.state_dict()[name] for name in names}


def _batch(keypoints: Keypoints) -> dict[str, Tensor]:
    size = torch.full((1, 2), float(keypoints.size), device=keypoints.xy.device)
    return {"keypoints": keypoints.xy[None], "descriptors": keypoints.descriptors[None], "image_size": size}
