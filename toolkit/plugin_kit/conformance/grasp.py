"""What every grasper must do."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from toolkit.geometry import is_rigid
from toolkit.plugin_kit.conformance.kit import Check, Subject, require, require_same_twice
from toolkit.rearrangement.moves import Grasp, GraspRequest
from toolkit.sim.robots import ROBOTS
from toolkit.types import Failure, Float, Gripper

_NOTHING = np.zeros((0, 3))
_BOX = (0.04, 0.12, 0.08)
_GRIPPER = ROBOTS["gen3"].gripper
_APPROACH_M = 0.08


def grasps_hold_a_box(subject: Subject) -> str:
    """A 4 x 12 x 8 cm box, for the gripper of every robot: rigid poses above the table, scores in 0..1, best first."""
    return ", ".join(f"{name}: {_hold_a_box(subject, robot.gripper)} grasps" for name, robot in ROBOTS.items())


def _hold_a_box(subject: Subject, gripper: Gripper) -> int:
    found = _grasp(subject, _box(_BOX), gripper=gripper)
    require(not isinstance(found, Failure), f"no grasp of an easy box: {found}")
    require(isinstance(found, list) and found, "grasp() must give a list that is not empty, or a Failure")
    for grasp in found:
        require(isinstance(grasp, Grasp), f"grasp() must give Grasps, got {type(grasp).__name__}")
        T = grasp.T_world_gripper
        require(is_rigid(T), "T_world_gripper must be a rigid (4, 4) transform, metres")
        require(T[2, 3] > 0, f"the fingertips are {-100 * T[2, 3]:.1f} cm below the table")
        inside = (np.abs(T[:2, 3]) < np.array(_BOX[:2]) / 2 + 0.02).all() and T[2, 3] < _BOX[2] + 0.02
        require(inside, "the fingertips are not at the object")
        require(grasp.opening >= _BOX[0] - 0.005, f"fingers {100 * grasp.opening:.1f} cm apart do not span a 4 cm box")
        opens = f"{100 * grasp.opening:.1f} cm is wider than the gripper opens, {100 * gripper.stroke_m:.1f} cm"
        require(grasp.opening <= gripper.stroke_m, f"{opens}: it is in request.gripper")
        closed = grasp.opening - 2 * grasp.spare
        require(abs(closed - _BOX[0]) < 0.015, f"with that spare the fingers are {100 * closed:.1f} cm apart on 4 cm")
        require(0 <= grasp.score <= 1, f"a score must be in 0..1, got {grasp.score}")
    scores = [grasp.score for grasp in found]
    require(scores == sorted(scores, reverse=True), "grasps must come best first")
    return len(found)


def no_grasp_is_a_failure(subject: Subject) -> None:
    """No point, a few points, a box of 30 cm: a Failure with a reason, or grasps; never an exception, never []."""
    for what, points in (
        ("no point", _NOTHING),
        ("two points", _box(_BOX)[:2]),
        ("a large box", _box((0.3, 0.3, 0.3))),
    ):
        found = _grasp(subject, points)
        require(isinstance(found, Failure) or bool(found), f"{what}: an empty list must be a Failure with its reason")
        if isinstance(found, Failure):
            require(
                found.stage == "grasp" and found.reason, f"{what}: the Failure must name stage 'grasp' and a reason"
            )


def what_the_gripper_does_not_span_is_a_failure(subject: Subject) -> None:
    """The same box for a gripper that opens 3 cm: a Failure."""
    found = _grasp(subject, _box(_BOX), gripper=replace(_GRIPPER, stroke_m=0.03))
    require(isinstance(found, Failure), "a box of 4 cm is to be held by a gripper that opens 3 cm: see request.gripper")


def neighbours_do_not_stand_between_the_fingers(subject: Subject) -> None:
    """A wall along one side: no grasp has its fingertips in it."""
    wall = _box((0.02, 0.3, 0.2)) + np.array([0.05, 0.0, 0.0])
    found = _grasp(subject, _box(_BOX), wall)
    for grasp in [] if isinstance(found, Failure) else found:
        half = grasp.opening / 2 * grasp.T_world_gripper[:3, 0]
        for tip in (grasp.T_world_gripper[:3, 3] + half, grasp.T_world_gripper[:3, 3] - half):
            require(not 0.04 < tip[0] < 0.06, "a finger stands in a neighbouring object")


def the_same_seed_gives_the_same_bytes(subject: Subject) -> None:
    """New instances agree, whatever the global random generators are at."""
    require_same_twice(lambda: _grasp(subject, _box(_BOX)), "the list of grasps")


def _grasp(subject: Subject, points: Float, others: Float = _NOTHING, gripper: Gripper = _GRIPPER) -> Any:
    """What the arm asks; the points can only be read."""
    for asked in (points, others):
        asked.flags.writeable = False
    return subject.make().grasp(GraspRequest(points, np.eye(4), others, gripper, _APPROACH_M), 5)


def _box(size: tuple[float, float, float]) -> Float:
    """(N, 3) seen points of a box that stands on the table at the origin: 3000 on its sides, 1500 on its top."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.5, 0.5, (4500, 3))
    side = np.arange(4500) % 3
    rows = np.arange(4500)
    points[rows, side] = np.where(side == 2, 0.5, 0.5 * np.sign(points[rows, side]))
    points = (points + np.array([0, 0, 0.5])) * np.array(size)
    return points[points[:, 2] > 0.003]


CHECKS: tuple[Check, ...] = (
    grasps_hold_a_box,
    no_grasp_is_a_failure,
    what_the_gripper_does_not_span_is_a_failure,
    neighbours_do_not_stand_between_the_fingers,
    the_same_seed_gives_the_same_bytes,
)
