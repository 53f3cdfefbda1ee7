"""Lens distortion taken out of images, so that a pinhole describes them (OpenCV's model and order)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.errors import ToolkitError
from toolkit.types import Float, Image, Mask

_LEAST_SEEN = 0.5
"""Part of the undistorted picture that the distorted one must fill: the wrong order of coefficients fills far less."""


@dataclass(frozen=True)
class Lens:
    """Where the pixels of an undistorted picture lie in the distorted one.

    Attributes:
        x: (H, W) float32 column, pixels.
        y: (H, W) float32 row, pixels.
    """

    x: Float
    y: Float

    @staticmethod
    def of(K: Float, coefficients: tuple[float, ...], size: tuple[int, int], where: str) -> Lens | None:
        """The lens of a camera whose pinhole K stays as it is; None where it does not distort.

        Args:
            K: (3, 3) intrinsics, pixels.
            coefficients: OpenCV's k1, k2, p1, p2[, k3[, k4, k5, k6[, s1, s2, s3, s4[, tx, ty]]]].
            size: (H, W).
            where: what the answer to coefficients that cannot be right names.

        Raises:
            ToolkitError: most of what the pinhole sees lies outside the distorted picture.
        """
        if not any(coefficients):
            return None
        height, width = size
        with np.errstate(all="ignore"):
            x, y = cv2.initUndistortRectifyMap(K, np.array(coefficients), None, K, (width, height), cv2.CV_32FC1)
        lens = Lens(*(np.nan_to_num(at, nan=-2.0).astype(np.float32) for at in (x, y)))
        seen = lens.inside.mean()
        if seen < _LEAST_SEEN:
            raise ToolkitError(
                f"{where}: cam_dist leaves {seen:.0%} of the picture; "
                "it is k1 k2 p1 p2 [k3 ...] in OpenCV's order, for this cam_K"
            )
        return lens

    @property
    def inside(self) -> Mask:
        """(H, W) bool: pixels that the distorted picture shows."""
        height, width = self.x.shape
        return (self.x > -0.5) & (self.x < width - 0.5) & (self.y > -0.5) & (self.y < height - 0.5)

    def color(self, rgb: Image) -> Image:
        """(H, W, 3) uint8, interpolated; the border's colours where the distorted picture ends."""
        return np.asarray(cv2.remap(rgb, self.x, self.y, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE), np.uint8)

    def nearest(self, values: NDArray[Any]) -> NDArray[Any]:
        """(H, W) depth or labels, each the nearest pixel's; 0 where the distorted picture ends."""
        height, width = values.shape
        row = np.rint(self.y.clip(0, height - 1)).astype(np.int64)
        column = np.rint(self.x.clip(0, width - 1)).astype(np.int64)
        return np.where(self.inside, values[row, column], 0).astype(values.dtype)
