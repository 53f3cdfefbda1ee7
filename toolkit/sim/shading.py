"""Light that PyBullet's renderers lack: cast shadows and mirrored lamps, added to a picture by its depth.

Both are functions of the picture, its depth and its camera, so that they look the same whatever rendered it. Shadows by
a shadow map (Williams, SIGGRAPH 1978) with percentage-closer filtering (Reeves et al., SIGGRAPH 1987); reflections of
lamps by Schlick's Fresnel term (Computer Graphics Forum 1994).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from toolkit.geometry import look_at
from toolkit.sim.world import Light, World
from toolkit.types import Camera, Float, Image

_MAP_PX = 640
_MAP_FROM_M = 2.5
_MAP_HALF_M = 0.85
"""Shadows fall within this distance of the world's origin."""

_BIAS_M = 0.004
_STEEPEST = 0.01
"""Largest change of depth between two texels that is taken for one surface's, metres."""

_TAPS = 10


@dataclass(frozen=True)
class Lamp:
    """A rectangular lamp under the ceiling, parallel to it.

    Attributes:
        middle: (x, y, z), metres.
        half: half its two sides, metres.
        brightness: of its mirror image in a perfect mirror, 1 is white.
    """

    middle: tuple[float, float, float]
    half: tuple[float, float]
    brightness: float


def draw_lamps(rng: np.random.Generator) -> list[Lamp]:
    """Two to four lamps or windows somewhere overhead."""
    lamps: list[Lamp] = []
    for _ in range(int(rng.integers(2, 5))):
        x, y = rng.uniform(-2, 2, 2).tolist()
        a, b = (0.15, 0.6) if rng.random() < 0.5 else (0.35, 0.35)
        if rng.random() < 0.5:
            a, b = b, a
        lamps.append(Lamp((x, y, float(rng.uniform(1.4, 2.2))), (a, b), float(rng.uniform(0.6, 1.4))))
    return lamps


class Surface:
    """The surface that a picture shows, pixel by pixel, in world coordinates.

    Args:
        depth: (H, W) metres along z, 0 where nothing is.
        camera: that it was seen from.
    """

    def __init__(self, depth: Float, camera: Camera) -> None:
        K, T = camera.K.astype(np.float32), camera.T_world_camera.astype(np.float32)
        x = (np.arange(camera.width, dtype=np.float32) - K[0, 2]) / K[0, 0]
        y = (np.arange(camera.height, dtype=np.float32) - K[1, 2]) / K[1, 1]
        rays = np.stack(np.broadcast_arrays(x[None, :], y[:, None], np.float32(1)), axis=-1)
        local = rays * depth[..., None].astype(np.float32)
        self.seen = depth > 0
        self.points = local @ T[:3, :3].T + T[:3, 3]
        down = np.gradient(self.points, axis=0)
        right = np.gradient(self.points, axis=1)
        normals = np.cross(down, right)
        lengths = np.linalg.norm(normals, axis=-1, keepdims=True)
        self.normals = normals / np.maximum(lengths, 1e-9)
        outgoing = self.points - T[:3, 3]
        self.rays = outgoing / np.maximum(np.linalg.norm(outgoing, axis=-1, keepdims=True), 1e-9)


