"""COLMAP's reconstructions, read by pycolmap, with depth images beside them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from toolkit.data.bop.images import DEPTHS
from toolkit.data.bop.poses import rigid
from toolkit.data.importing.folders import by_number, depth_image, picture
from toolkit.data.importing.recording import Importer, Recording, Shot, library, pinhole_frame
from toolkit.data.importing.settings import DepthScale
from toolkit.errors import ToolkitError
from toolkit.geometry import invert
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Float, Frame

_MODELS = ("sparse/0", "sparse", "0", ".")
_DISTORTION = {
    "PINHOLE": lambda p: (),
    "SIMPLE_PINHOLE": lambda p: (),
    "SIMPLE_RADIAL": lambda p: (p[3], 0.0, 0.0, 0.0),
    "RADIAL": lambda p: (p[3], p[4], 0.0, 0.0),
    "OPENCV": lambda p: tuple(p[4:8]),
    "FULL_OPENCV": lambda p: tuple(p[4:12]),
}
"""OpenCV's coefficients of the parameters of COLMAP's camera models (colmap/sensor/models.h)."""


class ColmapConfig(PluginConfig):
    """Settings of `Colmap`."""

    scale: float = Field(gt=0, description="metres of one unit of the reconstruction, which has no scale of its own")
    images: str = Field("images", description="folder of the pictures")
    depth: str = Field("depth", description="folder of the depth images, named as the pictures")
    depth_scale: DepthScale = 1.0


class Colmap(Plugin[ColmapConfig], Importer):
    """A COLMAP workspace (Schoenberger and Frahm, CVPR 2016): sparse/0 in text or binary, images/, and depth/.

    `scale` gives metres per unit: the distance of two cameras, or of two points, as you measure it over what the
    reconstruction has for it. Depth comes from a depth camera, aligned to colour; COLMAP's own dense depth is not read.
    """

    stage, name = "import kind", "colmap"

    def read(self, source: Path) -> Recording:
        pycolmap = library("pycolmap", "colmap", "the import kind 'colmap'")
        found = next((source / m for m in _MODELS if list((source / m).glob("images.*"))), None)
        if found is None:
            raise ToolkitError(f"'{source}' holds no reconstruction; sparse/0/ with cameras, images and points3D does")
        try:
            model = pycolmap.Reconstruction(found)
        except (ValueError, RuntimeError, OSError, IndexError) as error:
            raise ToolkitError(f"'{found}' is no reconstruction: {' '.join(str(error).split())}") from error
        depths = {path.stem: path for path in by_number(source / self.config.depth, DEPTHS)}
        images = sorted((image for image in model.images.values() if image.has_pose), key=lambda image: image.name)
        if not images:
            raise ToolkitError(f"'{found}' has no image with a pose")
        cameras = [_camera(image.camera) for image in images]
        shots = tuple(
            Shot(i, image.name, self._pose(image), Path(image.name).stem in depths) for i, image in enumerate(images)
        )

        def load(chosen: Sequence[Shot]) -> list[Frame]:
            return [self._frame(shot, cameras[shot.index], source, depths) for shot in chosen]

        return Recording(shots, load)

    def _pose(self, image: Any) -> Float:
        T = np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])
        T[:3, 3] *= self.config.scale
        return invert(rigid(T, f"image '{image.name}'"))

    def _frame(self, shot: Shot, camera: _Camera, source: Path, depths: dict[str, Path]) -> Frame:
        K, distortion, size = camera
        path = depths.get(Path(shot.name).stem)
        depth = None if path is None else depth_image(path, self.config.depth_scale)
        return pinhole_frame(shot, picture(source / self.config.images / shot.name, size), depth, K, distortion)


_Camera = tuple[Float, tuple[float, ...], tuple[int, int]]
"""K, distortion, and (H, W)."""


def _camera(camera: Any) -> _Camera:
    """COLMAP's pixel (0.5, 0.5) is the centre of the top-left pixel, where ours is (0, 0)."""
    name = camera.model_name
    if name not in _DISTORTION:
        raise ToolkitError(
            f"COLMAP's camera model {name} is not read, but {', '.join(_DISTORTION)} are; "
            "undistort its pictures first: colmap image_undistorter"
        )
    K = np.array(camera.calibration_matrix(), np.float64)
    K[:2, 2] -= 0.5
    return K, tuple(map(float, _DISTORTION[name](camera.params))), (int(camera.height), int(camera.width))
