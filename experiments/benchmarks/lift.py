"""Does a grasp hold? A free-floating parallel gripper closes on a body and lifts it, with contacts and gravity."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np

from toolkit.geometry import make_transform
from toolkit.rearrangement.moves import Grasp
from toolkit.sim.bullet import pybullet, silence
from toolkit.sim.client import BASE, Client, quaternion
from toolkit.sim.compound import add_compound
from toolkit.types import Float, Gripper

_STEP_S = 1 / 480
_SETTLE_S, _CLOSE_S, _LIFT_S, _HOLD_S = 0.3, 0.7, 1.5, 0.5
_HEIGHT_M = 0.15
_CARRIER_KG, _FINGER_KG = 2.0, 0.2
_GRIP_N = 40.0
_FRICTION = 0.8
"""Of rubber pads on household objects; grasps are looked for with a more careful one."""


def lifted_height(hulls: Sequence[Path], mass: float, T_world_body: Float, grasp: Grasp, gripper: Gripper) -> float:
    """Close a gripper on a body that stands on a table, lift it by 15 cm, and hold it.

    Args:
        hulls: the body's convex pieces, in its own coordinates.
        mass: kilograms.
        T_world_body: (4, 4) where it stands.
        grasp: how it is held.
        gripper: by what.

    Returns:
        Height of the body's lowest point over the table in the end, metres: 0.15 where it neither slipped nor tilted.
    """
    with closing(Client()) as client, silence():
        return _Lift(client, hulls, mass, T_world_body).run(grasp, np.array(gripper.finger_m))


class _Lift:
    """One client with a table, a body and a gripper."""

    def __init__(self, client: Client, hulls: Sequence[Path], mass: float, T_world_body: Float) -> None:
        self._client = client
        client.setGravity(0, 0, -9.81)
        client.setPhysicsEngineParameter(
            fixedTimeStep=_STEP_S, numSolverIterations=100, deterministicOverlappingPairs=1
        )
        self._friction(client.add_plane(), BASE, 0.6)
        shape = add_compound(client, hulls)
        low, high = self._box(shape)
        center = (low + high) / 2
        self._body = int(client.createMultiBody(mass, shape, baseInertialFramePosition=center.tolist()))
        self._friction(self._body, BASE, _FRICTION)
        R = T_world_body[:3, :3]
        client.place(self._body, make_transform(R, R @ center + T_world_body[:3, 3]))

    def _box(self, shape: int) -> tuple[Float, Float]:
        """Box of a collision shape in its own coordinates."""
        probe = int(self._client.createMultiBody(0, shape))
        box = self._client.box(probe)
        self._client.removeBody(probe)
        return box

    def _friction(self, body: int, link: int, value: float) -> None:
        self._client.changeDynamics(body, link, lateralFriction=value, spinningFriction=0.005, rollingFriction=0.0005)

    def run(self, grasp: Grasp, finger: Float) -> float:
        T = grasp.T_world_gripper
        gripper = self._gripper(grasp.opening, finger, T)
        hold = self._client.createConstraint(
            gripper, BASE, -1, -1, pybullet.JOINT_FIXED, [0, 0, 0], [0, 0, 0], [0, 0, 0]
        )
        self._drive(gripper, speed=0.0)
        self._step(_SETTLE_S, hold, T, 0.0, 0.0)
        self._drive(gripper, speed=-0.1)
        self._step(_CLOSE_S, hold, T, 0.0, 0.0)
        self._step(_LIFT_S, hold, T, 0.0, _HEIGHT_M)
        self._step(_HOLD_S, hold, T, _HEIGHT_M, _HEIGHT_M)
        return float(self._client.box(self._body)[0][2])

    def _gripper(self, opening: float, finger: Float, T: Float) -> int:
        """A carrier without a shape, and a finger on a sliding joint on each side."""
        box = self._client.createCollisionShape(pybullet.GEOM_BOX, halfExtents=(finger / 2).tolist())
        sides = np.array([1.0, -1.0])
        offset = (opening + finger[0]) / 2
        body = self._client.createMultiBody(
            baseMass=_CARRIER_KG,
            basePosition=T[:3, 3].tolist(),
            baseOrientation=quaternion(T),
            linkMasses=[_FINGER_KG] * 2,
            linkCollisionShapeIndices=[box] * 2,
            linkVisualShapeIndices=[-1] * 2,
            linkPositions=[[side * offset, 0, -finger[2] / 2] for side in sides],
            linkOrientations=[[0, 0, 0, 1]] * 2,
            linkInertialFramePositions=[[0, 0, 0]] * 2,
            linkInertialFrameOrientations=[[0, 0, 0, 1]] * 2,
            linkParentIndices=[0] * 2,
            linkJointTypes=[pybullet.JOINT_PRISMATIC] * 2,
            linkJointAxis=[[side, 0, 0] for side in sides],
        )
        for link in (0, 1):
            self._friction(body, link, _FRICTION)
        return int(body)

    def _drive(self, gripper: int, speed: float) -> None:
        """Move both fingers with the same speed and force; they stop where they meet enough resistance."""
        for link in (0, 1):
            self._client.setJointMotorControl2(
                gripper, link, pybullet.VELOCITY_CONTROL, targetVelocity=speed, force=_GRIP_N
            )

    def _step(self, seconds: float, hold: int, T: Float, start: float, end: float) -> None:
        """Let time pass while the carrier is held, rising from `start` to `end` metres above the grasp."""
        count = round(seconds / _STEP_S)
        for i in range(count):
            place = T[:3, 3] + np.array([0, 0, start + (end - start) * (i + 1) / count])
            self._client.changeConstraint(hold, place.tolist(), quaternion(T), maxForce=500)
            self._client.stepSimulation()