class ShadowMap:
    """What the light reaches, for one arrangement of a world.

    Args:
        world: as it stands now; it is rendered once, from the light.
        light: the one that casts shadows.
        softness: width of the shadows' edges, metres.
    """

    def __init__(self, world: World, light: Light, softness: float) -> None:
        toward = np.asarray(light.direction, np.float64)
        self._toward = (toward / np.linalg.norm(toward)).astype(np.float32)
        focal = _MAP_PX / 2 * _MAP_FROM_M / _MAP_HALF_M
        K = np.array([[focal, 0, (_MAP_PX - 1) / 2], [0, focal, (_MAP_PX - 1) / 2], [0, 0, 1]])
        eye = _MAP_FROM_M * self._toward.astype(np.float64)
        up = (0.0, 1.0, 0.0) if abs(self._toward[2]) > 0.99 else (0.0, 0.0, 1.0)
        self._camera = Camera(K, look_at(eye, np.zeros(3), up), _MAP_PX, _MAP_PX)
        depth = world.render(self._camera, light)[1]
        self._depth = np.where(depth > 0, depth, np.inf).astype(np.float32)
        self._softness_px = softness * focal / _MAP_FROM_M
        self._share = light.diffuse / (light.ambient + light.diffuse)

    def darken(self, rgb: Image, scene: Surface) -> Image:
        """Take the light's share from what lies in shadow; (H, W, 3) uint8 in and out."""
        T = np.linalg.inv(self._camera.T_world_camera).astype(np.float32)
        local = scene.points @ T[:3, :3].T + T[:3, 3]
        K = self._camera.K.astype(np.float32)
        z = np.maximum(local[..., 2], 1e-3)
        x, y = local[..., 0] / z * K[0, 0] + K[0, 2], local[..., 1] / z * K[1, 1] + K[1, 2]
        # How the surface's own depth changes from one texel to the next: a tilted one must not shadow itself.
        normals = scene.normals @ T[:3, :3].T
        off = (normals * local).sum(axis=-1)
        steep = -(z**2) / np.where(np.abs(off) < 1e-3, 1e-3, off) / K[0, 0]
        slope_x, slope_y = (np.clip(steep * normals[..., i], -_STEEPEST, _STEEPEST) for i in (0, 1))
        hidden = np.zeros(z.shape, np.float32)
        for k in range(_TAPS):
            # A sunflower's seeds: evenly over a disc.
            radius, angle = self._softness_px * np.sqrt((k + 0.5) / _TAPS), 2.399963 * k
            dx, dy = np.float32(radius * np.cos(angle)), np.float32(radius * np.sin(angle))
            seen = cv2.remap(
                self._depth, x + dx, y + dy, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=np.inf
            )
            hidden += seen < z + dx * slope_x + dy * slope_y - _BIAS_M
        # What is turned away from the light gets none of it to begin with.
        facing = np.clip(4 * (scene.normals @ self._toward), 0, 1)
        kept = 1 - self._share * hidden / _TAPS * facing * scene.seen
        return np.rint(rgb * kept[..., None]).astype(np.uint8)


def mirror_lamps(rgb: Image, scene: Surface, lamps: Sequence[Lamp], gloss: Float) -> Image:
    """Add the lamps' mirror images to a picture.

    Args:
        rgb: (H, W, 3) uint8.
        scene: what it shows.
        lamps: what is mirrored.
        gloss: (H, W) 0 (matt) to 1 (polished lacquer); less of it also blurs.

    Returns:
        (H, W, 3) uint8.
    """
    cosine = np.clip(-(scene.rays * scene.normals).sum(axis=-1), 0, 1)
    mirrored = scene.rays + 2 * cosine[..., None] * scene.normals
    rising = np.maximum(mirrored[..., 2], 1e-3)
    light = np.zeros(cosine.shape, np.float32)
    for lamp in lamps:
        x, y, z = lamp.middle
        way = (z - scene.points[..., 2]) / rising
        blur = 0.03 + 0.35 * (1 - gloss)
        off_x = (np.abs(scene.points[..., 0] + way * mirrored[..., 0] - x) - lamp.half[0]) / blur
        off_y = (np.abs(scene.points[..., 1] + way * mirrored[..., 1] - y) - lamp.half[1]) / blur
        light += lamp.brightness / (
            (1 + np.exp(np.clip(4 * off_x, -30, 30))) * (1 + np.exp(np.clip(4 * off_y, -30, 30)))
        )
    fresnel = 0.06 + 0.94 * (1 - cosine) ** 5
    added = 255 * np.minimum(gloss * fresnel * 6 * light * (mirrored[..., 2] > 0) * scene.seen, 1.5)
    return np.rint(np.minimum(rgb + added[..., None], 255)).astype(np.uint8)
