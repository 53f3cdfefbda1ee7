"""The fused model in the fixed shapes that compiled code wants."""

from __future__ import annotations

import numpy as np

from toolkit.fusion import FusedModel, Patch
from toolkit.refiners.images import normalized, opponent
from toolkit.types import Float

SHAPE_POINTS = 1024
"""Points of the whole model used for silhouettes and rendering."""

PATCH_POINTS = 768
"""Pixels of one patch compared photometrically."""


class Cloud:
    """A fused model, centred and sampled; patches are prepared when first asked for.

    Args:
        model: the model.
        levels_px: blur of the intensities, pixels.
    """

    def __init__(self, model: FusedModel, levels_px: tuple[float, ...]) -> None:
        self.model = model
        self.center = model.center
        rows = _spread(len(model.points), SHAPE_POINTS)
        self.points = (model.points[rows] - self.center).astype(np.float32)
        self.colors = opponent(model.colors[rows])
        self.valid = np.arange(SHAPE_POINTS) < len(model.points)
        self._levels_px = levels_px
        self._patches: dict[int, tuple[Float, Float, Float]] = {}

    def patch(self, index: int) -> tuple[Float, Float, Float]:
        """(P, 3) centred points, (L, P, 3) normalised intensities and (P,) weights of one patch."""
        if index not in self._patches:
            self._patches[index] = self._prepare(self.model.patches[index])
        return self._patches[index]

    def _prepare(self, patch: Patch) -> tuple[Float, Float, Float]:
        rows = _spread(len(patch.points), PATCH_POINTS)
        y, x = np.nonzero(patch.mask)
        margin = 12
        top, left = max(int(y.min()) - margin, 0), max(int(x.min()) - margin, 0)
        box = (slice(top, int(y.max()) + margin), slice(left, int(x.max()) + margin))
        px = patch.pixels[rows]
        values = [
            normalized(patch.rgb[box], patch.mask[box], sigma)[px[:, 1] - top, px[:, 0] - left]
            for sigma in self._levels_px
        ]
        weights = (np.arange(PATCH_POINTS) < len(patch.points)).astype(np.float32)
        return (patch.points[rows] - self.center).astype(np.float32), np.stack(values), weights

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
