"""What happens to an object between fingers that close, and space that no camera saw into."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from toolkit.geometry import invert, look_at, make_transform, rotation_z, transform_points
from toolkit.rearrangement.executors.drivers.simulated import Simulated
from toolkit.rearrangement.executors.handling.mover import Mover
from toolkit.rearrangement.executors.handling.planning import ArmSettings, Tools
from toolkit.rearrangement.executors.handling.reach import Reach
from toolkit.rearrangement.executors.handling.squeeze import squeezed
from toolkit.rearrangement.executors.handling.timing import Timer
from toolkit.rearrangement.hidden import empty_below, hidden_space
from toolkit.rearrangement.moves import Grasp
from toolkit.rearrangement.plans import Way
from toolkit.rearrangement.trajectories import Trajectory
from toolkit.sim.bench import Bench
from toolkit.sim.clearance import Clearance
from toolkit.sim.client import Client
from toolkit.sim.robot import Robot
from toolkit.sim.robots import ROBOTS
from toolkit.stages import MOTION_PLANNERS
from toolkit.types import Camera, Failure, Frame

GRIPPER = ROBOTS["gen3"].gripper
DOWN = np.diag([1.0, -1.0, -1.0])


def bar(angle):
    """(N, 3) a bar of 30 x 2 x 3 cm on the table, along y but for `angle` radians, with its middle at (0.4, 0.1)."""
    x, y, z = np.meshgrid(np.linspace(-0.01, 0.01, 11), np.linspace(-0.15, 0.15, 151), np.linspace(0, 0.03, 16))
    inside = (np.abs(x) < 0.01) & (z < 0.03)
    points = np.stack([x[~inside], y[~inside], z[~inside]], axis=1)
    return transform_points(rotation_z(angle), points) + np.array([0.4, 0.1, 0])


def grasp(yaw):
    """From above, on the bar's middle, closing along x but for `yaw` radians."""
    T = rotation_z(yaw) @ make_transform(DOWN, np.zeros(3))
    T[:3, 3] = [0.4, 0.1, 0.01]
    return Grasp(T, 0.035, 0.0075, 1.0)


@given(st.floats(-0.2, 0.2), st.floats(-3.0, 3.0))
def test_fingers_turn_a_bar_until_it_lies_along_them(off, yaw):
    turns = [np.arctan2(T[1, 0], T[0, 0]) for T in squeezed(bar(off + yaw), grasp(yaw), GRIPPER)]
    # A bar that is nearly along them is held as it is, by friction.
    assert abs(max(turns, key=abs) + off) < np.radians(2.5)
    assert all(min(0, -off) - 0.05 < turn < max(0, -off) + 0.05 for turn in turns)


def test_fingers_push_either_way_about_the_grasp_and_never_off_the_table():
    motions = squeezed(bar(0.1), grasp(0.0), GRIPPER)
    at = grasp(0.0).T_world_gripper[:3, 3]
    shifts = sorted(round(float((transform_points(T, at) - at)[0]), 6) for T in motions)
    assert shifts[0] == -0.0075 and shifts[-1] == 0.0075
    for T in motions:
        np.testing.assert_allclose(T[2], [0, 0, 1, 0], atol=1e-12)


def test_what_is_round_is_not_turned():
    angles = np.linspace(0, 2 * np.pi, 400)
    can = np.concatenate(
        [
            np.stack([0.4 + 0.01 * np.cos(angles), 0.1 + 0.01 * np.sin(angles), 0 * angles + z], 1)
            for z in np.linspace(0, 0.02, 5)
        ]
    )
    for T in squeezed(can, grasp(0.3), GRIPPER):
        np.testing.assert_allclose(T[:3, :3], np.eye(3), atol=1e-12)


PANDA = ROBOTS["panda"]
LIMITS = Tools(ArmSettings(robot="panda")).limits


