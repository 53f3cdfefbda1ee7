"""Motion planners: paths that are free all along, the same for the same seed, and failures with a reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from toolkit.errors import ToolkitError
from toolkit.geometry import make_transform, rotation_z
from toolkit.plugin_kit.conformance.motion import wall
from toolkit.rearrangement.paths import densify, length, shortcut
from toolkit.stages import MOTION_PLANNERS
from toolkit.types import ArmWorld, Failure, Shape, Solid

GAP = wall(0.8)


@pytest.fixture(params=MOTION_PLANNERS.names())
def planner(request):
    return MOTION_PLANNERS.create(request.param)


def test_paths_lead_around_what_is_in_the_way(planner):
    path = planner.plan(GAP, seed=0)
    np.testing.assert_allclose(path[[0, -1]], [GAP.start, GAP.goal])
    assert all(map(GAP.free, densify(path, 0.02)))
    assert 2.0 < length(path) < 4.0


def test_what_is_free_is_gone_straight(planner):
    path = planner.plan(wall(0.8, goal=(-0.5, 0.5, 0.3)), seed=0)
    assert len(path) == 2


@pytest.mark.parametrize("start", np.linspace(-0.5, -0.46, 6))
def test_thin_things_are_not_stepped_over(planner, start):
    """What is as thick as a seen point with its margin, 8 mm, and an arm's link of 2 cm: one way of 28 mm to touch."""
    half = 0.014
    thin = shifted(GAP.world, shape=Shape((GAP.world.solids[0].shape.pieces[0] * [0.04, 1, 1],)))
    problem = replace(
        GAP, start=np.array([start, -0.5, 0.0]), free=lambda q: bool(abs(q[0]) > half or q[1] > 0.81), world=thin
    )
    path = planner.plan(problem, seed=0)
    crossing = densify(path, 0.001)
    assert crossing[np.abs(crossing[:, 0]) < half - 0.005, 1].min() > 0.8


