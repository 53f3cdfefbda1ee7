"""Features of all views of an object, lifted to its surface and averaged where they are one point of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from toolkit.geometry import group_means
from toolkit.perception.fusion import Patch
from toolkit.perception.rootsift import SiftFeatures
from toolkit.types import Crop, Float, Mask

_REACH_M = 0.004
"""Features of two views closer than this may be one point."""

_ALIKE = 0.8
"""Least cosine of the descriptors of two views of one point."""

_MAX_STEP_M = 0.01
"""Neighbouring pixels further apart than this lie on different surfaces."""

_ELSEWHERE_M = 0.01
"""The ratio test compares with landmarks at least this far away: near ones are the same place, seen from elsewhere."""


@dataclass(frozen=True, eq=False)
class Landmarks:
    """(N, 3) float64 world points, metres, and their (N, 128) float32 descriptors of unit length."""

    points: Float
    descriptors: Float


def on_surface(patch: Patch, xy: Float) -> tuple[Float, Mask]:
    """Where sub-pixel positions of a view lie on the object.

    Args:
        patch: the view.
        xy: (N, 2) pixels.

    Returns:
        (N, 3) world points, metres, and (N,) bool which of them are to be used: those of which all four neighbours are
        reliable pixels of one surface.
    """
    height, width = patch.mask.shape
    rows = np.full((height + 1, width + 1), -1)
    rows[patch.pixels[:, 1], patch.pixels[:, 0]] = np.arange(len(patch.pixels))
    corner = np.floor(xy).astype(np.int64).clip(0, [width - 1, height - 1])
    x, y = corner.T
    near = rows[y[:, None] + [0, 0, 1, 1], x[:, None] + [0, 1, 0, 1]]
    around = patch.points[near].astype(np.float64)
    kept = (near >= 0).all(axis=1) & (np.ptp(around, axis=1).max(axis=1) < _MAX_STEP_M)
    fx, fy = (xy - corner).T
    weights = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], axis=1)
    return (weights[..., None] * around).sum(axis=1), kept


def gather(patches: Sequence[Patch], crops: Sequence[Crop], features: Sequence[SiftFeatures]) -> Landmarks:
    """The landmarks of an object (OnePose, Sun et al., CVPR 2022): tracks through its views, descriptors averaged.

    Args:
        patches: V views.
        crops: cut from them.
        features: of the crops.
    """
    lifted = [on_surface(p, c.to_image(f.xy)) for p, c, f in zip(patches, crops, features, strict=True)]
    views = np.repeat(np.arange(len(lifted)), [int(kept.sum()) for _, kept in lifted])
    points = np.concatenate([found[kept] for found, kept in lifted])
    descriptors = np.concatenate([f.descriptors[kept] for f, (_, kept) in zip(features, lifted, strict=True)])
    if not len(points):
        return Landmarks(points, descriptors)
    first, second = KDTree(points).query_pairs(_REACH_M, output_type="ndarray").T
    same = (views[first] != views[second]) & ((descriptors[first] * descriptors[second]).sum(axis=1) > _ALIKE)
    edges = coo_matrix((np.ones(int(same.sum())), (first[same], second[same])), shape=(len(points), len(points)))
    tracks = connected_components(edges, directed=False)[1]
    counts = np.bincount(tracks)
    mean = group_means(descriptors, tracks, counts)
    unit = mean / np.linalg.norm(mean, axis=1, keepdims=True)
    return Landmarks(group_means(points, tracks, counts), unit.astype(np.float32))


def find(landmarks: Landmarks, descriptors: Float, ratio: float) -> tuple[np.ndarray, np.ndarray, Float]:
    """Find landmarks again: mutual nearest neighbours that pass the ratio test against other places of the object.

    Args:
        landmarks: N of them.
        descriptors: (M, 128) float32 unit rows, of an image.
        ratio: largest ratio of the distances to the nearest landmark and to the nearest one elsewhere.

    Returns:
        (K,) rows of `descriptors`, (K,) rows of the landmarks, and (K,) float64 scores, 1 - ratio.
    """
    if not len(landmarks.points) or not len(descriptors):
        return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)
    distance = np.sqrt(np.maximum(2 - 2 * descriptors @ landmarks.descriptors.T, 0))
    nearest, rows = distance.argmin(axis=1), np.arange(len(descriptors))
    gaps = np.linalg.norm(landmarks.points[nearest][:, None] - landmarks.points, axis=2)
    elsewhere = np.where(gaps > _ELSEWHERE_M, distance, np.inf).min(axis=1)
    ratios = distance[rows, nearest] / np.maximum(elsewhere, 1e-9)
    # Nowhere else is no evidence.
    kept = (distance.argmin(axis=0)[nearest] == rows) & (ratios <= ratio) & np.isfinite(elsewhere)
    return rows[kept], nearest[kept], 1.0 - ratios[kept].astype(np.float64)
