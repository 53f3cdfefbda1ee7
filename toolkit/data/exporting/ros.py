"""Poses as JSON that reads like geometry_msgs/PoseStamped."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import Field
from scipy.spatial.transform import Rotation

from toolkit.data.exporting.results import Exporter, Result, one_file_each
from toolkit.files import write_json
from toolkit.registry import Plugin, PluginConfig
from toolkit.results.poses import GoalObject, matrix
from toolkit.types import Float


class RosConfig(PluginConfig):
    """Settings of `Ros`."""

    frame: str = Field("world", description="frame_id of the capture's world, such as the robot's base")


class Ros(Plugin[RosConfig], Exporter):
    """OUT.json: for every goal object, where its box is now and where it goes, as PoseStamped; null without a motion.

    Fields and their nesting are those of geometry_msgs/PoseStamped, in metres, so that
    `rosidl_runtime_py.set_message_fields` fills messages from it. The stamp is 0: captures have no times.
    """

    stage, name = "export kind", "ros"

    def write(self, results: Sequence[Result], out: Path) -> list[str]:
        for result, path in one_file_each(results, out, ".json"):
            path.parent.mkdir(parents=True, exist_ok=True)
            objects = [self._object(result, entry) for entry in result.poses.objects]
            write_json(path, {"capture": result.poses.capture, "objects": objects})
        return []

    def _object(self, result: Result, entry: GoalObject) -> dict[str, Any]:
        instance = result.poses.instance(entry.instance)
        now = None if instance is None else matrix(instance.T_world_box)
        then = None if now is None or entry.T_goal_current is None else matrix(entry.T_goal_current) @ now
        return {
            "goal_object": entry.goal_object,
            "instance": entry.instance,
            "confidence": entry.confidence,
            "status": entry.status,
            "reason": entry.reason,
            "size": None if instance is None else dict(zip("xyz", instance.size, strict=True)),
            "current": None if now is None else self._stamped(now),
            "goal": None if then is None else self._stamped(then),
        }

    def _stamped(self, T: Float) -> dict[str, Any]:
        turn = Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True)
        return {
            "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": self.config.frame},
            "pose": {
                "position": dict(zip("xyz", T[:3, 3].tolist(), strict=True)),
                "orientation": dict(zip("xyzw", turn.tolist(), strict=True)),
            },
        }
