"""Does an arm touch anything at given joint angles? A PyBullet client in which nothing moves by itself."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, product
from pathlib import Path

import numpy as np

from toolkit.geometry import invert
from toolkit.sim.bullet import silence
from toolkit.sim.client import Client, Contact
from toolkit.sim.compound import add_compound, convex_pieces
from toolkit.sim.robot import Robot
from toolkit.sim.robots import RobotModel
from toolkit.sim.urdf import absolute_text
from toolkit.types import ArmWorld, Float, Shape, Solid

_GROW_M = 0.002
"""Objects are this much larger than they are: an arm follows its path with an error below a millimetre."""

_MARGIN_M = 0.002
"""Within this PyBullet calls two convex bodies touching: a millimetre of each. Exact shapes grow by it as well."""

_TABLE_NAME = "the table"
_TABLE = Shape((np.array(list(product((-2.0, 2.0), (-2.0, 2.0), (-0.5, 0.0)))),))

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
        self._client = Client()
        self._T_world_base = T_world_base
        self._shapes = [_grown(pieces) for pieces in hulls]
        self.robot = Robot(self._client, model, T_world_base, own_collisions=True)
        self._table = self._client.add_plane()
        with silence():
            shapes = [add_compound(self._client, pieces, _GROW_M) for pieces in hulls]
        # A mass, because PyBullet looks for no contacts between bodies without one.
        self._bodies = [int(self._client.createMultiBody(1, shape)) for shape in shapes]
        for body in self._bodies:
            self._client.ignore(body, self._table)
        for link in self.robot.base_links:
            self._client.ignore(self.robot.body, self._table, link)
        near = ((a, b) for a, b in combinations(self.robot.links, 2) if not self._far(a, b))
        names = self.robot.names
        self._allowed = frozenset((names[a], names[b]) for a, b in near)
        self._allowed |= {(names[link], _TABLE_NAME) for link in self.robot.base_links}
        self.carried: int | None = None
        self._ignored: int | None = None
        self._neared: int | None = None
        self._T_hand_object = np.eye(4)
        self._lowest = 0.0

    def close(self) -> None:
        """Disconnect the client."""
        self._client.close()

    def arrange(self, poses: Sequence[Float], drive: float) -> None:
        """Put every object at its (4, 4) pose and the fingers at a drive value; nothing is carried."""
        for body, pose in zip(self._bodies, poses, strict=True):
            self._client.place(body, pose)
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
        self._client.place(self._bodies[number], pose)

    def room(self, number: int, pose: Float) -> bool:
        """Say whether an object at a (4, 4) pose would touch no other object; it stays there."""
        body = self._bodies[number]
        self._client.place(body, pose)
        self._client.performCollisionDetection()
        return self._neighbour(body) is None

    def free(self, q: Float) -> bool:
        """Say whether arm and load touch nothing at (J,) joint angles."""
        return self.hit(q) is None

    def hit(self, q: Float) -> str | None:
        """What arm or load touch at (J,) joint angles: 'the table', 'object 3', 'itself'; None for nothing."""
        self.robot.set(q)
        if self.carried is not None:
            self._client.place(self.carried, self.robot.T_world_hand() @ self._T_hand_object)
        self._client.performCollisionDetection()
        for contact in self._client.contacts(self.robot.body):
            if contact.distance <= 0 and not self._is_meant(contact):
                return self._name(contact.other)
        if self.carried is None:
            return None
        neighbour = self._neighbour(self.carried)
        if neighbour is not None:
            return self._name(neighbour)
        return _TABLE_NAME if self._client.box(self.carried)[0][2] < self._lowest else None

    def world(self) -> ArmWorld:
        """Arm, table and objects as arranged, and what is carried, as data."""
        robot, allowed = self.robot, self._allowed
        solids = [Solid(_TABLE_NAME, _TABLE, np.eye(4))]
        for body, shape in zip(self._bodies, self._shapes, strict=True):
            name = self._name(body)
            if body == self.carried:
                solids.append(Solid(name, shape, self._T_hand_object, robot.model.hand))
                allowed = allowed.union((name, link) for link in robot.names.values())
            else:
                solids.append(Solid(name, shape, self._client.pose(body)))
        return ArmWorld(
            absolute_text(robot.model.urdf()),
            robot.model.arm,
            robot.finger_joints(robot.drive),
            self._T_world_base,
            tuple(solids),
            allowed,
        )

    def _far(self, link: int, other: int) -> bool:
        return abs(self.robot.rank[link] - self.robot.rank[other]) >= _FAR_LINKS

    def _is_meant(self, contact: Contact) -> bool:
        """Say whether the robot may have a contact: between neighbouring links, with what it takes or carries."""
        if contact.other == self.robot.body:
            return not self._far(contact.link, contact.other_link)
        if contact.other == self._neared and contact.distance > -_GROW_M:
            return True
        on_foot = contact.other == self._table and contact.link in self.robot.base_links
        return contact.other == self._ignored or on_foot

    def _neighbour(self, body: int) -> int | None:
        """Another object that an object touches."""
        others = (contact.other for contact in self._client.contacts(body) if contact.distance <= 0)
        return next((other for other in others if other not in (self.robot.body, self._table)), None)

    def _name(self, body: int) -> str:
        if body == self.robot.body:
            return "itself"
        return _TABLE_NAME if body == self._table else f"object {self._bodies.index(body)}"

    def hand_at(self, q: Float) -> Float:
        """(4, 4) pose of the hand at (J,) joint angles."""
        return self.robot.chain.end(q)

    def object_in_hand(self, q: Float, T_world_object: Float) -> Float:
        """(4, 4) an object's pose in the frame of the hand at (J,) joint angles."""
        return invert(self.hand_at(q)) @ T_world_object


def _grown(hulls: Sequence[Path]) -> Shape:
    pieces = convex_pieces(tuple(hulls))
    return Shape(tuple(piece.vertices + (_GROW_M + _MARGIN_M) * piece.vertex_normals for piece in pieces))
