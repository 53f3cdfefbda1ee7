"""What every motion planner must do."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from toolkit.plugin_kit.conformance.kit import Check, Subject, require, require_same_twice
from toolkit.rearrangement.moves import MotionProblem
from toolkit.rearrangement.paths import densify
from toolkit.types import Failure, Float

_BOUND = np.ones(3)
_TIME_S = 5.0
_START, _GOAL = np.array([-0.5, -0.5, 0.0]), np.array([0.5, -0.5, 0.0])


def a_path_leads_around_what_is_in_the_way(subject: Subject) -> str:
    """A wall with a gap at its end: (N, 3) from start to goal, free all along, within the joints' limits."""
    path = subject.make().plan(_problem(_gap), 0)
    require(not isinstance(path, Failure), f"no path around a wall: {path}")
    require(path.ndim == 2 and path.shape[1] == 3, f"a path must be (N, 3), got {path.shape}")
    ends = np.abs(path[[0, -1]] - [_START, _GOAL]).max()
    require(ends < 1e-6, "the path does not lead from the start to the goal")
    require((np.abs(path) <= 1 + 1e-9).all(), "the path leaves the joints' limits")
    touched = sum(not _gap(q) for q in densify(path, 0.02))
    require(touched == 0, f"the path touches the wall at {touched} places")
    return f"{len(path)} points"


def an_arm_with_seven_joints_gets_there(subject: Subject) -> str:
    """Joints that turn around either way, and something half way: (N, 7) from start to goal, and past it."""
    start, goal = np.full(7, -0.2), np.full(7, 0.2)
    turns = np.full(7, 2 * np.pi)
    path = subject.make().plan(MotionProblem(start, goal, -turns, turns, lambda q: _norm(q) > 0.1, _TIME_S), 0)
    require(not isinstance(path, Failure), f"no path past what is half way: {path}")
    require(path.ndim == 2 and path.shape[1] == 7, f"a path must be (N, 7), got {path.shape}")
    require(np.abs(path[[0, -1]] - [start, goal]).max() < 1e-6, "the path does not lead from the start to the goal")
    nearest = min(map(_norm, densify(path, 0.01)))
    require(nearest > 0.05, "the path leads through what is half way")
    return f"{len(path)} points"


def what_cannot_be_reached_is_a_failure(subject: Subject) -> None:
    """A goal inside the wall: a Failure of stage 'motion' with a reason, never an exception."""
    answer = subject.make().plan(_problem(_gap, np.zeros(3)), 0)
    require(isinstance(answer, Failure), f"must be a Failure, got {type(answer).__name__}")
    require(answer.stage == "motion" and answer.reason, "the Failure must name stage 'motion' and a reason")


def a_search_ends_when_its_time_is_up(subject: Subject) -> str:
    """A wall without a gap and half a second: a Failure, in ten times as much processor time at most."""
    begun = time.process_time()
    answer = subject.make().plan(_problem(_wall, time_s=0.5), 0)
    spent = time.process_time() - begun
    require(isinstance(answer, Failure), f"there is no way through a wall, but it gives {type(answer).__name__}")
    require(spent < 5, f"it searches for {spent:.0f} s, and was given half a second: see problem.time_s")
    return f"{spent:.1f} s"


def the_same_seed_gives_the_same_bytes(subject: Subject) -> None:
    """New instances agree, whatever the global random generators are at."""
    require_same_twice(lambda: subject.make().plan(_problem(_gap), 7), "the path")


def _norm(q: Float) -> float:
    return float(np.linalg.norm(q))


def _gap(q: Float) -> bool:
    return _wall(q) or bool(q[1] >= 0.8)


def _wall(q: Float) -> bool:
    return bool(abs(q[0]) >= 0.1)


def _problem(free: Callable[[Float], bool], goal: Float = _GOAL, time_s: float = _TIME_S) -> MotionProblem:
    return MotionProblem(_START, goal, -_BOUND, _BOUND, free, time_s)


CHECKS: tuple[Check, ...] = (
    a_path_leads_around_what_is_in_the_way,
    an_arm_with_seven_joints_gets_there,
    what_cannot_be_reached_is_a_failure,
    a_search_ends_when_its_time_is_up,
    the_same_seed_gives_the_same_bytes,
)
