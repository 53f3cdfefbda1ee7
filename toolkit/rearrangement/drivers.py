"""What an arm is asked to do, and the one loop that asks: every motion is watched, and a robot that is lost is stopped.

An executor, a plan and a dry run talk to a `Driver`; simulator, recording and hardware are each one.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Protocol

import numpy as np

from toolkit.errors import ToolkitError
from toolkit.rearrangement.trajectories import Limits, Part, Row, Trajectory
from toolkit.types import Frame

_OFF_RAD = 0.05
"""An arm that ends this far from where it was to be has met something, or its motors gave in."""

_START_RAD = 0.1
"""An arm is led to the start of a motion from this far away at most."""


class DriverError(ToolkitError):
    """A robot that does not answer, answers late, or is not where it was sent. It has been stopped."""


class JointState(Part):
    """What a robot says of itself."""

    positions: Row
    """(J,) the arm's joint angles, radians."""
    opening_m: float
    """Distance of the fingers."""
    holding: bool | None
    """Whether both fingers press on something; null where the gripper cannot tell."""
    age_s: float = 0.0
    """How long ago that was."""


class Follow(Part):
    """Follow a timed trajectory."""

    trajectory: Trajectory
    phase: str
    """What for, as in: while ..."""
    touching: bool = False
    """Whether the hand may touch what it is to take, or has let go."""
    until_contact: bool = False
    """What is carried may meet the table before the end; a robot that feels that stops there."""


class Grip(Part):
    """Open or close the gripper."""

    opening_m: float
    """Distance of the fingers to go to."""
    phase: str
    """What for, as in: while ..."""
    effort: float
    """Largest force (N) or torque (Nm) of a joint that is driven."""
    holds: bool = False
    """Close on an object, and go on pressing."""


class Driver(Protocol):
    """A robot. `follow` and `grip` begin something and return at once; it goes on as `advance` is called.

    Every method may raise DriverError, with a sentence that says what has become of the robot.
    """

    @abstractmethod
    def state(self) -> JointState | None:
        """The latest state; None where none has come."""
        ...

    @abstractmethod
    def follow(self, request: Follow) -> None:
        """Begin to follow a trajectory, which starts where the arm is."""
        ...

    @abstractmethod
    def grip(self, request: Grip) -> None:
        """Begin to open or close."""
        ...

    @abstractmethod
    def advance(self) -> bool:
        """Let a short time pass, if only to hear of the robot; say whether what was begun goes on."""
        ...

    @abstractmethod
    def picture(self) -> Frame:
        """Take an RGB-D picture with the arm's camera, posed in the robot's world."""
        ...

    @abstractmethod
    def stop(self) -> None:
        """Stop where the arm is, at once. The gripper keeps what it holds."""
        ...


def perform(driver: Driver, request: Follow | Grip, limits: Limits) -> JointState:
    """Have a request carried out, and watch it to its end.

    Whatever ends that early, a robot that is lost, Ctrl-C or a mistake, stops the robot first.

    Args:
        driver: the robot.
        request: what to do. A trajectory that starts a little beside the arm is led to from where the arm is.
        limits: of the robot.

    Returns:
        The state that it ended in.

    Raises:
        DriverError: the request asks for more than the limits, the robot is not at the trajectory's start or does not
            come to its end, or its state is lost or late.
    """
    phase = request.phase
    driver.advance()  # so that the state is one of now
    before = _fresh(driver, phase, limits)
    if isinstance(request, Follow):
        request = _from_here(request, before, limits)
    elif request.effort > limits.effort:
        raise DriverError(f"{phase}: the gripper is asked for {request.effort:g}, and its limit is {limits.effort:g}")
    try:
        if isinstance(request, Follow):
            driver.follow(request)
        else:
            driver.grip(request)
        while driver.advance():
            _fresh(driver, phase, limits)
        after = _fresh(driver, phase, limits)
        if isinstance(request, Follow) and not request.until_contact:
            off = float(np.abs(after.positions - request.trajectory.end).max())
            if off > _OFF_RAD:
                raise DriverError(f"{phase}: the arm ended {off:.2f} rad from where it was sent; look what it has met")
    except BaseException:
        driver.stop()
        raise
    return after


def _from_here(request: Follow, before: JointState, limits: Limits) -> Follow:
    away = float(np.abs(request.trajectory.start - before.positions).max())
    if away > _START_RAD:
        raise DriverError(
            f"{request.phase}: the arm is {away:.2f} rad from where this motion starts; bring it there, or plan anew"
        )
    if request.trajectory.too_fast(limits):
        raise DriverError(f"{request.phase}: the motion is faster than the robot's limit of {limits.speed:g} rad/s")
    return request.model_copy(update={"trajectory": request.trajectory.from_where(before.positions, limits)})


def _fresh(driver: Driver, phase: str, limits: Limits) -> JointState:
    state = driver.state()
    if state is None:
        raise DriverError(f"{phase}: no state of the robot comes, so it is stopped; look whether it is connected")
    if state.age_s > limits.late_s:
        raise DriverError(
            f"{phase}: the robot's last state is {state.age_s:.1f} s old, so it is stopped; look at its connection"
        )
    return state
