"""Where an image shows the table in another light: a cast shadow, or the table without one that its map has."""

from __future__ import annotations

import cv2
import numpy as np

from toolkit.types import Float, Mask

_DEPTH = 0.6
"""Deepest shadow, in logarithms of grey levels."""

_LEFT = 0.7
"""What may be left of the table's texture, as a part of what a uniform object in its place would leave."""

_WINDOW_PX = 11
_SMOOTH_PX = 5
_NONE = 9.0


def relit(residual: Float, table: Float, seen: Mask, noise: float) -> tuple[Mask, Mask]:
    """Tell changes of light, which keep the table's chroma and its texture, from things that stand on it.

    Args:
        residual: (H, W, 3) logarithm of the image less that of the table.
        table: (H, W, 3) logarithm of the table.
        seen: (H, W) where the table is known.
        noise: deviation of the residual on the table itself.

    Returns:
        (H, W) bool, where a shadow is possible; and (H, W) bool, where the table's own texture is seen through the
        change, so that it is certain (in both directions: a shadow, or one that only the map has).
    """
    shade = residual.mean(axis=2, dtype=np.float32)
    chroma = np.abs(residual - shade[..., None]).max(axis=2)
    alike = (chroma < 2 * noise) & (np.abs(shade) < _DEPTH) & seen
    mean = cv2.blur(shade, (_SMOOTH_PX, _SMOOTH_PX))
    ripple = np.sqrt(np.maximum(cv2.blur(shade * shade, (_SMOOTH_PX, _SMOOTH_PX)) - mean * mean, 0))
    possible = alike & (shade < 0) & (ripple < 2 * noise)
    return possible, alike & _seen_through(shade, table.mean(axis=2, dtype=np.float32), alike, noise)


def _seen_through(shade: Float, brightness: Float, alike: Mask, noise: float) -> Mask:
    """(H, W) bool: one factor on the brightness of the table, within one pixel, explains a window around the pixel."""
    kernel = np.ones((3, 3), np.uint8)
    above, below = cv2.dilate(brightness, kernel) - brightness, brightness - cv2.erode(brightness, kernel)

    def unexplained(change: Float) -> Float:
        return np.maximum(change - above, 0) + np.maximum(-change - below, 0)

    level = _mean(shade, alike)
    left = _mean(np.minimum(unexplained(shade - level), 3 * noise), alike)
    uniform = _mean(unexplained(_mean(brightness, alike) - brightness), alike)
    explained = alike & (left < _LEFT * uniform)
    # A window across a shadow's edge fits no one factor. A pixel there lies between those of windows beside it.
    window = np.ones((_WINDOW_PX, _WINDOW_PX), np.uint8)
    most = cv2.dilate(np.where(explained, level, -_NONE).astype(np.float32), window)
    least = cv2.erode(np.where(explained, level, _NONE).astype(np.float32), window)
    return np.asarray((shade < most + 2 * noise + above) & (shade > least - 2 * noise - below))


def _mean(values: Float, where: Mask) -> Float:
    """(H, W) mean of the values at `where`, over a window."""
    total = cv2.blur(np.where(where, values, 0).astype(np.float32), (_WINDOW_PX, _WINDOW_PX))
    return total / np.maximum(cv2.blur(where.astype(np.float32), (_WINDOW_PX, _WINDOW_PX)), 1e-3)
