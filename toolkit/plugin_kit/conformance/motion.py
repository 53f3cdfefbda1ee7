"""What every motion planner must do."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from toolkit.plugin_kit.conformance.kit import Check, Subject, require, require_same_twice
from toolkit.rearrangement.moves import MotionProblem
from toolkit.rearrangement.paths import densify
from toolkit.types import ArmWorld, Failure, Float, Shape, Solid

_START, _GOAL = (-0.5, -0.5, 0.0), (0.5, -0.5, 0.0)
_HALF_M, _THIN_M = 0.1, 0.05
"""Half as thick as this are the wall and the post."""

_GAP_M = 0.8


def a_path_leads_around_what_is_in_the_way(subject: Subject) -> str:
    """A wall with a gap at its end: (N, 3) from start to goal, free all along, within the joints' limits."""
    path = subject.make().plan(wall(_GAP_M), 0)
    require(not isinstance(path, Failure), f"no path around a wall: {path}")
    require(path.ndim == 2 and path.shape[1] == 3, f"a path must be (N, 3), got {path.shape}")
    ends = np.abs(path[[0, -1]] - [_START, _GOAL]).max()
    require(ends < 1e-6, "the path does not lead from the start to the goal")
    require((np.abs(path) <= 1 + 1e-9).all(), "the path leaves the joints' limits")
    touched = sum(not wall(_GAP_M).free(q) for q in densify(path, 0.02))
    require(touched == 0, f"the path touches the wall at {touched} places")
    return f"{len(path)} points"


def an_arm_with_seven_joints_gets_there(subject: Subject) -> str:
    """Joints that turn around either way, and a post half way: (N, 7) from start to goal, and past it."""
    problem = post()
    path = subject.make().plan(problem, 0)
    require(not isinstance(path, Failure), f"no path past what is half way: {path}")
    require(path.ndim == 2 and path.shape[1] == 7, f"a path must be (N, 7), got {path.shape}")
    ends = np.abs(path[[0, -1]] - [problem.start, problem.goal]).max()
    require(ends < 1e-6, "the path does not lead from the start to the goal")
    nearest = min(float(np.abs(q[:2]).max()) for q in densify(path, 0.02))
    # Between two checks, a corner of the post may be cut.
    require(nearest > _THIN_M / 2, "the path leads through what is half way")
    return f"{len(path)} points"


def what_cannot_be_reached_is_a_failure(subject: Subject) -> None:
    """A goal inside the wall: a Failure of stage 'motion' with a reason, never an exception."""
    answer = subject.make().plan(wall(_GAP_M, goal=(0.0, 0.0, 0.0)), 0)
    require(isinstance(answer, Failure), f"must be a Failure, got {type(answer).__name__}")
    require(answer.stage == "motion" and answer.reason, "the Failure must name stage 'motion' and a reason")


def a_search_ends(subject: Subject) -> str:
    """A wall without a gap: a Failure after a number of steps, the same one twice; a clock must not decide."""
    answers = [subject.make().plan(wall(None), 0) for _ in range(2)]
    for answer in answers:
        require(isinstance(answer, Failure), f"there is no way through a wall, but it gives {type(answer).__name__}")
    require(answers[0] == answers[1], f"two searches end differently: {answers[0].reason}; {answers[1].reason}")
    return answers[0].reason


def the_same_seed_gives_the_same_bytes(subject: Subject) -> None:
    """New instances agree, whatever the global random generators are at."""
    require_same_twice(lambda: subject.make().plan(wall(_GAP_M), 7), "the path")


def wall(gap_from: float | None, start: Sequence[float] = _START, goal: Sequence[float] = _GOAL) -> MotionProblem:
    """Three joints that slide a column along x, y and z, each within ±1, and a wall across x = 0.

    The wall ends at y = `gap_from`; it has no end where that is None.
    """
    end = np.inf if gap_from is None else gap_from

    def free(q: Float) -> bool:
        return bool(abs(q[0]) >= _HALF_M or q[1] >= end)

    solid = _box("wall", (-_HALF_M, -3, -1), (_HALF_M, min(end, 3), 1))
    bound = np.ones(3)
    return MotionProblem(np.array(start), np.array(goal), -bound, bound, free, _column(("x", "y", "z"), solid))


def post() -> MotionProblem:
    """Two joints that slide a column along x and y and five that turn it about itself, and a post half way."""
    bound = np.full(7, 2 * np.pi)
    start, goal = np.full(7, -0.2), np.full(7, 0.2)

    def free(q: Float) -> bool:
        return bool(np.abs(q[:2]).max() >= _THIN_M)

    solid = _box("post", (-_THIN_M, -_THIN_M, -1), (_THIN_M, _THIN_M, 1))
    turns = tuple(f"turn_{i}" for i in range(5))
    return MotionProblem(start, goal, -bound, bound, free, _column(("x", "y", *turns), solid))


def _box(name: str, low: Sequence[float], high: Sequence[float]) -> Solid:
    corners = np.array(list(product(*zip(low, high, strict=True))), np.float64)
    return Solid(name, Shape((corners,)), np.eye(4))


def _column(joints: tuple[str, ...], solid: Solid) -> ArmWorld:
    """A thin column, longer than anything is high, that `joints` move: contacts depend on x and y alone."""
    axes = {"x": "1 0 0", "y": "0 1 0"}
    names = ["base", *(f"after_{joint}" for joint in joints[:-1]), "column"]
    links = "".join(f'<link name="{name}"/>' for name in names[:-1])
    geometry = '<geometry><cylinder radius="0.01" length="6"/></geometry>'
    links += f'<link name="column"><collision>{geometry}</collision></link>'
    turning = {True: "revolute", False: "prismatic"}
    chain = "".join(
        f'<joint name="{joint}" type="{turning[joint.startswith("turn")]}"><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="{axes.get(joint, "0 0 1")}"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        for joint, parent, child in zip(joints, names[:-1], names[1:], strict=True)
    )
    urdf = f'<robot name="column">{links}{chain}</robot>'
    return ArmWorld(urdf, joints, {}, np.eye(4), (solid,), frozenset())


CHECKS: tuple[Check, ...] = (
    a_path_leads_around_what_is_in_the_way,
    an_arm_with_seven_joints_gets_there,
    what_cannot_be_reached_is_a_failure,
    a_search_ends,
    the_same_seed_gives_the_same_bytes,
)
