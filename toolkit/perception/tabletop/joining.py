"""Pieces of objects that belong together, joined by colour and by how they touch."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from toolkit.perception.fusion import FusedModel
from toolkit.perception.tabletop.colours import colour_bins, smooth_histograms
from toolkit.perception.tabletop.table import inside_convex
from toolkit.types import Float, Image

_CRUMB_M2, _CRUMB_SHARE = 3e-4, 0.04
"""A piece smaller than this, or than this part of its neighbour, is no object of its own."""

_ALIKE, _WITHIN, _COMPACT = 0.45, 0.6, 1.25
"""Pieces that do not touch are one object if their histograms intersect this much and one lies within the other."""

_WEIGHTS, _BIAS = np.array([-0.56, 3.91, 4.51, 0.19, 3.89]), 0.78
"""Logistic regression (experiments/benchmarks/joins.py) on what `borders` tells."""

_MOST_CONTACT = 3.0
_STANDS_M = 0.04
"""A piece whose lowest point is higher than this stands on another, or is part of it."""

_LIKELY = 0.8
"""Two objects taken for one are lost; one taken for two is mended where both parts move alike."""

_GAP_M, _PROBES = 0.02, 400
"""Pieces that do not touch are looked at together up to this far: a rim seen edge-on has no depth."""


@dataclass
class _Piece:
    histogram: Float
    area: float
    points: Float

    @cached_property
    def raised(self) -> bool:
        """Whether it is too high above the table to stand on it."""
        return float(self.points[:, 2].min()) > _STANDS_M


@dataclass(frozen=True, eq=False)
class Pieces:
    """The smooth pieces of what stands on the table.

    Attributes:
        of_voxel: (V,) int64 piece of every voxel, 0..n-1, -1 for none.
        center: (V, 3) metres, in the table's frame.
        pairs: (E, 2) int64 neighbouring voxels.
        concave: (V,) degrees.
        voxel_of_pixel: (P,) int64.
        colours: (P, 3) uint8 RGB of the pixels.
        cell: side of a voxel, metres.
    """

    of_voxel: NDArray[np.int64]
    center: Float
    pairs: NDArray[np.int64]
    concave: Float
    voxel_of_pixel: NDArray[np.int64]
    colours: Image
    cell: float


def join_pieces(pieces: Pieces) -> tuple[NDArray[np.int64], Float]:
    """Join pieces while two neighbours are more likely one object than two, the likeliest first.

    Returns:
        (V,) objects, 0..m-1, -1 for none, and (m,) how likely each is a whole one: 1 where it touches none that it may
        be a part of.
    """
    count = int(pieces.of_voxel.max(initial=-1)) + 1
    if not count:
        return pieces.of_voxel, np.zeros(0)
    known = _make(pieces, count)
    borders = _gaps(known) | {
        pair: (length, length * float(features[:-1] @ _WEIGHTS[:-1] + _BIAS))
        for pair, (length, features) in _borders(known, pieces).items()
    }
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
        for (i, j), (length, evidence) in borders.items():
            i, j = sorted((a if i == b else i, a if j == b else j))
            if i != j:
                before = joined.get((i, j), (0, 0.0))
                joined[i, j] = before[0] + length, before[1] + evidence
        borders = joined
    names, objects = np.unique(owner, return_inverse=True)
    part = np.zeros(count)
    for (i, j), (length, evidence) in borders.items():
        likely = _likely(known[i], known[j], (length, evidence)) if length else 0.0
        for one, other in ((i, j), (j, i)):
            part[one] = max(part[one], likely * min(known[other].area / known[one].area, 1.0))
    return np.where(pieces.of_voxel >= 0, objects[pieces.of_voxel], -1), 1 - part[names]


def borders(pieces: Pieces) -> dict[tuple[int, int], tuple[int, Float]]:
    """By pair of pieces that touch: how many voxels meet there, and what says whether they are one object.

    That is (5,) the mean angle along the border in tens of degrees, how much the colour histograms intersect, the share
    of the smaller piece inside the larger one's outline, how long the border is for the size of the smaller piece, and
    1 if one of them is too high above the table to stand.
    """
    return _borders(_make(pieces, int(pieces.of_voxel.max(initial=-1)) + 1), pieces)


def kinship(one: FusedModel, other: FusedModel) -> float:
    """How much two objects look like parts of one, 0..1: of one colour, close to each other, one compact outline."""
    if not are_close(one.points, other.points):
        return 0.0
    a, b = (_piece(model.points, model.colors) for model in (one, other))
    compact = _within(*_by_size(a, b)) > _WITHIN or _spread(a.points, b.points) < _COMPACT
    return _alike(a, b) if compact else 0.0


def are_close(one: Float, other: Float) -> bool:
    """Whether two clouds (N, 3), (M, 3) come as near to each other as parts of one object do."""
    some = [points[:: max(len(points) // _PROBES, 1)] for points in (one, other)]
    return bool(np.isfinite(KDTree(some[0]).query(some[1], distance_upper_bound=_GAP_M)[0]).any())


def _piece(points: Float, colours: Float) -> _Piece:
    (histogram,) = smooth_histograms(np.zeros(len(points), np.int64), colour_bins(colours), 1)
    return _Piece(histogram, float(len(points)), points.astype(np.float64))


def _make(pieces: Pieces, count: int) -> list[_Piece]:
    of_voxel, owner = pieces.of_voxel, pieces.of_voxel[pieces.voxel_of_pixel]
    seen = owner >= 0
    histograms = smooth_histograms(owner[seen], colour_bins(pieces.colours[seen]), count)
    areas = np.bincount(of_voxel[of_voxel >= 0], minlength=count) * pieces.cell**2
    return [_Piece(histograms[k], float(areas[k]), pieces.center[of_voxel == k]) for k in range(count)]


def _borders(known: list[_Piece], pieces: Pieces) -> dict[tuple[int, int], tuple[int, Float]]:
    count = len(known)
    a, b = np.sort(pieces.of_voxel[pieces.pairs], axis=1).T
    touching = (a >= 0) & (a != b)
    angles = pieces.concave[pieces.pairs[touching]].max(axis=1)
    keys, inverse, lengths = np.unique(a[touching] * count + b[touching], return_inverse=True, return_counts=True)
    means = np.bincount(inverse, angles, len(keys)) / lengths
    found: dict[tuple[int, int], tuple[int, Float]] = {}
    for key, length, angle in zip(keys.tolist(), lengths.tolist(), means.tolist(), strict=True):
        one, other = known[key // count], known[key % count]
        contact = min(length * pieces.cell / np.sqrt(min(one.area, other.area)), _MOST_CONTACT)
        parts = [angle / 10, _alike(one, other), _within(*_by_size(one, other)), contact]
        found[divmod(key, count)] = (length, np.array([*parts, float(one.raised or other.raised)]))
    return found


def _gain(a: _Piece, b: _Piece, border: tuple[int, float]) -> float:
    """How much speaks for one object; 0 where nothing does."""
    length = border[0]
    if not length:
        alike = _alike(a, b)
        return alike if alike > _ALIKE and _within(*_by_size(a, b)) > _WITHIN else 0.0
    small, large = sorted((a.area, b.area))
    if small < _CRUMB_M2 or small < _CRUMB_SHARE * large:
        return 2 + length / (1 + length)
    likely = _likely(a, b, border)
    return likely if likely > _LIKELY else 0.0


def _likely(a: _Piece, b: _Piece, border: tuple[int, float]) -> float:
    """Probability that two pieces that touch are one object; one that cannot stand needs another, but only one."""
    length, evidence = border
    return float(1 / (1 + np.exp(-evidence / length - _WEIGHTS[-1] * (a.raised or b.raised))))


def _alike(a: _Piece, b: _Piece) -> float:
    """Intersection of the colour histograms, 0..1."""
    return float(np.minimum(a.histogram / a.histogram.sum(), b.histogram / b.histogram.sum()).sum())


def _by_size(a: _Piece, b: _Piece) -> tuple[Float, Float]:
    """The points of both, the smaller one's first."""
    return (a.points, b.points) if a.area < b.area else (b.points, a.points)


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
