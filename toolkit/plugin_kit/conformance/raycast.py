"""Boxes on a textured table, ray-cast, so that depth and masks are known exactly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from toolkit.geometry import look_at
from toolkit.perception.tabletop.plane import pixel_rays
from toolkit.types import Camera, Float, Frame

Box = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Centre of the base (x, y, z) and size (x, y, z), metres."""

WIDTH, HEIGHT = 320, 240
K = np.array([[308.0, 0, 159.5], [0, 308.0, 119.5], [0, 0, 1]])
COLOURS = np.array([[200, 40, 40], [40, 60, 190], [30, 140, 50], [230, 220, 60]], np.uint8)
HALF_TABLE = 0.5
GRAIN = 1.0
"""Contrast of the table's texture."""

NOW: list[Box] = [
    ((-0.2, 0.0, 0), (0.08, 0.12, 0.1)),
    ((0.1, 0.1, 0), (0.2, 0.03, 0.01)),
    ((0.15, -0.15, 0), (0.07, 0.07, 0.07)),
]
THEN: list[Box] = [
    ((0.2, 0.1, 0), (0.08, 0.12, 0.1)),
    ((-0.1, -0.1, 0), (0.2, 0.03, 0.01)),
    ((-0.1, 0.1, 0), (0.07, 0.07, 0.07)),
]


def camera(azimuth_deg: float) -> Camera:
    """A view of the table's centre from 1 m and 45 degrees above."""
    a = np.radians(azimuth_deg)
    eye = np.array([0.75 * np.cos(a), 0.75 * np.sin(a), 0.75])
    return Camera(K, look_at(eye, np.zeros(3)), WIDTH, HEIGHT)


def shoot(
    index: int,
    view: Camera,
    boxes: Sequence[Box],
    noise: float = 0.0,
    *,
    depth: bool = True,
    print_contrast: float = 0.0,
) -> Frame:
    """Ray-cast boxes on a textured table; beyond its edge is grey, without depth.

    Args:
        index: of the frame.
        view: the camera.
        boxes: object ids are 1, 2, ... in their order.
        noise: relative noise of depth; with any, colours are noisy too.
        depth: without it, the frame is like a goal image.
        print_contrast: of a pattern on every side of the boxes, another one on each; 0..1.
    """
    frame = Frame(index, np.zeros((HEIGHT, WIDTH, 3), np.uint8), view)
    T = view.T_world_camera
    rays = pixel_rays(frame).astype(np.float64) @ T[:3, :3].T
    eye = T[:3, 3]
    nearest = -eye[2] / rays[..., 2]
    ground = eye + nearest[..., None] * rays
    on_table = (np.abs(ground[..., :2]) < HALF_TABLE).all(axis=2) & (nearest > 0)
    owner = np.where(on_table, 0, -1)
    nearest = np.where(on_table, nearest, np.inf)
    grain = 12 * np.sin(40 * ground[..., 0] + 6 * np.sin(25 * ground[..., 1])) + 8 * np.sin(90 * ground[..., 1])
    rgb = np.where(on_table[..., None], np.array([170, 140, 100]) + GRAIN * grain[..., None], 95.0)
    for k, (base, size) in enumerate(boxes, start=1):
        low, high = np.array(base) - np.array([size[0] / 2, size[1] / 2, 0]), np.array(base)
        high = high + np.array([size[0] / 2, size[1] / 2, size[2]])
        with np.errstate(divide="ignore"):
            a, b = (low - eye) / rays, (high - eye) / rays
        enter, leave = np.minimum(a, b).max(axis=2), np.maximum(a, b).min(axis=2)
        hit = (enter < leave) & (enter > 0) & (enter < nearest)
        nearest = np.where(hit, enter, nearest)
        owner[hit] = k
        side = np.minimum(a, b).argmax(axis=2)
        shade = np.array([0.75, 0.85, 1.0])[side]
        shade = shade + print_contrast * (_pattern(eye + enter[..., None] * rays - base, k) - 0.5)
        rgb = np.where(hit[..., None], COLOURS[(k - 1) % len(COLOURS)] * shade[..., None], rgb)
    rng = np.random.default_rng(index)
    z = np.where(np.isfinite(nearest), nearest, 0)
    if noise:
        z = z * (1 + noise * rng.standard_normal(z.shape)) * (rng.random(z.shape) > 0.02)
        rgb = rgb + rng.normal(0, 2.5, rgb.shape)
    masks = {k: owner == k for k in range(1, len(boxes) + 1) if (owner == k).any()}
    return Frame(index, rgb.clip(0, 255).astype(np.uint8), view, z.astype(np.float32) if depth else None, masks, masks)


def _pattern(points: Float, number: int) -> Float:
    """(H, W) 0..1: squares of 8 mm, drawn at random for every box, at (H, W, 3) points of its own coordinates."""
    drawn = np.random.default_rng(number).random((16, 16, 16))
    i, j, k = np.moveaxis(np.floor(points / 0.008 + 1e-6).astype(int) % 16, -1, 0)
    return drawn[i, j, k]
