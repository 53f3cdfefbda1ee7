"""What every motion planner must do."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from toolkit.plugin_kit.conformance.kit import Check, Subject, require, require_same_twice
from toolkit.rearrangement.moves import MotionProblem
from toolkit.rearrangement.paths import densify
from toolkit.types import Failure, Float

_BOUND = np.ones(3)
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


def what_cannot_be_reached_is_a_failure(subject: Subject) -> None:
    """A goal inside the wall: a Failure of stage 'motion' with a reason, never an exception."""
    answer = subject.make().plan(_problem(_gap, np.zeros(3)), 0)
    require(isinstance(answer, Failure), f"must be a Failure, got {type(answer).__name__}")
    require(answer.stage == "motion" and answer.reason, "the Failure must name stage 'motion' and a reason")


def the_same_seed_gives_the_same_bytes(subject: Subject) -> None:
    """New instances agree, whatever the global random generators are at."""
    require_same_twice(lambda: subject.make().plan(_problem(_gap), 7), "the path")


def _gap(q: Float) -> bool:
    return not (abs(q[0]) < 0.1 and q[1] < 0.8)


def _problem(free: Callable[[Float], bool], goal: Float = _GOAL) -> MotionProblem:
    return MotionProblem(_START, goal, -_BOUND, _BOUND, free)


CHECKS: tuple[Check, ...] = (
    a_path_leads_around_what_is_in_the_way,
    what_cannot_be_reached_is_a_failure,
    the_same_seed_gives_the_same_bytes,
)
