"""Carries ways out: a driver follows trajectories, opens and closes, and what becomes of the object is watched."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Protocol

import numpy as np

from toolkit.geometry import invert, rotation_angle, transform_points
from toolkit.rearrangement.drivers import Driver, Follow, Grip, JointState, perform
from toolkit.rearrangement.plans import ArmPlan, PlannedMove, Way
from toolkit.rearrangement.trajectories import Limits, Trajectory
from toolkit.types import Failure, Float

_GIVES_M, _GIVES_DEG = 0.02, 10.0
"""What moves further than this in the gripper while it is lifted is put back, before it is lost."""


class Eye(Protocol):
    """Sees how an object lies in the hand and where it was put, and what that means for its way.

    How it lies in the hand is (4, 4) what takes its points, in the world where they were seen before the move, into the
    hand's frame.
    """

    @abstractmethod
    def expected(self) -> Float:
        """How the object is taken to lie in the hand, now that the fingers have closed."""
        ...

    @abstractmethod
    def in_hand(self, expected: Float) -> Float | Failure:
        """How it lies there now; a Failure where that cannot be seen."""
        ...

    @abstractmethod
    def adapted(self, way: Way, in_hand: Float) -> Way | Failure:
        """A way that was carried out up to its lift, with a second half for how the object lies in the hand."""
        ...

    @abstractmethod
    def placed(self, expected: Float) -> Float | Failure:
        """(4, 4) motion that the object has had, now that the hand has left; a Failure where that cannot be seen."""
        ...


class Mover:
    """Moves objects with a robot.

    Args:
        driver: the robot.
        limits: what it is not to exceed.
        wide_m: how far its gripper opens.
    """

    def __init__(self, driver: Driver, limits: Limits, wide_m: float) -> None:
        self._driver = driver
        self._limits = limits
        self._wide_m = wide_m

    def carry_out(self, way: Way, eye: Eye | None = None) -> Failure | None:
        """Carry a way out.

        Args:
            way: what to do.
            eye: sees the object; without one, and where it sees too little, it is taken to lie in the hand as planned.

        Returns:
            Why the object was not put down at the way's end; None where it was, wherever it then lies.

        Raises:
            DriverError: the robot does not do what it is told. It has been stopped.
        """
        self._grip(way.opening_m, "opening")
        self.follow(way.to_grasp, "going to the grasp", touching=False)
        self.follow(way.approach, "approaching")
        self.close()
        expected = eye.expected() if eye else np.eye(4)
        lifted = self.follow(way.lift, "lifting")
        adapted = _lost("slipped in") if lifted.holding is False else _adapted(way, eye, expected)
        if isinstance(adapted, Failure):
            self._put_back(way)
            return adapted
        way = adapted
        if self.follow(way.transfer, "carrying").holding is False:
            self._let_go(way)
            return Failure("executor", "the object slipped out of the gripper while it was carried")
        self._set_down(way.lower, "lowering", way, way.retreat)
        return None

    def follow(self, trajectory: Trajectory, phase: str, *, touching: bool = True) -> JointState:
        """Follow a trajectory to its end; the hand may touch what it is to take, unless told otherwise."""
        return self._perform(Follow(trajectory=trajectory, phase=phase, touching=touching))

    def close(self) -> None:
        """Close until the fingers hold something, and go on pressing."""
        self._grip(0.0, "grasping", holds=True)

    def _set_down(self, lower: Trajectory, phase: str, way: Way, retreat: Trajectory) -> None:
        """Lower an object until it stands, let go of it, and leave."""
        follow = Follow(trajectory=lower, phase=phase, touching=True, until_contact=True)
        stands = self._perform(follow).positions
        self._let_go(way)
        self.follow(retreat.from_where(stands, self._limits), "retreating")

    def _put_back(self, way: Way) -> None:
        """Set down what was lifted, where it came from."""
        self._set_down(way.lift.reversed(), "putting back", way, way.approach.reversed())

    def _let_go(self, way: Way) -> None:
        """Open as far as there is room for; what has turned and sticks between the fingers, as far as it takes."""
        if self._grip(way.opening_m, "releasing").holding:
            self._grip(self._wide_m, "releasing")

    def _grip(self, opening_m: float, phase: str, *, holds: bool = False) -> JointState:
        return self._perform(Grip(opening_m=opening_m, phase=phase, effort=self._limits.effort, holds=holds))

    def _perform(self, request: Follow | Grip) -> JointState:
        return perform(self._driver, request, self._limits)


def carry_out_plan(
    plan: ArmPlan, driver: Driver, on_move: Callable[[PlannedMove], None] | None = None
) -> Failure | None:
    """Carry a whole plan out, up to the first move that fails.

    Args:
        plan: what to do; the arm is at its start.
        driver: the robot.
        on_move: told of every move before it begins.

    Returns:
        Why a move failed; None where all went as planned.

    Raises:
        DriverError: the robot does not do what it is told. It has been stopped.
    """
    mover = Mover(driver, plan.robot.limits, plan.robot.opens_m)
    for move in plan.moves:
        if on_move is not None:
            on_move(move)
        failure = mover.carry_out(move.way)
        if failure is not None:
            return failure
    if plan.to_home is not None:
        mover.follow(plan.to_home, "going home", touching=False)
    return None


def _adapted(way: Way, eye: Eye | None, expected: Float) -> Way | Failure:
    """A way carried out up to its lift, for how the object now lies in the hand, and was (4, 4) expected to."""
    now = eye.in_hand(expected) if eye else expected
    if eye is None or isinstance(now, Failure):
        return way
    moved = now @ invert(expected)
    held = transform_points(expected, way.T_world_gripper[:3, 3])
    if np.linalg.norm(transform_points(moved, held) - held) > _GIVES_M:
        return _lost("slipped in")
    return _lost("turned in") if np.degrees(rotation_angle(moved[:3, :3])) > _GIVES_DEG else eye.adapted(way, now)


def _lost(what: str) -> Failure:
    return Failure("executor", f"the object {what} the gripper while it was lifted")
