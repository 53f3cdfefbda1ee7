"""What stands above the table in one depth image, cut into objects."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.geometry import invert
from toolkit.perception.robust import deviation
from toolkit.perception.tabletop.labels import keep, nearest_label
from toolkit.perception.tabletop.plane import Plane, pixel_rays
from toolkit.perception.tabletop.table import Table
from toolkit.types import Float, Frame, Mask

_SMOOTH_PX = 1.5
_HIGH, _LOW = 5.0, 2.5
"""Hysteresis, in deviations of the table's noise: real with a pixel above the first, and down to the second."""

_TOUCH_M = 0.04
"""What hovers higher than this above the table with all its visible parts does not stand on it."""


def cluster_above_plane(
    frame: Frame, plane: Plane, table: Table, min_height: float, cell: float, min_pixels: int
) -> NDArray[np.int32]:
    """Label the objects on the table.

    Args:
        frame: with depth.
        plane: the table before the frame's camera.
        table: the table of all frames.
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
    T = invert(table.T_world_table) @ frame.camera.T_world_camera
    plan = (rays[core] * depth[core, None]) @ T[:2, :3].T + T[:2, 3]
    seeds = np.zeros(depth.shape, np.int32)
    seeds[core] = _plan_labels(plan, max(cell, _footprint(frame, plane, core)))
    real = _supported(seeds, core, table.holds(plan), heights) & np.isin(np.arange(seeds.max() + 1), seeds[high])
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


def _supported(labels: NDArray[np.int32], core: Mask, inside: Mask, heights: Float) -> NDArray[np.bool_]:
    """(n + 1,) which clusters stand on the table: mostly inside its outline, and coming down to it."""
    count = int(labels.max(initial=0)) + 1
    members = labels[core]
    sizes = np.maximum(np.bincount(members, minlength=count), 1)
    lowest = np.full(count, np.inf)
    np.minimum.at(lowest, members, heights[core])
    return (np.bincount(members, inside, count) / sizes > 0.5) & (lowest < _TOUCH_M)


def _grow(seeds: NDArray[np.int32], mask: Mask) -> NDArray[np.int32]:
    """Give every pixel of `mask` that is connected to a seed the label of the seed nearest to it."""
    parts = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)[1].astype(np.int32)
    real = np.zeros(int(parts.max()) + 1, bool)
    real[np.unique(parts[seeds > 0])] = True
    real[0] = False
    nearest = nearest_label(seeds)
    return np.where(real[parts], nearest, 0)
