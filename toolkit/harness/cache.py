"""Content-addressed stage outputs: a key is the digest of all that the output depends on.

Entries are NumPy archives without pickle behind their own digest, written to a temporary name and renamed: a reader
never meets half an entry, and two workers may write the same one.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from toolkit.digests import crop_digest, digest, frame_digest, source_digest
from toolkit.files import write_bytes
from toolkit.perception.meter import Meter
from toolkit.registry import Plugin
from toolkit.stages import AdaptiveDescriptor, Descriptor, Matcher, Segmenter
from toolkit.types import Crop, Float, Frame, Matches, Segment

Arrays = Mapping[str, NDArray[Any]]

_LIBRARIES = (
    "numpy",
    "scipy",
    "opencv-python-headless",
    "torch",
    "kornia",
    "onnxruntime",
    "jax",
    "faiss-cpu",
    "poselib",
)

_DIGEST_BYTES = hashlib.sha256().digest_size


def library_versions() -> dict[str, str]:
    """Versions of the libraries that stage outputs depend on, by distribution name."""
    return dict(_versions())


@cache
def _versions() -> tuple[tuple[str, str], ...]:
    return tuple((name, version(name)) for name in _LIBRARIES)


def plugin_identity(plugin: Plugin) -> dict[str, Any]:
    """What of a plugin its outputs depend on: name, version, source, settings, weights."""
    return {
        "stage": plugin.stage,
        "name": plugin.name,
        "version": plugin.version,
        "source": source_digest(type(plugin).__module__),
        "config": plugin.config.model_dump(mode="json"),
        "weights": plugin.digests(),
    }


@dataclass(frozen=True)
class Cache:
    """A folder of content-addressed arrays.

    Args:
        folder: made when first written to.
    """

    folder: Path

    def load(self, key: str) -> dict[str, NDArray[Any]] | None:
        """Return the arrays stored under `key`, or None. An entry that is damaged counts as absent."""
        try:
            entry = self._path(key).read_bytes()
        except OSError:
            return None
        stated, content = entry[:_DIGEST_BYTES], entry[_DIGEST_BYTES:]
        if hashlib.sha256(content).digest() != stated:
            return None
        with np.load(BytesIO(content), allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}

    def store(self, key: str, arrays: Arrays) -> None:
        """Store arrays under `key`, atomically. A cache that cannot be written is not an error: work goes on."""
        path, archive = self._path(key), BytesIO()
        np.savez(archive, **arrays)  # pyright: ignore[reportArgumentType]
        content = archive.getvalue()
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(path, hashlib.sha256(content).digest() + content)

    def _path(self, key: str) -> Path:
        return self.folder / key[:2] / f"{key}.entry"


class _CachedStage:
    """Shared by the wrappers below: look up, else compute, store with the time it took, and tell the meter."""

    def __init__(self, plugin: Plugin, cache: Cache, meter: Meter) -> None:
        self._plugin = plugin
        self._cache = cache
        self._meter = meter
        self._identity = digest([plugin_identity(plugin), library_versions()])

    def _key(self, *inputs: Any) -> str:
        return digest([self._identity, inputs])

    def _find(self, key: str) -> dict[str, NDArray[Any]] | None:
        arrays = self._cache.load(key)
        if arrays is not None:
            self._meter.served(self._plugin.stage, float(arrays["time_ms"]))
        return arrays

    def _compute(self, keys: Sequence[str], compute: Callable[[], Sequence[Arrays]]) -> Sequence[Arrays]:
        start = perf_counter()
        results = compute()
        time_ms = np.array((perf_counter() - start) * 1e3 / len(keys))
        for key, arrays in zip(keys, results, strict=True):
            self._cache.store(key, {**arrays, "time_ms": time_ms})
        return results

    def _batch(
        self, keys: Sequence[str], compute: Callable[[list[int]], Sequence[Arrays]]
    ) -> list[Mapping[str, NDArray[Any]]]:
        """Results by key, computing only the missing ones, together."""
        found: list[Mapping[str, NDArray[Any]] | None] = [self._find(key) for key in keys]
        missing = [i for i, arrays in enumerate(found) if arrays is None]
        if missing:
            computed = self._compute([keys[i] for i in missing], lambda: compute(missing))
            for i, arrays in zip(missing, computed, strict=True):
                found[i] = arrays
        return [arrays for arrays in found if arrays is not None]


class CachedSegmenter(_CachedStage):
    """A Segmenter whose answers are kept by image and current frames."""

    def __init__(self, segmenter: Segmenter, plugin: Plugin, cache: Cache, meter: Meter) -> None:
        super().__init__(plugin, cache, meter)
        self._segmenter = segmenter

    def segment(self, frame: Frame, current: Sequence[Frame]) -> list[Segment]:
        key = self._key(frame_digest(frame), [frame_digest(f) for f in current])
        arrays = self._batch([key], lambda _: [_pack_segments(self._segmenter.segment(frame, current), frame)])[0]
        count = int(np.prod(frame.rgb.shape[:2]))
        masks = np.unpackbits(arrays["masks"], axis=1, count=count).astype(bool)
        shape = frame.rgb.shape[:2]
        found = zip(masks, arrays["scores"].tolist(), arrays["instances"].tolist(), strict=True)
        return [Segment(m.reshape(shape), score, None if i < 0 else i) for m, score, i in found]


def _pack_segments(segments: Sequence[Segment], frame: Frame) -> Arrays:
    flat = np.zeros((len(segments), int(np.prod(frame.rgb.shape[:2]))), bool)
    for row, segment in zip(flat, segments, strict=True):
        row[:] = segment.mask.ravel()
    return {
        "masks": np.packbits(flat, axis=1),
        "scores": np.array([s.score for s in segments]),
        "instances": np.array([-1 if s.instance is None else s.instance for s in segments], np.int64),
    }


class CachedDescriptor(_CachedStage):
    """A Descriptor whose vectors are kept by crop."""

    def __init__(self, descriptor: Descriptor, plugin: Plugin, cache: Cache, meter: Meter) -> None:
        super().__init__(plugin, cache, meter)
        self._descriptor = descriptor
        self.crop_size = descriptor.crop_size
        if isinstance(descriptor, AdaptiveDescriptor):
            self.adapt = descriptor.adapt  # as quick to do again as to look up

    def describe(self, crops: Sequence[Crop]) -> Float:
        keys = [self._key(crop_digest(crop)) for crop in crops]

        def compute(missing: list[int]) -> list[Arrays]:
            return [{"vector": row} for row in self._descriptor.describe([crops[i] for i in missing])]

        return np.stack([arrays["vector"] for arrays in self._batch(keys, compute)])


class _LazyFeatures:
    """Stands for a crop's features until a pair that is not in the cache needs them."""

    def __init__(self, crop: Crop) -> None:
        self.crop = crop
        self.digest = crop_digest(crop)
        self.value: Any = None


