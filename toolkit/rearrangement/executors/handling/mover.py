"""Carries ways out: motors follow paths, fingers close and open, and what becomes of the object is watched."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from toolkit.geometry import invert, rotation_angle
from toolkit.rearrangement.executors.handling.reach import Reach
from toolkit.rearrangement.executors.handling.way import Way
from toolkit.sim.bench import STEP_S, Bench
from toolkit.types import Failure, Float

_GRIP_S, _PRESS_S, _SET_DOWN_S, _RELEASE_S, _REST_S = 0.8, 0.3, 0.1, 0.5, 0.5
_RAMP_S = 0.2
_GIVES_M, _GIVES_DEG = 0.02, 10.0
"""What moves further than this in the gripper while it is lifted is put back, before it is lost."""

_SQUEEZE = 0.25
"""How far beyond the contact the fingers are driven, as a part of their whole way."""


class Mover:
    """Moves objects on a bench.

    Args:
        bench: the arm and what is around it.
        joint_speed: speed of the fastest joint in free motion, rad/s.
        line_speed: speed of the fastest joint near objects, rad/s.
    """

    def __init__(self, bench: Bench, joint_speed: float, line_speed: float) -> None:
        self._bench = bench
        self._fast, self._slow = joint_speed, line_speed

    def carry_out(self, way: Way, number: int, wanted: Float, reach: Reach) -> Failure | None:
        """Carry a way out.

        Args:
            way: whose second half is planned anew once it is seen how the object lies in the hand.
            number: the object.
            wanted: (4, 4) motion from where it is to where it is to be put down.
            reach: what planned the way.

        Returns:
            Why the object was not put down at the way's end; None where it was, wherever it then lies.
        """
        bench = self._bench
        T_object_seen = invert(bench.pose(number))
        bench.grip = bench.robot.drive_for(way.grasp.opening)
        self._follow(way.to_grasp, self._fast, "going to the grasp", None)
        self._follow(way.approach, self._slow, "approaching", number)
        self.close_on(number)
        in_hand = self._in_hand(number)
        self._follow(way.lift, self._slow, "lifting", number)
        if lost := self._lost(number, in_hand):
            self._put_back(way, number)
            return Failure("executor", f"the object {lost} the gripper while it was lifted")
        adapted = reach.adapted(way, self._in_hand(number) @ T_object_seen, wanted)
        if isinstance(adapted, Failure):
            self._put_back(way, number)
            return adapted
        way = adapted
        self._follow(way.transfer, self._fast, "carrying", number)
        if not bench.held(number):
            self._let_go(way, way.lower[0], number)
            return Failure("executor", "the object slipped out of the gripper while it was carried")
        self._follow(way.lower, self._slow, "lowering", number, until=lambda: bench.on_table(number))
        bench.wait(_SET_DOWN_S, "lowering", number)
        self._let_go(way, bench.target, number)
        self._follow(np.concatenate([bench.target[None], way.retreat[1:]]), self._slow, "retreating", number)
        bench.wait(_REST_S, "resting", number)
        return None

    def go_home(self, path: Float) -> None:
        """Follow an (N, J) free path with nothing in the hand."""
        self._follow(path, self._fast, "going home", None)

    def back_off(self, path: Float, number: int | None) -> None:
        """Follow an (N, J) path out of a contact, which may be with object `number`."""
        if len(path) > 1:
            self._follow(path, self._slow, "backing off", number)

    def close_on(self, number: int) -> None:
        """Close until the fingers hold an object, then press."""
        bench = self._bench
        opened, closed = bench.robot.model.drive
        pace = (closed - opened) * STEP_S / _GRIP_S
        while not bench.held(number) and abs(bench.grip - closed) > abs(pace):
            bench.grip += pace
            bench.wait(STEP_S, "grasping", number)
        bench.grip = bench.robot.drive + _SQUEEZE * (closed - opened)
        bench.wait(_PRESS_S, "grasping", number)

    def _put_back(self, way: Way, number: int) -> None:
        """Set down what was lifted, where it came from."""
        bench = self._bench
        self._follow(way.lift[::-1], self._slow, "putting back", number, lambda: bench.on_table(number))
        self._let_go(way, bench.target, number)
        back = np.concatenate([bench.target[None], way.approach[::-1]])
        self._follow(back, self._slow, "retreating", number)

    def _let_go(self, way: Way, q: Float, number: int) -> None:
        """Open as far as there is room for; what has turned and sticks between the fingers, as far as it takes."""
        self._open(self._bench.robot.drive_for(way.grasp.opening), q, number)
        if self._bench.held(number):
            self._open(self._bench.robot.model.drive[0], q, number)

    def _open(self, drive: float, q: Float, number: int) -> None:
        start = self._bench.grip
        for part in np.linspace(0, 1, round(_RELEASE_S / STEP_S)):
            self._bench.grip = (1 - part) * start + part * drive
            self._bench.step(q, np.zeros(len(q)), "releasing", number)

    def _lost(self, number: int, in_hand: Float) -> str | None:
        """What has become of the hold on an object, which was at a (4, 4) pose in the hand; None if nothing."""
        now = self._in_hand(number)
        if not self._bench.held(number) or np.linalg.norm(now[:3, 3] - in_hand[:3, 3]) > _GIVES_M:
            return "slipped in"
        turned = np.degrees(rotation_angle(now[:3, :3] @ in_hand[:3, :3].T))
        return "turned in" if turned > _GIVES_DEG else None

    def _in_hand(self, number: int) -> Float:
        """(4, 4) an object's pose in the hand's frame."""
        return invert(self._bench.robot.T_world_hand()) @ self._bench.pose(number)

    def _follow(
        self,
        path: Float,
        speed: float,
        phase: str,
        allowed: int | None,
        until: Callable[[], bool] | None = None,
    ) -> None:
        """Drive along an (N, J) path, the fastest joint at `speed` rad/s, with a soft start and end."""
        ramp_s = max(_RAMP_S, speed / self._bench.robot.model.file.acceleration)
        for q, velocity in zip(*_timed(path, speed, ramp_s), strict=True):
            self._bench.step(q, velocity, phase, allowed)
            if until is not None and until():
                break


def _timed(path: Float, speed: float, ramp_s: float) -> tuple[Float, Float]:
    """(T, J) targets and (T, J) velocities along an (N, J) path, one per step of the bench."""
    turned = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(path, axis=0)).max(axis=1))])
    keep = np.concatenate([[True], np.diff(turned) > 1e-9])
    path, turned = path[keep], turned[keep]
    seconds = turned[-1] / speed + ramp_s
    count = max(2, round(seconds / STEP_S))
    times = np.linspace(0, seconds, count + 1)[1:]
    ramped = _ramp(times, ramp_s) - _ramp(times - (seconds - ramp_s), ramp_s)
    along = turned[-1] * ramped / ramped[-1] if turned[-1] > 0 else np.zeros(count)
    targets = np.stack([np.interp(along, turned, column) for column in path.T], axis=1)
    return targets, np.gradient(targets, STEP_S, axis=0)


def _ramp(t: Float, ramp_s: float) -> Float:
    """How far one has come at unit speed, which is reached evenly over the ramp's time."""
    t = np.maximum(t, 0)
    return np.where(t < ramp_s, t * t / (2 * ramp_s), t - ramp_s / 2)
