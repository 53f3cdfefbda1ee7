"""How much an image differs from the empty table, beyond light, noise and small misregistration."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.perception.robust import deviation
from toolkit.perception.tabletop.appearance import TableScan, TableView, fill, render_table
from toolkit.perception.tabletop.light import relit
from toolkit.types import Float, Frame, Image, Mask

_LOG_OFFSET = 8.0
"""Grey levels added before the logarithm, so that noise in dark pixels counts no more than elsewhere."""

_MOST_LIGHT = 0.7

_LEAST_SIGMA = 0.012
_TEXTURE_PX, _TEXTURE = 4.0, 2.0
"""Surroundings of a pixel, and how many deviations from them its texture may go where no frame saw it."""

_SPREAD = 3.0
_LEAST_SPREAD = 0.06
_POSSIBLY_RELIT = 0.5
"""What is left of the score where the table may only be in shadow."""


@dataclass(frozen=True, eq=False)
class Difference:
    """An image against the empty table.

    Attributes:
        score: (H, W) float32 in deviations of the table's own residual; 0 where no object can be.
        relit: (H, W, 3) float32, the image as it would be in the current scene's light.
    """

    score: Float
    relit: Float


@lru_cache(maxsize=2)
def against_table(frame: Frame, scan: TableScan) -> tuple[TableView, Difference]:
    """The empty table in an image's camera, and the image against it. The last images' are kept."""
    view = render_table(scan, frame.camera)
    return view, difference(frame.rgb, view)


def difference(rgb: Image, view: TableView) -> Difference:
    """Score every pixel by how far its colour lies outside what the table could show there.

    Logarithms of colours are compared, so that light is a sum; it is fitted as a quadratic over the image. The table
    may show any colour that its map has within one pixel. Where no frame saw the table, it looks like what is around,
    give or take its own texture; beyond the table it may show any common colour of the background.

    Args:
        rgb: (H, W, 3) the image.
        view: the empty table in the same camera.

    """
    image = _log(rgb)
    table = _log(view.rgb)
    light = _light(image - table, view.seen)
    table += light
    sigma = np.full(3, _LEAST_SIGMA, np.float32)
    if view.seen.any():
        sigma = np.maximum(deviation((image - table)[view.seen], axis=0), sigma)
    kernel = np.ones((3, 3), np.uint8)
    low, high = _float(cv2.erode(table, kernel)), _float(cv2.dilate(table, kernel))
    near_unseen = cv2.dilate((~view.seen).astype(np.uint8), kernel) > 0
    guessed = near_unseen & view.table
    texture = _texture(table, view.seen)[guessed]
    low[guessed], high[guessed] = table[guessed] - texture, table[guessed] + texture
    beyond = ~view.table
    _fill_range(low, high, beyond, image[beyond])
    excess = np.maximum(image - high, 0) - np.maximum(low - image, 0)
    score = np.linalg.norm(excess / sigma, axis=2)
    possible, certain = relit(image - table, table, view.seen, float(sigma.mean()))
    score[possible] *= _POSSIBLY_RELIT
    score[certain | ~view.reach] = 0
    # Far from the table that it was fitted to, the light is a guess.
    relit_rgb = (rgb.astype(np.float32) + _LOG_OFFSET) * np.exp(-light.clip(-_MOST_LIGHT, _MOST_LIGHT)) - _LOG_OFFSET
    return Difference(score.astype(np.float32), relit_rgb.astype(np.float32))


def _log(rgb: Image) -> Float:
    smooth = cv2.GaussianBlur(rgb, (3, 3), 0)
    return np.log(smooth.astype(np.float32) + _LOG_OFFSET)


def _float(image: NDArray[Any]) -> Float:
    return np.asarray(image, np.float32)


def _texture(table: Float, seen: Mask) -> Float:
    """(H, W, 3) how far the table's colour goes from its surroundings' where it was seen, and as far elsewhere."""
    off = table - cv2.GaussianBlur(table, (0, 0), _TEXTURE_PX)
    inner = cv2.erode(seen.astype(np.uint8), np.ones((2 * round(_TEXTURE_PX) + 1,) * 2)) > 0
    if not inner.any():
        return np.full_like(table, _LEAST_SPREAD)
    return _TEXTURE * np.sqrt(fill(off * off, inner)) + _LEAST_SPREAD


def _light(residual: Float, where: Mask) -> Float:
    """(H, W, 3) robust quadratic fit of a residual image over the pixels `where`."""
    height, width = where.shape
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j].astype(np.float32)
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=2)
    rows, columns = np.nonzero(where[::6, ::6])
    if len(rows) < 100:
        return np.zeros_like(residual)
    A, b = terms[::6, ::6][rows, columns], residual[::6, ::6][rows, columns]
    center = np.median(b, axis=0)
    off = np.abs(b - center).max(axis=1)
    inliers = off <= np.percentile(off, 70)
    solution = np.zeros((6, 3), np.float32)
    for _ in range(5):
        solution = np.linalg.lstsq(A[inliers], b[inliers], rcond=None)[0]
        off = np.abs(b - A @ solution).max(axis=1)
        inliers = off <= max(3 * float(deviation(off)), 0.01)
    return (terms @ solution).astype(np.float32)


def _fill_range(low: Float, high: Float, where: Mask, samples: Float) -> None:
    """Set the allowed range of the pixels `where` to the spread of (N, 3) samples; to everything without samples."""
    if len(samples) < 100:
        low[where], high[where] = -np.inf, np.inf
        return
    some = samples[:: max(len(samples) // 5000, 1)]
    # Objects are among the samples, so the spread must not listen to outliers.
    middle = np.median(some, axis=0)
    spread = _SPREAD * deviation(some - middle, axis=0) + _LEAST_SPREAD
    low[where], high[where] = middle - spread, middle + spread