def at_grasp(robot, held):
    """(J,) angles of a Panda whose fingers are around what a grasp holds."""
    hand = held.T_world_gripper @ invert(robot.T_hand_tips(held.closed))
    return robot.chain.solve(hand, np.array(PANDA.home)[None])[0]


@pytest.mark.parametrize("off", [0.1, -0.15])
def test_fingers_turn_a_bar_as_was_foreseen(off, tmp_path):
    """With friction and contacts, in the simulator."""
    file = tmp_path / "bar.obj"
    trimesh.creation.box([0.02, 0.3, 0.03]).export(file)
    pose = rotation_z(off)
    pose[:3, 3] = [0.4, 0.1, 0.015]
    with closing(Bench(PANDA, np.eye(4), [([file], 0.2)], [pose])) as bench:
        held = grasp(0.0)
        bench.target = at_grasp(bench.robot, held)
        bench.grip = bench.robot.drive_for(held.opening)
        bench.robot.set(bench.target)
        bench.robot.set_drive(bench.grip)
        bench.wait(0.1, "settling", 0)
        before = bench.pose(0)
        driver = Simulated(bench, lambda pose: None)
        driver.handled = 0
        Mover(driver, LIMITS, PANDA.gripper.stroke_m).close()
        motion = bench.pose(0) @ invert(before)
    turned = np.arctan2(motion[1, 0], motion[0, 0])
    foreseen = squeezed(bar(off), held, PANDA.gripper)[-1]
    assert abs(turned - np.arctan2(foreseen[1, 0], foreseen[0, 0])) < np.radians(2)
    assert abs(turned) > np.radians(4)


def panda():
    """What is known of the surroundings of a Panda, and the ways it finds there."""
    with closing(Client()) as client:
        clearance = Clearance(Robot(client, PANDA, np.eye(4)), margin=0.002)
    timer = Timer(clearance, LIMITS, joint_speed=0.8, line_speed=0.25)
    return clearance, Reach(clearance, MOTION_PLANNERS.create("roboplan"), timer, approach_m=0.08, seed=0)


def test_a_bar_is_not_turned_against_its_neighbour():
    """A post beside the bar's end, on the side to which closing fingers turn it, and on the other."""
    clearance, reach = panda()
    lies = bar(0.15)  # its far end points to smaller x, and is turned to larger x
    far_end = lies[lies[:, 1].argmax()]
    ways = {}
    for side in (0.035, -0.045):
        post = far_end + np.array([side, 0, 0]) + np.random.default_rng(0).uniform(-0.008, 0.008, (500, 3))
        clearance.see(lies, post)
        ways[side] = reach.plan(np.array(PANDA.home), [grasp(0.0)], make_transform(np.eye(3), np.array([0, -0.05, 0])))
    assert isinstance(ways[-0.045], Way)
    assert isinstance(ways[0.035], Failure) and "no straight way leads to any grasp" in ways[0.035].reason


def test_a_place_that_is_taken_is_found_out_before_grasps_are_tried(monkeypatch):
    clearance, reach = panda()
    clearance.see(bar(0.0), bar(0.0) + np.array([0.1, 0, 0]))
    monkeypatch.setattr(Reach, "_lines", lambda *_: 1 / 0)
    there = make_transform(np.eye(3), np.array([0.11, 0, 0]))
    answer = reach.plan(np.array(PANDA.home), [grasp(0.0)], there)
    assert answer == Failure("executor", "another object is in the way where it is to be put")


@pytest.mark.parametrize(("opening", "taken"), [(0.035, True), (0.033, False)])
def test_what_fills_the_opened_gripper_is_not_taken(opening, taken):
    """A bar of 31.5 mm, full cubes of 2 mm: with half a millimetre to either side, it would hardly be let go again."""
    clearance, reach = panda()
    middle = np.array([0.4, 0, 0])
    clearance.see((bar(0.0) - middle) * [31.5 / 20, 1, 1] + middle, np.zeros((0, 3)))
    held = replace(grasp(0.0), opening=opening, spare=0.5e-3)
    way = reach.plan(np.array(PANDA.home), [held], make_transform(np.eye(3), np.array([0, -0.05, 0])))
    assert isinstance(way, Way) == taken


