"""TUM RGB-D benchmark folders: rgb.txt, depth.txt, groundtruth.txt."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pydantic import Field

from toolkit.data.importing.folders import TOLERANCE_S, depth_image, numbers, picture, rows
from toolkit.data.importing.recording import Importer, Recording, Shot, pinhole_frame
from toolkit.data.importing.settings import DepthScale, Distortion, Intrinsics, matrix
from toolkit.data.importing.trajectory import nearest, read_trajectory, without_pose
from toolkit.errors import ToolkitError
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Frame


class TumConfig(PluginConfig):
    """Settings of `Tum`."""

    intrinsics: Intrinsics
    distortion: Distortion = ()
    depth_scale: DepthScale = 0.2
    tolerance: float = Field(TOLERANCE_S, gt=0, description="seconds that stamps may lie apart")


class Tum(Plugin[TumConfig], Importer):
    """The layout of the TUM RGB-D benchmark (Sturm et al., IROS 2012): stamped lists of images, poses in metres.

    Colour images without depth or pose within the tolerance are left out; poses are interpolated. Depth has 5000 units
    per metre unless `depth_scale` says otherwise.
    """

    stage, name = "import kind", "tum"

    def read(self, source: Path) -> Recording:
        colors, depths = (_stamped(source / name) for name in ("rgb.txt", "depth.txt"))
        trajectory = read_trajectory(source / "groundtruth.txt")
        stamps, tolerance = [stamp for stamp, _ in depths], self.config.tolerance
        shots: list[Shot] = []
        files: dict[int, Path] = {}
        for index, (stamp, name) in enumerate(colors):
            near, pose = nearest(stamps, stamp, tolerance), trajectory.at(stamp, tolerance)
            if pose is not None:
                shots.append(Shot(index, name, pose, has_depth=near is not None))
                files |= {} if near is None else {index: source / depths[near][1]}
        left = len(colors) - len(shots)
        if not shots:
            raise ToolkitError(
                f"'{source}': no image of rgb.txt has a pose within {tolerance:g} s; are both stamped by one clock?"
            )

        def load(chosen: Sequence[Shot]) -> list[Frame]:
            K, scale = matrix(self.config.intrinsics), self.config.depth_scale
            depth = {s.index: depth_image(files[s.index], scale) if s.index in files else None for s in chosen}
            return [
                pinhole_frame(s, picture(source / s.name), depth[s.index], K, self.config.distortion) for s in chosen
            ]

        return Recording(tuple(shots), load, notes=without_pose(left, tolerance))


def _stamped(path: Path) -> list[tuple[float, str]]:
    found = [
        (numbers(values[:1], where)[0], values[1]) for where, values in rows(path, (2,), "a line `time file` per image")
    ]
    return sorted(found)
