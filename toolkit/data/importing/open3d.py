"""Open3D's and Redwood's folders: color/, depth/, and a trajectory.log."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydantic import Field

from toolkit.data.bop.images import DEPTHS, PICTURES
from toolkit.data.bop.poses import rigid
from toolkit.data.importing.folders import by_number, depth_image, numbers, picture, rows
from toolkit.data.importing.recording import Importer, Recording, Shot, pinhole_frame
from toolkit.data.importing.settings import DepthScale, Intrinsics, matrix, open3d_intrinsics
from toolkit.errors import ToolkitError
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Float, Frame

_COLORS = ("color", "rgb", "image")
_LOGS = ("trajectory.log", "scene/trajectory.log")
_INTRINSICS = ("camera_intrinsic.json", "intrinsic.json")


class Open3DConfig(PluginConfig):
    """Settings of `Open3D`."""

    intrinsics: Intrinsics | None = None
    depth_scale: DepthScale = 1.0
    trajectory: str | None = Field(None, description="the trajectory's file in the folder, where it has another name")


class Open3D(Plugin[Open3DConfig], Importer):
    """An RGB-D folder of Open3D's reconstruction system, or of Redwood: color/, depth/ and a trajectory.log.

    The log's poses are from camera to world (Choi et al., CVPR 2015); the first number of each says which image it is
    of. Intrinsics are read from camera_intrinsic.json or intrinsic.json where no setting gives them, the log from
    trajectory.log or scene/trajectory.log; `trajectory` names another file.
    """

    stage, name = "import kind", "open3d"

    def read(self, source: Path) -> Recording:
        colors = next((found for name in _COLORS if (found := by_number(source / name, PICTURES))), [])
        depths = by_number(source / "depth", DEPTHS)
        if not colors or len(colors) != len(depths):
            raise ToolkitError(
                f"'{source}' must hold as many pictures in {', '.join(f'{n}/' for n in _COLORS)} as in depth/; "
                f"it has {len(colors)} and {len(depths)}"
            )
        K = self._intrinsics(source)
        poses = _read_log(self._log(source))
        beyond = [index for index in poses if index >= len(colors)]
        if beyond:
            raise ToolkitError(f"'{self._log(source)}' has a pose of image {beyond[0]}, and there are {len(colors)}")
        shots = tuple(Shot(index, colors[index].name, poses[index]) for index in sorted(poses))
        left = len(colors) - len(shots)

        def load(chosen: Sequence[Shot]) -> list[Frame]:
            scale = self.config.depth_scale
            return [pinhole_frame(s, picture(colors[s.index]), depth_image(depths[s.index], scale), K) for s in chosen]

        return Recording(shots, load, notes=(f"{left} images have no pose in the log: left out",) if left else ())

    def _intrinsics(self, source: Path) -> Float:
        if self.config.intrinsics is not None:
            return matrix(self.config.intrinsics)
        found = next((source / name for name in _INTRINSICS if (source / name).is_file()), None)
        if found is None:
            raise ToolkitError(
                f"'{source}' holds no {' or '.join(_INTRINSICS)}; give --set \"intrinsics=FX FY CX CY\" "
                "(525 525 319.5 239.5 is what Redwood's PrimeSense recordings use)"
            )
        return open3d_intrinsics(found)

    def _log(self, source: Path) -> Path:
        names = _LOGS if self.config.trajectory is None else (self.config.trajectory,)
        found = next((source / name for name in names if (source / name).is_file()), None)
        if found is None:
            raise ToolkitError(f"'{source}' holds no {' or '.join(names)}; name it with --set trajectory=FILE")
        return found


def _read_log(path: Path) -> dict[int, Float]:
    """Poses (4, 4) T_world_camera by image: five lines each, `image image count` and the matrix."""
    lines = list(rows(path, (3, 4), "five lines per pose, `image image count` and a 4x4 matrix,"))
    poses: dict[int, Float] = {}
    for start in range(0, len(lines), 5):
        (where, head), *body = lines[start : start + 5]
        if [len(values) for _, values in body] != [4] * 4 or len(head) != 3:
            raise ToolkitError(f"{where}: a pose is five lines, `image image count` and a 4x4 matrix")
        index = int(numbers(head, where)[0])
        if index in poses or index < 0:
            raise ToolkitError(f"{where}: image {index} {'has two poses' if index in poses else 'is no image'}")
        poses[index] = rigid(np.array([numbers(values, at) for at, values in body]), where)
    if not poses:
        raise ToolkitError(f"'{path}' holds no pose")
    return poses
