"""`toolkit plan`: a capture becomes a plan that holds together, and what is not planned has a sentence."""

from __future__ import annotations

import sys
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from usual import USUAL

from toolkit.cli.commands import main
from toolkit.data.bop import load_capture
from toolkit.errors import ToolkitError
from toolkit.geometry import invert, rotation_z
from toolkit.harness import plan as planning
from toolkit.harness.experiment import load_experiment, only_cell
from toolkit.harness.plan import PlanRequest, plan_folder
from toolkit.pictures.recording import has_rerun
from toolkit.progress import Progress
from toolkit.rearrangement.executors.handling.planning import ArmPlanner, ArmSettings, Tools
from toolkit.rearrangement.moves import Layout
from toolkit.rearrangement.plans import read_plan
from toolkit.rearrangement.sight import Sight
from toolkit.sim.client import Client
from toolkit.sim.robot import Robot
from toolkit.sim.robots import ROBOTS
from toolkit.types import Failure, PoseEstimate, Segment

PANDA = ROBOTS["panda"]
BASE = rotation_z(np.pi / 2)
BASE[:3, 3] = [0, -0.52, 0]
"""The benchmark's world has its origin in the middle of the table."""


def cell(**changes):
    chosen = {**{f"pipeline.{slot}": [name] for slot, name in USUAL.items()}, "pipeline.refiner": ["none"]}
    chosen |= {"pipeline.explainer": ["none"]}
    chosen |= {"rearrange.executor": [{"name": "arm", "robot": "panda"}], **changes}
    return only_cell(load_experiment("estimate", chosen, rearranges=True))


def planned(folder, out, T_world_base=BASE, film=False):
    return plan_folder(folder, cell(), out, PlanRequest(T_world_base, sure=0.5, film=film), Progress())


@pytest.fixture(scope="module")
def made(dataset, tmp_path_factory):
    """A plan of several moves and where it was written to, its film short."""
    out = tmp_path_factory.mktemp("plan")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(planning, "_TICK_S", 3.0)
        return out, planned(dataset / "000001", out, film=True)


def parts(plan):
    for move in plan.moves:
        way = move.way
        yield from (way.to_grasp, way.approach, way.lift, way.transfer, way.lower, way.retreat)
    if plan.to_home is not None:
        yield plan.to_home


def test_every_motion_starts_where_the_one_before_it_ends_and_none_is_too_fast(made):
    out, plan = made
    assert len(plan.moves) > 1 and read_plan(out / "plan.json").model_dump_json() == plan.model_dump_json()
    at = plan.robot.home
    for part in parts(plan):
        np.testing.assert_allclose(part.start, at, atol=1e-6)
        assert not part.too_fast(plan.robot.limits)
        at = part.end
    np.testing.assert_allclose(at, PANDA.home, atol=1e-6)


def test_the_hand_is_at_the_grasp_and_moves_as_the_object_is_to(made):
    _, plan = made
    with closing(Client()) as client:
        robot = Robot(client, PANDA, BASE)
    for move in plan.moves:
        tips = robot.T_hand_tips(move.way.closed_m)
        at_grasp, at_place = (robot.chain.end(part.end) @ tips for part in (move.way.approach, move.way.lower))
        np.testing.assert_allclose(at_grasp, move.way.T_world_gripper, atol=2e-3)
        np.testing.assert_allclose(at_place, move.T_place_pick @ at_grasp, atol=2e-3)
        risen = robot.chain.end(move.way.lift.end)[:3, 3] - robot.chain.end(move.way.lift.start)[:3, 3]
        assert risen[2] > 0.05 and np.linalg.norm(risen[:2]) < 1e-3


def test_what_no_single_grasp_brings_to_its_place_is_planned_in_two_moves(dataset, made, tmp_path, monkeypatch):
    _, whole = made
    answers, plan = [], ArmPlanner.plan

    def fails_first(self, request, q, seed):
        answers.append(Failure("executor", "not in one") if not answers else plan(self, request, q, seed))
        return answers[-1]

    monkeypatch.setattr(ArmPlanner, "plan", fails_first)
    aside, onward, *_ = made_now = planned(dataset / "000001", tmp_path).moves
    (first, *_) = whole.moves
    assert (aside.object, aside.to, onward.object, onward.to) == (first.object, "buffer", first.object, first.to)
    assert aside.reason == "no single grasp serves both places; it is taken anew from here"
    np.testing.assert_allclose(onward.T_place_pick @ aside.T_place_pick, first.T_place_pick, atol=1e-9)
    assert len(made_now) == len(whole.moves) + 1
    at = np.array(PANDA.home)
    for move in made_now:
        np.testing.assert_allclose(move.way.to_grasp.start, at, atol=1e-6)
        at = move.way.retreat.end


