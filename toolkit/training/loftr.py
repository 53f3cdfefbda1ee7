"""Training of the small LoFTR: true matches from depth and pose, LoFTR's coarse and fine losses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from kornia.feature import LoFTR
from torch import Tensor, nn

from toolkit.errors import ToolkitError
from toolkit.models.loftr_small import (
    COARSE_STRIDE,
    FINE_STRIDE,
    load_xfeat,
    make_loftr_small,
    masked_tokens,
    scatter_tokens,
    standardize,
)
from toolkit.progress import Progress
from toolkit.training.config import LoftrTraining
from toolkit.training.loftr_loss import coarse_log_confidence, fine_loss, focal_loss
from toolkit.training.pairs import Pair, PairSource, Sample, cell_centers
from toolkit.training.pool import Pool, describe, folder_pool, training_pool
from toolkit.weights.load import fill, read_tensors

_NEAR_PX = 8.0
"""Cells this near to the true place are neither right nor wrong."""

_PRECISE_PX = 3.0


@dataclass(frozen=True, eq=False)
class LoftrBatch:
    """N pairs as tensors. Only cells on the objects are attended to: K of them, of the emptier crops some twice.

    Attributes:
        images: (2, N, S, S) float32 grey levels, 0..255.
        masks: (2, N, S, S) bool.
        tokens: (2, N, K) int64 cells on the object, row-major.
        valid: (2, N, K) bool, False where a token only fills the row.
        matched: batch, first and second token of the true matches, (M,) int64 each.
        targets: (M, 2) float32 true places in the second crop, pixels.
        negative: (N, K, K) bool, pairs of tokens known not to match.
    """

    images: Tensor
    masks: Tensor
    tokens: Tensor
    valid: Tensor
    matched: tuple[Tensor, Tensor, Tensor]
    targets: Tensor
    negative: Tensor

    def to(self, device: torch.device) -> LoftrBatch:
        """The same on a device."""
        images, masks, tokens, valid = (part.to(device) for part in (self.images, self.masks, self.tokens, self.valid))
        batch, first, second = (part.to(device) for part in self.matched)
        targets, negative = self.targets.to(device), self.negative.to(device)
        return LoftrBatch(images, masks, tokens, valid, (batch, first, second), targets, negative)


class LoftrTask:
    """What `toolkit train loftr` trains (`toolkit.training.loop.Task`).

    Args:
        config: the settings.
        cache: where pools are kept.
        objects: a folder of scans to train on, or None for procedural objects.
        scans: a folder of scans to evaluate on too, or None.
        start: the weights that the settings start from, or None.
        progress: shows the rendering.

    Raises:
        ToolkitError: the starting weights are of another network, or a pool cannot be made.
    """

    def __init__(
        self,
        config: LoftrTraining,
        cache: Path,
        objects: Path | None,
        scans: Path | None,
        start: Path | None,
        progress: Progress,
    ) -> None:
        self.config = config
        self._start, self._objects = start, objects
        self.source = PairSource(training_pool(config.pool, objects, cache, progress, held_out=False), config.pairs)
        short = config.pool.model_copy(update={"frames": config.held_out_frames})
        pools: dict[str, Pool] = {"held-out": training_pool(short, objects, cache, progress, held_out=True)}
        if scans is not None:
            pools["scans"] = folder_pool(short, scans, cache, progress)
        self._pools = pools
        self._cells = torch.from_numpy(cell_centers(config.pairs.crop_size)).float()

    @property
    def data(self) -> str:
        """What is trained on, for the card."""
        return describe(self.source.pool, self._pools, f"{len(self.source)} views with a partner", self._objects)

    def build(self) -> nn.Module:
        """The network with its first weights."""
        model = make_loftr_small()
        if self._start is not None and self.config.start == "tabletop":
            fill(model, read_tensors(self._start), self._start, "the toolkit's small LoFTR")
        elif self._start is not None:
            try:
                load_xfeat(model, read_tensors(self._start))
            except RuntimeError as error:
                raise ToolkitError(f"'{self._start}' does not hold XFeat's published weights") from error
        return model

    def rates(self, model: nn.Module) -> list[tuple[list[nn.Parameter], float]]:
        """XFeat's layers move slowly: their features match already, and nothing bounds how long they grow."""
        trunk = [p for name, p in model.named_parameters() if name.startswith("backbone.trunk.")]
        rest = [p for name, p in model.named_parameters() if not name.startswith("backbone.trunk.")]
        return [(trunk, self.config.backbone_rate), (rest, 1.0)]

    def batch(self, step: int) -> LoftrBatch:
        """Draw a step's pairs."""
        seed = self.config.loop.seed
        rngs = (np.random.default_rng([seed, step, i]) for i in range(self.config.loop.batch))
        return self._collate([self.source.draw(rng) for rng in rngs])

    def loss(self, model: nn.Module, batch: LoftrBatch) -> tuple[Tensor, dict[str, float]]:
        """Coarse focal loss and fine loss of a batch."""
        assert isinstance(model, LoFTR)
        c = self.config
        features = _features(model, batch)
        maps = [f["coarse"].flatten(2).transpose(1, 2) for f in features]
        rows = torch.arange(batch.tokens.shape[1], device=batch.tokens.device)[:, None]
        coarse = _attend(
            model.loftr_coarse, *(m[rows, t] for m, t in zip(maps, batch.tokens, strict=True)), *batch.valid
        )
        temperature = model.coarse_matching.temperature
        log_p = coarse_log_confidence(*coarse, *batch.valid, scale=temperature)
        matching = focal_loss(log_p, batch.matched, batch.negative, c.focal_gamma, c.negative_weight)
        fine = self._fine(model, features, coarse, batch)
        hit = log_p[batch.matched[0], batch.matched[1]].argmax(dim=1) == batch.matched[2]
        sure = log_p[batch.matched].detach().exp().mean()
        parts = {"coarse": matching, "fine": fine, "hit": hit.float().mean(), "confidence": sure}
        return matching + c.fine_weight * fine, {name: float(value.detach()) for name, value in parts.items()}

    def evaluate(self, model: nn.Module, device: torch.device) -> dict[str, float]:
        """Precision, number and recall of matches on pairs of objects that are not trained on."""
        assert isinstance(model, LoFTR)
        return {
            f"{name}/{key}": value
            for name, pairs in self._evaluation.items()
            for key, value in score_pairs(model, [self._collate(b).to(device) for b in _batches(pairs)], pairs).items()
        }

    @cached_property
    def _evaluation(self) -> dict[str, list[Pair]]:
        found: dict[str, list[Pair]] = {}
        for name, pool in self._pools.items():
            source = PairSource(pool, self.config.pairs)
            rngs = (np.random.default_rng([7, i]) for i in range(self.config.evaluation_pairs))
            found[name] = [source.draw(rng) for rng in rngs]
        return found

    def _fine(
        self, model: LoFTR, features: list[dict[str, Tensor]], coarse: tuple[Tensor, Tensor], batch: LoftrBatch
    ) -> Tensor:
        b, i, j = batch.matched
        # A batch's matches come in the order of its pairs, so they are thinned evenly.
        rows = torch.linspace(0, max(len(b) - 1, 0), min(len(b), self.config.fine_matches), device=b.device).long()
        if not len(rows):
            return features[0]["fine"].sum() * 0
        b = b[rows]
        i, j = batch.tokens[0][b, i[rows]], batch.tokens[1][b, j[rows]]
        data: dict[str, Any] = {"b_ids": b, "i_ids": i, "j_ids": j, "stride_c": COARSE_STRIDE, "stride_f": FINE_STRIDE}
        grids = [
            scatter_tokens(c, tokens, valid, len(self._cells))
            for c, tokens, valid in zip(coarse, batch.tokens, batch.valid, strict=True)
        ]
        windows = model.fine_preprocess(features[0]["fine"], features[1]["fine"], *grids, data)
        first, second = _attend(model.loftr_fine, *windows)
        centers = self._cells.to(b.device)
        data |= {"mkpts0_c": centers[i], "mkpts1_c": centers[j], "mconf": torch.ones(len(b), device=b.device)}
        with torch.autocast(b.device.type, enabled=False):
            model.fine_matching(first, second, data)
        reach = FINE_STRIDE * (model.fine_preprocess.W // 2)
        return fine_loss(data["expec_f"], (batch.targets[rows] - centers[j]) / reach)

    def _collate(self, pairs: list[Pair]) -> LoftrBatch:
        images = np.stack([[_gray(pair.samples[side]) for pair in pairs] for side in (0, 1)])
        masks = torch.from_numpy(np.stack([[pair.samples[side].mask for pair in pairs] for side in (0, 1)]))
        tokens, valid = masked_tokens(masks.flatten(0, 1))
        tokens, valid = tokens.unflatten(0, (2, -1)), valid.unflatten(0, (2, -1))
        # From a cell to its token.
        number = (masks[..., ::COARSE_STRIDE, ::COARSE_STRIDE].flatten(2).cumsum(dim=2) - 1).clamp(min=0)
        of_pair = torch.from_numpy(np.concatenate([np.full(len(pair.cells), n) for n, pair in enumerate(pairs)]))
        cells = torch.from_numpy(np.concatenate([pair.cells for pair in pairs]))
        matched = of_pair, number[0][of_pair, cells[:, 0]], number[1][of_pair, cells[:, 1]]
        targets = torch.from_numpy(np.concatenate([pair.target_xy for pair in pairs])).float()
        seen = torch.from_numpy(np.stack([pair.seen_xy for pair in pairs])).float()
        rows = torch.arange(len(pairs))[:, None]
        # A cell that is not seen in the other crop (NaN) matches nothing there.
        places = seen[rows, tokens[0]].nan_to_num(1e6)
        far = torch.cdist(places, self._cells[tokens[1]], compute_mode="donot_use_mm_for_euclid_dist") > _NEAR_PX
        negative = far & valid[0][:, :, None] & valid[1][:, None]
        return LoftrBatch(torch.from_numpy(images).float(), masks, tokens, valid, matched, targets, negative)


def score_pairs(model: LoFTR, batches: list[LoftrBatch], pairs: list[Pair]) -> dict[str, float]:
    """Share of matches within 3 px of the truth, matches per pair, and share of true cells that were found.

    A match from where nothing is seen in the other crop counts as wrong.
    """
    errors: list[np.ndarray] = []
    seen = np.concatenate([pair.seen_xy for pair in pairs])
    cells = (pairs[0].samples[0].mask.shape[0] // COARSE_STRIDE) ** 2
    done = 0
    for batch in batches:
        features = _features(model, batch)
        masks = {f"mask{side}": batch.masks[side] for side in (0, 1)}
        out = model({"features0": features[0], "features1": features[1], **masks})
        xy0, xy1 = (out[f"keypoints{side}"].cpu().numpy() for side in (0, 1))
        column, row = np.rint(xy0 / COARSE_STRIDE).astype(int).T
        pair = done + out["batch_indexes"].cpu().numpy()
        true = seen[pair * cells + row * int(cells**0.5) + column]
        errors.append(np.linalg.norm(true - (xy1 - 0.5), axis=1))
        done += batch.images.shape[1]
    error = np.nan_to_num(np.concatenate(errors), nan=np.inf)
    right = error < _PRECISE_PX
    return {
        "precision": float(right.mean()) if len(right) else 0.0,
        "matches": len(error) / len(pairs),
        "recall": float(right.sum() / max(sum(len(pair.cells) for pair in pairs), 1)),
        "error_px": float(np.median(error[right])) if right.any() else float("inf"),
    }


def _batches(pairs: list[Pair], size: int = 16) -> list[list[Pair]]:
    return [pairs[i : i + size] for i in range(0, len(pairs), size)]


def _features(model: LoFTR, batch: LoftrBatch) -> list[dict[str, Tensor]]:
    """Both sides' backbone features, made in one pass."""
    n = batch.images.shape[1]
    images = standardize(batch.images.flatten(0, 1), batch.masks.flatten(0, 1))
    both = model.extract_features(images.contiguous(memory_format=torch.channels_last))
    return [{k: v[:n] for k, v in both.items()}, {k: v[n:] for k, v in both.items()}]


def _attend(transformer: nn.Module, first: Tensor, second: Tensor, *masks: Tensor) -> tuple[Tensor, Tensor]:
    """A transformer's layers in float32: bfloat16 divides so coarsely that linear attention's gradients are noise."""
    with torch.autocast(first.device.type, enabled=False):
        return transformer(first.float(), second.float(), *masks)


def _gray(sample: Sample) -> np.ndarray:
    return cv2.cvtColor(sample.image, cv2.COLOR_RGB2GRAY)
