"""From a grasp and a place to an arm's whole way: straight lines near the object, free paths between them, timed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import Protocol

import numpy as np

from toolkit.geometry import invert, make_transform
from toolkit.rearrangement.executors.handling.inverse import Inverse, steps
from toolkit.rearrangement.executors.handling.squeeze import squeezed
from toolkit.rearrangement.executors.handling.timing import Timer
from toolkit.rearrangement.moves import Grasp, MotionProblem
from toolkit.rearrangement.plans import Way
from toolkit.rearrangement.stages import MotionPlanner
from toolkit.rearrangement.trajectories import Trajectory
from toolkit.sim.clearance import Clearance
from toolkit.types import Failure, Float

_UP, _LEAST_LIFT_M = np.array([0.0, 0.0, 0.15]), 0.06
_CLOSING = 3
"""Places between open and closed at which the fingers are looked at."""

_LOOSE_M = 0.001
"""An object has at least so much room to either side between the opened fingers."""

_MOST_SEARCHES = 3
"""Grasps whose free paths are searched for at most."""

_HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
"""A gripper turned by this holds the same."""

_REASONS = (
    "no IK solution reaches any grasp",
    "no straight way leads to any grasp and up from it without touching something",
    "the goal is out of the arm's reach with every grasp",
    "on the straight way to the place arm or object would touch something",
)
"""How far the best grasp came."""


@dataclass(frozen=True, eq=False)
class _Lines:
    """The straight parts of a way."""

    approach: Float
    lift: Float
    lower: Float
    retreat: Float


@dataclass(frozen=True, eq=False)
class _Taking:
    """(N, J) along the gripper's axis to a grasp, and straight up from there."""

    approach: Float
    lift: Float


@dataclass(frozen=True, eq=False)
class _Landing:
    """(N, J) straight up from where an object is let go, and back from there along the gripper's axis."""

    lower: Float
    retreat: Float


class Arranged(Protocol):
    """Puts objects where they are."""

    def __call__(self, *, far: bool) -> None:
        """Do so; where `far` is said, the arm keeps far from them (`Clearance`)."""
        ...