def test_by_default_the_world_is_the_frame_of_the_robots_base(dataset, made, tmp_path, monkeypatch):
    """As hand-eye calibration makes it. Joints are the same wherever the world's origin lies."""
    _, plan = made
    level = invert(BASE)
    capture = load_capture(dataset / "000001")
    moved = replace(capture, current=[f.moved(level) for f in capture.current], goal=capture.goal.moved(level))
    monkeypatch.setattr(planning, "read_capture", lambda *_: moved)
    same = planned(dataset / "000001", tmp_path, np.eye(4))
    assert [move.object for move in same.moves] == [move.object for move in plan.moves]
    for ours, theirs in zip(same.moves, plan.moves, strict=True):
        np.testing.assert_allclose(ours.T_place_pick, level @ theirs.T_place_pick @ BASE, atol=1e-6)
    first, other = same.moves[0].way, plan.moves[0].way
    np.testing.assert_allclose(first.T_world_gripper, level @ other.T_world_gripper, atol=1e-6)
    np.testing.assert_allclose(first.approach.end, other.approach.end, atol=1e-4)


def test_a_plan_is_filmed(made):
    out, _ = made
    assert (out / "plan.mp4").stat().st_size > 10_000
    assert (out / "plan.rrd").exists() == has_rerun()


def test_the_command_says_what_is_moved_and_what_is_not_and_why(dataset, tmp_path, monkeypatch, capsys):
    base = "0 -0.85 0 0 0 0.70710678 0.70710678"  # so far away that one goal is out of reach
    stages = [f"--{slot.replace('_', '-')}={name}" for slot, name in USUAL.items()]
    chosen = ["--explainer", "none", "--refiner", "none", "--set", "rearrange.executor.robot=panda", "--no-film"]
    arguments = ["plan", str(dataset / "000000"), "--out", str(tmp_path), "--base", base, *stages, *chosen]
    monkeypatch.setattr(sys, "argv", ["toolkit", *arguments])
    with pytest.raises(SystemExit) as end:
        main()
    said = capsys.readouterr().out.splitlines()
    plan = read_plan(tmp_path / "plan.json")
    assert end.value.code == 0 and said[:-1] == plan.in_words() and said[-1] == f"Written: {tmp_path / 'plan.json'}"
    assert len({move.object for move in plan.moves}) + len(plan.not_planned) == 3
    assert {"executor", "grasp", "planner"} >= {one.stage for one in plan.not_planned} > set()
    assert (tmp_path / "poses.json").exists() and not (tmp_path / "plan.mp4").exists()


def test_what_is_not_sure_enough_is_left_where_it_is():
    segment = Segment(np.ones((2, 2), bool))
    estimate = PoseEstimate(3, segment, 1, np.eye(4), confidence=0.429)
    assert planning._believed(estimate, 0.42) is estimate
    left = planning._believed(estimate, 0.5)
    assert left.T_goal_current is None
    assert left.failure.reason == (
        "its motion is right with a probability of 42%, and 50% are asked for; look at it, and take it by --sure 0.42"
    )


@pytest.mark.parametrize(
    ("base", "said"),
    [
        ([5.0, 0, 0], r"no object lies where 'panda' can reach: the nearest is 4\.\d\d m from its shoulder"),
        ([0, -0.5, -0.4], "touches the table or what stands on it when it is at its home, with its base -40 cm above"),
    ],
)
def test_a_base_that_cannot_be_is_refused_with_what_was_measured(base, said):
    T, box = BASE.copy(), np.array([[0.1, 0, 0.02], [0.1, 0.01, 0.05]])
    T[:3, 3] = base
    sight = Sight(Layout(()), {0: box}, (), {}, {}, {}, np.zeros((0, 3)), {})
    with closing(Client()) as client, pytest.raises(ToolkitError, match=said):
        planning._require_place(ArmPlanner(Tools(ArmSettings(robot="panda")), Robot(client, PANDA, T)), sight)


def test_a_home_that_reaches_into_what_nobody_saw_is_told_from_one_that_touches():
    T, box = BASE.copy(), np.array([[0.1, 0, 0.02], [0.1, 0.01, 0.05]])
    T[:3, 3] = [0, -0.5, 0]
    with closing(Client()) as client:
        robot = Robot(client, PANDA, T)
        robot.set(np.array(PANDA.home))
        around = robot.T_world_hand()[:3, 3] + np.random.default_rng(0).uniform(-0.03, 0.03, (50, 3))
        arm = ArmPlanner(Tools(ArmSettings(robot="panda")), robot)
        planning._require_place(arm, Sight(Layout(()), {0: box}, (), {}, {}, {}, np.zeros((0, 3)), {}))
        with pytest.raises(ToolkitError, match="into space that no current frame looked into, with its base 0 cm"):
            planning._require_place(arm, Sight(Layout(()), {0: box}, (), {}, {}, {}, around, {}))


def test_what_is_no_arm_plans_nothing(dataset, tmp_path):
    request = PlanRequest(BASE, sure=0.5)
    with pytest.raises(ToolkitError, match="executor 'kinematic' is none; use `arm`"):
        plan_folder(dataset / "000000", cell(**{"rearrange.executor": ["kinematic"]}), tmp_path, request, Progress())
