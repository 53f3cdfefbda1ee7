"""Touching objects, parted where two known objects explain a blob better than one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from toolkit.perception.tabletop.colours import colour_bins
from toolkit.perception.tabletop.labels import keep, nearest_label
from toolkit.perception.tabletop.refine import window
from toolkit.types import Float, Image, Mask

_NECK = 0.9
"""A neck is where the blob is narrower than this part of the narrower side's own width."""

_PROPOSED_GAIN, _NECK_GAIN, _COLOUR_GAIN = 0.3, 0.6, 1.25
"""Gain in log-likelihood a pixel of the smaller part, below which one object explains the blob as well.

A change of colour alone is weaker evidence of two objects than a neck, and a neck than what a network calls an object.
"""

_BLUR_PX = 9
_OUTLINE_SHARE = 0.3
_NEIGHBOURS = np.ones((3, 3), np.uint8)


@dataclass(frozen=True, eq=False)
class _Cut:
    """A blob in two: log-likelihoods (2, K) of both parts, pixels (N,) of the second, the least gain, and its rank."""

    scores: Float
    part: NDArray[np.int64]
    least_gain: float
    proposed: bool


def split_touching(
    rgb: Image, labels: NDArray[np.int32], looks: Float, min_pixels: int, proposals: Sequence[Mask] = ()
) -> NDArray[np.int32]:
    """Split blobs while there are fewer than known objects and a split explains the colours better.

    Every blob is assigned one known object, no object twice, at the greatest likelihood of the blobs' colours. A cut
    along a neck or a change of colour is worth what it adds to that likelihood; the best is made, and so on.

    Args:
        rgb: (H, W, 3) the image.
        labels: (H, W) int32 label image.
        looks: (K, B) from `learn_looks`.
        min_pixels: no part may be smaller.
        proposals: (H, W) masks of what may be one object, from a network.
    """
    labels = labels.copy()
    bins = colour_bins(rgb)
    count = int(labels.max())
    if not 0 < count < len(looks):
        return labels
    scores = [_likelihood(looks, bins[labels == k]) for k in range(1, count + 1)]
    cuts = [_cuts(labels == k, bins, looks, min_pixels, proposals) for k in range(1, count + 1)]
    while count < len(looks):
        now = _explained(scores)
        gains = [
            (cut.proposed, _explained([*scores[:k], *scores[k + 1 :], *cut.scores]) - now, k, i)
            for k, options in enumerate(cuts)
            for i, cut in enumerate(options)
        ]
        good = [entry for entry in gains if entry[1] > cuts[entry[2]][entry[3]].least_gain]
        if not good:
            break
        _, _, k, i = max(good)
        cut = cuts[k][i]
        count += 1
        labels.ravel()[cut.part] = count
        scores[k] = cut.scores[0]
        scores.append(cut.scores[1])
        cuts[k] = _cuts(labels == k + 1, bins, looks, min_pixels, proposals)
        cuts.append(_cuts(labels == count, bins, looks, min_pixels, proposals))
    return keep(labels, np.ones(count + 1, bool), 1)


def _likelihood(looks: Float, bins: NDArray[np.int64]) -> Float:
    """(K,) log-likelihood of the pixels' colours under every object."""
    return looks @ np.bincount(bins.ravel(), minlength=looks.shape[1])


def _explained(scores: list[Float]) -> float:
    """The greatest sum of one score per blob, no object used twice."""
    table = np.array(scores)
    rows, columns = linear_sum_assignment(table, maximize=True)
    return float(table[rows, columns].sum())


def _cuts(mask: Mask, bins: NDArray[np.int64], looks: Float, min_pixels: int, proposals: Sequence[Mask]) -> list[_Cut]:
    """Every way considered to cut a blob in two."""
    box = window(mask, 1)
    inside, colours = mask[box], bins[box]
    index = np.arange(mask.size).reshape(mask.shape)[box]
    whole = _likelihood(looks, colours[inside])
    size = int(inside.sum())
    outline = cv2.erode(inside.astype(np.uint8), _NEIGHBOURS, borderValue=0) == 0
    cuts: list[_Cut] = []
    proposed = ((proposal[box] & inside, _PROPOSED_GAIN) for proposal in proposals)
    necks = ((part, _NECK_GAIN) for part in neck_cuts(inside))
    changes = ((part, _COLOUR_GAIN) for part in _colour_cuts(inside, colours, looks, min_pixels))
    for part, gain in chain(proposed, necks, changes):
        n = int(part.sum())
        if min_pixels <= n <= size - min_pixels and _reaches_outline(part, outline):
            score = _likelihood(looks, colours[part])
            cuts.append(
                _Cut(np.stack([whole - score, score]), index[part], gain * min(n, size - n), gain == _PROPOSED_GAIN)
            )
    return cuts


def _reaches_outline(part: Mask, outline: Mask) -> bool:
    """Say whether enough of a part's outline is the blob's own: print on an object is surrounded by the object."""
    own = part & (cv2.erode(part.astype(np.uint8), _NEIGHBOURS) == 0)
    return bool(np.count_nonzero(own & outline) >= _OUTLINE_SHARE * np.count_nonzero(own))


def neck_cuts(mask: Mask) -> Iterator[Mask]:
    """Yield the parts (H, W) that necks cut off.

    Level sets of the distance to the border come apart at necks: the watershed of the distance transform, level by
    level (Vincent and Soille, PAMI 1991).
    """
    distance = cv2.distanceTransform(np.pad(mask.astype(np.uint8), 1), cv2.DIST_L2, 5)[1:-1, 1:-1]
    before = 1
    for level in np.arange(0.5, float(distance.max()), 0.5):
        cores = cv2.connectedComponents((distance > level).astype(np.uint8), connectivity=8)[1].astype(np.int32)
        n = int(cores.max())
        if n > 1 and n != before:
            owners = np.where(mask, nearest_label(cores), 0)
            for k in range(1, n + 1):
                if level < _NECK * float(distance[cores == k].max()):
                    yield owners == k
        before = n


def _colour_cuts(mask: Mask, bins: NDArray[np.int64], looks: Float, min_pixels: int) -> Iterator[Mask]:
    """Yield the connected parts (H, W) in which, over a small window, some object is likelier than another.

    What is smaller than `min_pixels` is left out.
    """
    weight = np.maximum(cv2.blur(mask.astype(np.float32), (_BLUR_PX, _BLUR_PX)), 1e-6)
    maps = np.where(mask, looks.astype(np.float32)[:, bins], 0)
    smooth = np.stack([cv2.blur(m, (_BLUR_PX, _BLUR_PX)) / weight for m in maps])
    for first in range(len(looks)):
        for second in range(first + 1, len(looks)):
            wins = mask & (smooth[second] > smooth[first])
            if np.count_nonzero(wins) < min_pixels:
                continue
            _, members, stats, _ = cv2.connectedComponentsWithStats(wins.astype(np.uint8), connectivity=8)
            largest = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
            if stats[largest, cv2.CC_STAT_AREA] >= min_pixels:
                yield members == largest
