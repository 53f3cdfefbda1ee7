"""Poses over time, and the pose at the time of an image."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from toolkit.data.importing.folders import numbers, rows
from toolkit.data.importing.settings import pose
from toolkit.errors import ToolkitError
from toolkit.geometry import make_transform
from toolkit.types import Float


class Trajectory:
    """Poses of one body in one world.

    Args:
        stamps: N times in seconds, in any order.
        poses: (N, 4, 4) T_world_body, metres.
    """

    def __init__(self, stamps: Sequence[float], poses: Sequence[Float]) -> None:
        order = np.argsort(np.asarray(stamps, np.float64), kind="stable")
        self._stamps: list[float] = np.asarray(stamps, np.float64)[order].tolist()
        self._poses = np.asarray(poses, np.float64).reshape(-1, 4, 4)[order]

    def at(self, stamp: float, tolerance: float) -> Float | None:
        """(4, 4) T_world_body at a time, between the poses before and after it.

        Returns:
            None where no pose is within `tolerance` seconds.
        """
        if nearest(self._stamps, stamp, tolerance) is None:
            return None
        after = bisect_left(self._stamps, stamp)
        if after == len(self._stamps) or after == 0 or self._stamps[after] == stamp:
            return self._poses[min(after, len(self._stamps) - 1)]
        before = after - 1
        share = (stamp - self._stamps[before]) / (self._stamps[after] - self._stamps[before])
        return _between(self._poses[before], self._poses[after], share)


def nearest(stamps: Sequence[float], stamp: float, tolerance: float) -> int | None:
    """Index of the nearest of sorted `stamps` within `tolerance` seconds, or None."""
    after = bisect_left(stamps, stamp)
    near = [i for i in (after - 1, after) if 0 <= i < len(stamps) and abs(stamps[i] - stamp) <= tolerance]
    return min(near, key=lambda i: abs(stamps[i] - stamp)) if near else None


def without_pose(count: int, tolerance: float, what: str = "images") -> tuple[str, ...]:
    """The note that so many have no pose near enough in time; none where all have one."""
    return (f"{count} {what} have no pose within {tolerance:g} s: left out",) if count else ()


def read_trajectory(path: Path) -> Trajectory:
    """Read `time x y z qx qy qz qw` lines, as the TUM RGB-D benchmark writes them.

    Raises:
        ToolkitError: it cannot be read, a line is not as said, or there is none.
    """
    stamps: list[float] = []
    poses: list[Float] = []
    for where, values in rows(path, (8,), "a line `time x y z qx qy qz qw` per pose"):
        stamp, *numbered = numbers(values, where)
        stamps.append(stamp)
        poses.append(pose(tuple(numbered), where))
    if not poses:
        raise ToolkitError(f"'{path}' holds no pose; a line each is `time x y z qx qy qz qw`")
    return Trajectory(stamps, poses)


def _between(a: Float, b: Float, share: float) -> Float:
    turn = Slerp([0, 1], Rotation.from_matrix(np.stack([a[:3, :3], b[:3, :3]])))(share)
    return make_transform(turn.as_matrix(), (1 - share) * a[:3, 3] + share * b[:3, 3])