def test_from_a_joint_that_was_measured_a_rounding_beyond_its_limit_there_are_ways():
    """Around a post: straight on, nothing is searched."""
    clearance, reach = panda()
    post = np.random.default_rng(0).uniform([0.35, -0.02, 0], [0.6, 0.02, 0.7], (5000, 3))
    clearance.see(bar(0.0) + np.array([-0.9, 0, 0]), post)
    start, goal = np.array(PANDA.home), np.array(PANDA.home)
    start[[0, 6]], goal[0] = (-0.8, clearance.robot.chain.upper[6] + 1e-12), 0.8
    path = reach.free_path(start, goal, partial(clearance.arrange, clearance.drive))
    assert isinstance(path, Trajectory) and len(path.positions) > 2
    assert (path.positions <= clearance.robot.chain.upper).all()
    np.testing.assert_allclose(path.start, start, atol=1e-9)


def test_a_free_path_keeps_far_where_there_is_room():
    """Over a bar lying across the straight way: a path that is only just free would do, and another one is taken."""
    clearance, reach = panda()
    start = np.array(PANDA.home)
    start[0] = -0.8
    goal = start * np.array([-1, 1, 1, 1, 1, 1, 1])
    post = np.random.default_rng(0).uniform([0.35, -0.02, 0], [0.6, 0.02, 0.7], (5000, 3))
    clearance.see(bar(0.0) + np.array([-0.9, 0, 0]), post)
    arranged = partial(clearance.arrange, clearance.drive)
    path = reach.free_path(start, goal, arranged)
    arranged(far=True)
    assert all(map(clearance.free, path.positions))


def test_a_free_path_comes_near_where_there_is_no_other():
    """The arm begins between a near thing's margin and that of keeping far."""
    clearance, reach = panda()
    q = np.array(PANDA.home)
    arranged = partial(clearance.arrange, clearance.drive)
    for beside in np.arange(0.02, 0.12, 0.001):
        tip = clearance.hand_at(q) @ make_transform(np.eye(3), np.array([0, beside, 0.1]))
        clearance.see(np.zeros((0, 3)), tip[None, :3, 3])
        arranged(far=True)
        tight = not clearance.free(q)
        arranged(far=False)
        if tight and clearance.free(q):
            break
    else:
        pytest.fail("nowhere is only the larger margin in the way")
    assert isinstance(reach.free_path(q, q + np.array([0, -0.2, 0, 0, 0, 0, 0]), arranged), Trajectory)


CAMERA_K = np.array([[300.0, 0, 160], [0, 300.0, 120], [0, 0, 1]])


def frame(eye, box):
    """What a camera at `eye` measures of a box (its two corners) on a table."""
    T = look_at(np.array(eye), np.zeros(3))
    v, u = np.mgrid[0:240, 0:320]
    rays = np.stack([(u - 160) / 300, (v - 120) / 300, np.ones_like(u)], axis=-1).reshape(-1, 3) @ T[:3, :3].T
    with np.errstate(divide="ignore"):
        depth = np.where(rays[:, 2] < 0, -T[2, 3] / rays[:, 2], 0.0)
    with np.errstate(divide="ignore"):
        bounds = np.sort((np.array(box)[:, None] - T[:3, 3]) / rays[None], axis=0)
    near, far = bounds[0].max(axis=1), bounds[1].min(axis=1)
    depth = np.where((near < far) & (near > 0), near, depth)
    return Frame(0, np.zeros((240, 320, 3), np.uint8), Camera(CAMERA_K, T, 320, 240), depth.reshape(240, 320))


