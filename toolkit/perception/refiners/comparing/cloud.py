"""The fused model in the fixed shapes that compiled code wants."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import ConvexHull, KDTree, QhullError

from toolkit.geometry import cubes
from toolkit.perception.fusion import FusedModel, Patch
from toolkit.perception.lighting import relit
from toolkit.perception.refiners.comparing.images import Normalizer, opponent
from toolkit.types import Float

SHAPE_POINTS = 1024
"""Points of the whole model used for silhouettes and rendering."""

PATCH_POINTS = 768
"""Pixels of one patch compared photometrically."""

FACING_AWAY = -0.3
"""Cosine of an outward normal and the way to the camera: less is seen from behind. Normals at edges are not exact."""

_MARGIN_PX = 12
_NORMAL_BLUR_PX = 1.5

BOTTOM_POINTS = 256
_FINEST_M = 0.002
_LOW_M = 0.005
"""What is seen of an object less than this above the lowest that is seen goes on down to the table."""


@dataclass(frozen=True, eq=False)
class _Prepared:
    """A patch, cut out: (h, w, 3) opponent colours and normals, and the rows that are compared."""

    colors: Float
    levels: tuple[Normalizer, ...]
    normals: Float
    pixels: np.ndarray
    points: Float
    weights: Float


class Cloud:
    """A fused model, centred and sampled; patches are prepared when first asked for.

    Attributes:
        points: (N, 3) float32, centred; what was seen, then the bottom, which no camera sees: N is SHAPE_POINTS +
            BOTTOM_POINTS.
        normals: (N, 3) float32 outward; 0 for the bottom.
        colors: (N, 3) float32 opponent colours; 0 for the bottom.
        valid: (N,) bool, no padding; padding repeats points.
        seen: (N,) bool, not of the bottom.

    Args:
        model: the model.
        levels_px: blur of the intensities, pixels.
        light: (3,) of the scene (`toolkit.perception.lighting`).
        table: world z of the table below the object, metres; that of its lowest point when left out.
    """

    def __init__(
        self, model: FusedModel, levels_px: tuple[float, ...], light: Float, table: float | None = None
    ) -> None:
        self.model = model
        self.light = light
        self.center = model.center
        rows = _evenly(model.points, SHAPE_POINTS)
        self.table = float(model.points[:, 2].min()) if table is None else table
        bottom = np.zeros((0, 3)) if table is None else _bottom(model.points, table)
        below = bottom[_spread(len(bottom), BOTTOM_POINTS)] if len(bottom) else model.points[rows[:BOTTOM_POINTS]]
        none = np.zeros((BOTTOM_POINTS, 3), np.float32)
        self.points = (np.concatenate([model.points[rows], below]) - self.center).astype(np.float32)
        self.colors = np.concatenate([opponent(model.colors[rows]), none])
        self.normals = np.concatenate([model.normals_at(rows), none])
        self.valid = np.arange(len(self.points)) < min(len(model.points), SHAPE_POINTS)
        self.valid[SHAPE_POINTS:] = np.arange(BOTTOM_POINTS) < len(bottom)
        self.seen = np.arange(len(self.points)) < SHAPE_POINTS
        self._levels_px = levels_px
        self._prepared: dict[int, _Prepared] = {}

    def shade(self, R: Float) -> Float:
        """(B, SHAPE_POINTS) float32 factors of the points' brightness once the model is turned by (B, 3, 3) R."""
        return relit(self.light, self.normals, R).astype(np.float32)

    def patch(self, index: int, R: Float, direction: Float) -> tuple[Float, Float, Float]:
        """A patch as it looks from a (3,) unit direction of the current world, once the model is turned by (3, 3) R.

        Returns:
            (P, 3) centred points, (L, P, 3) normalised intensities, and (P,) weights: 0 for what faces away.
        """
        if index not in self._prepared:
            self._prepared[index] = self._prepare(self.model.patches[index])
        p = self._prepared[index]
        factor = relit(self.light, p.normals.reshape(-1, 3), R).astype(np.float32)
        image = p.colors * factor.reshape(*p.colors.shape[:2], 1)
        x, y = p.pixels.T
        values = [level.normalized(image)[y, x] for level in p.levels]
        return p.points, np.stack(values), p.weights * (p.normals[y, x] @ direction > FACING_AWAY)

    def _prepare(self, patch: Patch) -> _Prepared:
        rows = _spread(len(patch.points), PATCH_POINTS)
        y, x = np.nonzero(patch.mask)
        top, left = max(int(y.min()) - _MARGIN_PX, 0), max(int(x.min()) - _MARGIN_PX, 0)
        box = (slice(top, int(y.max()) + _MARGIN_PX), slice(left, int(x.max()) + _MARGIN_PX))
        _, nearest = KDTree(self.points[self.seen] + self.center).query(patch.points)
        measured = np.zeros((*patch.mask[box].shape, 3), np.float32)
        measured[patch.pixels[:, 1] - top, patch.pixels[:, 0] - left] = self.normals[nearest]
        # Pixels without a reliable point take their neighbours' normal.
        normals = cv2.GaussianBlur(measured, (0, 0), _NORMAL_BLUR_PX)
        normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-6)
        return _Prepared(
            colors=opponent(patch.rgb[box]),
            levels=tuple(Normalizer(patch.mask[box], sigma) for sigma in self._levels_px),
            normals=normals,
            pixels=patch.pixels[rows] - [left, top],
            points=(patch.points[rows] - self.center).astype(np.float32),
            weights=(np.arange(PATCH_POINTS) < len(patch.points)).astype(np.float32),
        )

    def nearest_patches(self, direction: Float, count: int) -> list[int]:
        """Patches seen from closest to a (3,) unit direction in the current world, best first."""
        angles = np.array([patch.observation for patch in self.model.patches]) @ direction
        order = np.argsort(-angles, kind="stable")[:count].tolist()
        # A fixed number, so that shapes stay: the best is repeated.
        return order + [order[0]] * (count - len(order))


def _bottom(points: Float, table: float) -> Float:
    """(B, 3) points of the table below those of the (N, 3) points that lie over where the object stands.

    What is not seen between the lowest points and the table is taken for chamfered, as most edges are round.
    """
    xy, lowest = points[:, :2], points[:, 2].min()
    try:
        sides = ConvexHull(xy[points[:, 2] < lowest + _LOW_M]).equations
    except (QhullError, ValueError):
        return np.zeros((0, 3))
    within = xy[(xy @ sides[:, :2].T + sides[:, 2] < table - lowest).all(axis=1)]
    return np.column_stack([within, np.full(len(within), table)])


def _evenly(points: Float, want: int) -> np.ndarray:
    """(want,) rows of (N, 3) points, one per cube as far as they go round: oblique views leave fewer points behind."""
    if len(points) <= want:
        return np.arange(want) % len(points)
    order = np.random.default_rng(0).permutation(len(points))
    side, offset = _FINEST_M, points[order] - points.min(axis=0)
    while True:
        first = np.unique(cubes(offset, side), return_index=True)[1]
        if len(first) <= want:
            break
        side *= 1.2
    rest = np.ones(len(order), bool)
    rest[first] = False
    return np.concatenate([order[np.sort(first)], order[rest]])[:want]


def _spread(have: int, want: int) -> np.ndarray:
    """(want,) rows out of `have`: without order when there are more, repeated when there are fewer."""
    if have >= want:
        return np.random.default_rng(0).permutation(have)[:want]
    return np.arange(want) % have
