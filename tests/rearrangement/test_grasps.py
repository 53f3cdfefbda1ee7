"""Grasps on shapes whose surfaces are known: closed by friction, wide enough, and clear of everything else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from toolkit.errors import ToolkitError
from toolkit.geometry import invert, make_transform, rotation_z, transform_points
from toolkit.rearrangement.grasps.geometry.gripper import boxes_of, lowest
from toolkit.rearrangement.moves import GraspRequest
from toolkit.rearrangement.surfaces import normals
from toolkit.sim.robots import ROBOTS
from toolkit.stages import GRASPERS
from toolkit.types import Failure

NOTHING = np.zeros((0, 3))
GRIPPER = ROBOTS["gen3"].gripper
FRICTION = 0.4
SPACING = 0.003
"""Clouds are thinned out before they are checked: what overlaps by less may be missed."""


def surface(mesh, count=6000):
    """Points of a mesh that stands on the table; what lies on the table is not seen."""
    points, _ = trimesh.sample.sample_surface(mesh, count, seed=0)
    points = np.asarray(points) - [0, 0, mesh.bounds[0, 2]]
    return points[points[:, 2] > 0.003]


def box(x, y, z, at=(0.0, 0.0)):
    return surface(trimesh.creation.box((x, y, z))) + np.array([*at, 0.0])


@pytest.fixture(scope="module", params=GRASPERS.names())
def grasper(request):
    found = GRASPERS.get(request.param)()
    try:
        found.check_ready()
    except ToolkitError as error:
        pytest.skip(str(error))
    return found


@pytest.fixture(scope="module")
def antipodal():
    return GRASPERS.create("antipodal")


def find(grasper, points, others=NOTHING, T=None, seed=0, gripper=GRIPPER):
    return grasper.grasp(GraspRequest(points, np.eye(4) if T is None else T, others, gripper, 0.08), seed)


SHAPES = {
    "box": box(0.04, 0.12, 0.08),
    "can": surface(trimesh.creation.cylinder(0.03, 0.10)),
    "ball": surface(trimesh.creation.icosphere(4, 0.035)),
    "dice": box(0.018, 0.018, 0.018),
    "bar": box(0.02, 0.2, 0.015),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_grasps_are_open_wide_enough_clear_and_point_down(grasper, shape):
    found = find(grasper, SHAPES[shape])
    assert not isinstance(found, Failure)
    for grasp in found:
        assert 0 < grasp.opening <= GRIPPER.stroke_m and 0 <= grasp.score <= 1
        boxes = boxes_of(GRIPPER, grasp.opening)
        assert lowest(grasp.T_world_gripper, boxes) >= 0.003
        assert grasp.T_world_gripper[2, 2] < 0
        own = transform_points(invert(grasp.T_world_gripper), SHAPES[shape])
        for low, high in boxes:
            assert ((own > low + SPACING) & (own < high - SPACING)).all(axis=1).sum() <= 3
        between = (np.abs(own[:, 0]) < grasp.opening / 2) & (np.abs(own[:, 1]) < 0.011) & (own[:, 2] > -0.045)
        assert between.sum() > 10
    scores = [grasp.score for grasp in found]
    assert scores == sorted(scores, reverse=True)


def test_a_box_is_held_across_its_narrow_sides_within_the_friction_cone(antipodal):
    """Its other sides are 12 cm apart, and above and below there is no room for a finger."""
    turned = transform_points(rotation_z(0.4), SHAPES["box"])
    for grasp in find(antipodal, turned):
        closing = rotation_z(-0.4)[:3, :3] @ grasp.T_world_gripper[:3, 0]
        assert abs(closing[0]) >= np.cos(np.arctan(FRICTION)) - 0.02


def test_a_ball_is_held_through_its_middle(antipodal):
    """Only lines through the middle, but for the friction cone, meet a ball's surface upright on both sides."""
    for grasp in find(antipodal, SHAPES["ball"]):
        own = transform_points(invert(grasp.T_world_gripper), np.array([[0, 0, 0.035]]))[0]
        assert np.hypot(own[1], own[2] + 0.005) < 0.035 * np.sin(np.arctan(FRICTION)) + 0.01


def test_a_bowl_is_held_by_its_rim(antipodal):
    outer, inner = trimesh.creation.cylinder(0.08, 0.06), trimesh.creation.cylinder(0.077, 0.06)
    walls = [np.asarray(trimesh.sample.sample_surface(m, 9000, seed=0)[0]) for m in (outer, inner)]
    walls = np.concatenate([wall[np.abs(wall[:, 2]) < 0.0299] for wall in walls]) + np.array([0, 0, 0.03])
    for grasp in find(antipodal, walls):
        assert 0.06 < np.hypot(*grasp.T_world_gripper[:2, 3]) < 0.09


def test_a_mug_that_fills_the_gripper_is_held_by_its_rim(antipodal):
    """Across, it leaves 2 to 4 mm: room in the boxes of a gripper, and too little for an arm that is not exact."""
    mug = surface(trimesh.creation.annulus(0.036, 0.0395, 0.09), 20000)
    found = find(antipodal, mug)
    assert len(found) <= antipodal.config.keep
    rim = [grasp for grasp in found if grasp.opening < 0.03]
    assert len(rim) > 5
    assert all(0.03 < np.hypot(*grasp.T_world_gripper[:2, 3]) < 0.05 for grasp in rim)
    tight = [grasp for grasp in found if grasp.spare < antipodal.config.spare_m]
    assert found[len(found) - len(tight) :] == tight


