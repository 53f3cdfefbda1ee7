"""From a grasp and a motion to an arm's whole way: IK, straight lines near the object, free motion between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from toolkit.geometry import invert, make_transform
from toolkit.rearrangement.moves import Grasp, MotionProblem
from toolkit.rearrangement.stages import Motion
from toolkit.sim.clearance import Clearance
from toolkit.types import Failure, Float

_RANDOM_STARTS = 11
_LINE_STEP_M = 0.01
_JUMP_RAD = 0.4
"""A joint that turns further than this in one step along a line has changed over to another solution."""

_SPARE_M = 0.005
"""Antipodal grasps open this much wider on each side."""

_UP, _LEAST_LIFT_M = np.array([0.0, 0.0, 0.15]), 0.06
_MOST_MOTIONS = 3
"""Grasps whose free motion is searched for at most."""

_HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
"""A gripper turned by this holds the same."""

_REASONS = (
    "no IK solution reaches any grasp",
    "no straight way leads to any grasp and up from it without touching something",
    "the goal is out of the arm's reach with every grasp",
    "on the straight way to the place arm or object would touch something",
)
"""By how far the best grasp came."""


@dataclass(frozen=True, eq=False)
class Way:
    """Everything an arm does to move one object.

    Attributes:
        opening: distance of the fingertips before they close, metres.
        to_grasp: (N, J) free motion to above the grasp.
        approach: (N, J) along the gripper's axis.
        lift: (N, J) straight up.
        transfer: (N, J) free motion with the object.
        lower: (N, J) straight down.
        retreat: (N, J) back along the gripper's axis.
    """

    opening: float
    to_grasp: Float
    approach: Float
    lift: Float
    transfer: Float
    lower: Float
    retreat: Float


@dataclass(frozen=True, eq=False)
class Lines:
    """The straight parts of a way."""

    approach: Float
    lift: Float
    lower: Float
    retreat: Float


@dataclass(frozen=True, eq=False)
class Landing:
    """(N, J) straight up from where an object is let go, and back from there along the gripper's axis."""

    lower: Float
    retreat: Float


