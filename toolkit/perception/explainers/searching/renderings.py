"""What a moved model would show in the goal image, pixel by pixel, and what each pixel would cost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from toolkit.geometry import invert, transform_points
from toolkit.perception.explainers.searching.evidence import MOST_COST, UNSEEN_COST, Evidence, scaled
from toolkit.perception.fusion import FusedModel
from toolkit.types import Camera, Float

_POINTS = 6000
_SPACING_M = 0.0035
"""Points are about this far apart, and each covers the pixels around it."""

_GRAZING = 0.1


@dataclass(frozen=True, eq=False)
class Rendering:
    """The pixels a model would cover.

    Attributes:
        pixels: (P,) int64 row-major index.
        depth: (P,) metres.
        cost: (P,) of the model as explanation of them.
    """

    pixels: NDArray[np.int64]
    depth: Float
    cost: Float


@dataclass(frozen=True, eq=False)
class Surface:
    """Some points of a model, in no order, to be compared and drawn many times.

    Attributes:
        points: (N, 3) float32 metres, in the world of the current scene.
        normals: (N, 3) float32 outward.
        colours: (N, 3) float32, as `evidence.scaled` gives them.
        spacing: metres between neighbouring points, about.
    """

    points: Float
    normals: Float
    colours: Float
    spacing: float


def surface_of(model: FusedModel) -> Surface:
    """Take as many points of a model as are drawn."""
    rows = np.random.default_rng(0).permutation(len(model.points))[:_POINTS]
    spacing = _SPACING_M * max(1.0, np.sqrt(len(model.points) / _POINTS))
    return Surface(model.points[rows], model.normals_at(rows), scaled(model.colors[rows]), spacing)


def render(surface: Surface, T_goal_current: Float, camera: Camera, goal: Evidence) -> Rendering:
    """Draw a surface as the goal camera would see it once it is moved; its points hide those behind them."""
    T = invert(camera.T_world_camera) @ T_goal_current
    points = transform_points(T, surface.points)
    normals = surface.normals @ T[:3, :3].T
    depth = points[:, 2]
    ahead = depth > 1e-2
    pixels = points[:, :2] / np.where(ahead, depth, 1.0)[:, None] * np.diagonal(goal.K)[:2] + goal.K[:2, 2]
    column, row = np.rint(pixels).astype(np.int64).T
    reach = max(0, int(np.ceil(surface.spacing * goal.K[0, 0] / max(float(np.median(depth)), 1e-2) / 2 - 0.5)))
    height, width = goal.background.shape
    right, down = (step.ravel() for step in np.meshgrid(*[np.arange(-reach, reach + 1)] * 2))
    columns, rows = column[:, None] + right, row[:, None] + down
    inside = ahead[:, None] & (columns >= 0) & (rows >= 0) & (columns < width) & (rows < height)
    index = (rows * width + columns)[inside]
    # Of two points of one surface that reach a pixel the one that is centred on it shows its colour.
    order_depth = (depth[:, None] + 1e-4 * (np.abs(right) + np.abs(down)))[inside]
    source = np.broadcast_to(np.arange(len(points))[:, None], inside.shape)[inside]
    nearest = np.full(height * width, np.inf)
    np.minimum.at(nearest, index, order_depth)
    front = np.flatnonzero(order_depth == nearest[index])[::-1]
    shown = np.zeros(height * width, np.int64)
    shown[index[front]] = source[front]  # of equal ones, the first is written last
    index = np.flatnonzero(np.isfinite(nearest))
    source = shown[index]
    gap = goal.colours.reshape(-1, 3)[index] - surface.colours[source]
    cost = np.minimum((gap * gap).sum(axis=1), MOST_COST)
    front = -(normals * points).sum(axis=1) > _GRAZING * np.linalg.norm(points, axis=1)
    return Rendering(index, depth[source], np.where(front[source], cost, UNSEEN_COST))
