"""Point clouds taken for surfaces: thinned out evenly, and their normals."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from toolkit.geometry import cubes, group_means
from toolkit.types import Float

_NEIGHBOURS = 16


def thin_out(points: Float, spacing: float) -> Float:
    """(M, 3) means of (N, 3) points over the cubes of a grid, by rising x, then y, then z."""
    cells = cubes((points - points.min(axis=0))[:, ::-1], spacing)
    _, inverse, counts = np.unique(cells, return_inverse=True, return_counts=True)
    return group_means(points, inverse, counts)


def normals(points: Float) -> Float:
    """(N, 3) unit normals of (N, 3) points, signs left open: the direction its neighbours vary least in."""
    count = min(_NEIGHBOURS, len(points))
    _, neighbours = KDTree(points).query(points, count)
    near = points[neighbours.reshape(len(points), -1)]
    centered = near - near.mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", centered, centered))
    return vectors[:, :, 0]
