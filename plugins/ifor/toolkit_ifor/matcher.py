"""ifor: a matcher that minimises the optical flow between two crops, as IFOR does between current and goal view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from toolkit.registry import Plugin, PluginConfig
from toolkit.stages import Matcher
from toolkit.types import Crop, Float, Image, Mask, Matches
from toolkit.weights.resolve import file_digest, resolve_weights
from toolkit_ifor.flows import GMFLOW, Flow, dis, gmflow

_FEWEST_PIXELS = 100
"""No flow is computed for objects with fewer pixels."""

_SETTLED_PX = 0.5
"""The iteration ends once an alignment moves pixels by less than this."""


class IforConfig(PluginConfig):
    """Settings of `ifor`."""

    flow: Literal["dis", "gmflow"] = Field(
        "dis", description="The optical flow: OpenCV's dense inverse search, or GMFlow, whose weights are fetched."
    )
    file: Path | None = Field(None, description="Your own checkpoint for `gmflow`.")
    device: str = Field("cpu", description="The torch device of `gmflow`.")
    precision: Literal["float32", "bfloat16"] = Field(
        "float32", description="Number format of `gmflow`; bfloat16 is faster where the processor can multiply it."
    )
    crop_size: int = Field(160, ge=64, multiple_of=8, description="Side of the crops, in pixels.")
    starts: int = Field(
        1,
        ge=1,
        description="Number of in-plane turns from which the iteration starts, evenly spaced; with 1, objects are "
        "taken to stay upright.",
    )
    iterations: int = Field(4, ge=1, description="Number of rounds of flow and alignment from every start.")
    consistent_px: float = Field(
        1.5, gt=0, description="Largest distance, in pixels, by which the flow there and back may miss a pixel."
    )
    step_px: int = Field(3, ge=1, description="Distance between correspondences in both directions, in pixels.")
    min_correlation: float = Field(
        0.3, ge=-1, le=1, description="Crops whose correlation after alignment is lower than this do not match."
    )


@dataclass(frozen=True, eq=False)
class Picture:
    """(S, S, 3) uint8 RGB, its object's mean outside the object; (S, S) bool mask; (2,) mask centre (x, y)."""

    image: Image
    mask: Mask
    center: Float


@dataclass(frozen=True, eq=False)
class Alignment:
    """A (2, 3) transform from query to reference pixels, and how well the crops then agree, -1..1."""

    A: Float
    correlation: float


class Ifor(Plugin[IforConfig], Matcher):
    """Iterative flow minimisation (Goyal et al., IFOR, CVPR 2022), one object at a time.

    From each of the in-plane turns that are tried: warp the reference by the transform so far, compute dense flow (DIS
    or GMFlow; IFOR trains RAFT), fit a similarity transform to it, and again until nothing moves. The start whose crops
    agree best is kept; pixels whose flow there and back agrees are the matches. Depth and the rigid fit are the
    pipeline's.
    """

    stage = "matcher"
    name = "ifor"
    cards = (GMFLOW,)

    @property
    def crop_size(self) -> int:
        """Side of the crops, in pixels."""
        return self.config.crop_size

    def check_ready(self) -> None:
        """Load GMFlow where it is wanted, so that a missing or foreign file stops the command before any work."""
        _ = self._flow

    def digests(self) -> dict[str, str]:
        """The checkpoint's digest by its file name; DIS has none."""
        return {self._path.name: file_digest(self._path)} if self.config.flow == "gmflow" else {}

    def extract(self, crops: Sequence[Crop]) -> list[Picture]:
        """Pictures of the objects alone."""
        return [_picture(crop) for crop in crops]

    def match(self, query: Picture, references: Sequence[Picture]) -> list[Matches]:
        """Minimise the flow to each reference."""
        return [self._match(query, reference) for reference in references]

    @cached_property
    def _path(self) -> Path:
        return resolve_weights(GMFLOW, self.config.file)

    @cached_property
    def _flow(self) -> Flow:
        c = self.config
        return gmflow(self._path, c.device, c.precision) if c.flow == "gmflow" else dis()

    def _match(self, query: Picture, reference: Picture) -> Matches:
        if min(int(query.mask.sum()), int(reference.mask.sum())) < _FEWEST_PIXELS:
            return Matches.empty()
        turns = 2 * np.pi * np.arange(self.config.starts) / self.config.starts
        best = max((self._align(query, reference, turn) for turn in turns), key=lambda found: found.correlation)
        if best.correlation < self.config.min_correlation:
            return Matches.empty()
        return self._correspondences(query, reference, best.A)

    def _align(self, query: Picture, reference: Picture, turn: float) -> Alignment:
        A = _turn_about(query.center, reference.center, turn)
        best = Alignment(A, _correlation(query, *_warp(reference, A)))
        y, x = (part[::3] for part in np.nonzero(query.mask))
        xy = np.stack([x, y], axis=1).astype(np.float64)
        for _ in range(self.config.iterations):
            warped, mask = _warp(reference, A)
            there = xy + self._flow(query.image, warped)[y, x]
            inside = _inside(mask, there)
            if inside.sum() < _FEWEST_PIXELS // 4:
                break
            pixels, targets = xy[inside], _apply(A, there[inside])
            fitted = _similarity(pixels, targets)
            if fitted is None:
                break
            moved = np.linalg.norm(_apply(fitted, pixels) - _apply(A, pixels), axis=1).mean()
            A = fitted  # pyright: ignore[reportConstantRedefinition]
            found = Alignment(A, _correlation(query, *_warp(reference, A)))
            best = max(best, found, key=lambda alignment: alignment.correlation)
            if moved < _SETTLED_PX:
                break
        return best

    def _correspondences(self, query: Picture, reference: Picture, A: Float) -> Matches:
        c = self.config
        warped, mask = _warp(reference, A)
        forth, back = self._flow(query.image, warped), self._flow(warped, query.image)
        y, x = np.nonzero(query.mask)
        grid = (x % c.step_px == 0) & (y % c.step_px == 0)
        xy = np.stack([x[grid], y[grid]], axis=1).astype(np.float64)
        there = xy + forth[y[grid], x[grid]]
        inside = _inside(mask, there)
        xy, there = xy[inside], there[inside]
        u, v = np.rint(there).astype(int).T
        missed = np.linalg.norm(there + back[v, u] - xy, axis=1)
        found = _apply(A, there)
        keep = (missed <= c.consistent_px) & _inside(reference.mask, found)
        return Matches(xy[keep], found[keep], np.exp(-missed[keep] / c.consistent_px).astype(np.float64))


