"""One PyBullet client: objects placed exactly, and rendered by the camera model the rest of the toolkit uses."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from toolkit.errors import ToolkitError
from toolkit.geometry import invert
from toolkit.sim.bullet import Renderer, pybullet, silence
from toolkit.sim.client import BASE, Client
from toolkit.types import Camera, Float, Image

NEAR_M = 0.2
"""Far enough that the 24-bit z-buffer resolves less than 0.01 mm at a metre."""


@dataclass(frozen=True)
class Light:
    """A distant light.

    Attributes:
        direction: (x, y, z) from what is lit to the light, world coordinates.
        ambient: light from everywhere, 0..1.
        diffuse: light from the direction, 0..1.
    """

    direction: tuple[float, float, float] = (0.3, -0.6, 1.0)
    ambient: float = 0.55
    diffuse: float = 0.45


class World:
    """A PyBullet client of its own; use it as a context manager.

    Args:
        renderer: `tiny` (TinyRenderer, always there) or `egl` (PyBullet's plug-in).
        far_m: nothing further than this is rendered.
        near_m: nor anything nearer than this.

    Raises:
        ToolkitError: `egl` was asked for and does not load on this machine.
    """

    def __init__(self, renderer: Renderer = "tiny", far_m: float = 4.0, near_m: float = NEAR_M) -> None:
        self.client = Client()
        self._range_m = (near_m, far_m)
        self._renderer = pybullet.ER_TINY_RENDERER
        # TinyRenderer samples a pixel at its top-right corner, not at its centre (tests/sim/test_world.py measures it).
        self._sample_offset = np.array([0.5, -0.5]) if renderer == "tiny" else np.zeros(2)
        if renderer == "egl":
            if not self.client.load_egl():
                self.close()
                raise ToolkitError("PyBullet's EGL renderer does not load here; set dataset.renderer to tiny")
            self._renderer = pybullet.ER_BULLET_HARDWARE_OPENGL

    def __enter__(self) -> World:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Disconnect the client."""
        self.client.close()

    def add_visuals(self, visuals: Sequence[tuple[Path, Path]]) -> list[int]:
        """Add meshes (OBJ) with their textures, which collide with nothing, at the origin; returns their body ids.

        To be called once, before anything else is added: with EGL, a mesh whose own material names an image takes a
        texture number that a later loadTexture does not count, and the textures of all later meshes are mixed up.
        """
        bodies: list[int] = []
        with silence():  # about pictures that a mesh's own material names, and that are not needed
            textures = [self.client.loadTexture(str(texture)) for _, texture in visuals]
            for (mesh, _), texture in zip(visuals, textures, strict=True):
                shape = self.client.createVisualShape(pybullet.GEOM_MESH, fileName=str(mesh), specularColor=[0, 0, 0])
                body = int(self.client.createMultiBody(0, -1, shape))
                self.client.changeVisualShape(body, BASE, textureUniqueId=texture)
                bodies.append(body)
        return bodies

    def move_all(self, bodies: Sequence[int], poses: Sequence[Float]) -> None:
        """Put every body at its (4, 4) pose."""
        for body, T_world_object in zip(bodies, poses, strict=True):
            self.client.place(body, T_world_object)

    def render(self, camera: Camera, light: Light, supersample: int = 1) -> tuple[Image, Float, NDArray[np.int32]]:
        """Render what a camera sees.

        Args:
            camera: intrinsics and pose.
            light: the one light there is.
            supersample: rendered pixels per pixel and axis; colours are averaged.

        Returns:
            (H, W, 3) uint8 colours, (H, W) float32 depth along z in metres (0 where nothing is), (H, W) int32 body ids
            (-1 where nothing is).
        """
        width, height = camera.width * supersample, camera.height * supersample
        with silence() if self._renderer != pybullet.ER_TINY_RENDERER else contextlib.nullcontext():
            _, _, rgba, zbuffer, ids = self.client.getCameraImage(
                width,
                height,
                _gl_view(camera),
                _gl_projection(camera, self._sample_offset / supersample, self._range_m),
                lightDirection=list(light.direction),
                lightAmbientCoeff=light.ambient,
                lightDiffuseCoeff=light.diffuse,
                lightSpecularCoeff=0.0,
                shadow=0,
                renderer=self._renderer,
            )
        rgb = np.reshape(np.asarray(rgba, np.uint8), (height, width, 4))[..., :3]
        z = np.reshape(np.asarray(zbuffer, np.float64), (height, width))
        near, far = self._range_m
        depth = far * near / (far - (far - near) * z)
        ids = np.reshape(np.asarray(ids, np.int32), (height, width))
        depth = np.where(ids >= 0, depth, 0).astype(np.float32)
        if supersample == 1:
            return rgb.copy(), depth, ids
        return _downsample(rgb, depth, ids, supersample)


def _downsample(
    rgb: Image, depth: Float, ids: NDArray[np.int32], factor: int
) -> tuple[Image, Float, NDArray[np.int32]]:
    """Average colours over blocks; depth is the harmonic mean (exact on planes) of the samples with the block's id."""
    height, width = ids.shape[0] // factor, ids.shape[1] // factor

    def blocks(image: NDArray[Any]) -> NDArray[Any]:
        split = image.reshape(height, factor, width, factor, -1).swapaxes(1, 2)
        return split.reshape(height, width, factor * factor, -1)

    colors = np.rint(blocks(rgb).mean(axis=2, dtype=np.float32)).astype(np.uint8)
    samples = blocks(ids)[..., 0]
    block_ids = samples[..., (factor // 2) * (factor + 1)]
    same = samples == block_ids[..., None]
    inverse = np.where(same, 1 / np.maximum(blocks(depth)[..., 0], 1e-6), 0).sum(axis=2) / same.sum(axis=2)
    return colors, np.where(block_ids >= 0, 1 / inverse, 0).astype(np.float32), block_ids


def _gl_view(camera: Camera) -> list[float]:
    T = np.diag([1.0, -1.0, -1.0, 1.0]) @ invert(camera.T_world_camera)
    return T.T.ravel().tolist()


def _gl_projection(camera: Camera, sample_offset: Float, range_m: tuple[float, float]) -> list[float]:
    """OpenGL's matrix for K, whose pixel (0, 0) is the centre of the top-left pixel; column-major.

    `sample_offset` (2,) is where the renderer samples, relative to the pixel's centre, pixels.
    """
    fx, fy = camera.K[0, 0], camera.K[1, 1]
    cx, cy = camera.K[:2, 2] - sample_offset
    w, h = camera.width, camera.height
    P = np.zeros((4, 4))
    P[0, 0], P[1, 1] = 2 * fx / w, 2 * fy / h
    P[0, 2], P[1, 2] = 1 - 2 * (cx + 0.5) / w, 2 * (cy + 0.5) / h - 1
    near, far = range_m
    P[2, 2] = -(far + near) / (far - near)
    P[2, 3] = -2 * far * near / (far - near)
    P[3, 2] = -1
    return P.T.ravel().tolist()
