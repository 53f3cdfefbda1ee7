"""The simulated arm: objects end where they were to be put, nothing else is touched, and what goes wrong has a name."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest
import trimesh

from toolkit.data.objects import load_object_set
from toolkit.data.tabletop import TabletopConfig, draw_scene
from toolkit.errors import ToolkitError
from toolkit.geometry import invert, make_transform, transform_points
from toolkit.rearrangement.executors.arm import Arm, ArmConfig
from toolkit.rearrangement.executors.handling.planning import ArmPlanner
from toolkit.rearrangement.grasps.antipodal import Antipodal
from toolkit.rearrangement.moves import PickPlace
from toolkit.sim.bench import Bench
from toolkit.sim.bullet import pybullet
from toolkit.sim.client import Client
from toolkit.sim.robot import Robot
from toolkit.sim.robots import ROBOTS
from toolkit.stages import GRASPERS
from toolkit.types import Failure

CONFIG = TabletopConfig(scenes=1, min_objects=4, max_objects=4, views=2, seed=1, renderer="tiny", supersample=1)


@pytest.fixture(scope="module")
def scene(cache):
    return draw_scene(CONFIG, load_object_set("procedural", cache), 0, cache)


@pytest.fixture(scope="module")
def arm(scene):
    executor = Arm(ArmConfig(robot="panda"))
    executor.begin(scene)
    yield executor
    executor.close()


def request(scene, arm, number, T_place_pick):
    clouds = []
    for asset, pose in zip(scene.assets, arm.state().values(), strict=True):
        points, _ = trimesh.sample.sample_surface(trimesh.load(asset.mesh, force="mesh"), 3000, seed=0)
        points = transform_points(pose, np.asarray(points))
        clouds.append(points[points[:, 2] > 0.004])
    others = [cloud for i, cloud in enumerate(clouds) if i != number]
    return PickPlace(clouds[number], T_place_pick, np.concatenate(others))


def nearest_first(arm):
    """Objects by their distance from the middle of the arm's reach."""
    return sorted(arm.state(), key=lambda number: np.linalg.norm(arm.state()[number][:2, 3]))


def moves(scene, arm, count):
    """Outcomes of moves of the objects in turn to places near the table's middle; some of the places are taken."""
    rng = np.random.default_rng(0)
    order = nearest_first(arm)
    for turn in range(count):
        number = order[turn % len(order)]
        shift = np.append(rng.uniform([-0.3, -0.15], [0.3, 0.2]) - arm.state()[number][:2, 3], 0)
        T = make_transform(np.eye(3), shift)
        before = arm.state()[number]
        wanted = T @ before
        asked = request(scene, arm, number, T)
        outcome = arm.pick_place(asked)
        assert outcome.object == number
        if outcome.T_moved is not None:  # what the camera says, against the truth
            middle, moved = asked.points.mean(axis=0), arm.state()[number] @ invert(before)
            off = transform_points(outcome.T_moved, middle) - transform_points(moved, middle)
            assert np.linalg.norm(off) < 0.005
        if outcome.failure is None:
            assert np.linalg.norm(arm.state()[number][:3, 3] - wanted[:3, 3]) <= arm.config.off_m
        else:
            assert outcome.failure.stage in ("executor", "grasp", "motion")
        yield outcome


def test_moves_succeed_touch_nothing_else_and_repeat(scene, arm):
    outcomes, states = [], []
    for outcome in moves(scene, arm, 2):
        outcomes.append(outcome)
        states.append(arm.state())
    assert sum(outcome.failure is None for outcome in outcomes) >= 1
    assert all(outcome.seconds > 2 for outcome in outcomes if outcome.failure is None)
    assert arm.touches == []

    again = Arm(ArmConfig(robot="panda"))
    again.begin(scene)
    assert list(moves(scene, again, 1)) == outcomes[:1]
    for number, pose in again.state().items():
        np.testing.assert_array_equal(pose, states[0][number])
    again.close()


def test_the_simulator_s_truth_can_be_asked_for(scene):
    told = Arm(ArmConfig(robot="panda", look="measured"))
    told.begin(scene)
    known = 0
    before = told.state()
    for outcome in moves(scene, told, 2):
        if outcome.T_moved is not None:
            moved = told.state()[outcome.object] @ invert(before[outcome.object])
            np.testing.assert_allclose(outcome.T_moved, moved, atol=1e-3)
            known += 1
        before = told.state()
    told.close()
    assert known > 0


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["panda", "gen3"])
def test_a_hundred_moves_touch_nothing_else(scene, robot):
    executor = Arm(ArmConfig(robot=robot))
    executor.begin(scene)
    outcomes = list(moves(scene, executor, 100))
    touches = executor.touches
    executor.close()
    assert sum(outcome.failure is None for outcome in outcomes) >= 25
    assert touches == []


def test_what_cannot_be_done_has_a_reason(scene, arm):
    before = arm.state()
    (number, *_) = nearest_first(arm)
    away = make_transform(np.eye(3), np.array([2.0, 0, 0]))
    assert arm.pick_place(request(scene, arm, number, away)).failure.reason == "the place lies beyond the table's edge"
    far = make_transform(np.eye(3), np.append(np.array([0.6, 0.6]) - before[number][:2, 3], 0))
    assert "out of the arm's reach" in arm.pick_place(request(scene, arm, number, far)).failure.reason
    nothing = PickPlace(request(scene, arm, number, away).points + np.array([0, 0, 1.0]), away, np.zeros((0, 3)))
    assert "there is no object" in arm.pick_place(nothing).failure.reason
    for number, pose in before.items():  # nothing has moved
        np.testing.assert_allclose(arm.state()[number], pose, atol=1e-4)


