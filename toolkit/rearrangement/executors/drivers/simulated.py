"""An arm in PyBullet as a driver: motors, friction and contacts on a bench."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from toolkit.rearrangement.drivers import Driver, Follow, Grip, JointState
from toolkit.sim.bench import STEP_S, Bench
from toolkit.types import Float, Frame

_GRIP_S, _PRESS_S, _SET_DOWN_S, _OPEN_S = 0.8, 0.3, 0.1, 0.5

_SQUEEZE = 0.25
"""How far beyond the contact the fingers are driven, as a part of their whole way."""


class Simulated(Driver):
    """The arm on a bench. A step of the simulation is the time that `advance` lets pass.

    Args:
        bench: the arm and what is around it.
        shoot: takes an RGB-D picture with a camera at a (4, 4) pose.

    Attributes:
        handled: the number of the object that is to be touched; contacts with all others are written down.
    """

    def __init__(self, bench: Bench, shoot: Callable[[Float], Frame]) -> None:
        self._bench = bench
        self._shoot = shoot
        self._doing: Iterator[None] = iter(())
        self.handled: int | None = None

    def state(self) -> JointState:
        robot = self._bench.robot
        holding = None if self.handled is None else self._bench.held(self.handled)
        return JointState(positions=robot.q, opening_m=robot.opening, holding=holding)

    def follow(self, request: Follow) -> None:
        self._doing = self._follow(request)

    def grip(self, request: Grip) -> None:
        self._doing = self._close(request) if request.holds else self._open(request)

    def advance(self) -> bool:
        return next(self._doing, self) is None

    def picture(self) -> Frame:
        return self._shoot(self._bench.robot.T_world_camera())

    def stop(self) -> None:
        """Hold still: nothing moves while no time passes, and then only to where the motors are told to be."""
        self._doing = iter(())
        self._bench.target = self._bench.robot.q

    def _follow(self, request: Follow) -> Iterator[None]:
        bench, handled = self._bench, self.handled if request.touching else None
        steps = max(1, int(np.ceil(request.trajectory.seconds / STEP_S)))
        for q, velocity in zip(*request.trajectory.at(STEP_S * np.arange(1, steps + 1)), strict=True):
            bench.step(q, velocity, request.phase, handled)
            yield
            if request.until_contact and handled is not None and bench.on_table(handled):
                break
        if request.until_contact:
            yield from self._hold(_SET_DOWN_S, request.phase)

    def _close(self, request: Grip) -> Iterator[None]:
        """Close until the fingers hold an object, then press."""
        bench = self._bench
        opened, closed = bench.robot.model.drive
        end = bench.robot.drive_for(request.opening_m)
        pace = (closed - opened) * STEP_S / _GRIP_S
        while not self._holds() and abs(bench.grip - end) > abs(pace):
            bench.grip += pace
            yield from self._hold(STEP_S, request.phase)
        bench.grip = bench.robot.drive + _SQUEEZE * (closed - opened)
        yield from self._hold(_PRESS_S, request.phase)

    def _open(self, request: Grip) -> Iterator[None]:
        bench = self._bench
        for drive in np.linspace(bench.grip, bench.robot.drive_for(request.opening_m), round(_OPEN_S / STEP_S)):
            bench.grip = float(drive)
            yield from self._hold(STEP_S, request.phase)

    def _hold(self, seconds: float, phase: str) -> Iterator[None]:
        """Keep the arm where it is to be."""
        for _ in range(round(seconds / STEP_S)):
            self._bench.wait(STEP_S, phase, self.handled)
            yield

    def _holds(self) -> bool:
        return self.handled is not None and self._bench.held(self.handled)
