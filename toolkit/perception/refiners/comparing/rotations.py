"""Turns that an object may have been put down with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from toolkit.geometry import cubes
from toolkit.types import Float

_HULL_M = 0.003
"""Points are thinned to one per cube of this side, so that noise on a face makes no faces of its own."""

_SAME_REST = np.cos(np.radians(12))
_SUPPORT_M = 0.003
"""Corners this near to the lowest one carry the object."""

_LEAST_M3 = 1e-9
"""A hull of less than a cubic millimetre has no inside."""

_SPHERE = 256


def yaw_rotations(count: int) -> Float:
    """(count, 3, 3) turns about the vertical."""
    return Rotation.from_rotvec(np.outer(2 * np.pi * np.arange(count) / count, [0, 0, 1])).as_matrix()


def resting_rotations(points: Float, rests: int, yaws: int) -> Float:
    """Turns that put `rests` sides of an object up, each in `yaws` yaws.

    The side that is up now comes first, then the rests that are stable on the object's convex hull, by falling
    probability; directions all around fill up what is left.

    Args:
        points: (N, 3) metres, of the object as it stands.
        rests: sides.
        yaws: turns about the vertical.

    Returns:
        (rests * yaws, 3, 3).
    """
    now = np.array([[0.0, 0.0, 1.0]])
    others = _stable(points)
    ups = np.concatenate([now, others[others[:, 2] < _SAME_REST]])[:rests]
    sphere = _fibonacci(_SPHERE)
    while len(ups) < rests:
        furthest = (sphere @ ups.T).max(axis=1).argmin()
        ups = np.concatenate([ups, sphere[[furthest]]])
    upright = np.stack([_shortest_to_vertical(up) for up in ups])
    return (yaw_rotations(yaws) @ upright[:, None]).reshape(-1, 3, 3)


def _stable(points: Float) -> Float:
    """(S, 3) directions that point up when the object rests stably, most probable first; none for flat objects.

    A rest is likely as the part of all directions, seen from the centre of mass, that its side of the hull takes up.
    """
    import trimesh

    # By x first, since the hull's triangles follow the order of its points.
    _, first = np.unique(cubes(points[:, ::-1], _HULL_M), return_index=True)
    try:
        with np.errstate(invalid="ignore"):  # the centre of mass of no volume
            hull = trimesh.convex.convex_hull(points[first])
    except QhullError:
        return np.zeros((0, 3))
    if hull.volume < _LEAST_M3:
        return np.zeros((0, 3))
    center, corners = np.asarray(hull.center_mass), np.asarray(hull.vertices)
    away = np.asarray(hull.triangles_center) - center
    normals = np.asarray(hull.face_normals)
    angle = np.asarray(hull.area_faces) * (normals * away).sum(axis=1) / np.linalg.norm(away, axis=1) ** 3
    sides = [_mean_direction(normals[rows], angle[rows]) for rows in _groups(normals, angle)]
    return np.array([-down for down in sides if _stands(corners - center, down)]).reshape(-1, 3)


def _groups(normals: Float, weights: Float) -> list[NDArray[np.int64]]:
    """Rows of (F, 3) normals that are close to the weightiest one left, again and again; heavy groups first."""
    left, groups = np.argsort(-weights, kind="stable"), list[NDArray[np.int64]]()
    while len(left):
        close = normals[left] @ normals[left[0]] > _SAME_REST
        groups.append(left[close])
        left = left[~close]
    return sorted(groups, key=lambda rows: -float(weights[rows].sum()))


def _mean_direction(normals: Float, weights: Float) -> Float:
    mean = weights @ normals
    return mean / np.linalg.norm(mean)


def _stands(corners: Float, down: Float) -> bool:
    """Whether the origin, the centre of mass, is above what touches the ground of the (V, 3) corners of a hull."""
    depth = corners @ down
    flat = corners[depth > depth.max() - _SUPPORT_M] @ _shortest_to_vertical(-down)[:2].T
    try:
        return bool((ConvexHull(flat).equations[:, 2] < 0).all())
    except (QhullError, ValueError):
        # Fewer than three corners, or all in a row: it rolls.
        return False


def _fibonacci(count: int) -> Float:
    """(count, 3) unit vectors spread evenly over the sphere."""
    step = np.arange(count) + 0.5
    z, azimuth = 1 - 2 * step / count, step * np.pi * (3 - np.sqrt(5))
    level = np.sqrt(1 - z**2)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), z], axis=1)


def _shortest_to_vertical(up: Float) -> Float:
    """(3, 3) turn about a horizontal axis that takes a (3,) unit vector to the vertical."""
    return Rotation.align_vectors([0.0, 0.0, 1.0], up)[0].as_matrix()
