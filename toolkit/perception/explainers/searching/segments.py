"""From an explanation at a coarse scale to crisp segments of the goal image, and to what it leaves over."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.perception.tabletop.labels import nearest_label
from toolkit.perception.tabletop.refine import snap_to_colour
from toolkit.types import Image, Mask, Segment

_REACH = 0.1
"""Foreground beside an object is its own as far as this part of the object's size."""

_LEFT_OVER = 0.5
"""A segment of which more than this part is explained by no object shows something unknown."""


def object_masks(owner: NDArray[np.int64], factor: int, rgb: Image, foreground: Mask) -> dict[int, Mask]:
    """Masks of the objects in the full image.

    Args:
        owner: (h, w) the instance in every pixel of the explained image, -1 for none.
        factor: pixels of the image to one of those.
        rgb: (H, W, 3) the image.
        foreground: (H, W) bool, what differs from the empty table.

    Returns:
        By instance, (H, W) bool, disjoint, none empty.
    """
    height, width = foreground.shape
    instances = np.unique(owner[owner >= 0])
    numbers = np.zeros(int(owner.max(initial=-1)) + 2, np.int32)
    numbers[instances] = np.arange(1, len(instances) + 1)
    small = np.where(owner >= 0, numbers[owner], 0).astype(np.int32)
    large = cv2.resize(small.astype(np.uint8), None, fx=factor, fy=factor, interpolation=cv2.INTER_NEAREST)
    labels = np.zeros((height, width), np.int32)
    labels[: large.shape[0], : large.shape[1]] = large[:height, :width]
    labels = snap_to_colour(rgb, _grown(labels, foreground))
    found = {int(instance): labels == number for number, instance in enumerate(instances, start=1)}
    return {instance: mask for instance, mask in found.items() if mask.any()}


def _grown(labels: NDArray[np.int32], foreground: Mask) -> NDArray[np.int32]:
    """Labels grown over the foreground beside them: no model shows all sides of its object."""
    gap = cv2.distanceTransform((labels == 0).astype(np.uint8), cv2.DIST_L2, 5)
    sizes = np.sqrt(np.bincount(labels.ravel())).astype(np.float32)
    nearest = nearest_label(labels)
    free = (labels == 0) & foreground & (gap <= np.maximum(_REACH * sizes[nearest], 2))
    return np.where(free, nearest, labels)


def unexplained(segments: Sequence[Segment], objects: Mapping[int, Mask]) -> tuple[Segment, ...]:
    """What is left of the segments that mostly lie on none of the objects."""
    if not objects:
        return tuple(segments)
    taken = np.any(list(objects.values()), axis=0)
    left = [(segment, segment.mask & ~taken) for segment in segments]
    return tuple(Segment(rest, s.score) for s, rest in left if rest.sum() > _LEFT_OVER * s.mask.sum())
