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


def normalized(rgb: Image | Float, mask: Mask, sigma: float) -> Float:
    """(H, W, 3) float32 opponent colours, blurred by `sigma` pixels and normalised locally, on the mask only.

    Mean and deviation are taken over a Gaussian neighbourhood inside the mask, so that neither light nor what lies
    beside the object matters. 0 off the mask.
    """
    weight = mask.astype(np.float32)
    image = opponent(rgb) * weight[..., None]
    wide = _WINDOW * max(sigma, 0.7)
    # Normalised convolution (Knutsson and Westin, CVPR 1993): what is blurred, over how much of it was there.
    share, wide_share = (np.maximum(cv2.GaussianBlur(weight, (0, 0), s), 1e-3)[..., None] for s in (sigma, wide))
    blurred = cv2.GaussianBlur(image, (0, 0), sigma) / share
    mean = cv2.GaussianBlur(blurred * weight[..., None], (0, 0), wide) / wide_share
    centered = (blurred - mean) * weight[..., None]
    variance = cv2.GaussianBlur(centered * centered, (0, 0), wide) / wide_share
    return centered / np.sqrt(variance + _NOISE**2)