def test_the_same_seed_gives_the_same_path(planner):
    first, second, other = (planner.plan(GAP, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, second)
    assert first.shape != other.shape or not np.allclose(first, other)


def test_what_was_planned_before_changes_nothing(planner):
    fresh = MOTION_PLANNERS.create(planner.name)
    for asked in (wall(None), wall(0.5), GAP):
        path = planner.plan(asked, seed=3)
    np.testing.assert_array_equal(path, fresh.plan(GAP, seed=3))


@pytest.mark.parametrize(
    ("name", "settings", "said"),
    [("ompl", {"iterations": 300}, "in 300 iterations"), ("roboplan", {"nodes": 300}, "among 300 poses")],
)
def test_failures_have_reasons(name, settings, said):
    planner = MOTION_PLANNERS.create(name, settings)
    found = planner.plan(wall(None), seed=0)
    assert isinstance(found, Failure) and found.reason == f"no motion was found {said}"
    found = planner.plan(wall(0.8, goal=(0.0, 0.0, 0.0)), seed=0)
    assert "would touch something at the motion's goal" in found.reason


@pytest.mark.parametrize("name", ["ompl", "roboplan"])
def test_a_planner_that_is_not_installed_says_how_to_get_it(name, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(ToolkitError, match=r"pip install 'rearrange-toolkit\[arm\]'"):
        MOTION_PLANNERS.create(name).check_ready()


def test_a_description_that_roboplan_cannot_read_is_a_mistake():
    broken = replace(
        GAP, world=replace(GAP.world, urdf='<robot name="two roots"><link name="a"/><link name="b"/></robot>')
    )
    with pytest.raises(ToolkitError, match="RoboPlan cannot read the robot's description"):
        MOTION_PLANNERS.create("roboplan").plan(broken, seed=0)


def shifted(world, **changes):
    """The wall's world with its one solid changed."""
    (solid,) = world.solids
    return replace(world, solids=(replace(solid, **changes),))


def test_shapes_are_where_the_world_says():
    """The same wall seen from a base that stands elsewhere, and by a planner that has placed it before."""
    planner = MOTION_PLANNERS.create("roboplan")
    straight = wall(0.8, goal=(-0.5, 0.5, 0.3))
    assert len(planner.plan(straight, seed=0)) == 2
    T = rotation_z(0.7) @ make_transform(np.eye(3), np.array([3.0, -1.0, 0.2]))
    world = shifted(GAP.world, pose=T)
    np.testing.assert_allclose(
        planner.plan(replace(GAP, world=replace(world, T_world_base=T)), seed=3), planner.plan(GAP, seed=3), atol=1e-6
    )
    away = replace(GAP, world=shifted(GAP.world, pose=make_transform(np.eye(3), np.array([0, 0, 9.0]))))
    assert len(planner.plan(away, seed=0)) == 2


def test_what_may_touch_is_no_obstacle():
    planner = MOTION_PLANNERS.create("roboplan")
    allowed = replace(GAP, world=replace(GAP.world, allowed=frozenset({("wall", "column")})))
    assert len(planner.plan(allowed, seed=0)) == 2
    assert len(planner.plan(GAP, seed=0)) > 2


def test_what_is_carried_hits_other_things_and_things_may_stand_on_each_other():
    """A plate on the column is wider than the gap, and the wall stands on a floor."""
    planner = MOTION_PLANNERS.create("roboplan")
    (solid,) = GAP.world.solids
    floor = Solid(
        "floor", Shape((solid.shape.pieces[0] * [50, 1, 0.1],)), make_transform(np.eye(3), np.array([0, 0, -1]))
    )
    column = GAP.world.arm, frozenset({("floor", "column"), ("plate", "column"), ("floor", "plate")})

    def carrying(half):
        corners = half * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
        plate = Solid("plate", Shape((corners,)), np.eye(4), held_by="column")
        world = ArmWorld(GAP.world.urdf, column[0], {}, np.eye(4), (solid, floor, plate), column[1])
        return planner.plan(replace(GAP, world=world), seed=0)

    small = carrying(0.03)
    assert not isinstance(small, Failure)
    crossing = densify(small, 0.01)
    assert crossing[np.abs(crossing[:, 0]) < 0.1, 1].min() > 0.8 + 0.03 - 1e-3
    assert isinstance(carrying(0.3), Failure)


def test_what_a_fixed_link_carries_is_where_that_link_is():
    """A hand 5 m above the column's middle carries a plate far above the wall, or 5 m below the hand, in it."""
    hand = '<link name="hand"/><joint name="wrist" type="fixed"><parent link="column"/><child link="hand"/>'
    urdf = GAP.world.urdf.replace("</robot>", hand + '<origin xyz="0 0 5"/></joint></robot>')
    (solid,) = GAP.world.solids
    corners = 0.3 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    T_hand_plate = make_transform(np.eye(3), np.array([0, 0, -5.0]))
    allowed = frozenset({("plate", "column"), ("wall", "column")})
    for pose, free in ((np.eye(4), True), (T_hand_plate, False)):
        plate = Solid("plate", Shape((corners,)), pose, held_by="hand")
        world = ArmWorld(urdf, GAP.world.arm, {}, np.eye(4), (solid, plate), allowed)
        path = MOTION_PLANNERS.create("roboplan").plan(replace(GAP, world=world), seed=0)
        assert (not isinstance(path, Failure) and len(path) == 2) == free


def test_shortcuts_keep_the_ends_and_never_lengthen():
    rng = np.random.default_rng(0)
    detour = np.array([[-0.5, -0.5, 0], [-0.9, 0.2, 0.5], [-0.3, 0.95, -0.5], [0.4, 0.9, 0.5], [0.5, -0.5, 0]])
    shorter = shortcut(detour, GAP.free, 0.02, 100, rng)
    np.testing.assert_array_equal(shorter[[0, -1]], detour[[0, -1]])
    assert length(shorter) < 0.8 * length(detour)
    assert all(map(GAP.free, densify(shorter, 0.02)))
