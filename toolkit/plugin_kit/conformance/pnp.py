"""What every PnP solver must do."""

from __future__ import annotations

import numpy as np

from toolkit.geometry import invert, make_transform, project, rotation_angle, rotation_z
from toolkit.plugin_kit.conformance.kit import Check, Subject, require, require_array, require_same_twice
from toolkit.plugin_kit.conformance.scene import goal_frame
from toolkit.types import Correspondences, Failure, Float, PnPSolution

_TRUE, _WRONG = 60, 20
_MOTION = make_transform(rotation_z(0.6)[:3, :3], np.array([0.10, -0.05, 0.0]))
"""An object turns and slides on its table, which solvers that assume as much must find too."""


def the_pose_is_found_among_outliers(subject: Subject) -> str:
    """60 points of a 12 cm box with 0.3 px noise and 20 outliers: within 2 deg and 1 cm, in metres."""
    solution = subject.make().solve(_problem(), 0)
    require(isinstance(solution, PnPSolution), f"no PnPSolution for an easy problem: {solution}")
    truth = invert(goal_frame().camera.T_world_camera) @ _MOTION
    center = _points().mean(axis=0)
    turn = np.degrees(rotation_angle(truth[:3, :3].T @ solution.T_camera_world[:3, :3]))
    shift = 100 * np.linalg.norm((solution.T_camera_world - truth)[:3] @ np.append(center, 1))
    require(turn < 2 and shift < 1, f"the pose of an easy problem is {turn:.1f} deg and {shift:.1f} cm off")
    return f"{turn:.2f} deg, {shift:.2f} cm off"


def inliers_are_told_from_outliers(subject: Subject) -> None:
    """(N,) bool: most of the true correspondences, and hardly any of those that are 20 px off or more."""
    inliers = require_array(subject.make().solve(_problem(), 0).inliers, (_TRUE + _WRONG,), np.bool_, "inliers")
    require(inliers[:_TRUE].mean() > 0.7, f"only {inliers[:_TRUE].sum()} of {_TRUE} true correspondences are inliers")
    require(inliers[_TRUE:].sum() <= 1, f"{inliers[_TRUE:].sum()} of {_WRONG} outliers are called inliers")


def what_cannot_be_solved_is_a_failure(subject: Subject) -> None:
    """No point, two points, points in one place or on a line: a Failure with a reason, never an exception."""
    line = np.linspace(0, 1, 20)[:, None] * np.array([0.1, 0.05, 0.08])
    for what, points in (
        ("no correspondence", np.zeros((0, 3))),
        ("two correspondences", _points()[:2]),
        ("twenty times the same point", np.tile(_points()[:1], (20, 1))),
        ("points on a line", line),
    ):
        answer = subject.make().solve(_exact(points), 0)
        require(isinstance(answer, Failure), f"{what}: must be a Failure, got {type(answer).__name__}")
        require(answer.stage == "pnp" and answer.reason, f"{what}: the Failure must name stage 'pnp' and a reason")


def chance_agreement_is_not_a_pose(subject: Subject) -> None:
    """Random pixels: a Failure, or a solution that calls fewer than half of them inliers."""
    pixels = np.random.default_rng(3).uniform([0, 0], [320, 240], (40, 2))
    answer = subject.make().solve(Correspondences(_points()[:40], pixels, np.ones(40), goal_frame().camera), 0)
    if isinstance(answer, PnPSolution):
        require(answer.inliers.mean() < 0.5, f"{answer.inliers.sum()} of 40 random correspondences are called inliers")
    else:
        require(isinstance(answer, Failure), f"must be a PnPSolution or a Failure, got {type(answer).__name__}")


def the_same_seed_gives_the_same_bytes(subject: Subject) -> None:
    """New instances agree, whatever the global random generators are at."""
    require_same_twice(lambda: subject.make().solve(_problem(), 7), "the solution")


def _points() -> Float:
    """(60, 3) points on a box's top and sides, world of the current scene, metres."""
    points = np.random.default_rng(1).uniform(-0.06, 0.06, (_TRUE, 3))
    sides = np.arange(_TRUE) % 3
    points[np.arange(_TRUE), sides] = np.where(sides == 2, 0.06, np.sign(points[np.arange(_TRUE), sides]) * 0.06)
    return points + np.array([0.05, 0.1, 0.06])


def _exact(points: Float) -> Correspondences:
    camera = goal_frame().camera
    pixels, _ = project(camera.K, invert(camera.T_world_camera) @ _MOTION, points)
    return Correspondences(points, pixels, np.ones(len(points)), camera)


def _problem() -> Correspondences:
    rng = np.random.default_rng(2)
    exact = _exact(_points())
    away = rng.uniform(20, 60, (_WRONG, 2)) * rng.choice([-1, 1], (_WRONG, 2))
    pixels = np.concatenate([exact.pixels + rng.normal(0, 0.3, (_TRUE, 2)), exact.pixels[:_WRONG] + away])
    points = np.concatenate([exact.points, exact.points[:_WRONG]])
    return Correspondences(points, pixels, np.ones(len(points)), exact.camera)


CHECKS: tuple[Check, ...] = (
    the_pose_is_found_among_outliers,
    inliers_are_told_from_outliers,
    what_cannot_be_solved_is_a_failure,
    chance_agreement_is_not_a_pose,
    the_same_seed_gives_the_same_bytes,
)