class CachedMatcher(_CachedStage):
    """A Matcher whose matches are kept by pair of crops; features are extracted only where a pair is missing."""

    def __init__(self, matcher: Matcher, plugin: Plugin, cache: Cache, meter: Meter) -> None:
        super().__init__(plugin, cache, meter)
        self._matcher = matcher
        self.crop_size = matcher.crop_size

    def extract(self, crops: Sequence[Crop]) -> list[_LazyFeatures]:
        return [_LazyFeatures(crop) for crop in crops]

    def match(self, query: _LazyFeatures, references: Sequence[_LazyFeatures]) -> list[Matches]:
        keys = [self._key(query.digest, reference.digest) for reference in references]

        def compute(missing: list[int]) -> list[Arrays]:
            pending = [references[i] for i in missing]
            self._extract([query, *pending])
            matches = self._matcher.match(query.value, [reference.value for reference in pending])
            return [{"query": m.query_xy, "reference": m.reference_xy, "scores": m.scores} for m in matches]

        found = self._batch(keys, compute)
        return [Matches(a["query"], a["reference"], a["scores"]) for a in found]

    def _extract(self, features: Sequence[_LazyFeatures]) -> None:
        pending = [f for f in features if f.value is None]
        if pending:
            for lazy, value in zip(pending, self._matcher.extract([f.crop for f in pending]), strict=True):
                lazy.value = value
