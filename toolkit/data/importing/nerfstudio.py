"""nerfstudio's transforms.json, as its own tools, Polycam, Record3D and many others write it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from toolkit.data.bop.poses import rigid
from toolkit.data.importing.folders import checked, depth_image, picture
from toolkit.data.importing.opengl import from_opengl, low_resolution
from toolkit.data.importing.recording import Importer, Recording, Shot, pinhole_frame
from toolkit.data.importing.settings import DepthScale
from toolkit.errors import ToolkitError
from toolkit.files import read_json
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Frame

_PINHOLES = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "FULL_OPENCV")


class NerfstudioConfig(PluginConfig):
    """Settings of `Nerfstudio`."""

    depth_scale: DepthScale = 1.0
    scale: float = Field(1.0, gt=0, description="metres of one unit of the poses")


class Nerfstudio(Plugin[NerfstudioConfig], Importer):
    """A folder with transforms.json: poses from camera to world in OpenGL's axes, `depth_file_path` for depth.

    Its pixel (0.5, 0.5) is the centre of the top-left pixel, where ours is (0, 0). Depth of lower resolution, as phones
    have it, is enlarged without interpolation. Poses of COLMAP have no scale of their own: `scale` gives it.
    """

    stage, name = "import kind", "nerfstudio"

    def read(self, source: Path) -> Recording:
        path = source if source.is_file() else source / "transforms.json"
        data = read_json(path)
        frames = data.get("frames") if isinstance(data, dict) else None
        if not isinstance(frames, list) or not frames:
            raise ToolkitError(f"'{path}' lists no frames, as nerfstudio's transforms.json does")
        shared = {key: value for key, value in data.items() if key != "frames"}
        entries = {index: _entry(shared, frame, f"'{path}', frame {index}") for index, frame in enumerate(frames)}
        shots = tuple(self._shot(index, entry, f"'{path}', frame {index}") for index, entry in entries.items())

        def load(chosen: Sequence[Shot]) -> list[Frame]:
            return [self._frame(shot, entries[shot.index], path.parent) for shot in chosen]

        return Recording(shots, load)

    def _shot(self, index: int, entry: _Entry, where: str) -> Shot:
        rows = entry.transform_matrix
        if len(rows) not in (3, 4) or any(len(row) != 4 for row in rows):
            raise ToolkitError(f"{where}: transform_matrix must be 4x4, row by row")
        T = rigid(np.array([*rows[:3], [0, 0, 0, 1]], np.float64), where).copy()
        T[:3, 3] *= self.config.scale / entry.applied_scale
        return Shot(index, entry.file_path, from_opengl(T), entry.depth_file_path is not None)

    def _frame(self, shot: Shot, entry: _Entry, folder: Path) -> Frame:
        rgb = picture(folder / entry.file_path, None if entry.h is None or entry.w is None else (entry.h, entry.w))
        depth = None
        if entry.depth_file_path is not None:
            depth = low_resolution(depth_image(folder / entry.depth_file_path, self.config.depth_scale), rgb.shape[:2])
        K = np.array([[entry.fl_x, 0, entry.cx - 0.5], [0, entry.fl_y or entry.fl_x, entry.cy - 0.5], [0, 0, 1]])
        return pinhole_frame(shot, rgb, depth, K, entry.distortion)


class _Entry(BaseModel):
    """One frame, with what transforms.json says of all frames."""

    model_config = ConfigDict(frozen=True)

    file_path: str
    transform_matrix: list[list[float]]
    depth_file_path: str | None = None
    camera_model: str = "OPENCV"
    fl_x: float = Field(gt=0)
    fl_y: float | None = None
    cx: float
    cy: float
    w: int | None = None
    h: int | None = None
    k1: float = 0
    k2: float = 0
    k3: float = 0
    k4: float = 0
    p1: float = 0
    p2: float = 0
    applied_scale: float = Field(1.0, gt=0)

    @property
    def distortion(self) -> tuple[float, ...]:
        """OpenCV's coefficients; none where all are 0."""
        found = (self.k1, self.k2, self.p1, self.p2, self.k3)
        return found if any(found) else ()


def _entry(shared: dict[str, Any], frame: Any, where: str) -> _Entry:
    if not isinstance(frame, dict):
        raise ToolkitError(f"{where}: an object {{...}} of its keys is wanted")
    entry = checked(_Entry, {**shared, **frame}, where)
    if entry.camera_model not in _PINHOLES or entry.k4:
        raise ToolkitError(
            f"{where}: the camera is {entry.camera_model}{' with k4' if entry.k4 else ''}, and only pinholes with "
            "OpenCV's k1 k2 p1 p2 k3 are read; undistort its pictures first (colmap image_undistorter does)"
        )
    return entry
