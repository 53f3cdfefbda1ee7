"""Does an arm touch anything at given joint angles? What was seen of the table is all that it keeps clear of."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from toolkit.geometry import invert, transform_points
from toolkit.sim.cubes import FINE_M, any_inside, around, standing, with_underside, without
from toolkit.sim.robot import Robot
from toolkit.sim.urdf import absolute_text
from toolkit.types import ArmWorld, Cubes, Float, Shape, Solid

_TABLE_NAME, _OTHERS, _LOAD = "the table", "what stands around", "the object"
_TABLE_MARGIN_M = 0.001
"""An arm follows its path with an error below a millimetre."""

_TABLE = Shape((np.array(list(product((-2.0, 2.0), (-2.0, 2.0), (-0.5, _TABLE_MARGIN_M)))),))

_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
_COARSE_M = 0.004
"""Side of the cubes of all that the arm passes by."""

_APART_M = FINE_M + 0.0005
"""Nothing else is this near to a point of the object: neighbours that touch each other do not cut into each other."""

_FAR_M = 0.002
"""So much larger than else is everything where the arm keeps far: seen points do not lie everywhere on a rim or an
edge, and in free motion there is room."""

_NOWHERE = np.zeros((0, 3))
_FAR_LINKS = 3
"""Links this many joints apart are kept from touching; nearer ones meet at their joints."""


@dataclass(frozen=True, eq=False)
class _Around:
    """What the arm passes by: the object, and all others."""

    passed: Cubes | None
    others: Cubes | None


class Clearance:
    """An arm, the table, the points of one object and those of all others.

    The others are full down to the table, and everything the arm passes by is `margin` larger than it was seen. What is
    to be taken, or is carried, is exactly as large as it was seen, and where it is there is nothing else. Its
    underside, which no camera sees, lies up to 2 cm below what was seen of it, no lower than the table, and nowhere
    that was seen to be empty: fingers may reach under the rim of a bowl that a camera looked under.

    Args:
        robot: whose description is read; it is not moved.
        margin: metres.

    Raises:
        ToolkitError: RoboPlan cannot read the robot's description.
    """

    def __init__(self, robot: Robot, margin: float) -> None:
        self.robot = robot
        self._margin = margin
        names = robot.names
        near = ((a, b) for a, b in combinations(robot.links, 2) if abs(robot.rank[a] - robot.rank[b]) < _FAR_LINKS)
        self._allowed = frozenset((names[a], names[b]) for a, b in near)
        self._allowed |= {(names[link], _TABLE_NAME) for link in robot.base_links}
        self._urdf = absolute_text(robot.model.urdf())
        self.points: Float = np.zeros((0, 3))
        """(N, 3) of the object, where it was seen."""
        self.drive: float = robot.model.drive[0]
        """Of the gripper, as arranged."""
        self._load: Cubes | None = None
        self._seen_others: Float = _NOWHERE
        self._surroundings: dict[bool, _Around] = {}
        self.arrange(self.drive)
        from toolkit.sim.arm_scene import ArmScene  # RoboPlan is not on every machine

        self._scene = ArmScene(self.world(), robot.chain.lower, robot.chain.upper)

    def see(self, points: Float, others: Float, empty: Float = _NOWHERE) -> None:
        """Take what is given for what is there now; nothing is carried.

        Args:
            points: (N, 3) of an object.
            others: (M, 3) of everything else.
            empty: (K, 3) of space below the object's points that was seen to be empty (`hidden.empty_below`).
        """
        self.points = points
        self._load = with_underside(points, empty) if len(points) else None
        self._seen_others = others
        self._surroundings = {}
        self.arrange(self.drive)

    def _around(self, *, far: bool) -> _Around:
        """What the arm passes by, as large as it is to keep from it: made when it is first asked for."""
        if far not in self._surroundings:
            self._surroundings[far] = self._enlarged(self._margin + (_FAR_M if far else 0.0))
        return self._surroundings[far]

    def _enlarged(self, margin: float) -> _Around:
        """The object and all others, by so much larger than they were seen."""
        others = self._seen_others
        full = standing(around(others, _COARSE_M, margin)) if len(others) else None
        if self._load is None:
            return _Around(None, full)
        whole = np.concatenate([self.points, self._load.centers])
        if full is not None:
            full = without(full, around(whole, _COARSE_M, _APART_M))
        return _Around(around(whole, _COARSE_M, margin), full)

    def arrange(self, drive: float, *, far: bool = False) -> None:
        """Leave the object where it was seen, with the fingers at a drive value, and pass by it at a distance.

        Args:
            drive: of the gripper.
            far: keep far from everything.
        """
        self.drive = drive
        passed = self._around(far=far).passed
        self._set(Solid(_LOAD, passed, np.eye(4)) if passed is not None else None, far=far)

    def approach(self) -> None:
        """From now on the arm may come as near to the object as it can without touching it."""
        self._set(Solid(_LOAD, self._load, np.eye(4)) if self._load is not None else None)

    def carry(self, in_hand: Float, *, over_table: bool = False, far: bool = False) -> None:
        """From now on the object moves with the hand, at a (4, 4) pose in its frame of where it was seen.

        Args:
            in_hand: takes points of the world, where they were seen, into the hand's frame.
            over_table: it must not touch the table. Where it was seen to stand, and where it is to stand, has errors.
            far: keep far from everything else.
        """
        assert self._load is not None
        load = Solid(_LOAD, self._load, in_hand, self.robot.model.hand)
        self._set(load, touching=True, over_table=over_table, far=far)

    def put(self, T: Float, drive: float, *, held: bool) -> None:
        """Leave the object a (4, 4) motion away from where it was seen, between fingers at a drive value for now.

        Args:
            T: from where it was seen to where it is.
            drive: of the gripper.
            held: the robot may touch it.
        """
        assert self._load is not None
        self._set(Solid(_LOAD, self._load, T), touching=held, drive=drive)

    def _set(
        self,
        load: Solid | None,
        *,
        touching: bool = False,
        over_table: bool = False,
        far: bool = False,
        drive: float | None = None,
    ) -> None:
        allowed = self._allowed
        if touching:
            allowed = allowed.union((_LOAD, link) for link in self.robot.names.values())
        if load is not None and not over_table:
            allowed |= {(_LOAD, _TABLE_NAME)}
        solids = [Solid(_TABLE_NAME, _TABLE, np.eye(4))]
        others = self._around(far=far).others
        if others is not None:
            solids.append(Solid(_OTHERS, others, np.eye(4)))
        if load is not None:
            solids.append(load)
        robot = self.robot
        joints = robot.finger_joints(self.drive if drive is None else drive)
        self._world = ArmWorld(self._urdf, robot.model.arm, joints, robot.T_world_base, tuple(solids), allowed)
        self._shown = False

    def world(self) -> ArmWorld:
        """Arm, table and objects as arranged, and what is carried, as data."""
        return self._world

    def room(self, T: Float) -> bool:
        """Say whether the object would touch no other, a (4, 4) motion away from where it was seen."""
        others = self._around(far=False).others
        return others is None or not any_inside(others, transform_points(T, self.points))

    def fits(self, T: Float) -> bool:
        """Say whether the object, as large as it is carried, would touch no other a (4, 4) motion away."""
        others = self._around(far=False).others
        if self._load is None or others is None:
            return True
        corners = self._load.centers[:, None] + self._load.side / 2 * _CORNERS
        return not any_inside(others, transform_points(T, corners.reshape(-1, 3)))

    def free(self, q: Float) -> bool:
        """Say whether arm and load touch nothing at (J,) joint angles."""
        if not self._shown:
            self._scene.arrange(self._world)
            self._shown = True
        return self._scene.free(q)

    def hand_at(self, q: Float) -> Float:
        """(4, 4) pose of the hand at (J,) joint angles."""
        return self.robot.chain.end(q)

    def in_hand(self, q: Float) -> Float:
        """(4, 4) what takes the world's points into the frame of the hand at (J,) joint angles."""
        return invert(self.hand_at(q))
