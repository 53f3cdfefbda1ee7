"""What depth cameras do beyond noise: mixed pixels at edges, stereo shadows, holes, lost borders; and structured light.

Each effect is one function, so that each can be switched on alone (`dataset.noise`). Sources:

- Structured light (Kinect): disparity steps and their growth with z^2, Khoshelham and Elberink, "Accuracy and
  resolution of Kinect depth data for indoor mapping applications", Sensors 2012; axial and lateral noise by distance
  and angle, Nguyen, Izadi and Lovell, "Modeling Kinect sensor noise for improved 3D reconstruction and tracking",
  3DIMPVT 2012; edges looked up at shifted pixels, Handa et al., "A benchmark for RGB-D visual odometry, 3D
  reconstruction and SLAM" (ICL-NUIM), ICRA 2014, after Barron and Malik, "Intrinsic scene properties from a single
  RGB-D image", CVPR 2013.
- Active stereo (D435): `toolkit.data.noise`; edges and shadows follow from matching windows on two images a baseline
  apart.

How often what happens was set on real captures: experiments/benchmarks/depth_noise.py measures both alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from toolkit.data import noise
from toolkit.data.conditions import Effect, Sensor
from toolkit.types import Float, Image, Mask


@dataclass(frozen=True)
class DepthSensor:
    """One kind of camera.

    Attributes:
        baseline_m: from its eye to its second eye or projector; below 0 where that is on the left.
        edge_px: how far depth at an edge is taken from beside it (standard deviation).
        window_px: width of its matching window: what its second eye sees less than that of is lost.
        border: share of the picture that is lost at its left, top, right and bottom.
        range_m: nearest and furthest depth.
        ripple: deviation, at 1 m, of an error that is smooth over a matching window; it grows with the square of depth.
        axial: adds noise along z: (H, W) metres and the focal length in pixels in, metres out.
        quantize: rounds to the sensor's steps: (H, W) metres in and out.
    """

    baseline_m: float
    edge_px: float
    window_px: int
    border: tuple[float, float, float, float]
    range_m: tuple[float, float]
    ripple: float
    axial: Callable[[Float, float, np.random.Generator], Float]
    quantize: Callable[[Float], Float]


def kinect_noise(depth: Float, focal: float, rng: np.random.Generator) -> Float:
    """Nguyen et al., Eq. 3: 1.2 mm at 0.4 m, growing with the square of distance, and towards grazing angles."""
    turn = np.minimum(np.arctan(slope(depth, focal)), np.radians(80))
    z = np.maximum(depth, 0.4)
    sigma = 0.0012 + 0.0019 * (z - 0.4) ** 2 + 0.0001 / np.sqrt(z) * turn**2 / (np.pi / 2 - turn) ** 2
    return np.where(depth > 0, depth + sigma * _smooth(rng, depth.shape, 1.0), 0).astype(np.float32)


def kinect_steps(depth: Float) -> Float:
    """Khoshelham and Elberink, Eq. 8: steps of 2.85 mm at 1 m, growing with the square of distance."""
    levels = np.rint(_KINECT_STEPS_M / np.maximum(depth, 1e-6))
    return np.where(depth > 0, _KINECT_STEPS_M / np.maximum(levels, 1), 0).astype(np.float32)


_KINECT_STEPS_M = 351.3
"""z^2 over the depth step (Handa et al.: 35130 in centimetres)."""

SENSORS: dict[Sensor, DepthSensor] = {
    "d435": DepthSensor(
        baseline_m=noise.BASELINE_M,
        edge_px=1.3,
        window_px=8,
        border=(0.06, 0.0, 0.0, 0.0),
        range_m=(0.28, 4.0),
        ripple=0.0026,
        axial=lambda depth, _, rng: noise.axial_noise(depth, rng),
        quantize=noise.quantize,
    ),
    "kinect": DepthSensor(
        baseline_m=-0.075,
        edge_px=0.6,
        window_px=3,
        border=(0.02, 0.04, 0.08, 0.03),
        range_m=(0.45, 4.0),
        ripple=0.0016,
        axial=kinect_noise,
        quantize=kinect_steps,
    ),
}

_RIPPLE_PX = 3.0
_EDGE_M = 0.02
_DOUBTED = 0.6
"""Pixels at edges are given up where a smooth field of unit deviation exceeds this: a quarter of them."""

_FARTHEST_M = 20.0
"""These sensors measure nothing beyond; the ripple of a flying pixel would reach the stars."""

_DARK, _BRIGHT = 45.0, 242.0
"""Grey levels (0 to 255) below and above which infrared light does not come back, or only as glare."""


def measure_depth(
    depth: Float, rgb: Image, focal: float, kind: Sensor, effects: tuple[Effect, ...], rng: np.random.Generator
) -> Float:
    """What a sensor makes of true depth.

    Args:
        depth: (H, W) metres along z, 0 where nothing is.
        rgb: (H, W, 3) uint8 picture of the same.
        focal: focal length, pixels.
        kind: of sensor.
        effects: those that are on; the ones about colour, light and pose are not this function's.
        rng: the source of chance.

    Returns:
        (H, W) float32 metres, 0 where nothing was measured.
    """
    sensor = SENSORS[kind]
    lost = np.zeros(depth.shape, bool)
    if "dropout" in effects and kind == "kinect":
        lost |= grazing_dropout(depth, focal, rng)
    if "shadow" in effects:
        lost |= stereo_shadow(depth, focal, sensor, rng)
    if "holes" in effects:
        lost |= holes(depth, rgb, rng)
    if "border" in effects:
        lost |= border(depth, sensor, rng)
    if "flying_pixels" in effects:
        depth = mixed_edges(depth, sensor, rng)
    if "ripple" in effects:
        depth = depth + sensor.ripple * depth**2 * _smooth(rng, depth.shape, _RIPPLE_PX)
    if "depth" in effects:
        depth = sensor.axial(depth, focal, rng)
    if "quantization" in effects:
        depth = sensor.quantize(depth)
    if "dropout" in effects and kind == "d435":
        depth = noise.dropout(depth, rng)
    return np.where(lost | (depth <= 0) | (depth > _FARTHEST_M), 0, depth).astype(np.float32)


def mixed_edges(depth: Float, sensor: DepthSensor, rng: np.random.Generator) -> Float:
    """Take depth at edges from beside, between pixels, so that it is neither surface's ("flying pixels"), or lose it.

    (H, W) metres in and out. The look-up shifts smoothly along an edge, as matching windows slide over it; depth
    between two surfaces is mixed by its inverse.
    """
    height, width = depth.shape
    shift = np.stack([_smooth(rng, depth.shape, 2.0) for _ in range(2)]).astype(np.float32) * sensor.edge_px
    y, x = np.mgrid[:height, :width].astype(np.float32)
    inverse = np.where(depth > 0, 1 / np.maximum(depth, 1e-3), 0).astype(np.float32)
    spread = cv2.GaussianBlur(inverse, (0, 0), 0.7)
    moved = cv2.remap(spread, x + shift[0], y + shift[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    near_edge = _edges(depth, 2 + round(2 * sensor.edge_px))
    found = np.where(moved > 1e-3, 1 / np.maximum(moved, 1e-3), 0)
    kernel = np.ones((5, 5), np.uint8)
    mixed = (found - cv2.erode(depth, kernel) > _EDGE_M) & (cv2.dilate(depth, kernel) - found > _EDGE_M)
    found[mixed & (_smooth(rng, depth.shape, 3.0) > _DOUBTED)] = 0
    return np.where(near_edge & (depth > 0), found, depth).astype(np.float32)


def stereo_shadow(depth: Float, focal: float, sensor: DepthSensor, rng: np.random.Generator) -> Mask:
    """(H, W) bool: what the second eye does not see because something nearer stands before it.

    A surface point is seen by the second eye at x - f b / z: hidden where a pixel further on in its direction falls on
    the same place or before it. A matching window that is partly hidden finds nothing either.
    """
    image = depth if sensor.baseline_m > 0 else depth[:, ::-1]
    columns = np.arange(image.shape[1], dtype=np.float32)
    shift = focal * abs(sensor.baseline_m) / np.maximum(image, 1e-3)
    there = np.where(image > 0, columns - shift, np.inf)
    before = np.minimum.accumulate(there[:, ::-1], axis=1)[:, ::-1]
    hidden = (image > 0) & (there > np.concatenate([before[:, 1:], np.full((len(image), 1), np.inf)], axis=1) + 0.75)
    if sensor.baseline_m < 0:
        hidden = hidden[:, ::-1]
    # Single hidden pixels are rounding at steep surfaces.
    hidden = cv2.morphologyEx(hidden.astype(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    reach = cv2.distanceTransform(1 - hidden, cv2.DIST_L2, 3)
    ragged = sensor.window_px * (0.5 + 0.5 * _smooth(rng, depth.shape, 2.5))
    # Grown to the far side only: the near one is seen by both eyes.
    behind = np.where(hidden > 0, depth, 0).astype(np.float32)
    far = depth > cv2.dilate(behind, np.ones((4 * sensor.window_px + 1,) * 2, np.uint8)) - _EDGE_M
    return (hidden > 0) | ((reach < ragged) & far)


def holes(depth: Float, rgb: Image, rng: np.random.Generator) -> Mask:
    """(H, W) bool: blobs that are lost on dark surfaces and in glare, and a few anywhere."""
    grey = cv2.GaussianBlur(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), 1.5)
    dark, glare = np.clip((_DARK - grey) / 30, 0, 1), np.clip((grey - _BRIGHT) / 8, 0, 1)
    # Half of all dark things reflect infrared light well.
    hard = float(rng.random() < 0.5) * 1.6 * dark + 2.2 * glare
    field = 0.8 * _smooth(rng, depth.shape, 6.0) + 0.6 * _smooth(rng, depth.shape, 2.0)
    return (depth > 0) & (field > 3.1 - hard * 1.6)


def border(depth: Float, sensor: DepthSensor, rng: np.random.Generator) -> Mask:
    """(H, W) bool: what lies outside the second eye's picture, or nearer or further than can be measured."""
    height, width = depth.shape
    y, x = np.mgrid[:height, :width]
    ragged = 1.5 * _smooth(rng, depth.shape, 2.0)
    left, top, right, bottom = np.array(sensor.border) * rng.uniform(0.5, 1.3)
    outside = (x + ragged < left * width) | (x + ragged > (1 - right) * width - 1 + 4 * (right == 0))
    outside |= (y + ragged < top * height) | (y + ragged > (1 - bottom) * height - 1 + 4 * (bottom == 0))
    near, far = sensor.range_m
    return outside | ((depth > 0) & ((depth < near) | (depth > far)))