def test_a_bottle_is_taken_from_the_side(antipodal):
    """From above, its neck is in the way of all grasps on its body; and its body is most of it."""
    body, neck = trimesh.creation.cylinder(0.035, 0.15), trimesh.creation.cylinder(0.013, 0.05)
    neck.apply_translation([0, 0, 0.1])
    found = find(antipodal, surface(trimesh.util.concatenate([body, neck])))
    assert len(found) == antipodal.config.keep
    for grasp in found:
        assert grasp.T_world_gripper[2, 2] > -0.5 and grasp.closed == pytest.approx(0.07, abs=0.005)


def test_what_is_too_wide_says_so(antipodal):
    found = find(antipodal, box(0.2, 0.2, 0.2))
    assert found == Failure("grasp", "no two opposite surfaces lie within 8.1 cm of each other")


@pytest.mark.parametrize(("side", "spare"), [(0.07, 0.005), (0.08, 0.0025)])
def test_a_box_that_nearly_fills_the_gripper_is_taken_with_the_room_that_is_left(antipodal, side, spare):
    for grasp in find(antipodal, box(side, 0.15, 0.1)):
        assert grasp.spare == pytest.approx(spare, abs=5e-4) and grasp.closed == pytest.approx(side, abs=2e-3)
        assert grasp.opening <= GRIPPER.stroke_m


def test_neighbours_leave_only_the_grasps_that_miss_them(grasper):
    can = SHAPES["can"]
    wall = box(0.3, 0.02, 0.2, at=(0, 0.045))
    free, beside = find(grasper, can), find(grasper, can, wall)
    assert not isinstance(beside, Failure)
    for grasp in beside:
        own = transform_points(invert(grasp.T_world_gripper), wall)
        for low, high in boxes_of(GRIPPER, grasp.opening):
            assert not ((own > low + SPACING) & (own < high - SPACING)).all(axis=1).any()
    across = [abs(grasp.T_world_gripper[1, 0]) for grasp in free]
    assert max(across) > 0.8 > max(abs(grasp.T_world_gripper[1, 0]) for grasp in beside)
    walls = np.concatenate([box(0.3, 0.02, 0.2, at=(0, y)) for y in (0.045, -0.045)])
    walls = np.concatenate([walls, transform_points(rotation_z(np.pi / 2), walls)])
    assert "another object" in find(grasper, can, walls).reason


def test_the_gripper_that_is_asked_about_is_the_one_that_must_fit(grasper):
    """A narrow one does not span what a wide one does; one with a wide palm does not come between two walls."""
    narrow = replace(GRIPPER, stroke_m=0.03)
    assert isinstance(find(grasper, SHAPES["box"], gripper=narrow), Failure)
    walls = np.concatenate([box(0.02, 0.3, 0.2, at=(x, 0)) for x in (0.1, -0.1)])
    assert not isinstance(find(grasper, SHAPES["bar"], walls), Failure)
    wide = replace(GRIPPER, palm_m=(0.3, 0.3, 0.1))
    assert "another object" in find(grasper, SHAPES["bar"], walls, gripper=wide).reason


def test_fingers_close_on_the_object(antipodal):
    assert {round(grasp.closed, 2) for grasp in find(antipodal, SHAPES["box"])} == {0.04}


def test_there_must_be_room_where_it_is_put_as_well(grasper):
    can = SHAPES["can"]
    T = make_transform(np.eye(3), np.array([0.3, 0, 0]))
    there = box(0.3, 0.02, 0.2, at=(0.3, 0.045))
    across = [abs(grasp.T_world_gripper[1, 0]) for grasp in find(grasper, can, there, T)]
    assert max(across) < 0.8


def test_the_placement_is_the_motion_applied_to_the_grasp(grasper):
    T = make_transform(rotation_z(1.0)[:3, :3], np.array([0.1, 0.2, 0]))
    grasp = find(grasper, SHAPES["box"])[0]
    np.testing.assert_allclose(grasp.placed(T), T @ grasp.T_world_gripper)


def test_the_same_seed_gives_the_same_grasps(grasper):
    first, second = (find(grasper, SHAPES["can"], seed=7) for _ in range(2))
    assert [g.T_world_gripper.tobytes() for g in first] == [g.T_world_gripper.tobytes() for g in second]


def test_few_points_are_no_crash(grasper):
    for count in (0, 1, 2, 5):
        assert "points of the object were seen" in find(grasper, SHAPES["box"][:count]).reason


def test_normals_of_a_box_are_its_sides():
    points = SHAPES["box"]
    inside = np.sort(np.abs(points - np.array([0, 0, 0.04])) - np.array([0.02, 0.06, 0.04]), axis=1)[:, 1] < -0.01
    assert np.abs(normals(points)[inside]).max(axis=1).min() > 0.99
