"""An arm with a parallel gripper in a PyBullet client: placed, or driven by its motors."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, cast

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from toolkit.geometry import invert, make_transform, transform_points
from toolkit.sim.bullet import pybullet, silence
from toolkit.sim.kinematics import Chain
from toolkit.sim.robots import RobotModel
from toolkit.types import Float

_MOTOR = 150.0
"""Strong enough that the arm follows its path; what it can lift is for the gripper's friction to say."""

_COUPLING = 50.0
_GEAR = 200.0
"""Largest force (N) or torque (Nm) between the two fingers' drives: more than any load's."""

_TURNS = 2 * np.pi
"""Joints without limits turn this far either way."""

_PAD_M = 0.02
_FRICTION = 0.8


class Robot:
    """One robot in one client.

    Args:
        client: PyBullet client it is loaded into.
        model: what it is.
        T_world_base: (4, 4) where it stands.
        pictures: load its visual meshes too.
        own_collisions: let PyBullet look for contacts between its own links.
    """

    def __init__(
        self,
        client: int,
        model: RobotModel,
        T_world_base: Float,
        *,
        pictures: bool = False,
        own_collisions: bool = False,
    ) -> None:
        self.client = client
        self.model = model
        flags = 0 if pictures else pybullet.URDF_IGNORE_VISUAL_SHAPES
        flags |= pybullet.URDF_USE_SELF_COLLISION if own_collisions else 0
        with silence():
            self.body: int = pybullet.loadURDF(
                str(model.urdf()),
                T_world_base[:3, 3].tolist(),
                Rotation.from_matrix(T_world_base[:3, :3]).as_quat().tolist(),
                useFixedBase=True,
                flags=flags,
                physicsClientId=client,
            )
        infos = [
            pybullet.getJointInfo(self.body, i, physicsClientId=client)
            for i in range(pybullet.getNumJoints(self.body, physicsClientId=client))
        ]
        joints = {info[1].decode(): info[0] for info in infos}
        links = {info[12].decode(): info[0] for info in infos}
        self._arm = [joints[name] for name in model.arm]
        self._fingers = [joints[name] for name in model.fingers]
        self._ratios = np.array(list(model.fingers.values()))
        self.hand: int = links[model.hand]
        self.tips = tuple(links[name] for name in model.tips)
        self.base_links = frozenset({-1, *range(self._arm[0])})
        self.rank = {-1: 0}
        for info in infos:
            self.rank[info[0]] = self.rank[info[16]] + (info[0] in self._arm)
        self.set_drive(model.drive[0])
        self.chain = self._chain(infos)
        self._measure_gripper()
        self.set(np.array(model.home))
        self._couple_fingers()
        for tip in self.tips:
            pybullet.changeDynamics(self.body, tip, lateralFriction=_FRICTION, physicsClientId=client)
            pybullet.changeDynamics(self.body, tip, spinningFriction=0.005, physicsClientId=client)

    def _chain(self, infos: list[Any]) -> Chain:
        """The arm from its base to its hand, read off at angles zero."""
        self.set(np.zeros(len(self._arm)))
        T_base = self._link_pose(self._arm[0])
        frames = [self._link_pose(joint) for joint in self._arm]
        T_joints = np.stack([np.eye(4), *(invert(a) @ b for a, b in pairwise(frames))])
        limits = np.array([[infos[joint][8], infos[joint][9]] for joint in self._arm])
        limits[limits[:, 0] >= limits[:, 1]] = [-_TURNS, _TURNS]
        axes = np.array([infos[joint][13] for joint in self._arm])
        T_end = invert(frames[-1]) @ self._link_pose(self.hand)
        return Chain(T_base, T_joints, axes, T_end, limits[:, 0], limits[:, 1])

    def _couple_fingers(self) -> None:
        """One drive moves both fingers: what they hold cannot push them aside together, as two motors would let it."""
        (one, first), (other, second) = (
            (joint, ratio)
            for name, joint, ratio in zip(self.model.fingers, self._fingers, self._ratios, strict=True)
            if _is_driven(name)
        )
        gear = pybullet.createConstraint(
            self.body,
            one,
            self.body,
            other,
            pybullet.JOINT_GEAR,
            [1, 0, 0],
            [0, 0, 0],
            [0, 0, 0],
            physicsClientId=self.client,
        )
        ratio = -float(first / second)
        pybullet.changeConstraint(gear, gearRatio=ratio, erp=0.2, maxForce=_GEAR, physicsClientId=self.client)

    def _measure_gripper(self) -> None:
        """Opening and reach of the fingertips over the whole way of the drive, from their meshes."""
        self._drives = np.linspace(*self.model.drive, 33)
        openings, reaches = [], []
        R = self.model.R_hand_gripper
        for drive in self._drives:
            self.set_drive(float(drive))
            T_gripper_world = invert(self._link_pose(self.hand) @ make_transform(R, np.zeros(3)))
            sides = [transform_points(T_gripper_world, self._vertices(tip)) for tip in self.tips]
            reach = max(side[:, 2].max() for side in sides)
            pads = [np.abs(side[side[:, 2] > reach - _PAD_M, 0]).min() for side in sides]
            openings.append(sum(pads))
            reaches.append(reach)
        self._openings, self._reaches = np.array(openings), np.array(reaches)
        self.set_drive(self.model.drive[0])

    def _vertices(self, link: int) -> Float:
        """(N, 3) world points of a link's collision mesh."""
        (shape, *_) = pybullet.getCollisionShapeData(self.body, link, physicsClientId=self.client)
        points = np.asarray(cast(Any, trimesh.load(shape[4].decode(), force="mesh")).vertices)
        place, turn = shape[5], shape[6]
        T_inertial_mesh = make_transform(Rotation.from_quat(turn).as_matrix(), np.array(place))
        return transform_points(self._link_pose(link, inertial=True) @ T_inertial_mesh, points)

    def _link_pose(self, link: int, *, inertial: bool = False) -> Float:
        state = pybullet.getLinkState(self.body, link, computeForwardKinematics=1, physicsClientId=self.client)
        place, turn = (state[0], state[1]) if inertial else (state[4], state[5])
        return make_transform(Rotation.from_quat(turn).as_matrix(), np.array(place))

    def T_hand_tips(self, opening: float) -> Float:
        """(4, 4) point between the fingertips, in gripper axes, in the hand's frame, at an opening in metres."""
        R = self.model.R_hand_gripper
        return make_transform(R, R @ np.array([0, 0, np.interp(self.drive_for(opening), *self._rising(self._reaches))]))

    def drive_for(self, opening: float) -> float:
        """The drive's value at which the fingertips are `opening` metres apart."""
        return float(np.interp(opening, self._openings[::-1], self._drives[::-1]))

    def _rising(self, values: Float) -> tuple[Float, Float]:
        order = np.argsort(self._drives)
        return self._drives[order], values[order]

    @property
    def q(self) -> Float:
        """(J,) the arm's joint angles now, radians."""
        states = pybullet.getJointStates(self.body, self._arm, physicsClientId=self.client)
        return np.array([state[0] for state in states])

    @property
    def drive(self) -> float:
        """The gripper's drive now: the mean over its joints."""
        states = pybullet.getJointStates(self.body, self._fingers, physicsClientId=self.client)
        return float(np.mean(np.array([state[0] for state in states]) / self._ratios))

    def T_world_hand(self) -> Float:
        """(4, 4) pose of the hand now."""
        return self._link_pose(self.hand)

    def set(self, q: Float) -> None:
        """Put the arm at (J,) joint angles, at once."""
        for joint, angle in zip(self._arm, q.tolist(), strict=True):
            pybullet.resetJointState(self.body, joint, angle, physicsClientId=self.client)

    def set_drive(self, drive: float) -> None:
        """Put the fingers where the drive says, at once."""
        for joint, angle in zip(self._fingers, (drive * self._ratios).tolist(), strict=True):
            pybullet.resetJointState(self.body, joint, angle, physicsClientId=self.client)

    def follow(self, q: Float, velocity: Float) -> None:
        """Let the arm's motors hold (J,) angles, moving at (J,) radians a second."""
        pybullet.setJointMotorControlArray(
            self.body,
            self._arm,
            pybullet.POSITION_CONTROL,
            targetPositions=q.tolist(),
            targetVelocities=velocity.tolist(),
            forces=[_MOTOR] * len(self._arm),
            positionGains=[0.4] * len(self._arm),
            velocityGains=[1.0] * len(self._arm),
            physicsClientId=self.client,
        )

    def squeeze(self, drive: float) -> None:
        """Let the gripper's motors hold a drive value with limited force; mimic joints follow the driven ones.

        Of a linkage, the joints next to the palm carry the force, and the others take the angle their side really has.
        """
        names = list(self.model.fingers)
        states = pybullet.getJointStates(self.body, self._fingers, physicsClientId=self.client)
        now = {name: state[0] / ratio for name, state, ratio in zip(names, states, self._ratios, strict=True)}
        drivers = [name for name in names if _is_driven(name)]
        for name, joint, ratio in zip(names, self._fingers, self._ratios.tolist(), strict=True):
            driven = name in drivers
            side = next((own for own in drivers if ("left" in own) == ("left" in name)), name)
            target = drive if driven else now[side]
            pybullet.setJointMotorControl2(
                self.body,
                joint,
                pybullet.POSITION_CONTROL,
                targetPosition=target * ratio,
                force=self.model.grip if driven else _COUPLING,
                positionGain=0.2 if driven else 0.8,
                physicsClientId=self.client,
            )


def _is_driven(finger: str) -> bool:
    """Say whether a joint of the gripper is next to the palm, where the drive's force acts."""
    return "inner" not in finger and "tip" not in finger