def grazing_dropout(depth: Float, focal: float, rng: np.random.Generator) -> Mask:
    """(H, W) bool: what is seen at more than about 75 deg (most of it), and some specks."""
    lost = np.clip((slope(depth, focal) - 3.5) / 8, 0, 0.9) * (depth > 0)
    # Jumps look steep as well; there about a quarter is lost, in stretches.
    lost *= np.where(_edges(depth, 1), _smooth(rng, depth.shape, 3.0) > _DOUBTED, 1)
    return (rng.random(depth.shape) < lost) | (_smooth(rng, depth.shape, 1.5) > 3.9)


def slope(depth: Float, focal: float) -> Float:
    """(H, W) tangent of the angle between a surface and the image plane."""
    dx = cv2.Sobel(depth.astype(np.float32), cv2.CV_32F, 1, 0, scale=1 / 8)
    dy = cv2.Sobel(depth.astype(np.float32), cv2.CV_32F, 0, 1, scale=1 / 8)
    return np.hypot(dx, dy) * focal / np.maximum(depth, 1e-6)


def _edges(depth: Float, reach: int) -> Mask:
    """(H, W) bool: within `reach` pixels of a jump in depth."""
    kernel = np.ones((3, 3), np.uint8)
    jump = cv2.dilate(depth, kernel) - cv2.erode(depth, kernel) > _EDGE_M * np.maximum(depth, 0.3)
    return cv2.dilate(jump.astype(np.uint8), np.ones((2 * reach - 1,) * 2, np.uint8)) > 0


def _smooth(rng: np.random.Generator, shape: tuple[int, ...], sigma: float) -> Float:
    """(H, W) noise of unit deviation that is smooth over `sigma` pixels."""
    field = cv2.GaussianBlur(rng.standard_normal(shape, np.float32), (0, 0), sigma)
    return field / field.std()
