"""An object that no single grasp brings to its place stands aside in between."""

from __future__ import annotations

from contextlib import closing
from itertools import pairwise

import numpy as np
import pytest

from toolkit.geometry import make_transform, transform_points
from toolkit.rearrangement.executors.handling.planning import ArmPlanner, ArmSettings, Tools
from toolkit.rearrangement.executors.handling.regrasp import steps_of
from toolkit.rearrangement.moves import PickPlace
from toolkit.sim.client import Client
from toolkit.sim.robot import Robot
from toolkit.sim.robots import ROBOTS
from toolkit.types import Failure

PANDA = ROBOTS["panda"]
HOME = np.array(PANDA.home)
T_GOAL = make_transform(np.eye(3), np.array([0.05, -0.45, 0.0]))


def block(low, high):
    """(N, 3) points on the sides of a box, every 2 mm."""
    axes = (np.linspace(a, b, round((b - a) / 0.002) + 1) for a, b in zip(low, high, strict=True))
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    return points[((points < np.array(low) + 1e-6) | (points > np.array(high) - 1e-6)).any(axis=1)]


CUBE = block([0.43, 0.2, 0.0], [0.47, 0.24, 0.04])
"""It can be taken along x or along y, from above."""

BESIDE = [block([0.43 + off, 0.19, 0], [0.45 + off, 0.25, 0.04]) for off in (-0.034, 0.054)]
BEFORE = [block([0.42, 0.2 + off, 0], [0.48, 0.22 + off, 0.04]) for off in (-0.034, 0.054)]
"""Walls so near to two of its sides that no finger fits between."""


@pytest.fixture(scope="module")
def planner():
    with closing(Client()) as client:
        yield ArmPlanner(Tools(ArmSettings(robot="panda")), Robot(client, PANDA, np.eye(4)))


def among(start, goal):
    """The cube among walls where it stands, and among walls where it is to be put."""
    return PickPlace(CUBE, T_GOAL, np.concatenate([*start, *(transform_points(T_GOAL, wall) for wall in goal)]))


def test_what_one_grasp_serves_is_moved_in_one_step(planner):
    (step,) = steps_of(planner, among(BESIDE, BESIDE), HOME, 0)
    np.testing.assert_array_equal(step.T_place_pick, T_GOAL)


def test_where_no_grasp_serves_both_places_the_object_stands_aside(planner):
    asked = among(BESIDE, BEFORE)
    assert isinstance(planner.plan(asked, HOME, 0), Failure)
    first, second = steps_of(planner, asked, HOME, 0)
    np.testing.assert_allclose(second.T_place_pick @ first.T_place_pick, T_GOAL, atol=1e-9)
    aside = transform_points(first.T_place_pick, CUBE)
    np.testing.assert_allclose(aside[:, 2], CUBE[:, 2], atol=1e-9)  # it stands as it stood
    assert np.linalg.norm(aside[:, None, :2] - asked.others[None, ::7, :2], axis=2).min() > 0.04
    for step in (first, second):
        parts = (step.way.to_grasp, step.way.approach, step.way.lift, step.way.transfer, step.way.lower)
        for before, after in pairwise([*parts, step.way.retreat]):
            np.testing.assert_allclose(before.end, after.start, atol=1e-6)
    np.testing.assert_allclose(second.way.to_grasp.start, first.way.retreat.end, atol=1e-6)
    np.testing.assert_array_equal(planner.clearance.points, asked.points)  # where it stands, not where it is to stand
    at_start, aside = (step.way.T_world_gripper[:3, 0] for step in (first, second))
    at_goal = second.T_place_pick[:3, :3] @ aside
    assert abs(at_start[1]) > 0.9 and abs(at_goal[0]) > 0.9


@pytest.mark.parametrize(("start", "goal"), [(BESIDE + BEFORE, BESIDE), (BESIDE, BESIDE + BEFORE)])
def test_what_cannot_be_taken_or_put_down_at_all_is_not_stood_aside(planner, start, goal):
    asked = among(start, goal)
    failure = planner.plan(asked, HOME, 0)
    assert isinstance(failure, Failure) and steps_of(planner, asked, HOME, 0) == failure
    np.testing.assert_array_equal(planner.clearance.points, asked.points)
