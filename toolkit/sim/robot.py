"""An arm with a parallel gripper in a PyBullet client: placed, or driven by its motors."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from itertools import pairwise, product
from pathlib import Path
from typing import Any, cast

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from toolkit.errors import ToolkitError
from toolkit.geometry import invert, make_transform, transform_points
from toolkit.sim.bullet import pybullet, silence
from toolkit.sim.client import BASE, Client, Joint, quaternion
from toolkit.sim.kinematics import Chain
from toolkit.sim.robots import RobotModel
from toolkit.sim.urdf import absolute_text
from toolkit.types import Float

_MOTOR = 150.0
"""Strong enough that the arm follows its path; what it can lift depends on the gripper's friction."""

_COUPLING = 50.0
_GEAR = 200.0
"""Largest force (N) or torque (Nm) between the two driven joints: more than any load's."""

_TURNS = 2 * np.pi
"""Joints without limits turn this far either way."""

_PAD_M = 0.02
_FRICTION = 0.8


class Robot:
    """One robot in one client.

    Args:
        client: what it is loaded into.
        model: what it is.
        T_world_base: (4, 4) where it stands.
        pictures: load its visual meshes too.

    Raises:
        ToolkitError: PyBullet cannot load its description.
    """

    def __init__(
        self,
        client: Client,
        model: RobotModel,
        T_world_base: Float,
        *,
        pictures: bool = False,
    ) -> None:
        self._client = client
        self.model = model
        self.T_world_base = T_world_base
        flags = 0 if pictures else pybullet.URDF_IGNORE_VISUAL_SHAPES
        with silence(), tempfile.TemporaryDirectory(prefix="toolkit-") as folder:
            file = Path(folder) / "robot.urdf"
            file.write_text(absolute_text(model.urdf()))
            place = T_world_base[:3, 3].tolist(), quaternion(T_world_base)
            try:
                self.body: int = client.loadURDF(str(file), *place, useFixedBase=True, flags=flags)
            except pybullet.error as error:
                raise ToolkitError(f"robot '{model.name}': PyBullet cannot load {model.urdf()}: {error}") from error
        joints = client.joints(self.body)
        numbers = {joint.name: number for number, joint in enumerate(joints)}
        links = {joint.link: number for number, joint in enumerate(joints)}
        self._arm = [numbers[name] for name in model.arm]
        self._fingers = {name: numbers[name] for name in model.fingers}
        self._ratios = np.array([finger.ratio for finger in model.fingers.values()])
        self.hand: int = links[model.hand]
        self._camera = links.get(model.file.camera.link, BASE)
        self.tips = tuple(links[name] for name in model.tips)
        self.links = range(BASE, len(joints))
        self.names = {BASE: client.getBodyInfo(self.body)[0].decode(), **{n: link for link, n in links.items()}}
        """Link -> its name."""
        self.base_links = frozenset({BASE, *range(self._arm[0])})
        self.rank = {BASE: 0}
        """Link -> how many of the arm's joints lie between it and the base."""
        for number, joint in enumerate(joints):
            self.rank[number] = self.rank[joint.parent] + (number in self._arm)
        self.set_drive(model.drive[0])
        self.chain = self._chain(joints)
        self._measure_gripper()
        self.set(np.array(model.home))
        self._couple_fingers()
        for tip in self.tips:
            client.changeDynamics(self.body, tip, lateralFriction=_FRICTION)
            client.changeDynamics(self.body, tip, spinningFriction=0.005)

    def _chain(self, joints: Sequence[Joint]) -> Chain:
        """The arm from its base to its hand, read off at angles zero."""
        self.set(np.zeros(len(self._arm)))
        frames = [self._link_pose(joint) for joint in self._arm]
        T_joints = np.stack([np.eye(4), *(invert(a) @ b for a, b in pairwise(frames))])
        limits = np.array([[joints[number].lower, joints[number].upper] for number in self._arm])
        limits[limits[:, 0] >= limits[:, 1]] = [-_TURNS, _TURNS]
        axes = np.array([joints[number].axis for number in self._arm])
        T_end = invert(frames[-1]) @ self._link_pose(self.hand)
        return Chain(frames[0], T_joints, axes, T_end, limits[:, 0], limits[:, 1])

    def _couple_fingers(self) -> None:
        """One drive moves both fingers: what they hold cannot push them aside together, as two motors would let it."""
        (one, first), (other, second) = ((n, joint) for n, joint in self.model.fingers.items() if joint.follows is None)
        ends = (self.body, self._fingers[one], self.body, self._fingers[other])
        gear = self._client.createConstraint(*ends, pybullet.JOINT_GEAR, [1, 0, 0], [0, 0, 0], [0, 0, 0])
        self._client.changeConstraint(gear, gearRatio=-first.ratio / second.ratio, erp=0.2, maxForce=_GEAR)

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
        """(N, 3) world points of a link's collision shape, a mesh or a box."""
        (shape, *_) = self._client.getCollisionShapeData(self.body, link)
        _, _, kind, size, file, place, turn = shape[:7]
        if kind == pybullet.GEOM_BOX:
            points = np.array(list(product((-0.5, 0.5), repeat=3))) * size
        else:
            points = np.asarray(cast(Any, trimesh.load(file.decode(), force="mesh")).vertices) * size
        T_mass_mesh = make_transform(Rotation.from_quat(turn).as_matrix(), np.array(place))
        return transform_points(self._client.link(self.body, link).T_world_mass @ T_mass_mesh, points)

    def _link_pose(self, link: int) -> Float:
        return self._client.link(self.body, link).T_world_link

    @property
    def openings(self) -> tuple[float, float]:
        """Distance of the fingertips with the gripper open, and closed, metres, from their shapes."""
        return float(self._openings[0]), float(self._openings[-1])

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
        return self._client.angles(self.body, self._arm)

    def finger_joints(self, drive: float) -> dict[str, float]:
        """Where every joint of the gripper is at a drive value, radians or metres."""
        return dict(zip(self._fingers, (drive * self._ratios).tolist(), strict=True))

    @property
    def finger_drives(self) -> dict[str, float]:
        """Where every joint of the gripper is now, as a value of the drive."""
        angles = self._client.angles(self.body, list(self._fingers.values()))
        return dict(zip(self._fingers, (angles / self._ratios).tolist(), strict=True))

    @property
    def drive(self) -> float:
        """The gripper's drive now: the mean over its joints."""
        return float(np.mean(list(self.finger_drives.values())))

    @property
    def opening(self) -> float:
        """Distance of the fingertips now, metres."""
        return float(np.interp(self.drive, *self._rising(self._openings)))

    def T_world_hand(self) -> Float:
        """(4, 4) pose of the hand now."""
        return self._link_pose(self.hand)

    def T_world_camera(self) -> Float:
        """(4, 4) pose of the camera now."""
        return self._link_pose(self._camera) @ self.model.file.camera.T_link_camera

    def set(self, q: Float) -> None:
        """Put the arm at (J,) joint angles, at once."""
        for joint, angle in zip(self._arm, q.tolist(), strict=True):
            self._client.resetJointState(self.body, joint, angle)

    def set_drive(self, drive: float) -> None:
        """Put the fingers where the drive says, at once."""
        for name, angle in self.finger_joints(drive).items():
            self._client.resetJointState(self.body, self._fingers[name], angle)

    def follow(self, q: Float, velocity: Float) -> None:
        """Let the arm's motors hold (J,) angles, moving at (J,) radians per second."""
        self._client.setJointMotorControlArray(
            self.body,
            self._arm,
            pybullet.POSITION_CONTROL,
            targetPositions=q.tolist(),
            targetVelocities=velocity.tolist(),
            forces=[_MOTOR] * len(self._arm),
            positionGains=[0.4] * len(self._arm),
            velocityGains=[1.0] * len(self._arm),
        )

    def squeeze(self, drive: float) -> None:
        """Let the gripper's motors hold a drive value with limited force.

        Of a linkage, the driven joints carry the force, and the others take the angle their side really has.
        """
        now = self.finger_drives
        for name, finger in self.model.fingers.items():
            driven = finger.follows is None
            target = drive if finger.follows is None else now[finger.follows]
            self._client.setJointMotorControl2(
                self.body,
                self._fingers[name],
                pybullet.POSITION_CONTROL,
                targetPosition=target * finger.ratio,
                force=self.model.grip if driven else _COUPLING,
                positionGain=0.2 if driven else 0.8,
            )
