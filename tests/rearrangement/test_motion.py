"""Motion planners: paths that are free all along, the same for the same seed, and failures with a reason."""

from __future__ import annotations

import numpy as np
import pytest

from toolkit.rearrangement.moves import MotionProblem
from toolkit.rearrangement.paths import densify, length, shortcut
from toolkit.stages import MOTION_PLANNERS
from toolkit.types import Failure


def wall(q):
    """A wall between left and right with a gap at the top."""
    return not (abs(q[0]) < 0.1 and q[1] < 0.8)


def closed(q):
    return abs(q[0]) >= 0.1


def problem(free, start=(-0.5, -0.5, 0.0), goal=(0.5, -0.5, 0.0), time_s=5.0):
    bound = np.ones(3)
    return MotionProblem(np.array(start), np.array(goal), -bound, bound, free, time_s)


@pytest.fixture(params=MOTION_PLANNERS.names())
def planner(request):
    return MOTION_PLANNERS.create(request.param)


def test_paths_lead_around_what_is_in_the_way(planner):
    asked = problem(wall)
    path = planner.plan(asked, seed=0)
    np.testing.assert_allclose(path[[0, -1]], [asked.start, asked.goal])
    assert all(wall(q) for q in densify(path, 0.02))
    assert 2.0 < length(path) < 4.0


def test_what_is_free_is_gone_straight(planner):
    path = planner.plan(problem(wall, goal=(-0.5, 0.5, 0.3)), seed=0)
    assert len(path) == 2


def test_the_same_seed_gives_the_same_path(planner):
    first, second, other = (planner.plan(problem(wall), seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, second)
    assert first.shape != other.shape or not np.allclose(first, other)


def test_failures_have_reasons():
    planner = MOTION_PLANNERS.create("ompl")
    found = planner.plan(problem(closed, time_s=0.2), seed=0)
    assert isinstance(found, Failure) and found.reason == "no motion was found within 0.2 s"
    found = planner.plan(problem(wall, goal=(0.0, 0.0, 0.0)), seed=0)
    assert "would touch something at the motion's goal" in found.reason


def test_shortcuts_keep_the_ends_and_never_lengthen():
    rng = np.random.default_rng(0)
    detour = np.array([[-0.5, -0.5, 0], [-0.9, 0.2, 0.5], [-0.3, 0.95, -0.5], [0.4, 0.9, 0.5], [0.5, -0.5, 0]])
    shorter = shortcut(detour, wall, 0.02, 100, rng)
    np.testing.assert_array_equal(shorter[[0, -1]], detour[[0, -1]])
    assert length(shorter) < 0.8 * length(detour)
    assert all(wall(q) for q in densify(shorter, 0.02))
