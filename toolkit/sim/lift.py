"""Does a grasp hold? A free-floating parallel gripper closes on a body and lifts it, with contacts and gravity."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from toolkit.sim.bullet import pybullet, silence
from toolkit.sim.compound import add_compound
from toolkit.types import Float

_STEP_S = 1 / 480
_SETTLE_S, _CLOSE_S, _LIFT_S, _HOLD_S = 0.3, 0.7, 1.5, 0.5
_HEIGHT_M = 0.15
_CARRIER_KG, _FINGER_KG = 2.0, 0.2
_GRIP_N = 40.0
_FRICTION = 0.8
"""Of rubber pads on household objects; grasps are looked for with a more careful one."""


def lifted_height(
    hulls: Sequence[Path], mass: float, T_world_body: Float, T_world_gripper: Float, opening: float, finger: Float
) -> float:
    """Close a gripper on a body that stands on a table, lift it by 15 cm, and hold it.

    Args:
        hulls: the body's convex pieces, in its own coordinates.
        mass: kilograms.
        T_world_body: (4, 4) where it stands.
        T_world_gripper: (4, 4) the grasp: origin between the fingertips, x closes, z approaches.
        opening: distance of the fingers before they close, metres.
        finger: (3,) thickness (x), width (y) and length (z) of a finger, metres.

    Returns:
        Height of the body's lowest point over the table in the end, metres: 0.15 where it neither slipped nor tilted.
    """
    client: int = pybullet.connect(pybullet.DIRECT)
    try:
        with silence():
            return _Lift(client, hulls, mass, T_world_body).run(T_world_gripper, opening, finger)
    finally:
        with silence():
            pybullet.disconnect(client)


class _Lift:
    """One client with a table, a body and a gripper."""

    def __init__(self, client: int, hulls: Sequence[Path], mass: float, T_world_body: Float) -> None:
        self._client = client
        pybullet.setGravity(0, 0, -9.81, physicsClientId=client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=_STEP_S, numSolverIterations=100, deterministicOverlappingPairs=1, physicsClientId=client
        )
        table = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
        self._friction(pybullet.createMultiBody(0, table, physicsClientId=client), -1, 0.6)
        shape = add_compound(client, hulls)
        low, high = self._box(shape, T_world_body)
        center = (low + high) / 2
        self._body = pybullet.createMultiBody(
            mass, shape, baseInertialFramePosition=center.tolist(), physicsClientId=client
        )
        self._friction(self._body, -1, _FRICTION)
        place = T_world_body[:3, :3] @ center + T_world_body[:3, 3]
        pybullet.resetBasePositionAndOrientation(
            self._body, place.tolist(), _quaternion(T_world_body), physicsClientId=client
        )

    def _box(self, shape: int, T_world_body: Float) -> tuple[Float, Float]:
        """Box of a collision shape in its own coordinates."""
        probe = pybullet.createMultiBody(0, shape, physicsClientId=self._client)
        low, high = pybullet.getAABB(probe, physicsClientId=self._client)
        pybullet.removeBody(probe, physicsClientId=self._client)
        return np.array(low), np.array(high)

    def _friction(self, body: int, link: int, value: float) -> None:
        pybullet.changeDynamics(
            body,
            link,
            lateralFriction=value,
            spinningFriction=0.005,
            rollingFriction=0.0005,
            physicsClientId=self._client,
        )

    def run(self, T_world_gripper: Float, opening: float, finger: Float) -> float:
        gripper = self._gripper(opening, finger, T_world_gripper)
        hold: Any = pybullet.createConstraint(
            gripper, -1, -1, -1, pybullet.JOINT_FIXED, [0, 0, 0], [0, 0, 0], [0, 0, 0], physicsClientId=self._client
        )
        self._drive(gripper, speed=0.0)
        self._step(_SETTLE_S, hold, T_world_gripper, 0.0, 0.0)
        self._drive(gripper, speed=-0.1)
        self._step(_CLOSE_S, hold, T_world_gripper, 0.0, 0.0)
        self._step(_LIFT_S, hold, T_world_gripper, 0.0, _HEIGHT_M)
        self._step(_HOLD_S, hold, T_world_gripper, _HEIGHT_M, _HEIGHT_M)
        return float(pybullet.getAABB(self._body, physicsClientId=self._client)[0][2])

    def _gripper(self, opening: float, finger: Float, T: Float) -> int:
        """A carrier without a shape, and a finger on a sliding joint on each side."""
        box = pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=(finger / 2).tolist(), physicsClientId=self._client
        )
        sides = np.array([1.0, -1.0])
        offset = (opening + finger[0]) / 2
        body = pybullet.createMultiBody(
            baseMass=_CARRIER_KG,
            basePosition=T[:3, 3].tolist(),
            baseOrientation=_quaternion(T),
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
            physicsClientId=self._client,
        )
        for link in (0, 1):
            self._friction(body, link, _FRICTION)
        return int(body)

    def _drive(self, gripper: int, speed: float) -> None:
        """Move both fingers with the same speed and force; they stop where they meet enough resistance."""
        for link in (0, 1):
            pybullet.setJointMotorControl2(
                gripper,
                link,
                pybullet.VELOCITY_CONTROL,
                targetVelocity=speed,
                force=_GRIP_N,
                physicsClientId=self._client,
            )

    def _step(self, seconds: float, hold: int, T: Float, start: float, end: float) -> None:
        """Let time pass while the carrier is held, rising from `start` to `end` metres above the grasp."""
        count = round(seconds / _STEP_S)
        for i in range(count):
            place = T[:3, 3] + np.array([0, 0, start + (end - start) * (i + 1) / count])
            pybullet.changeConstraint(hold, place.tolist(), _quaternion(T), maxForce=500, physicsClientId=self._client)
            pybullet.stepSimulation(physicsClientId=self._client)


def _quaternion(T: Float) -> list[float]:
    return Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
