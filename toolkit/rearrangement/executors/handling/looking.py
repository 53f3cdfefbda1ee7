"""What the camera in the hand says of an object: how it lies between the fingers, and how it came to stand."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import KDTree

from toolkit.geometry import invert, lift, transform_points
from toolkit.rearrangement.drivers import Driver, DriverError, JointState
from toolkit.rearrangement.executors.handling.align import REACH_M, Aligned, align
from toolkit.rearrangement.executors.handling.mover import Eye
from toolkit.rearrangement.executors.handling.reach import Reach
from toolkit.rearrangement.moves import PickPlace
from toolkit.rearrangement.plans import Way
from toolkit.sim.robot import Robot
from toolkit.types import Failure, Float, Frame

_STEP_PX = 2
_TABLE_M = 0.005
"""What is seen lower than this above the table may be the table."""

_PAD_M, _AROUND_M, _OUTWARD_M = 0.001, 0.006, 0.03
"""A gripper is larger than its measures: into what it holds, around its fingers, and outward, where its linkage is."""


@dataclass
class Look(Eye):
    """Takes one picture with depth at a time; the same for every driver.

    The picture is compared with what was seen of the object before it was taken, from where it is expected on; see
    `align`. The gripper itself, the table, and what is nearer to other things than to the object are left out of it.

    Args:
        driver: the robot.
        robot: whose description is read; it is not moved.
        request: the move.
        reach: plans ways among what was seen.

    Attributes:
        last: what the last picture said, with how sure it is.
    """

    driver: Driver
    robot: Robot
    request: PickPlace
    reach: Reach
    last: Aligned | Failure | None = field(default=None, init=False)

    def expected(self) -> Float:
        return invert(self._hand(self._state()))

    def in_hand(self, expected: Float) -> Float | Failure:
        hand = self._hand(self._state())
        seen = self._find(hand @ expected)
        return seen if isinstance(seen, Failure) else invert(hand) @ seen

    def adapted(self, way: Way, in_hand: Float) -> Way | Failure:
        return self.reach.adapted(way, in_hand, self.request.T_place_pick)

    def placed(self, expected: Float) -> Float | Failure:
        return self._find(expected)

    def _find(self, expected: Float) -> Float | Failure:
        """(4, 4) motion of the object from where it was seen first, near the one that is expected."""
        frame, state = self.driver.picture(), self._state()
        points = transform_points(expected, self.request.points)
        seen = self._without_gripper(_around(points, frame), state)
        if len(self.request.others):
            own, _ = KDTree(points).query(seen)
            others, _ = KDTree(self.request.others).query(seen)
            seen = seen[own < others]
        self.last = align(points, seen, frame.camera.T_world_camera[:3, 3])
        return self.last if isinstance(self.last, Failure) else self.last.T @ expected

    def _without_gripper(self, points: Float, state: JointState) -> Float:
        """Those of (N, 3) points that lie outside of fingers and palm."""
        gripper, half = self.robot.model.gripper, state.opening_m / 2
        T_world_gripper = self._hand(state) @ self.robot.T_hand_tips(state.opening_m)
        x, y, z = transform_points(invert(T_world_gripper), points).T
        x, y = np.abs(x), np.abs(y)
        thickness, width, length = gripper.finger_m
        finger = (x > half - _PAD_M) & (x < half + thickness + _OUTWARD_M) & (y < width / 2 + _AROUND_M)
        palm = (x < gripper.palm_m[0] / 2 + _AROUND_M) & (y < gripper.palm_m[1] / 2 + _AROUND_M) & (z < -length)
        return points[~((finger & (z < _AROUND_M)) | palm)]

    def _hand(self, state: JointState) -> Float:
        """(4, 4) pose of the hand in the world."""
        return self.robot.chain.end(state.positions)

    def _state(self) -> JointState:
        state = self.driver.state()
        if state is None:
            raise DriverError("looking: no state of the robot comes; look whether it is connected")
        return state


def _around(points: Float, frame: Frame) -> Float:
    """(M, 3) what a picture shows around (N, 3) points, above the table; world coordinates."""
    if frame.depth is None:
        raise DriverError("looking: the camera's picture has no depth")
    y, x = (part * _STEP_PX for part in np.nonzero(frame.depth[::_STEP_PX, ::_STEP_PX]))
    camera = frame.camera
    seen = lift(camera.K, camera.T_world_camera, np.stack([x, y], axis=1).astype(np.float64), frame.depth[y, x])
    low, high = points.min(axis=0) - REACH_M, points.max(axis=0) + REACH_M
    return seen[((seen > low) & (seen < high)).all(axis=1) & (seen[:, 2] > _TABLE_M)]
