"""Pieces of objects that belong together, joined by colour and by how they touch."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import KDTree

from toolkit.perception.fusion import FusedModel
from toolkit.perception.tabletop.table import inside_convex
from toolkit.types import Float, Image

_LEVELS = 8
_SMOOTH_BINS = 0.7
_CRUMB_M2, _CRUMB_SHARE = 3e-4, 0.04
"""A piece smaller than this, or than this part of its neighbour, is no object of its own."""

_ALIKE, _WITHIN, _COMPACT = 0.45, 0.6, 1.25
"""Pieces that do not touch are one object if their histograms intersect this much and one lies within the other."""

_PER_DEGREE, _PER_ALIKE, _PER_WITHIN, _BIAS = -0.055, 4.1, 6.4, 1.8
"""Logistic regression (experiments/benchmarks/joins.py): whether two pieces that touch are one object, by the mean
angle along their border, how much their colour histograms intersect, and the share of one inside the other's outline.
"""

_LIKELY = 0.8
"""Two objects taken for one are lost; one taken for two is mended where both parts move alike."""

_GAP_M, _PROBES = 0.02, 400
"""Pieces that do not touch are looked at together up to this far: a rim seen edge-on has no depth."""


@dataclass
class _Piece:
    histogram: Float
    area: float
    points: Float


def join_pieces(
    pieces: NDArray[np.int64],
    center: Float,
    pairs: NDArray[np.int64],
    concave: Float,
    voxel_of_pixel: NDArray[np.int64],
    colours: Image,
    cell: float,
) -> NDArray[np.int64]:
    """Join pieces while two neighbours are more likely one object than two, the likeliest first.

    Args:
        pieces: (V,) piece of every voxel, 0..n-1, -1 for none.
        center: (V, 3) metres, in the table's frame.
        pairs: (E, 2) neighbouring voxels.
        concave: (V,) degrees.
        voxel_of_pixel: (P,).
        colours: (P, 3) uint8 RGB of the pixels.
        cell: side of a voxel, metres.

    Returns:
        (V,) objects, 0..m-1, -1 for none.
    """
    count = int(pieces.max(initial=-1)) + 1
    if not count:
        return pieces
    known = _make(pieces, center, voxel_of_pixel, colours, cell, count)
    borders = _gaps(known) | _borders(pieces, pairs, concave, count)
    owner = np.arange(count)
    while True:
        options = [(gain, a, b) for (a, b), border in borders.items() if (gain := _gain(known[a], known[b], border))]
        if not options:
            break
        _, a, b = max(options)
        owner[owner == b] = a
        known[a] = _Piece(
            known[a].histogram + known[b].histogram,
            known[a].area + known[b].area,
            np.concatenate([known[a].points, known[b].points]),
        )
        joined: dict[tuple[int, int], tuple[int, float]] = {}
        for (i, j), (length, angles) in borders.items():
            i, j = sorted((a if i == b else i, a if j == b else j))
            if i != j:
                before = joined.get((i, j), (0, 0.0))
                joined[i, j] = before[0] + length, before[1] + angles
        borders = joined
    objects = np.unique(owner, return_inverse=True)[1]
    return np.where(pieces >= 0, objects[pieces], -1)


def kinship(one: FusedModel, other: FusedModel) -> float:
    """How much two objects look like parts of one, 0..1: of one colour, close to each other, one compact outline."""
    if not are_close(one.points, other.points):
        return 0.0
    a, b = (_piece(model.points, model.colors) for model in (one, other))
    alike = float(np.minimum(a.histogram / a.histogram.sum(), b.histogram / b.histogram.sum()).sum())
    small, large = (a, b) if len(a.points) < len(b.points) else (b, a)
    compact = _within(small.points, large.points) > _WITHIN or _spread(a.points, b.points) < _COMPACT
    return alike if compact else 0.0


def are_close(one: Float, other: Float) -> bool:
    """Whether two clouds (N, 3), (M, 3) come as near to each other as parts of one object do."""
    some = [points[:: max(len(points) // _PROBES, 1)] for points in (one, other)]
    return bool(np.isfinite(KDTree(some[0]).query(some[1], distance_upper_bound=_GAP_M)[0]).any())


def _piece(points: Float, colours: Float) -> _Piece:
    cube = np.bincount(_bins(colours), minlength=_LEVELS**3).astype(np.float64)
    smooth = gaussian_filter(cube.reshape(_LEVELS, _LEVELS, _LEVELS), _SMOOTH_BINS)
    return _Piece(smooth.ravel(), float(len(points)), points.astype(np.float64))


def _bins(colours: Image | Float) -> NDArray[np.int64]:
    levels = colours.astype(np.int64) * _LEVELS // 256
    return (levels[:, 0] * _LEVELS + levels[:, 1]) * _LEVELS + levels[:, 2]


def _make(
    pieces: NDArray[np.int64], center: Float, of_pixel: NDArray[np.int64], colours: Image, cell: float, count: int
) -> list[_Piece]:
    bins, owner = _bins(colours), pieces[of_pixel]
    seen = owner >= 0
    flat = np.bincount(owner[seen] * _LEVELS**3 + bins[seen], minlength=count * _LEVELS**3).astype(np.float64)
    cubes = gaussian_filter(flat.reshape(count, _LEVELS, _LEVELS, _LEVELS), (0, *[_SMOOTH_BINS] * 3))
    areas = np.bincount(pieces[pieces >= 0], minlength=count) * cell**2
    return [_Piece(cubes[k].ravel(), float(areas[k]), center[pieces == k]) for k in range(count)]


def _borders(
    pieces: NDArray[np.int64], pairs: NDArray[np.int64], concave: Float, count: int
) -> dict[tuple[int, int], tuple[int, float]]:
    """Number of neighbouring voxels, and the sum of their angles, by pair of pieces that touch."""
    a, b = np.sort(pieces[pairs], axis=1).T
    touching = (a >= 0) & (a != b)
    angles = concave[pairs[touching]].max(axis=1)
    keys, inverse, lengths = np.unique(a[touching] * count + b[touching], return_inverse=True, return_counts=True)
    sums = np.bincount(inverse, angles, len(keys))
    return {
        (int(key // count), int(key % count)): (int(length), float(total))
        for key, length, total in zip(keys, lengths, sums, strict=True)
    }


def _gain(a: _Piece, b: _Piece, border: tuple[int, float]) -> float:
    """How much speaks for one object; 0 where nothing does."""
    small, large = (a, b) if a.area < b.area else (b, a)
    alike = float(np.minimum(a.histogram / a.histogram.sum(), b.histogram / b.histogram.sum()).sum())
    if not border[0]:
        return alike if alike > _ALIKE and _within(small.points, large.points) > _WITHIN else 0.0
    if small.area < _CRUMB_M2 or small.area < _CRUMB_SHARE * large.area:
        return 2 + border[0] / (1 + border[0])
    evidence = (
        _PER_DEGREE * border[1] / border[0] + _PER_ALIKE * alike + _PER_WITHIN * _within(small.points, large.points)
    )
    likely = float(1 / (1 + np.exp(-(evidence + _BIAS))))
    return likely if likely > _LIKELY else 0.0


def _gaps(known: list[_Piece]) -> dict[tuple[int, int], tuple[int, float]]:
    """Pairs of pieces that are close to each other, as borders of no length."""
    large = [k for k, piece in enumerate(known) if piece.area >= _CRUMB_M2]
    some = {k: known[k].points[:: max(len(known[k].points) // _PROBES, 1)] for k in large}
    trees = {k: KDTree(points) for k, points in some.items()}
    return {
        (i, j): (0, 0.0)
        for i, j in combinations(large, 2)
        if np.isfinite(trees[i].query(some[j], distance_upper_bound=_GAP_M)[0]).any()
    }


def _outline(points: Float) -> Float:
    """(M, 2) convex hull of (N, 3) points seen from above."""
    return np.asarray(cv2.convexHull(points[:, :2].astype(np.float32))[:, 0], np.float64)


def _within(small: Float, large: Float) -> float:
    """Share of the first points inside the outline of the second."""
    hull = _outline(large)
    return float(inside_convex(hull, small[:, :2]).mean()) if len(hull) > 2 else 0.0


def _spread(a: Float, b: Float) -> float:
    """How much larger the outline of both is than their outlines together."""
    whole, one, other = (
        float(cv2.contourArea(_outline(points).astype(np.float32))) for points in (np.concatenate([a, b]), a, b)
    )
    return whole / max(one + other, 1e-9)
