"""Fused models as PLY files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from pydantic import Field

from toolkit.data.clouds import write_cloud
from toolkit.data.exporting.results import Exporter, Result, one_file_each
from toolkit.geometry import transform_points
from toolkit.registry import Plugin, PluginConfig
from toolkit.results.poses import matrix


class PlyConfig(PluginConfig):
    """Settings of `Ply`."""

    place: Literal["current", "goal"] = Field("current", description="where objects stand, or where their motions go")


class Ply(Plugin[PlyConfig], Exporter):
    """OUT/<instance>.ply: every object's coloured points in metres and world coordinates.

    With `place: goal`, OUT/<goal object>.ply: those objects that have a motion, where it takes them.
    """

    stage, name = "export kind", "ply"

    def write(self, results: Sequence[Result], out: Path) -> list[str]:
        for result, folder in one_file_each(results, out, ""):
            folder.mkdir(parents=True, exist_ok=True)
            if self.config.place == "current":
                for instance in result.poses.instances:
                    write_cloud(folder / f"{instance.instance:06d}.ply", *result.cloud(instance))
                continue
            for entry in result.poses.objects:
                instance = result.poses.instance(entry.instance)
                if instance is not None and entry.T_goal_current is not None:
                    points, colors = result.cloud(instance)
                    moved = transform_points(matrix(entry.T_goal_current), points)
                    write_cloud(folder / f"{entry.goal_object:06d}.ply", moved, colors)
        return []
