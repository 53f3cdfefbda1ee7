"""Whether two images show the same bare table at the same place: seen from above, its texture lies on itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.perception.tabletop.plane import Plane, on_plane, table_homography
from toolkit.perception.tabletop.table import Table
from toolkit.types import Camera, Float, Frame, Image, Mask

_CELLS = 320
"""Cells along the longer side of the plan."""

_PATCH, _BLUR = 16, 6.0
_SMOOTH = 2.0
"""Finer texture than this many cells is not compared: poses are off by millimetres."""

_CONTRAST = 1.0
"""Grey values: patches of less local contrast than this show no texture."""

_LEAST_SEEN = 0.8

PATCHES = 40
"""With fewer textured patches compared, nothing is said."""


@dataclass(frozen=True, eq=False)
class Plan:
    """An image of the table from above.

    Attributes:
        texture: (N, N) float32 smoothed grey values less their local mean.
        seen: (N, N) bool, where it shows bare table, or may do so.
    """

    texture: Float
    seen: Mask


def from_above(table: Table, camera: Camera, image: Float, bare: Mask) -> tuple[Float, Mask]:
    """Look at the table from above.

    Args:
        table: the table.
        camera: that took the image.
        image: (H, W) float32.
        bare: (H, W) where it may show the table bare.

    Returns:
        (N, N) float32 the image by cells of a plan, the same one for every camera; and (N, N) bool, those that it shows
        bare, or may do so.
    """
    low, size = table.outline.min(axis=0), float(np.ptp(table.outline, axis=0).max())
    cell = size / _CELLS
    to_plane = np.array([[cell, 0, low[0]], [0, cell, low[1]], [0, 0, 1]])
    to_pixels = table_homography(table.T_world_table, camera) @ to_plane
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    # A camera below the plan's horizon would see it mirrored.
    x, y = np.meshgrid(np.arange(_CELLS) + 0.5, np.arange(_CELLS) + 0.5)
    ahead = to_pixels[2, 0] * x + to_pixels[2, 1] * y + to_pixels[2, 2] > 0
    top = cv2.warpPerspective(image, to_pixels, (_CELLS, _CELLS), flags=flags)
    weight = cv2.warpPerspective(bare.astype(np.float32), to_pixels, (_CELLS, _CELLS), flags=flags)
    return top.astype(np.float32), (weight > 0.99) & ahead


def plan(table: Table, camera: Camera, rgb: Image, bare: Mask) -> Plan:
    """The plan of an image; `bare` (H, W) is where it may show the table bare."""
    gray = cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2GRAY).astype(np.float32)
    top, seen = from_above(table, camera, gray, bare)
    fine, mean = (
        cv2.GaussianBlur(np.where(seen, top, 0).astype(np.float32), (0, 0), sigma)
        / np.maximum(cv2.GaussianBlur(seen.astype(np.float32), (0, 0), sigma), 1e-3)
        for sigma in (_SMOOTH, _BLUR)
    )
    return Plan(np.where(seen, fine - mean, 0).astype(np.float32), seen)


def bare_plans(table: Table, flip: tuple[int, ...] = ()) -> list[Plan]:
    """The plans of all frames that see the table, of what of it is bare; colour images flipped along these axes."""
    return [
        plan(table, frame.camera, np.flip(frame.rgb, flip), surely_bare(frame, plane)) for frame, plane in table.seen()
    ]


def surely_bare(frame: Frame, plane: Plane) -> Mask:
    """(H, W) bool: where a frame's depth is the table's, and so is all around it."""
    return cv2.erode(on_plane(plane, frame).astype(np.uint8), np.ones((7, 7), np.uint8)) > 0


def between(plans: Sequence[Plan]) -> NDArray[np.float64]:
    """(P,) -1..1: the `likeness` of every plan to the others."""
    return np.concatenate([likeness(own, [*plans[:i], *plans[i + 1 :]]) for i, own in enumerate(plans)])


def likeness(one: Plan, others: Sequence[Plan]) -> NDArray[np.float64]:
    """(P,) -1..1: by patch of textured table, its correlation with the most alike of other plans."""
    best = np.full((_CELLS // _PATCH) ** 2, np.nan)
    for other in others:
        both = one.seen & other.seen
        a, b = (np.where(both, p.texture, 0).astype(np.float64) for p in (one, other))
        n, aa, bb, ab = (_sums(v) for v in (both.astype(np.float64), a * a, b * b, a * b))
        enough = n > _LEAST_SEEN * _PATCH**2
        textured = enough & (np.minimum(aa, bb) > _CONTRAST**2 * n)
        best = np.fmax(best, np.where(textured, ab / np.sqrt(np.maximum(aa * bb, 1e-9)), np.nan))
    return best[np.isfinite(best)]


def _sums(values: Float) -> Float:
    """(P,) sums over patches."""
    side = _CELLS // _PATCH
    return values.reshape(side, _PATCH, side, _PATCH).sum(axis=(1, 3)).ravel()
