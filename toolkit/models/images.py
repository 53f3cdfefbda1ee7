"""Colour images as networks take them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from toolkit.types import Image


def color_tensor(images: Sequence[Image], mean: tuple[float, ...], deviation: tuple[float, ...]) -> Tensor:
    """(S, S, 3) uint8 images as (N, 3, S, S) float32, normalised by channel, channels last in memory.

    Args:
        images: at least one.
        mean: of every channel, of colours in 0..1.
        deviation: likewise.
    """
    stacked = torch.from_numpy(np.stack(images)).permute(0, 3, 1, 2).float() / 255
    shifted = (stacked - torch.tensor(mean).view(3, 1, 1)) / torch.tensor(deviation).view(3, 1, 1)
    return shifted.contiguous(memory_format=torch.channels_last)
