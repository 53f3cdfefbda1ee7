"""Which positions in a crop lie on its object."""

from __future__ import annotations

import numpy as np

from toolkit.types import Float, Mask


def on_mask(mask: Mask, xy: Float) -> Mask:
    """(M,) bool: whether the pixel under each of (M, 2) positions is on the (S, S) mask."""
    x, y = np.rint(xy).astype(np.int64).clip(0, len(mask) - 1).T
    return mask[y, x]
