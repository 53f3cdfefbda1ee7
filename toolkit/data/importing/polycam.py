"""Polycam's raw export: keyframes/ with images, depth and a JSON file for the camera of each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict

from toolkit.data.bop.images import DEPTHS, PICTURES
from toolkit.data.bop.poses import rigid
from toolkit.data.importing.folders import by_number, checked, depth_image, picture
from toolkit.data.importing.opengl import from_opengl, low_resolution
from toolkit.data.importing.recording import Importer, Recording, Shot, pinhole_frame
from toolkit.data.importing.settings import DepthScale
from toolkit.errors import ToolkitError
from toolkit.files import read_json
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Float, Frame

_CORRECTED = "corrected_"
"""Before the folders of cameras and images that Polycam has adjusted, which are used where they are there."""


class PolycamConfig(PluginConfig):
    """Settings of `Polycam`."""

    depth_scale: DepthScale = 1.0


class Polycam(Plugin[PolycamConfig], Importer):
    """Polycam's raw data, from a phone with LiDAR: poses in OpenGL's axes and metres, depth in millimetres.

    Cameras and images that Polycam has corrected are used where there are any. The world's y is up, as ARKit has it.
    Depth is enlarged to the size of colour without interpolation. What was converted by nerfstudio's tools is of kind
    `nerfstudio`.
    """

    stage, name = "import kind", "polycam"

    def read(self, source: Path) -> Recording:
        folder = source / "keyframes" if (source / "keyframes").is_dir() else source
        corrected = _CORRECTED if (folder / f"{_CORRECTED}cameras").is_dir() else ""
        cameras = by_number(folder / f"{corrected}cameras", (".json",))
        if not cameras:
            raise ToolkitError(f"'{folder}' holds no cameras/*.json, as the raw data of Polycam does")
        entries = [checked(_Camera, read_json(path), f"'{path}'") for path in cameras]
        images, depths = (
            {path.stem: path for path in by_number(folder / name, suffixes)}
            for name, suffixes in ((f"{corrected}images", PICTURES), ("depth", DEPTHS))
        )
        missing = next((path.stem for path in cameras if path.stem not in images), None)
        if missing is not None:
            raise ToolkitError(f"'{folder / (corrected + 'images')}' has no picture of camera '{missing}'")
        names = [path.stem for path in cameras]
        shots = tuple(Shot(i, names[i], entry.pose(names[i]), names[i] in depths) for i, entry in enumerate(entries))

        def load(chosen: Sequence[Shot]) -> list[Frame]:
            return [self._frame(s, entries[s.index], images[s.name], depths.get(s.name)) for s in chosen]

        return Recording(shots, load)

    def _frame(self, shot: Shot, camera: _Camera, image: Path, depth: Path | None) -> Frame:
        rgb = picture(image, (camera.height, camera.width))
        measured = None
        if depth is not None:
            measured = low_resolution(depth_image(depth, self.config.depth_scale), rgb.shape[:2])
        K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
        return pinhole_frame(shot, rgb, measured, K)


class _Camera(BaseModel):
    """One camera's file."""

    model_config = ConfigDict(frozen=True)

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    t_00: float
    t_01: float
    t_02: float
    t_03: float
    t_10: float
    t_11: float
    t_12: float
    t_13: float
    t_20: float
    t_21: float
    t_22: float
    t_23: float

    def pose(self, name: str) -> Float:
        """(4, 4) T_world_camera; raises ToolkitError where it is not rigid."""
        T = [[getattr(self, f"t_{row}{column}") for column in range(4)] for row in range(3)]
        return from_opengl(rigid(np.array([*T, [0, 0, 0, 1]], np.float64), f"camera '{name}'"))
