"""The tree of frames that /tf and /tf_static describe."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import reduce
from typing import Any

import numpy as np

from toolkit.data.importing.ros_messages import pose_of, seconds
from toolkit.data.importing.trajectory import Trajectory
from toolkit.errors import ToolkitError, suggest
from toolkit.geometry import invert
from toolkit.types import Float

Pose = Callable[[float], Float | None]
"""(4, 4) T_world_body at a time in seconds; None where it is not known."""


class Tree:
    """Frames by name, each with its pose in its parent.

    Args:
        messages: tf2_msgs/TFMessage, each after whether it is of /tf_static.
    """

    def __init__(self, messages: Iterable[tuple[bool, Any]]) -> None:
        found: dict[str, list[tuple[float, Float]]] = {}
        self._parents: dict[str, str] = {}
        self._fixed: set[str] = set()
        for fixed, message in messages:
            for transform in message.transforms:
                child = transform.child_frame_id.lstrip("/")
                self._parents[child] = transform.header.frame_id.lstrip("/")
                self._fixed |= {child} if fixed else set()
                found.setdefault(child, []).append((seconds(transform.header.stamp), pose_of(transform)))
        self._poses = {child: Trajectory(*zip(*poses, strict=True)) for child, poses in found.items()}

    def pose(self, world: str, body: str, tolerance: float) -> Pose:
        """The pose of frame `body` in frame `world`.

        Raises:
            ToolkitError: a frame is unknown, or nothing connects them.
        """
        ups = {name: self._up(name.lstrip("/")) for name in (world, body)}
        if ups[world][-1] != ups[body][-1]:
            raise ToolkitError(f"/tf does not connect '{world}' and '{body}'")

        def at(stamp: float) -> Float | None:
            roots = [self._in_root(ups[name], stamp, tolerance) for name in (world, body)]
            return None if roots[0] is None or roots[1] is None else invert(roots[0]) @ roots[1]

        return at

    def _up(self, frame: str) -> list[str]:
        """The frame, its parent, and so on to the root."""
        if frame not in self._parents and frame not in self._parents.values():
            known = sorted({*self._parents, *self._parents.values()})
            raise ToolkitError(f"/tf has no frame '{frame}'{suggest(frame, known)}")
        way = [frame]
        while (parent := self._parents.get(way[-1])) is not None and parent not in way:
            way.append(parent)
        return way

    def _in_root(self, way: list[str], stamp: float, tolerance: float) -> Float | None:
        found = [self._poses[c].at(stamp, np.inf if c in self._fixed else tolerance) for c in way[:-1]]
        steps = [T for T in reversed(found) if T is not None]
        return reduce(np.matmul, steps, np.eye(4)) if len(steps) == len(found) else None
