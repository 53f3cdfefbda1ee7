"""Training of the light MixVPR's mixer: its vectors shall tell objects apart, and an object's views.

The backbone is frozen, so its maps are computed once, for a few augmented crops of every view, and kept. Two losses:
views of one object are alike and other objects are not; and among one object's views, near ones are alike and far ones
are not.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from toolkit.digests import digest
from toolkit.files import make_once
from toolkit.models.efficientnet_lite import DEVIATION, MEAN, StackedStages, load_efficientnet
from toolkit.models.images import color_tensor
from toolkit.models.mixvpr import mixer_lite
from toolkit.progress import Progress
from toolkit.training.config import MixvprTraining
from toolkit.training.multi_similarity import multi_similarity
from toolkit.training.pairs import augmented_crop
from toolkit.training.pool import Pool, describe, folder_pool, training_pool
from toolkit.types import Float


@dataclass(frozen=True, eq=False)
class MixvprBatch:
    """Backbone maps of N crops, and which are alike.

    Attributes:
        maps: (N, C, s, s) float32.
        objects: (N,) int64.
        near: (N, N) bool, views of one object within the near angle.
        far: (N, N) bool, views of one object beyond the far angle.
    """

    maps: Tensor
    objects: Tensor
    near: Tensor
    far: Tensor

    def to(self, device: torch.device) -> MixvprBatch:
        """The same on a device."""
        return MixvprBatch(*(part.to(device) for part in (self.maps, self.objects, self.near, self.far)))


@dataclass(frozen=True, eq=False)
class MapPool:
    """Backbone maps of every view's crops.

    Attributes:
        maps: (V, A, C, s, s) float16, A augmented crops of each of V views.
        objects: (V,) int64.
        rests: (V,) int64 resting poses.
        azimuths: (V,) float64 radians.
    """

    maps: NDArray[np.float16]
    objects: NDArray[np.int64]
    rests: NDArray[np.int64]
    azimuths: Float


class MixvprTask:
    """What `toolkit train mixvpr` trains (`toolkit.training.loop.Task`).

    Args:
        config: the settings.
        cache: where pools and maps are kept.
        objects: a folder of scans to train on, or None for procedural objects.
        scans: a folder of scans to evaluate on too, or None.
        backbone: EfficientNet-Lite0's published weights.
        progress: shows rendering and the backbone's work.

    Raises:
        ToolkitError: the backbone's file does not fit, or a pool cannot be made.
    """

    def __init__(
        self,
        config: MixvprTraining,
        cache: Path,
        objects: Path | None,
        scans: Path | None,
        backbone: Path,
        progress: Progress,
    ) -> None:
        self.config = config
        self._backbone = StackedStages(load_efficientnet(backbone))
        self._cache, self._progress = cache, progress
        pool = training_pool(config.pool, objects, cache, progress, held_out=False)
        self._pool = self._maps(pool, config.crops_per_view)
        short = config.pool.model_copy(update={"frames": config.held_out_frames})
        held_out = {"held-out": training_pool(short, objects, cache, progress, held_out=True)}
        if scans is not None:
            held_out["scans"] = folder_pool(short, scans, cache, progress)
        self._held_out = {name: self._maps(pool, 1) for name, pool in held_out.items()}
        crops = f"{config.crops_per_view} augmented crop(s) of every view"
        self.data = describe(pool, held_out, crops, objects)

    def build(self) -> nn.Module:
        """The mixer alone: the backbone stays as published."""
        return mixer_lite()

    def rates(self, model: nn.Module) -> list[tuple[list[nn.Parameter], float]]:
        """All alike."""
        return [(list(model.parameters()), 1.0)]

    def batch(self, step: int) -> MixvprBatch:
        """Draw objects, and views of each."""
        c = self.config
        rng = np.random.default_rng([c.loop.seed, step])
        rows = self._rows_of
        chosen = rng.choice(len(rows), min(c.loop.batch // c.views_per_object, len(rows)), replace=False)
        views = np.concatenate(
            [rng.choice(rows[i], min(c.views_per_object, len(rows[i])), replace=False) for i in chosen]
        )
        pool = self._pool
        maps = pool.maps[views, rng.integers(pool.maps.shape[1], size=len(views))]
        near, far = view_relations(pool, views, c.near_deg, c.far_deg)
        parts = (maps.astype(np.float32), pool.objects[views], near, far)
        return MixvprBatch(*map(torch.from_numpy, parts))

    def loss(self, model: nn.Module, batch: MixvprBatch) -> tuple[Tensor, dict[str, float]]:
        """Multi-similarity over objects, and over views within an object."""
        vectors = model(batch.maps).float()
        similarity = vectors @ vectors.T
        same = batch.objects[:, None] == batch.objects
        other = ~same
        instance = multi_similarity(
            similarity, same & ~torch.eye(len(same), dtype=torch.bool, device=same.device), other
        )
        view = multi_similarity(similarity, batch.near, batch.far)
        parts = {"instance": float(instance.detach()), "view": float(view.detach())}
        return instance + self.config.view_weight * view, parts

    def evaluate(self, model: nn.Module, device: torch.device) -> dict[str, float]:
        """Retrieval figures on objects that are not trained on."""
        found: dict[str, float] = {}
        for name, pool in self._held_out.items():
            maps = torch.from_numpy(pool.maps[:, 0].astype(np.float32)).to(device)
            vectors = model(maps).cpu().numpy()
            for key, value in score_retrieval(vectors, pool).items():
                found[f"{name}/{key}"] = value
        return found

    @cached_property
    def _rows_of(self) -> list[NDArray[np.int64]]:
        rows = [np.flatnonzero(self._pool.objects == i) for i in range(int(self._pool.objects.max()) + 1)]
        return [r for r in rows if len(r) > 1]

    def _maps(self, pool: Pool, crops: int) -> MapPool:
        """The backbone's maps of a pool, made once."""
        key = digest([pool.key, self._backbone.width, crops, self.config.crops.model_dump(mode="json")])[:16]
        place = self._cache / "training-pools" / f"maps-{key}"
        folder = make_once(place, lambda folder: self._write_maps(pool, crops, folder))
        labels = np.load(folder / "labels.npy", allow_pickle=False)
        maps = np.load(folder / "maps.npy", mmap_mode="r", allow_pickle=False)
        return MapPool(maps, labels[:, 0].astype(np.int64), labels[:, 1].astype(np.int64), labels[:, 2])

    @torch.inference_mode()
    def _write_maps(self, pool: Pool, crops: int, folder: Path) -> None:
        shape = (len(pool.views), crops, self._backbone.width, 10, 10)
        maps: Any = np.lib.format.open_memmap(folder / "maps.npy", "w+", np.float16, shape)
        with self._progress.step("Backbone", len(pool.views)) as advance:
            for start in range(0, len(pool.views), 16):
                views = pool.views[start : start + 16]
                rngs = [np.random.default_rng([self.config.loop.seed, start + i]) for i in range(len(views))]
                images = [
                    augmented_crop(v, self.config.crops, rng).image
                    for v, rng in zip(views, rngs, strict=True)
                    for _ in range(crops)
                ]
                features = self._backbone(color_tensor(images, MEAN, DEVIATION))
                maps[start : start + len(views)] = features.half().numpy().reshape(len(views), *shape[1:])
                advance(len(views))
        maps.flush()
        labels = np.array([[v.object_id, v.rest, v.azimuth] for v in pool.views])
        np.save(folder / "labels.npy", labels, allow_pickle=False)


