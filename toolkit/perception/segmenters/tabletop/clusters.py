"""What stands above the table in one depth image, cut into objects."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.perception.plane import Plane, on_plane, pixel_rays, plan_axes
from toolkit.perception.robust import deviation
from toolkit.perception.segmenters.tabletop.labels import keep, nearest_label
from toolkit.types import Float, Frame, Mask

_SMOOTH_PX = 1.5
_HIGH, _LOW = 5.0, 2.5
"""Hysteresis, in deviations of the table's noise: real with a pixel above the first, and down to the second."""

_TABLE_CELL_M = 0.01
_TOUCH_M = 0.04
"""What hovers higher than this above the table with all its visible parts does not stand on it."""


def cluster_above_plane(
    frame: Frame, plane: Plane, min_height: float = 0.0015, cell: float = 0.005, min_pixels: int = 60
) -> NDArray[np.int32]:
    """Label the objects on the table.

    Args:
        frame: with depth.
        plane: the table, from `fit_plane`.
        min_height: metres; the least threshold.
        cell: metres; side of the plan's cells.
        min_pixels: smaller clusters are dropped.

    Returns:
        (H, W) int32: 0 for none, else 1..n in row-major order of the objects' first pixels.
    """
    assert frame.depth is not None
    rays = pixel_rays(frame)
    depth = frame.depth
    if is_noisy(frame, plane, min_height):
        heights, noise_height = _smooth_heights(plane, rays, depth)
    else:
        heights, noise_height = np.where(depth > 0, plane.heights(rays, depth), 0), 0.0
    high = heights > max(min_height, _HIGH * noise_height)
    low = heights > max(min_height, _LOW * noise_height)
    core = low & (depth > 0)
    plan = (rays[core] * depth[core, None]) @ plan_axes(plane).T.astype(np.float32)
    seeds = np.zeros(depth.shape, np.int32)
    seeds[core] = _plan_labels(plan, max(cell, _footprint(frame, plane, core)))
    real = _supported(frame, plane, seeds, core, plan, heights) & np.isin(np.arange(seeds.max() + 1), seeds[high])
    labels = _grow(keep(seeds, real, min_pixels), low)
    return keep(labels, np.ones(int(labels.max(initial=0)) + 1, bool), min_pixels)


def is_noisy(frame: Frame, plane: Plane, min_height: float) -> bool:
    """Say whether the table's own noise reaches `min_height` (metres), so that depth alone leaves borders ragged."""
    assert frame.depth is not None
    return _HIGH * plane.noise * plane.camera_height * float(np.median(frame.depth[frame.depth > 0])) > min_height


def _smooth_heights(plane: Plane, rays: Float, depth: Float) -> tuple[Float, float]:
    """Heights (H, W) with noise averaged out and small holes filled, and the noise that is left, metres."""
    measured = (depth > 0).astype(np.float32)
    raw = np.where(depth > 0, plane.heights(rays, depth), 0).astype(np.float32)
    # Far below the table is background, whose size must not bleed into what stands before it.
    total = cv2.GaussianBlur(raw.clip(-0.05, None), (0, 0), _SMOOTH_PX)
    weight = cv2.GaussianBlur(measured, (0, 0), _SMOOTH_PX)
    heights = np.where(weight > 0.05, total / np.maximum(weight, 0.05), 0)
    table = heights[(np.abs(raw) < 3 * plane.noise * plane.camera_height * depth) & (depth > 0)]
    return heights, float(deviation(table)) if len(table) else 0.0


def _footprint(frame: Frame, plane: Plane, core: Mask) -> float:
    """Metres on the table between neighbouring pixels of `core`: finer cells would tear surfaces apart."""
    assert frame.depth is not None
    if not core.any():
        return 0.0
    rays, depth = pixel_rays(frame)[core], frame.depth[core]
    sine = np.maximum(-(rays @ plane.normal.astype(np.float32)) / np.linalg.norm(rays, axis=1), 0.1)
    return float(np.percentile(depth / sine, 95)) / float(frame.camera.K[1, 1])


def _plan_labels(plan: Float, cell: float) -> NDArray[np.int32]:
    """Connected components, 1..n, of (N, 2) points on a grid over the plane."""
    if not len(plan):
        return np.zeros(0, np.int32)
    cells = np.floor((plan - plan.min(axis=0)) / cell).astype(np.int64)
    grid = np.zeros((cells.max(axis=0) + 1).tolist(), np.uint8)
    grid[tuple(cells.T)] = 1
    return cv2.connectedComponents(grid, connectivity=8)[1][tuple(cells.T)].astype(np.int32)


def _supported(
    frame: Frame, plane: Plane, labels: NDArray[np.int32], core: Mask, plan: Float, heights: Float
) -> NDArray[np.bool_]:
    """(n + 1,) which clusters stand on the table: most of their plan lies in its hull, and they come down to it."""
    count = int(labels.max(initial=0)) + 1
    assert frame.depth is not None
    table = on_plane(plane, frame)[::4, ::4]
    points = (pixel_rays(frame)[::4, ::4][table] * frame.depth[::4, ::4][table][:, None]) @ plan_axes(plane).T
    hull = table_hull(points.astype(np.float32))
    members = labels[core]
    inside = inside_hull(hull, plan)
    sizes = np.maximum(np.bincount(members, minlength=count), 1)
    lowest = np.full(count, np.inf)
    np.minimum.at(lowest, members, heights[core])
    return (np.bincount(members, inside, count) / sizes > 0.5) & (lowest < _TOUCH_M)


def table_hull(points: Float) -> Float:
    """(M, 2) float32 convex hull, metres, of the largest connected part of (N, 2) table points in plan."""
    low = points.min(axis=0)
    cells = np.floor((points - low) / _TABLE_CELL_M).astype(np.int64)
    grid = np.zeros((cells.max(axis=0) + 1).tolist(), np.uint8)
    grid[tuple(cells.T)] = 1
    # The far side of a table is sampled sparsely, and objects cast gaps.
    _, labels = cv2.connectedComponents(cv2.dilate(grid, np.ones((5, 5), np.uint8)))
    members = labels[tuple(cells.T)]
    largest = int(np.bincount(members).argmax())
    return np.asarray(cv2.convexHull(points[members == largest].astype(np.float32))[:, 0], np.float32)


def inside_hull(hull: Float, points: Float) -> Mask:
    """(N,) bool: which (N, 2) points lie in a convex polygon (M, 2) of either orientation."""
    edges = np.roll(hull, -1, axis=0) - hull
    sides = points @ np.stack([-edges[:, 1], edges[:, 0]]) - (hull[:, 1] * edges[:, 0] - hull[:, 0] * edges[:, 1])
    return np.asarray((sides >= 0).all(axis=1) | (sides <= 0).all(axis=1))


def _grow(seeds: NDArray[np.int32], mask: Mask) -> NDArray[np.int32]:
    """Give every pixel of `mask` that is connected to a seed the label of the seed nearest to it."""
    parts = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)[1].astype(np.int32)
    real = np.zeros(int(parts.max()) + 1, bool)
    real[np.unique(parts[seeds > 0])] = True
    real[0] = False
    nearest = nearest_label(seeds)
    return np.where(real[parts], nearest, 0)
