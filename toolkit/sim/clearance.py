"""Does an arm touch anything at given joint angles? A PyBullet client in which nothing moves by itself."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from toolkit.geometry import invert
from toolkit.sim.bullet import pybullet, silence
from toolkit.sim.compound import add_compound
from toolkit.sim.robot import Robot
from toolkit.sim.robots import RobotModel
from toolkit.types import Float

_GROW_M = 0.002
"""Objects are this much larger than they are: an arm follows its path with an error below a millimetre."""

_FAR_LINKS = 3
"""Links this many joints apart are kept from touching; nearer ones meet at their joints."""


class Clearance:
    """Robot, table and objects, placed exactly; close it after use.

    Args:
        model: the robot.
        T_world_base: (4, 4) where it stands.
        hulls: by object, its convex meshes in the object's own coordinates.
    """

    def __init__(self, model: RobotModel, T_world_base: Float, hulls: Sequence[Sequence[Path]]) -> None:
        self.client: int = pybullet.connect(pybullet.DIRECT)
        self.robot = Robot(self.client, model, T_world_base, own_collisions=True)
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=self.client)
        self._table: int = pybullet.createMultiBody(0, plane, physicsClientId=self.client)
        with silence():
            shapes = [add_compound(self.client, pieces, _GROW_M) for pieces in hulls]
        # A mass, because PyBullet looks for no contacts between bodies without one.
        self._bodies = [int(pybullet.createMultiBody(1, shape, physicsClientId=self.client)) for shape in shapes]
        for body in self._bodies:
            self._collide(body, self._table, False)
        for link in self.robot.base_links:
            pybullet.setCollisionFilterPair(self.robot.body, self._table, link, -1, 0, physicsClientId=self.client)
        self.carried: int | None = None
        self._ignored: int | None = None
        self._neared: int | None = None
        self._T_hand_object = np.eye(4)
        self._lowest = 0.0

    def close(self) -> None:
        """Disconnect the client."""
        with silence():
            pybullet.disconnect(self.client)

    def arrange(self, poses: Sequence[Float], drive: float) -> None:
        """Put every object at its (4, 4) pose and the fingers at a drive value; nothing is carried."""
        for body, pose in zip(self._bodies, poses, strict=True):
            self._place(body, pose)
        self.robot.set_drive(drive)
        self.carried = self._ignored = self._neared = None

    def approach(self, number: int) -> None:
        """From now on the arm may come as near to one object as it can without touching it."""
        self._neared = self._bodies[number]

    def carry(self, number: int, T_hand_object: Float, lowest: float = -0.02) -> None:
        """From now on an object moves with the hand, at a (4, 4) pose in its frame; not below `lowest` metres.

        Below zero for lifting and lowering: where an object was seen to stand, and where it is to stand, has errors.
        """
        self._lowest = lowest
        self.carried, self._ignored = self._bodies[number], self._bodies[number]
        self._T_hand_object = T_hand_object

    def put(self, number: int, pose: Float) -> None:
        """Put one object down at a (4, 4) pose; the hand may still touch it."""
        self.carried = None
        self._place(self._bodies[number], pose)

    def room(self, number: int, pose: Float) -> bool:
        """Say whether an object at a (4, 4) pose would touch no other object; it stays there."""
        body = self._bodies[number]
        self._place(body, pose)
        pybullet.performCollisionDetection(physicsClientId=self.client)
        return self._neighbour(body) is None

    def free(self, q: Float) -> bool:
        """Say whether arm and load touch nothing at (J,) joint angles."""
        return self.hit(q) is None

    def hit(self, q: Float) -> str | None:
        """What arm or load touch at (J,) joint angles: 'the table', 'object 3', 'itself'; None for nothing."""
        self.robot.set(q)
        if self.carried is not None:
            self._place(self.carried, self.robot.T_world_hand() @ self._T_hand_object)
        pybullet.performCollisionDetection(physicsClientId=self.client)
        for contact in pybullet.getContactPoints(self.robot.body, physicsClientId=self.client):
            if contact[8] > 0:
                continue
            one, other = (contact[i] for i in ((3, 2) if contact[1] == self.robot.body else (4, 1)))
            if other == self.robot.body:
                if abs(self.robot.rank[contact[3]] - self.robot.rank[contact[4]]) >= _FAR_LINKS:
                    return "itself"
            elif other == self._neared and contact[8] > -_GROW_M:
                continue
            elif other != self._ignored and not (other == self._table and one in self.robot.base_links):
                return self._name(other)
        if self.carried is None:
            return None
        neighbour = self._neighbour(self.carried)
        if neighbour is not None:
            return self._name(neighbour)
        low = pybullet.getAABB(self.carried, physicsClientId=self.client)[0][2]
        return "the table" if low < self._lowest else None

    def _neighbour(self, body: int) -> int | None:
        """Another object that an object touches."""
        for contact in pybullet.getContactPoints(body, physicsClientId=self.client):
            other = contact[2] if contact[1] == body else contact[1]
            if contact[8] <= 0 and other not in (self.robot.body, self._table):
                return int(other)
        return None

    def _name(self, body: int) -> str:
        return "the table" if body == self._table else f"object {self._bodies.index(body)}"

    def _place(self, body: int, pose: Float) -> None:
        quaternion = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
        pybullet.resetBasePositionAndOrientation(body, pose[:3, 3].tolist(), quaternion, physicsClientId=self.client)

    def _collide(self, a: int, b: int, on: bool) -> None:
        pybullet.setCollisionFilterPair(a, b, -1, -1, int(on), physicsClientId=self.client)

    def hand_at(self, q: Float) -> Float:
        """(4, 4) pose of the hand at (J,) joint angles."""
        return self.robot.chain.frames(q[None])[1][0]

    def object_in_hand(self, q: Float, T_world_object: Float) -> Float:
        """(4, 4) an object's pose in the frame of the hand at (J,) joint angles."""
        return invert(self.hand_at(q)) @ T_world_object
