"""A table with objects and an arm in a PyBullet client with gravity, friction and contacts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from toolkit.geometry import make_transform
from toolkit.sim.bullet import pybullet, silence
from toolkit.sim.compound import add_compound, mass_center
from toolkit.sim.robot import Robot
from toolkit.sim.robots import RobotModel
from toolkit.types import Float

STEP_S = 1 / 240
_FRICTION, _TABLE_FRICTION = 0.8, 0.6
_ROLLING = 0.0005
_RAY_TOP_M, _RAY_BELOW_M = 2.0, 0.003
_ROBOT, _ALL = 64, -1
"""Bullet's collision groups: the robot's own, so that rays can look past it."""


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
        self.client: int = pybullet.connect(pybullet.DIRECT)
        pybullet.setGravity(0, 0, -9.81, physicsClientId=self.client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=STEP_S, numSolverIterations=150, deterministicOverlappingPairs=1, physicsClientId=self.client
        )
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=self.client)
        self.table: int = pybullet.createMultiBody(0, plane, physicsClientId=self.client)
        pybullet.changeDynamics(self.table, -1, lateralFriction=_TABLE_FRICTION, physicsClientId=self.client)
        self.robot = Robot(self.client, model, T_world_base)
        for link in range(-1, pybullet.getNumJoints(self.robot.body, physicsClientId=self.client)):
            pybullet.setCollisionFilterGroupMask(self.robot.body, link, _ROBOT, _ALL, physicsClientId=self.client)
        for link in self.robot.base_links:
            pybullet.setCollisionFilterPair(self.robot.body, self.table, link, -1, 0, physicsClientId=self.client)
        with silence():
            self._added = [self._add(hulls, mass, T) for (hulls, mass), T in zip(bodies, poses, strict=True)]
        self.target = self.robot.q
        self.grip = model.drive[0]
        self.touches: list[Touch] = []
        self.seconds = 0.0
        self.on_step: Callable[[], None] | None = None

    def close(self) -> None:
        """Disconnect the client."""
        with silence():
            pybullet.disconnect(self.client)

    def _add(self, hulls: Sequence[Path], mass: float, T: Float) -> tuple[int, Float]:
        """Body id, and (3,) its centre of mass in its own coordinates."""
        shape = add_compound(self.client, hulls)
        center = mass_center(hulls)
        body = int(
            pybullet.createMultiBody(
                mass, shape, baseInertialFramePosition=center.tolist(), physicsClientId=self.client
            )
        )
        pybullet.changeDynamics(
            body,
            -1,
            lateralFriction=_FRICTION,
            spinningFriction=0.005,
            rollingFriction=_ROLLING,
            physicsClientId=self.client,
        )
        place = T[:3, :3] @ center + T[:3, 3]
        quaternion = Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
        pybullet.resetBasePositionAndOrientation(body, place.tolist(), quaternion, physicsClientId=self.client)
        return body, center

    def pose(self, number: int) -> Float:
        """(4, 4) where an object is now."""
        body, center = self._added[number]
        place, quaternion = pybullet.getBasePositionAndOrientation(body, physicsClientId=self.client)
        R = Rotation.from_quat(quaternion).as_matrix()
        return make_transform(R, np.array(place) - R @ center)

    def poses(self) -> list[Float]:
        """Where all objects are now."""
        return [self.pose(number) for number in range(len(self._added))]

    def under(self, points: Float) -> int | None:
        """The object that vertical rays through most of (N, 3) points meet first; None where they meet none.

        The arm is no obstacle to them.
        """
        above = np.column_stack([points[:, :2], np.full(len(points), _RAY_TOP_M)])
        below = points - np.array([0, 0, _RAY_BELOW_M])
        hits = pybullet.rayTestBatch(
            above.tolist(), below.tolist(), collisionFilterMask=_ALL ^ _ROBOT, physicsClientId=self.client
        )
        numbers = {body: number for number, (body, _) in enumerate(self._added)}
        counts = Counter(numbers[hit[0]] for hit in hits if hit[0] in numbers)
        return min(counts, key=lambda number: (-counts[number], number), default=None)

    def wait(self, seconds: float, phase: str, allowed: int | None) -> None:
        """Let time pass; the arm holds still and the gripper its drive value."""
        for _ in range(round(seconds / STEP_S)):
            self.step(self.target, np.zeros(len(self.target)), phase, allowed)

    def step(self, q: Float, velocity: Float, phase: str, allowed: int | None) -> None:
        """One step of time; object `allowed` may be touched by the arm, and touch the table."""
        self.target = q
        self.robot.follow(q, velocity)
        self.robot.squeeze(self.grip)
        pybullet.stepSimulation(physicsClientId=self.client)
        self.seconds += STEP_S
        self._log(phase, allowed)
        if self.on_step is not None:
            self.on_step()

    def on_table(self, number: int) -> bool:
        """Say whether an object presses on the table."""
        points = pybullet.getContactPoints(self._added[number][0], self.table, physicsClientId=self.client)
        return sum(point[9] for point in points) > 0.1

    def held(self, number: int) -> bool:
        """Say whether both fingertips press on an object."""
        body = self._added[number][0]
        return all(
            sum(
                point[9]
                for point in pybullet.getContactPoints(
                    self.robot.body, body, linkIndexA=tip, physicsClientId=self.client
                )
            )
            > 0.1
            for tip in self.robot.tips
        )

    def _log(self, phase: str, allowed: int | None) -> None:
        mine = None if allowed is None else self._added[allowed][0]
        for contact in pybullet.getContactPoints(self.robot.body, physicsClientId=self.client):
            other = contact[2] if contact[1] == self.robot.body else contact[1]
            if contact[9] > 0 and other not in (mine, self.robot.body):
                self.touches.append(Touch(phase, "the arm", self._name(other), float(contact[9])))
        if mine is None:
            return
        for contact in pybullet.getContactPoints(mine, physicsClientId=self.client):
            other = contact[2] if contact[1] == mine else contact[1]
            if contact[9] > 0 and other not in (self.robot.body, self.table):
                self.touches.append(Touch(phase, f"object {allowed}", self._name(other), float(contact[9])))

    def _name(self, body: int) -> str:
        numbers = {own: number for number, (own, _) in enumerate(self._added)}
        return f"object {numbers[body]}" if body in numbers else "the table"
