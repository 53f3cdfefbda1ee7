"""The fused model in the fixed shapes that compiled code wants."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import KDTree

from toolkit.fusion import FusedModel, Patch
from toolkit.lighting import relit
from toolkit.refiners.images import normalized, opponent
from toolkit.types import Float, Mask

SHAPE_POINTS = 1024
"""Points of the whole model used for silhouettes and rendering."""

PATCH_POINTS = 768
"""Pixels of one patch compared photometrically."""

_MARGIN_PX = 12
_NORMAL_BLUR_PX = 1.5


@dataclass(frozen=True, eq=False)
class _Prepared:
    """A patch, cut out; (h, w, ...) images, and the rows that are compared."""

    rgb: Float
    mask: Mask
    normals: Float
    pixels: np.ndarray
    points: Float
    weights: Float


class Cloud:
    """A fused model, centred and sampled; patches are prepared when first asked for.

    Args:
        model: the model.
        levels_px: blur of the intensities, pixels.
        light: (3,) of the scene (`toolkit.lighting`).
    """

    def __init__(self, model: FusedModel, levels_px: tuple[float, ...], light: Float) -> None:
        self.model = model
        self.light = light
        self.center = model.center
        rows = _spread(len(model.points), SHAPE_POINTS)
        self.points = (model.points[rows] - self.center).astype(np.float32)
        self.colors = opponent(model.colors[rows])
        self.valid = np.arange(SHAPE_POINTS) < len(model.points)
        self.normals = model.normals_at(rows)
        self._levels_px = levels_px
        self._prepared: dict[int, _Prepared] = {}

    def shade(self, R: Float) -> Float:
        """(B, SHAPE_POINTS) float32 factors of the points' brightness once the model is turned by (B, 3, 3) R."""
        return relit(self.light, self.normals, R).astype(np.float32)

    def patch(self, index: int, R: Float) -> tuple[Float, Float, Float]:
        """(P, 3) centred points of a patch, (L, P, 3) normalised intensities once turned by (3, 3) R, (P,) weights."""
        if index not in self._prepared:
            self._prepared[index] = self._prepare(self.model.patches[index])
        p = self._prepared[index]
        image = p.rgb * relit(self.light, p.normals.reshape(-1, 3), R).reshape(*p.mask.shape, 1)
        x, y = p.pixels.T
        values = [normalized(image, p.mask, sigma)[y, x] for sigma in self._levels_px]
        return p.points, np.stack(values), p.weights

    def _prepare(self, patch: Patch) -> _Prepared:
        rows = _spread(len(patch.points), PATCH_POINTS)
        y, x = np.nonzero(patch.mask)
        top, left = max(int(y.min()) - _MARGIN_PX, 0), max(int(x.min()) - _MARGIN_PX, 0)
        box = (slice(top, int(y.max()) + _MARGIN_PX), slice(left, int(x.max()) + _MARGIN_PX))
        _, nearest = KDTree(self.points + self.center).query(patch.points)
        measured = np.zeros((*patch.mask[box].shape, 3), np.float32)
        measured[patch.pixels[:, 1] - top, patch.pixels[:, 0] - left] = self.normals[nearest]
        # Pixels without a reliable point take their neighbours' normal.
        normals = cv2.GaussianBlur(measured, (0, 0), _NORMAL_BLUR_PX)
        normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-6)
        return _Prepared(
            rgb=patch.rgb[box].astype(np.float32),
            mask=patch.mask[box],
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


def _spread(have: int, want: int) -> np.ndarray:
    """(want,) rows out of `have`: without order when there are more, repeated when there are fewer."""
    if have >= want:
        return np.random.default_rng(0).permutation(have)[:want]
    return np.arange(want) % have
