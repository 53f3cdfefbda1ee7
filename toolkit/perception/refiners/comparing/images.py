"""Images made comparable: opponent colours, normalised by their own neighbourhood on the object."""

from __future__ import annotations

import cv2
import numpy as np

from toolkit.types import Float, Image, Mask

_NOISE = 6.0
"""Grey levels: contrast below this is noise and must not be blown up."""

_WINDOW = 5.0
"""Width of the neighbourhood, in blur widths."""


def opponent(rgb: Image | Float) -> Float:
    """(..., 3) float32 brightness, red against green, yellow against blue."""
    r, g, b = np.moveaxis(np.asarray(rgb, np.float32), -1, 0)
    return np.stack([(r + g + b) / 3, (r - g) / 2, (r + g) / 4 - b / 2], axis=-1)


class Normalizer:
    """Blurs opponent colours and normalises them locally, on one mask only.

    Mean and deviation are taken over a Gaussian neighbourhood inside the mask, so that neither light nor what lies
    beside the object matters: normalised convolution (Knutsson and Westin, CVPR 1993), what is blurred over how much
    of it was there.

    Args:
        mask: (H, W) of the object.
        sigma: blur, pixels.
    """

    def __init__(self, mask: Mask, sigma: float) -> None:
        self._weight = mask.astype(np.float32)[..., None]
        self._sigma, self._wide = sigma, _WINDOW * max(sigma, 0.7)
        self._share, self._wide_share = (
            np.maximum(cv2.GaussianBlur(self._weight, (0, 0), s), 1e-3)[..., None] for s in (self._sigma, self._wide)
        )

    def normalized(self, colors: Float) -> Float:
        """(H, W, 3) float32 of an (H, W, 3) float32 image of opponent colours; 0 off the mask."""
        blurred = cv2.GaussianBlur(colors * self._weight, (0, 0), self._sigma) / self._share
        mean = cv2.GaussianBlur(blurred * self._weight, (0, 0), self._wide) / self._wide_share
        centered = (blurred - mean) * self._weight
        variance = cv2.GaussianBlur(centered * centered, (0, 0), self._wide) / self._wide_share
        return centered / np.sqrt(variance + _NOISE**2)