class Reach:
    """Plans ways among objects.

    Args:
        scene: robot and objects to keep clear of.
        motion: searches free motions.
        approach_m: way along the gripper's axis to the grasp, and back from the place.
        seed: of IK's starts and the search.
    """

    def __init__(self, scene: Clearance, motion: Motion, approach_m: float, seed: int) -> None:
        self._scene = scene
        self._motion = motion
        self._approach_m = approach_m
        self._seed = seed
        chain = scene.robot.chain
        rng = np.random.default_rng(seed)
        low, high = np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi)
        self._starts = rng.uniform(low, high, (_RANDOM_STARTS, len(low)))

    def plan(
        self, q: Float, number: int, poses: Sequence[Float], grasps: Sequence[Grasp], T_place_pick: Float
    ) -> Way | Failure:
        """The way of the first grasp that works out.

        Args:
            q: (J,) where the arm is.
            number: the object to move.
            poses: (4, 4) of all objects.
            grasps: on that object, best first.
            T_place_pick: (4, 4) its motion.
        """
        self._scene.arrange(poses, self._scene.robot.drive)
        if not self._scene.room(number, T_place_pick @ poses[number]):
            return Failure("executor", "another object is in the way where it is to be put")
        furthest, searched = 0, 0
        failure: Failure | None = None
        for grasp in grasps:
            for turn in (np.eye(4), _HALF_TURN):
                lines = self._lines(q, number, poses, grasp, turn, T_place_pick)
                if isinstance(lines, int):
                    furthest = max(furthest, lines)
                    continue
                way = self._join(q, number, poses, grasp.opening, lines)
                if isinstance(way, Way):
                    return way
                failure, searched = way, searched + 1
                if searched == _MOST_MOTIONS:
                    return failure
        return failure or Failure("executor", _REASONS[furthest])

    def _lines(
        self, q: Float, number: int, poses: Sequence[Float], grasp: Grasp, turn: Float, T_place_pick: Float
    ) -> Lines | int:
        """The straight parts; where they do not work out, how far they came, as an index into `_REASONS`."""
        scene, robot = self._scene, self._scene.robot
        closed = grasp.opening - 2 * _SPARE_M
        T_tips_hand = invert(robot.T_hand_tips(max(closed, 0.0)))
        hand = grasp.T_world_gripper @ turn @ T_tips_hand
        wanted = T_place_pick @ poses[number]
        drive = robot.drive_for(grasp.opening)
        at_grasps = self._solve(hand, q)[:3]
        if at_grasps and not self._solve(T_place_pick @ hand, q):
            return 2
        if at_grasps and not self._can_be_centred(number, poses, hand[:3, :3] @ robot.model.R_hand_gripper[:, 0]):
            return 1
        furthest = 0
        for at_grasp in at_grasps:
            scene.arrange(poses, drive)
            scene.approach(number)
            furthest = max(furthest, 1)
            approach = self._line(at_grasp, self._back(hand)) if scene.free(at_grasp) else None
            if approach is None or not all(map(scene.free, approach)):
                continue
            in_hand = scene.object_in_hand(at_grasp, poses[number])
            scene.carry(number, in_hand)
            lift = self._rise(at_grasp, _UP)
            if lift is None:
                continue
            landing = self._land(number, in_hand, wanted, lift[-1], drive)
            if not isinstance(landing, int):
                steps = min(len(lift), len(landing.lower))
                return Lines(approach[::-1], lift[:steps], landing.lower[:steps][::-1], landing.retreat)
            furthest = max(furthest, landing)
        return furthest

    def _land(self, number: int, in_hand: Float, wanted: Float, near: Float, drive: float) -> Landing | int:
        """How an object at a (4, 4) pose in the hand is put down at a pose `wanted`; else an index into `_REASONS`."""
        hand = wanted @ invert(in_hand)
        furthest = 2
        for at_place in self._solve(hand, near)[:3]:
            retreat = self._line(at_place, self._back(hand))
            if retreat is None:
                continue
            furthest = 3
            self._scene.carry(number, in_hand)
            lower = self._rise(at_place, _UP)
            if lower is not None and self._leaves(number, wanted, retreat, drive):
                return Landing(lower, retreat)
        return furthest

    def _back(self, hand: Float) -> Float:
        """(3,) the way back from a (4, 4) pose of the hand, along the gripper's axis."""
        return -self._approach_m * hand[:3, :3] @ self._scene.robot.model.R_hand_gripper[:, 2]

    def _rise(self, q: Float, up: Float) -> Float | None:
        """A line as far up as arm and load stay clear and the arm reaches; None where that is not high enough."""
        path = self._line(q, up, _LEAST_LIFT_M)
        if path is None:
            return None
        clear = next((i for i, q in enumerate(path[1:], 1) if not self._scene.free(q)), len(path))
        return path[:clear] if clear > _steps(_LEAST_LIFT_M) else None

    def _can_be_centred(self, number: int, poses: Sequence[Float], closing: Float) -> bool:
        """Say whether the finger that comes first may push the object along (3,) without pushing others."""
        self._scene.arrange(poses, self._scene.robot.drive)
        return all(self._scene.room(number, _shifted(poses[number], way * closing)) for way in (_SPARE_M, -_SPARE_M))

    def _leaves(self, number: int, wanted: Float, retreat: Float, drive: float) -> bool:
        """Say whether the opened hand gets away from the object where it was put."""
        held = self._scene.robot.drive
        self._scene.robot.set_drive(drive)
        self._scene.put(number, wanted)
        leaves = all(map(self._scene.free, retreat))
        self._scene.robot.set_drive(held)
        return leaves

    def _join(self, q: Float, number: int, poses: Sequence[Float], opening: float, lines: Lines) -> Way | Failure:
        """Free motions to the straight parts, and between them."""
        scene = self._scene
        scene.arrange(poses, scene.robot.drive_for(opening))
        to_grasp = self.motion(q, lines.approach[0])
        if isinstance(to_grasp, Failure):
            return to_grasp
        scene.carry(number, scene.object_in_hand(lines.lift[0], poses[number]), lowest=0.005)
        transfer = self.motion(lines.lift[-1], lines.lower[0])
        if isinstance(transfer, Failure):
            return transfer
        return Way(opening, to_grasp, lines.approach, lines.lift, transfer, lines.lower, lines.retreat)

    def adapted(self, way: Way, number: int, poses: Sequence[Float], in_hand: Float, wanted: Float) -> Way:
        """A way whose second half puts an object down right that lies in the hand otherwise than it was to.

        Args:
            way: carried out up to its lift.
            number: the object.
            poses: (4, 4) of all objects.
            in_hand: (4, 4) pose of the object in the hand's frame.
            wanted: (4, 4) pose to put it down at.

        Returns:
            The way as it was, where there is none that is better.
        """
        robot = self._scene.robot
        self._scene.arrange(poses, robot.drive_for(way.opening - 2 * _SPARE_M))
        landing = self._land(number, in_hand, wanted, way.lower[-1], robot.drive_for(way.opening))
        if isinstance(landing, int):
            return way
        self._scene.carry(number, in_hand, lowest=0.005)
        lower = landing.lower[: len(way.lift)][::-1]
        transfer = self.motion(way.lift[-1], lower[0])
        if isinstance(transfer, Failure):
            return way
        return replace(way, transfer=transfer, lower=lower, retreat=landing.retreat)

    def way_out(self, q: Float) -> Float:
        """(N, J) straight back along the gripper's axis to where nothing is touched, in the scene as it is arranged.

        N is 1 where nothing is touched at `q`, or nowhere on that way.
        """
        hand = self._scene.hand_at(q)
        back = -self._approach_m * hand[:3, :3] @ self._scene.robot.model.R_hand_gripper[:, 2]
        path = self._line(q, back, 0.0)
        if path is None:
            return q[None]
        clear = next((i for i, on_way in enumerate(path) if self._scene.free(on_way)), 0)
        return path[: clear + 1]

    def motion(self, start: Float, goal: Float) -> Float | Failure:
        """A free motion in the scene as it is arranged; joints without limits turn the shorter way."""
        chain = self._scene.robot.chain
        problem = MotionProblem(start, goal, chain.lower, chain.upper, self._scene.free)
        return self._motion.plan(problem, self._seed)

    def _solve(self, hand: Float, near: Float) -> list[Float]:
        """IK solutions, the nearest to `near` first; of joints without limits, the turn nearest to it."""
        chain = self._scene.robot.chain
        found = chain.solve(hand, np.concatenate([near[None], near + 0.3 * (self._starts - near), self._starts]))
        endless = chain.upper >= 2 * np.pi
        turned = near + (found - near + np.pi) % (2 * np.pi) - np.pi
        found = np.where(endless & (np.abs(turned) <= chain.upper), turned, found)
        order = np.argsort(np.abs(found - near).max(axis=1), kind="stable")
        unlike: list[Float] = []
        for q in found[order]:
            if all(np.abs(q - other).max() > 0.05 for other in unlike):
                unlike.append(q)
        return unlike

    def _line(self, q: Float, way: Float, least_m: float | None = None) -> Float | None:
        """(N, J) joint angles along a straight way (3,) of the hand from where it is at `q`.

        None where it gets stuck, unless it has come `least_m` by then: the part up to there.
        """
        chain = self._scene.robot.chain
        start = self._scene.hand_at(q)
        count = _steps(float(np.linalg.norm(way)))
        path = [q]
        for part in np.linspace(0, 1, count + 1)[1:]:
            found = chain.solve(_shifted(start, part * way), path[-1][None])
            if not len(found) or np.abs(found[0] - path[-1]).max() > _JUMP_RAD:
                break
            path.append(found[0])
        enough = count if least_m is None else _steps(least_m)
        return np.array(path) if len(path) > enough else None


def _steps(way_m: float) -> int:
    return max(1, int(np.ceil(way_m / _LINE_STEP_M - 1e-9)))


def _shifted(T: Float, by: Float) -> Float:
    return make_transform(T[:3, :3], T[:3, 3] + by)
