"""The goal image at one scale: its colours in the current scene's light, and what the empty table would cost."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from toolkit.perception.tabletop.difference import Difference
from toolkit.types import Camera, Float, Frame, Mask

MOST_COST = 9.0
"""Cost of a pixel that nothing explains: three deviations, squared."""

UNSEEN_COST = 5.0
"""Cost of a pixel where a model shows a side that no frame has seen."""

_BEYOND_COST = 1.5
"""Cost of a pixel beyond the table, whose background may look like anything."""

_OBJECT_SCORE = 8.0
"""A score of `difference` that is as good as certain not to be table."""

_SHADE, _TINT = 0.3, 0.2
"""By how much the logarithm of a surface's brightness differs between images, since it was turned in the light; and its
tint, red against green and yellow against blue as parts of its brightness."""

_DARK = 20.0
"""Grey levels added to the brightness, so that noise in dark pixels counts no more than elsewhere."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """A goal image to be explained.

    Attributes:
        colours: (H, W, 3) float32, in deviations (`scaled`).
        background: (H, W) float32 cost of the empty table, and of what is beyond, as explanation of each pixel.
        depth: (H, W) float32 metres of what is known to stand there, inf where nothing is.
        K: (3, 3) intrinsics at this scale.
        factor: pixels of the goal image to a pixel here.
    """

    colours: Float
    background: Float
    depth: Float
    K: Float
    factor: int


def scaled(rgb: Float) -> Float:
    """(..., 3) float32 brightness and two tints of (..., 3) RGB, in deviations of one surface between images."""
    r, g, b = np.moveaxis(np.asarray(rgb, np.float32).clip(0, 255), -1, 0)
    level = (r + g + b) / 3 + _DARK
    return np.stack([np.log(level) / _SHADE, (r - g) / level / _TINT, ((r + g) / 2 - b) / level / _TINT], axis=-1)


def evidence(goal: Frame, found: Difference, surface: Mask, factor: int) -> Evidence:
    """Prepare a goal image.

    Args:
        goal: the goal image.
        found: how it differs from the empty table.
        surface: (H, W) bool, where it shows the table's surface.
        factor: pixels of it that are joined along each side.
    """
    height, width = surface.shape
    size = (width // factor, height // factor)
    smooth = np.asarray(cv2.GaussianBlur(found.relit, (0, 0), 0.5 * factor), np.float32)
    colours = cv2.resize(scaled(smooth), size, interpolation=cv2.INTER_AREA)
    cost = np.minimum((found.score / _OBJECT_SCORE) ** 2 * MOST_COST, MOST_COST)
    cost = np.where(surface, cost, _BEYOND_COST).astype(np.float32)
    background = cv2.resize(cost, size, interpolation=cv2.INTER_AREA)
    return Evidence(
        colours=np.asarray(colours, np.float32),
        background=np.asarray(background, np.float32),
        depth=np.full(background.shape, np.inf, np.float32),
        K=_scaled_K(goal.camera, factor),
        factor=factor,
    )


def with_known(goal: Evidence, cost: Float, depth: Float) -> Evidence:
    """The image once some of what it shows is known: (h, w) cost of every pixel, and metres to what stands there."""
    height, width = goal.background.shape
    smaller = cv2.resize(cost.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
    nearest = cv2.resize(depth.astype(np.float32), (width, height), interpolation=cv2.INTER_NEAREST)
    return replace(goal, background=np.asarray(smaller, np.float32), depth=np.asarray(nearest, np.float32))


def _scaled_K(camera: Camera, factor: int) -> Float:
    K = np.array(camera.K)
    K[:2] /= factor
    K[:2, 2] += 0.5 / factor - 0.5
    return K