def view_relations(
    pool: MapPool, views: NDArray[np.int64], near_deg: float, far_deg: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which pairs of views show one object, in one resting pose, from near and from far azimuths; (N, N) bool each."""
    one = (pool.objects[views][:, None] == pool.objects[views]) & (pool.rests[views][:, None] == pool.rests[views])
    turn = azimuth_gap_deg(pool.azimuths[views][:, None], pool.azimuths[views])
    near = one & (turn < near_deg)
    np.fill_diagonal(near, False)
    return near, one & (turn > far_deg)


def azimuth_gap_deg(a: Float, b: Float) -> Float:
    """Angle between azimuths (radians), degrees in 0..180; broadcasts."""
    return np.abs(np.degrees((a - b + np.pi) % (2 * np.pi) - np.pi))


def score_retrieval(vectors: Float, pool: MapPool) -> dict[str, float]:
    """Leave-one-out retrieval among all views.

    `recall`: share of views whose most similar other view is of the same object. `view_error_deg`: median azimuth gap
    to the most similar view of the same object in the same resting pose.
    """
    similarity = vectors @ vectors.T
    np.fill_diagonal(similarity, -2)
    nearest = similarity.argmax(axis=1)
    recall = pool.objects[nearest] == pool.objects
    own = (pool.objects[:, None] == pool.objects) & (pool.rests[:, None] == pool.rests)
    np.fill_diagonal(own, False)
    known = own.any(axis=1)
    best = np.where(own, similarity, -2).argmax(axis=1)
    gap = azimuth_gap_deg(pool.azimuths, pool.azimuths[best])[known]
    return {"recall": float(recall[known].mean()), "view_error_deg": float(np.median(gap))}
