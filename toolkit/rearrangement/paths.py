"""Joint-space paths, walked in small steps and made shorter."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from toolkit.types import Float


def densify(path: Float, step: float) -> Float:
    """(M, J) points of an (N, J) path at most `step` radians apart, its own among them."""
    parts = [path[:1]]
    for a, b in pairwise(path):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / step)))
        parts.append(a + (b - a) * np.linspace(0, 1, count + 1)[1:, None])
    return np.concatenate(parts)


def length(path: Float) -> float:
    """Length of an (N, J) path, radians over all joints."""
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def shortcut(path: Float, free: Callable[[Float], bool], step: float, tries: int, rng: np.random.Generator) -> Float:
    """An (M, J) path with the ends of `path` (N, J): straight lines in place of detours, where they are free.

    Two points drawn along the path are joined (Geraerts, Overmars, IJRR 2007).
    """
    for _ in range(tries):
        if len(path) < 3:
            break
        ways = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
        low, high = np.sort(rng.uniform(0, ways[-1], 2))
        first, last = (int(np.clip(np.searchsorted(ways, way, "right") - 1, 0, len(path) - 2)) for way in (low, high))
        if first == last:
            continue
        ends = [
            path[i] + (path[i + 1] - path[i]) * ((way - ways[i]) / max(ways[i + 1] - ways[i], 1e-12))
            for i, way in ((first, low), (last, high))
        ]
        if all(free(q) for q in densify(np.stack(ends), step)):
            path = np.concatenate([path[: first + 1], ends, path[last + 1 :]])
    return path
