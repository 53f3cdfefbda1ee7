"""Whether two poses of a model look the same from everywhere: symmetry of shape and colour, found in the model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from toolkit.geometry import invert, transform_points
from toolkit.perception.fusion import FusedModel
from toolkit.perception.refiners.comparing.images import opponent
from toolkit.types import Float

_PROBES = 512
_REACH_M = 0.005
_TINT = np.array([0.3, 1.0, 1.0])
"""Brightness counts less than colour: the fused views were lit from one side."""

_TINT_STEP = 30.0
"""Grey levels: colours further apart than this are two."""


def unlikeness(model: FusedModel, motions: Sequence[Float]) -> Float:
    """How much of the model shows that it was moved by another than the first of the motions.

    Args:
        model: the object.
        motions: (4, 4) in world coordinates.

    Returns:
        (len(motions),) float64 share of the surface, 0..1, that comes to lie where the model has no surface, or one of
        another colour, once moved by one motion and moved back by the first. 0 for the first itself.
    """
    points, colors = model.points.astype(np.float64), opponent(model.colors) * _TINT
    rows = np.random.default_rng(0).permutation(len(points))[:_PROBES]
    back = invert(motions[0])
    moved = np.stack([transform_points(back @ T, points[rows]) for T in motions])
    gaps, nearest = KDTree(points).query(moved.reshape(-1, 3))
    tints = np.abs(colors[nearest].reshape(len(motions), -1, 3) - colors[rows]).sum(axis=-1)
    return ((gaps.reshape(len(motions), -1) > _REACH_M) | (tints > _TINT_STEP)).mean(axis=1)