BOX = (np.array([-0.05, -0.05, 0.0]), np.array([0.05, 0.05, 0.1]))
RING = [(0.7 * np.cos(a), 0.7 * np.sin(a), 0.5) for a in np.arange(8) * np.pi / 4]


def box_cloud():
    """(N, 3) the box's surface."""
    grid = np.stack(np.meshgrid(*[np.linspace(a, b, 41) for a, b in zip(*BOX, strict=True)]), axis=-1).reshape(-1, 3)
    return grid[((grid == BOX[0]) | (grid == BOX[1])).any(axis=1)]


def test_from_all_around_only_the_inside_is_hidden():
    hidden, elsewhere = hidden_space([frame(eye, BOX) for eye in RING], {4: box_cloud()})
    assert set(hidden) == {4} and len(elsewhere) == 0
    inside = ((hidden[4] > BOX[0] - 0.005) & (hidden[4] < BOX[1] + 0.005)).all(axis=1)
    assert inside.all()
    assert len(hidden[4]) > 300


def test_from_one_side_what_is_behind_is_hidden_and_what_is_in_front_is_not():
    hidden, elsewhere = hidden_space([frame((0.0, -0.8, 0.3), BOX)], {4: box_cloud()})
    full = np.concatenate([hidden[4], elsewhere])
    assert (full[:, 1] > BOX[0][1]).all()
    assert ((full[:, 1] > 0.1) & (full[:, 2] < 0.05) & (np.abs(full[:, 0]) < 0.03)).sum() > 50
    both, _ = hidden_space([frame((0.0, -0.8, 0.3), BOX), frame((0.0, 0.8, 0.3), BOX)], {4: box_cloud()})
    assert (np.abs(both[4][:, 1]) < 0.06).all()


def test_a_thing_that_is_no_instance_is_hidden_space_of_none():
    away = (np.array([0.1, -0.02, 0.0]), np.array([0.16, 0.02, 0.1]))
    cloud = box_cloud() - np.array([0.1, 0, 0])
    hidden, elsewhere = hidden_space([frame(eye, away) for eye in RING], {0: cloud})
    assert len(hidden[0]) == 0
    assert ((elsewhere > away[0] - 0.005) & (elsewhere < away[1] + 0.005)).all() and len(elsewhere) > 50


def test_where_nothing_was_found_nothing_is_hidden():
    hidden, elsewhere = hidden_space([frame(RING[0], BOX)], {})
    assert hidden == {} and elsewhere.shape == (0, 3)


LID = (np.array([-0.05, -0.05, 0.045]), np.array([0.05, 0.05, 0.05]))
"""It hangs in the air, as the rim of a bowl does."""


def lid_cloud():
    """(N, 3) its upper side."""
    x, y = np.meshgrid(np.linspace(-0.05, 0.05, 101), np.linspace(-0.05, 0.05, 101))
    return np.stack([x, y, np.full_like(x, 0.05)], axis=-1).reshape(-1, 3)


def test_what_a_camera_looked_under_is_empty_and_nothing_else_is():
    """From above a lid hides what is below it; from all around, low down, the cameras look under it."""
    low = [frame((0.7 * np.cos(a), 0.7 * np.sin(a), 0.1), LID) for a in np.arange(8) * np.pi / 4]
    seen = {
        "above": empty_below([frame((0.0, 0.01, 0.8), LID)], lid_cloud()),
        "under": empty_below(low, lid_cloud()),
        "solid": empty_below([frame(eye, BOX) for eye in RING], box_cloud()),
    }
    # Within a pixel (2.5 mm) of an edge, cameras look past it.
    found = {name: points[np.abs(points[:, :2]).max(axis=1) < 0.045] for name, points in seen.items()}
    assert len(found["above"]) == len(found["solid"]) == 0
    assert len(found["under"]) > 1000
    assert ((found["under"][:, 2] > 0.029) & (found["under"][:, 2] < 0.0475)).all()
    assert empty_below([], np.zeros((0, 3))).shape == (0, 3)
