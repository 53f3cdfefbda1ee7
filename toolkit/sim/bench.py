"""A table with objects and an arm in a PyBullet client with gravity, friction and contacts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from toolkit.geometry import make_transform
from toolkit.sim.bullet import silence
from toolkit.sim.client import BASE, EVERYTHING, Client, Contact
from toolkit.sim.compound import add_compound, mass_center
from toolkit.sim.robot import Robot
from toolkit.sim.robots import RobotModel
from toolkit.types import Float

STEP_S = 1 / 240
_FRICTION, _TABLE_FRICTION = 0.8, 0.6
_ROLLING = 0.0005
_ROBOT = 64
"""The robot's own collision group, so that rays can look past it."""

_BREAKS_M = 0.002
"""Contact points are kept until they are this far apart. With PyBullet's 2 cm, objects hang on opened fingers."""

_PRESSES_N = 0.1
"""A contact with less force is none to count on."""


@dataclass(frozen=True)
class Touch:
    """A contact that no move is meant to have.

    Attributes:
        phase: what was being done.
        what: `the arm` or `object 3`.
        other: `the table`, `object 2`.
        newtons: the contact's force.
    """

    phase: str
    what: str
    other: str
    newtons: float


class Bench:
    """What really happens; close it after use.

    Args:
        model: the robot.
        T_world_base: (4, 4) where it stands.
        bodies: by object, its convex meshes and its mass in kilograms.
        poses: (4, 4) where the objects stand.
    """

    def __init__(
        self,
        model: RobotModel,
        T_world_base: Float,
        bodies: Sequence[tuple[Sequence[Path], float]],
        poses: Sequence[Float],
    ) -> None:
        self.client = Client()
        self.client.setGravity(0, 0, -9.81)
        self.client.setPhysicsEngineParameter(
            fixedTimeStep=STEP_S,
            numSolverIterations=150,
            deterministicOverlappingPairs=1,
            contactBreakingThreshold=_BREAKS_M,
        )
        self._table = self.client.add_plane()
        self.client.changeDynamics(self._table, BASE, lateralFriction=_TABLE_FRICTION)
        self.robot = Robot(self.client, model, T_world_base)
        for link in self.robot.links:
            self.client.setCollisionFilterGroupMask(self.robot.body, link, _ROBOT, EVERYTHING)
        for link in self.robot.base_links:
            self.client.ignore(self.robot.body, self._table, link)
        self._centers = [mass_center(hulls) for hulls, _ in bodies]
        with silence():
            self._bodies = [
                self._add(hulls, mass, center, T)
                for (hulls, mass), center, T in zip(bodies, self._centers, poses, strict=True)
            ]
        self.target = self.robot.q
        self.grip = model.drive[0]
        self.touches: list[Touch] = []
        self.seconds = 0.0
        self.on_step: Callable[[], None] | None = None

    def close(self) -> None:
        """Disconnect the client."""
        self.client.close()

    def _add(self, hulls: Sequence[Path], mass: float, center: Float, T: Float) -> int:
        """Body of an object at a (4, 4) pose; (3,) `center` is its centre of mass in its own coordinates."""
        shape = add_compound(self.client, hulls)
        body = int(self.client.createMultiBody(mass, shape, baseInertialFramePosition=center.tolist()))
        self.client.changeDynamics(
            body, BASE, lateralFriction=_FRICTION, spinningFriction=0.005, rollingFriction=_ROLLING
        )
        self.client.place(body, make_transform(T[:3, :3], T[:3, :3] @ center + T[:3, 3]))
        return body

    def pose(self, number: int) -> Float:
        """(4, 4) where an object is now."""
        T = self.client.pose(self._bodies[number])
        return make_transform(T[:3, :3], T[:3, 3] - T[:3, :3] @ self._centers[number])

    def poses(self) -> list[Float]:
        """Where all objects are now."""
        return [self.pose(number) for number in range(len(self._bodies))]

    def under(self, points: Float) -> int | None:
        """The object that vertical rays through most of (N, 3) points meet first; None where they meet none.

        The arm is no obstacle to them.
        """
        return self.client.under(points, self._bodies, EVERYTHING ^ _ROBOT)

    def wait(self, seconds: float, phase: str, allowed: int | None) -> None:
        """Let time pass; the arm holds still and the gripper its drive value."""
        for _ in range(round(seconds / STEP_S)):
            self.step(self.target, np.zeros(len(self.target)), phase, allowed)

    def step(self, q: Float, velocity: Float, phase: str, allowed: int | None) -> None:
        """One step of time; object `allowed` may be touched by the arm, and touch the table."""
        self.target = q
        self.robot.follow(q, velocity)
        self.robot.squeeze(self.grip)
        self.client.stepSimulation()
        self.seconds += STEP_S
        self._log(phase, allowed)
        if self.on_step is not None:
            self.on_step()

    def on_table(self, number: int) -> bool:
        """Say whether an object presses on the table."""
        return _presses(self.client.contacts(self._bodies[number], self._table))

    def held(self, number: int) -> bool:
        """Say whether both fingertips press on an object."""
        body = self._bodies[number]
        return all(_presses(self.client.contacts(self.robot.body, body, link=tip)) for tip in self.robot.tips)

    def _log(self, phase: str, allowed: int | None) -> None:
        mine = None if allowed is None else self._bodies[allowed]
        self._log_contacts(phase, "the arm", self.robot.body, but={mine, self.robot.body})
        if mine is not None:
            self._log_contacts(phase, f"object {allowed}", mine, but={self.robot.body, self._table})

    def _log_contacts(self, phase: str, what: str, body: int, but: set[int | None]) -> None:
        for contact in self.client.contacts(body):
            if contact.force > 0 and contact.other not in but:
                self.touches.append(Touch(phase, what, self._name(contact.other), contact.force))

    def _name(self, body: int) -> str:
        return "the table" if body == self._table else f"object {self._bodies.index(body)}"


def _presses(contacts: Sequence[Contact]) -> bool:
    return sum(contact.force for contact in contacts) > _PRESSES_N