class Reach:
    """Plans ways among what was seen.

    Args:
        clearance: robot and objects, to keep clear of.
        planner: searches free paths.
        timer: of the same arm.
        approach_m: way along the gripper's axis to the grasp, and back from the place.
        seed: of IK's starts and the search.
    """

    def __init__(
        self, clearance: Clearance, planner: MotionPlanner, timer: Timer, approach_m: float, seed: int
    ) -> None:
        self._clearance = clearance
        self._planner = planner
        self._timer = timer
        self._approach_m = approach_m
        self._seed = seed
        self._inverse = Inverse(clearance.robot.chain, seed)

    def plan(self, q: Float, grasps: Sequence[Grasp], T_place_pick: Float) -> Way | Failure:
        """The way of the first grasp that works out.

        Args:
            q: (J,) where the arm is.
            grasps: on the object, best first.
            T_place_pick: (4, 4) its motion.
        """
        if not self._clearance.fits(T_place_pick):
            return Failure("executor", "another object is in the way where it is to be put")
        furthest, searched = 0, 0
        failure: Failure | None = None
        for grasp in _either_way(grasps):
            lines = self._lines(q, grasp, T_place_pick)
            if isinstance(lines, int):
                furthest = max(furthest, lines)
                continue
            way = self._join(q, grasp, lines)
            if isinstance(way, Way):
                return way
            failure, searched = way, searched + 1
            if searched == _MOST_SEARCHES:
                return failure
        return failure or Failure("executor", _REASONS[furthest])

    def taken(self, q: Float, grasps: Sequence[Grasp], count: int) -> list[Grasp]:
        """The first `count` grasps, as they are or turned over, that lift the object where it was seen.

        Args:
            q: (J,) near what the arm is to be.
            grasps: on the object, best first.
            count: how many are enough.
        """
        found = (grasp for grasp in _either_way(grasps) if self._takes(q, grasp))
        return list(islice(found, count))

    def _takes(self, q: Float, grasp: Grasp) -> bool:
        at_grasps = self._inverse.solve(self._hand(grasp), q)[:3]
        if not at_grasps or not self._can_be_squeezed(grasp):
            return False
        return any(self._take(at_grasp, grasp) is not None for at_grasp in at_grasps)

    def _lines(self, q: Float, grasp: Grasp, T_place_pick: Float) -> _Lines | int:
        """The straight parts; where they do not work out, how far they came, as an index into `_REASONS`."""
        hand = self._hand(grasp)
        at_grasps = self._inverse.solve(hand, q)[:3]
        if at_grasps and not self._inverse.solve(T_place_pick @ hand, q):
            return 2
        if at_grasps and not self._can_be_squeezed(grasp):
            return 1
        furthest = 0
        for at_grasp in at_grasps:
            furthest = max(furthest, 1)
            taking = self._take(at_grasp, grasp)
            if taking is None:
                continue
            in_hand = self._clearance.in_hand(at_grasp)
            landing = self._land(in_hand, T_place_pick, taking.lift[-1], grasp.opening)
            if not isinstance(landing, int):
                count = min(len(taking.lift), len(landing.lower))
                return _Lines(taking.approach, taking.lift[:count], landing.lower[:count][::-1], landing.retreat)
            furthest = max(furthest, landing)
        return furthest

    def _hand(self, grasp: Grasp) -> Float:
        """(4, 4) pose of the hand whose fingers have closed on a grasp."""
        return grasp.T_world_gripper @ invert(self._clearance.robot.T_hand_tips(grasp.closed))

    def _take(self, at_grasp: Float, grasp: Grasp) -> _Taking | None:
        """How an object is taken and lifted at (J,) joint angles; None where that touches something."""
        if not self._closes(at_grasp, grasp):  # first, since a line takes longer to find
            return None
        approach = self._inverse.line(at_grasp, self._back(self._hand(grasp)))
        if approach is None or not self._comes(approach, grasp):
            return None
        self._clearance.carry(self._clearance.in_hand(at_grasp))
        lift = self._rise(at_grasp, _UP)
        return None if lift is None else _Taking(approach[::-1], lift)

    def _closes(self, at_grasp: Float, grasp: Grasp) -> bool:
        """Say whether the opened hand is free around the object, at (J,) joint angles, and can close there."""
        clearance, robot = self._clearance, self._clearance.robot
        across = grasp.T_world_gripper[:3, 0]
        for off in (-_LOOSE_M, _LOOSE_M):  # what fills the opened gripper to the last is not let go again
            clearance.put(make_transform(np.eye(3), off * across), robot.drive_for(grasp.opening), held=False)
            if not clearance.free(at_grasp):
                return False
        for opening in np.linspace(grasp.opening, grasp.closed, _CLOSING + 1)[1:]:
            clearance.put(np.eye(4), robot.drive_for(float(opening)), held=True)
            if not clearance.free(at_grasp):
                return False
        return True

    def _comes(self, approach: Float, grasp: Grasp) -> bool:
        """Say whether the opened hand gets to a grasp on an (N, J) way back from it."""
        self._clearance.arrange(self._clearance.robot.drive_for(grasp.opening))
        self._clearance.approach()
        return all(map(self._clearance.free, approach))

    def _land(self, in_hand: Float, wanted: Float, near: Float, opening: float) -> _Landing | int:
        """How an object at a (4, 4) pose in the hand is put down at a pose `wanted`; else an index into `_REASONS`."""
        clearance, hand = self._clearance, wanted @ invert(in_hand)
        drive = clearance.robot.drive_for(opening)
        furthest = 2
        for at_place in self._inverse.solve(hand, near)[:3]:
            clearance.put(wanted, drive, held=True)
            if not clearance.free(at_place):  # first, since lines take longer to find
                furthest = 3
                continue
            retreat = self._inverse.line(at_place, self._back(hand))
            if retreat is None:
                continue
            furthest = 3
            # The opened hand must get away from the object without taking it along.
            clearance.put(wanted, drive, held=False)
            if not all(map(clearance.free, retreat[1:])):
                continue
            clearance.carry(in_hand)
            lower = self._rise(at_place, _UP)
            if lower is not None:
                return _Landing(lower, retreat)
        return furthest

    def _back(self, hand: Float) -> Float:
        """(3,) the way back from a (4, 4) pose of the hand, along the gripper's axis."""
        return -self._approach_m * hand[:3, :3] @ self._clearance.robot.model.R_hand_gripper[:, 2]

    def _rise(self, q: Float, up: Float) -> Float | None:
        """A line as far up as arm and load stay clear and the arm reaches; None where that is not high enough."""
        path = self._inverse.line(q, up, _LEAST_LIFT_M)
        if path is None:
            return None
        clear = next((i for i, q in enumerate(path[1:], 1) if not self._clearance.free(q)), len(path))
        return path[:clear] if clear > steps(_LEAST_LIFT_M) else None

    def _can_be_squeezed(self, grasp: Grasp) -> bool:
        """Say whether the fingers may close on the object without pushing it against others."""
        clearance = self._clearance
        motions = squeezed(clearance.points, grasp, clearance.robot.model.gripper)
        return all(map(clearance.room, motions))

    def _join(self, q: Float, grasp: Grasp, lines: _Lines) -> Way | Failure:
        """Free paths to the straight parts, and between them."""
        clearance = self._clearance
        to_grasp = self.free_path(
            q, lines.approach[0], partial(clearance.arrange, clearance.robot.drive_for(grasp.opening))
        )
        if isinstance(to_grasp, Failure):
            return to_grasp
        carry = partial(clearance.carry, clearance.in_hand(lines.lift[0]), over_table=True)
        transfer = self.free_path(lines.lift[-1], lines.lower[0], carry)
        if isinstance(transfer, Failure):
            return transfer
        line = self._timer.line
        return Way(
            T_world_gripper=grasp.T_world_gripper,
            opening_m=grasp.opening,
            closed_m=grasp.closed,
            to_grasp=to_grasp,
            approach=line(lines.approach),
            lift=line(lines.lift),
            transfer=transfer,
            lower=line(lines.lower),
            retreat=line(lines.retreat),
        )

    def adapted(self, way: Way, in_hand: Float, wanted: Float) -> Way | Failure:
        """Plan the second half of a way anew, for an object that lies in the hand otherwise than planned.

        Args:
            way: carried out up to its lift.
            in_hand: (4, 4) takes the world's points of the object, where it was seen, into the hand's frame.
            wanted: (4, 4) motion from where it was seen to where it is to be put.

        Returns:
            The way with its new second half; the way as it was where no better one is found and nothing is touched on
            it; else a Failure.
        """
        clearance = self._clearance
        clearance.arrange(clearance.robot.drive_for(way.closed_m))
        landing = self._land(in_hand, wanted, way.lower.end, way.opening_m)
        if not isinstance(landing, int):
            carry = partial(clearance.carry, in_hand, over_table=True)
            transfer = self.free_path(way.lift.end, landing.lower[-1], carry)
            if not isinstance(transfer, Failure):
                lower, retreat = self._timer.line(landing.lower[::-1]), self._timer.line(landing.retreat)
                return way.model_copy(update={"transfer": transfer, "lower": lower, "retreat": retreat})
        clearance.carry(in_hand)
        if all(map(clearance.free, np.concatenate([way.transfer.positions, way.lower.positions]))):
            return way
        return Failure(
            "executor", "as the object lies in the gripper, it would touch something on the way to its place"
        )

    def way_out(self, q: Float) -> Trajectory:
        """Straight back along the gripper's axis to where nothing is touched, among objects as arranged.

        It stays at `q` where nothing is touched there, or nowhere on that way.
        """
        path = self._inverse.line(q, self._back(self._clearance.hand_at(q)), 0.0)
        if path is None:
            return Trajectory.resting(q)
        clear = next((i for i, on_way in enumerate(path) if self._clearance.free(on_way)), 0)
        return self._timer.line(path[: clear + 1])

    def free_path(self, start: Float, goal: Float, arranged: Arranged) -> Trajectory | Failure:
        """A path from one pose of the arm to another, far from everything where such a path is found.

        Args:
            start: (J,) joint angles.
            goal: (J,) the same.
            arranged: puts objects where they are, as things to keep far from or not.
        """
        chain = self._clearance.robot.chain
        start = np.clip(start, chain.lower, chain.upper)  # what was measured at a limit can lie a rounding beyond it
        arranged(far=True)
        if self._clearance.free(start) and self._clearance.free(goal):
            path = self._searched(start, goal)
            if isinstance(path, Trajectory):
                return path
        arranged(far=False)
        return self._searched(start, goal)

    def _searched(self, start: Float, goal: Float) -> Trajectory | Failure:
        clearance, chain = self._clearance, self._clearance.robot.chain
        problem = MotionProblem(start, goal, chain.lower, chain.upper, clearance.free, clearance.world())
        path = self._planner.plan(problem, self._seed)
        return path if isinstance(path, Failure) else self._timer.free(path)


def _either_way(grasps: Sequence[Grasp]) -> Iterator[Grasp]:
    """Every grasp, and with the fingers exchanged."""
    for grasp in grasps:
        yield grasp
        yield replace(grasp, T_world_gripper=grasp.T_world_gripper @ _HALF_TURN)