def test_what_stands_aside_is_looked_at_and_goes_on_from_there(scene, monkeypatch):
    """As if no single grasp had served both places."""
    asked, plan = [], ArmPlanner.plan

    def fails_first(self, request, q, seed):
        asked.append(request)
        return Failure("executor", "not in one") if len(asked) == 1 else plan(self, request, q, seed)

    monkeypatch.setattr(ArmPlanner, "plan", fails_first)
    with closing(Arm(ArmConfig(robot="panda"))) as arm:
        arm.begin(scene)
        number = 1  # a hammer, with room around it
        T = make_transform(np.eye(3), np.append(np.array([0.2, -0.1]) - arm.state()[number][:2, 3], 0))
        wanted = T @ arm.state()[number]
        outcome = arm.pick_place(request(scene, arm, number, T))
        assert outcome.failure is None and outcome.picks == arm.moves == len(asked) == 2
        np.testing.assert_allclose(arm.state()[number][:3, 3], wanted[:3, 3], atol=arm.config.off_m)
    one, onward = asked
    assert np.linalg.norm(onward.points.mean(axis=0) - one.points.mean(axis=0)) > 0.05
    there = (transform_points(request.T_place_pick, request.points) for request in asked)
    np.testing.assert_allclose(next(there), next(there), atol=1e-9)


def test_the_gripper_and_the_chain_are_the_description_s():
    with closing(Client()) as client:
        robot = Robot(client, ROBOTS["panda"], np.eye(4))
        for opening in (0.0, 0.03, 0.07):
            robot.set_drive(robot.drive_for(opening))
            assert 2 * robot.drive == pytest.approx(opening, abs=1e-3)  # a Panda's fingers slide by half of it each
        q = np.array(robot.model.home)
        robot.set(q)
        hand = robot.chain.end(q)
        np.testing.assert_allclose(hand, robot.T_world_hand(), atol=1e-6)
        (found, *_) = robot.chain.solve(hand, q[None] + 0.1)
        np.testing.assert_allclose(robot.chain.end(found), hand, atol=1e-3)


def test_one_drive_moves_both_fingers():
    """Pushed to one side with more than their force, they yield together or not at all."""
    bench = Bench(ROBOTS["panda"], np.eye(4), [], [])
    robot = bench.robot
    bench.grip = 0.02
    bench.wait(0.5, "opening", None)
    push = 2 * robot.model.grip * robot.T_world_hand()[:3, :3] @ robot.model.R_hand_gripper[:, 0]
    for _ in range(120):
        for tip in robot.tips:
            at = bench.client.link(robot.body, tip).mass_place
            bench.client.applyExternalForce(robot.body, tip, push.tolist(), at, pybullet.WORLD_FRAME)
        bench.step(bench.target, np.zeros(7), "holding", None)
    ways = list(robot.finger_drives.values())
    bench.close()
    np.testing.assert_allclose(ways, 0.02, atol=5e-4)


def test_an_object_is_found_below_the_arm(scene):
    (asset, *_), (pose, *_) = scene.assets, scene.current
    bench = Bench(ROBOTS["panda"], np.eye(4), [], [])
    x, y, _ = bench.robot.T_world_hand()[:3, 3]
    bench.close()
    below = make_transform(pose[:3, :3], np.array([x, y, pose[2, 3]]))
    bench = Bench(ROBOTS["panda"], np.eye(4), [(asset.hulls, asset.mass_kg)], [below])
    points, _ = trimesh.sample.sample_surface(trimesh.load(asset.mesh, force="mesh"), 50, seed=0)
    assert bench.under(transform_points(below, np.asarray(points))) == 0
    bench.close()


def test_what_the_arm_works_with_is_checked_and_digested_with_it(monkeypatch):
    class Weighty(Antipodal):
        """Has weights."""

        name = "weighty"

        def check_ready(self):
            raise ToolkitError("put its weights there")

        def digests(self):
            return {"grasps.pt": "a" * 64}

    monkeypatch.setattr(GRASPERS, "_entries", dict(GRASPERS._entries))
    GRASPERS.register(Weighty, "here")
    executor = Arm(ArmConfig(robot="panda", grasp={"name": "weighty", "friction": 0.3}))
    assert executor.digests() == {"grasps.pt": "a" * 64}
    with pytest.raises(ToolkitError, match="put its weights there"):
        executor.check_ready()


def test_a_task_that_cannot_be_taken_up_leaves_nothing_open(scene, monkeypatch):
    closed = []
    monkeypatch.setattr(Bench, "close", lambda bench: closed.append(bench))
    monkeypatch.setattr("toolkit.rearrangement.executors.arm.ArmPlanner", lambda *_: 1 / 0)
    executor = Arm(ArmConfig(robot="panda"))
    with pytest.raises(ZeroDivisionError):
        executor.begin(scene)
    assert len(closed) == 1
    executor.close()
    assert len(closed) == 1


def test_an_unknown_motion_planner_is_a_mistake():
    with pytest.raises(ToolkitError, match="unknown motion 'omlp'"):
        ArmConfig(robot="panda", motion="omlp")
