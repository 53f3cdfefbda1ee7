"""What a RealSense D435 does to depth and colour, one effect per function, so that each can be switched on alone.

Sources: axial noise and disparity steps from Intel's "Tuning depth cameras for best performance"
(RMS error = z^2 * subpixel / (f * B)) with the D435's 50 mm baseline; dropout at edges and grazing angles after
Nguyen et al., "Modeling Kinect sensor noise", 3DIMPVT 2012, and Ahn et al., "Analysis and noise modeling of the
Intel RealSense D435 for mobile robots", UR 2019.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from toolkit.types import Float, Image

BASELINE_M = 0.05
FOCAL_PX = 640.0
SUBPIXEL_RMS = 0.08
DISPARITY_STEP_PX = 1 / 32
_CORRELATION_PX = 1.5
_COLOR_SIGMA = 2.5


def axial_noise(depth: Float, rng: np.random.Generator) -> Float:
    """Add depth noise that grows with z^2 and is correlated over neighbouring pixels; (H, W) metres in and out."""
    white = rng.standard_normal(depth.shape).astype(np.float32)
    smooth = cv2.GaussianBlur(white, (0, 0), _CORRELATION_PX)
    sigma = depth**2 * (SUBPIXEL_RMS / (FOCAL_PX * BASELINE_M))
    return np.where(depth > 0, depth + sigma * smooth / smooth.std(), 0).astype(np.float32)


def quantize(depth: Float) -> Float:
    """Round depth to the camera's disparity steps; (H, W) metres in and out."""
    disparity = FOCAL_PX * BASELINE_M / np.maximum(depth, 1e-6)
    stepped = np.rint(disparity / DISPARITY_STEP_PX) * DISPARITY_STEP_PX
    return np.where(depth > 0, FOCAL_PX * BASELINE_M / np.maximum(stepped, 1e-6), 0).astype(np.float32)


def dropout(depth: Float, rng: np.random.Generator) -> Float:
    """Lose most pixels at depth edges, and more the steeper the surface; (H, W) metres in and out."""
    dx = cv2.Sobel(depth, cv2.CV_32F, 1, 0, scale=1 / 8)
    dy = cv2.Sobel(depth, cv2.CV_32F, 0, 1, scale=1 / 8)
    slope = np.hypot(dx, dy) * FOCAL_PX / np.maximum(depth, 1e-6)
    edge = cv2.dilate((np.hypot(dx, dy) > 0.01).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    lost = np.where(edge, 0.7, np.clip((slope - 3) / 10, 0, 0.9)) + 0.002
    return np.where(rng.random(depth.shape) < lost, 0, depth).astype(np.float32)


def color_noise(rgb: Image, rng: np.random.Generator) -> Image:
    """Add sensor noise to (H, W, 3) uint8 colours."""
    noisy = rgb + rng.normal(0, _COLOR_SIGMA, rgb.shape)
    return np.rint(noisy).clip(0, 255).astype(np.uint8)


@dataclass(frozen=True)
class Exposure:
    """Exposure, white balance, tone curve, and light that falls off towards the corners."""

    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    gamma: float = 1.0
    falloff: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Exposure:
        """Draw settings as a camera's automatic control chooses them in one room."""
        light, warmth, tint = np.exp(rng.normal(0, [0.18, 0.07, 0.02]))
        gain = (float(light * warmth), float(light * tint), float(light / warmth))
        return cls(gain, float(np.exp(rng.normal(0, 0.15))), float(rng.uniform(0, 0.25)))

    def apply(self, rgb: Image) -> Image:
        """(H, W, 3) uint8 in and out."""
        y, x = np.linspace(-1, 1, rgb.shape[0])[:, None], np.linspace(-1, 1, rgb.shape[1])
        kept = (1 - self.falloff * (x**2 + y**2) / 2).astype(np.float32)
        light = np.minimum(rgb / np.float32(255) * np.array(self.gain, np.float32), 1) * kept[..., None]
        return np.rint(255 * light**self.gamma).clip(0, 255).astype(np.uint8)


def blur(rgb: Image, rng: np.random.Generator) -> Image:
    """Out of focus by up to a pixel and a half, and in one picture of four shaken; (H, W, 3) uint8 in and out."""
    soft = cv2.GaussianBlur(rgb, (0, 0), rng.uniform(0.3, 1.5))
    if rng.random() < 0.25:
        length, angle = rng.uniform(3, 8), rng.uniform(0, np.pi)
        kernel = np.zeros((9, 9), np.float32)
        half = 0.5 * length * np.array([np.cos(angle), np.sin(angle)])
        start, end = (tuple(np.rint(4 + sign * half).astype(int).tolist()) for sign in (-1, 1))
        cv2.line(kernel, start, end, 1.0)
        soft = cv2.filter2D(soft, -1, kernel / kernel.sum())
    return np.asarray(soft, np.uint8)