def _picture(crop: Crop) -> Picture:
    y, x = np.nonzero(crop.mask)
    mean = crop.image[y, x].mean(axis=0) if len(x) else np.zeros(3)
    image = np.where(crop.mask[..., None], crop.image, mean.astype(np.uint8))
    return Picture(image, crop.mask, np.array([x.mean(), y.mean()]))


def _turn_about(center: Float, target: Float, turn: float) -> Float:
    """(2, 3) that turns about `center` and takes it to `target`."""
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return np.concatenate([R, (target - R @ center)[:, None]], axis=1)


def _warp(reference: Picture, A: Float) -> tuple[Image, Mask]:
    """The reference seen in the query's pixels, and its mask there."""
    size = reference.mask.shape[::-1]
    outside = reference.image[~reference.mask][0].tolist() if not reference.mask.all() else (0, 0, 0)
    image = cv2.warpAffine(reference.image, A, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderValue=outside)
    mask = cv2.warpAffine(reference.mask.astype(np.uint8), A, size, flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP)
    return np.asarray(image, np.uint8), mask > 0


def _correlation(query: Picture, image: Image, mask: Mask) -> float:
    """Normalised correlation of grey values where both masks are, weighed by how far the masks overlap."""
    both = query.mask & mask
    if both.sum() < _FEWEST_PIXELS // 4:
        return -1.0
    a, b = (cv2.cvtColor(one, cv2.COLOR_RGB2GRAY)[both].astype(np.float64) for one in (query.image, image))
    a, b = a - a.mean(), b - b.mean()
    scale = np.linalg.norm(a) * np.linalg.norm(b)
    return float(a @ b / max(scale, 1e-9) * both.sum() / (query.mask | mask).sum())


def _similarity(xy: Float, targets: Float) -> Float | None:
    """The (2, 3) similarity that most points follow; None where there is none, or it scales too much."""
    fitted, _ = cv2.estimateAffinePartial2D(xy.astype(np.float32), targets.astype(np.float32))
    # OpenCV's stubs do not say that it may find none.
    if fitted is None or not 0.2 < abs(np.linalg.det(fitted[:, :2])) < 5:  # pyright: ignore[reportUnnecessaryComparison]
        return None
    return np.asarray(fitted, np.float64)


def _apply(A: Float, xy: Float) -> Float:
    return np.asarray(xy, np.float64) @ A[:, :2].T + A[:, 2]


def _inside(mask: Mask, xy: Float) -> NDArray[np.bool_]:
    """(N,) whether the pixels nearest to (N, 2) points belong to a mask."""
    x, y = np.rint(xy).astype(int).T
    seen = (x >= 0) & (x < mask.shape[1]) & (y >= 0) & (y < mask.shape[0])
    inside = np.zeros(len(xy), bool)
    inside[seen] = mask[y[seen], x[seen]]
    return inside
