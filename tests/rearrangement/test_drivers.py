"""Trajectories keep to limits, every motion is watched to its end, and whatever goes wrong stops the robot first."""

from __future__ import annotations

import json
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from made_plans import HOME, LIMITS, between, plan
from scipy.spatial.transform import Rotation

from toolkit.errors import ToolkitError
from toolkit.geometry import invert, make_transform
from toolkit.rearrangement.drivers import DriverError, Follow, Grip, JointState, perform
from toolkit.rearrangement.executors.drivers.recorded import Recorded, Recorder, read_recording
from toolkit.rearrangement.executors.drivers.simulated import Simulated
from toolkit.rearrangement.executors.handling.mover import carry_out_plan
from toolkit.rearrangement.executors.handling.timing import Timer
from toolkit.rearrangement.plans import ArmPlan, read_plan
from toolkit.rearrangement.trajectories import Limits, Trajectory
from toolkit.sim.bench import Bench
from toolkit.sim.clearance import Clearance
from toolkit.sim.client import Client
from toolkit.sim.robot import Robot
from toolkit.sim.robots import ROBOTS

ANGLES = arrays(np.float64, 2, elements=st.floats(-2, 2, width=32))
TIMES = np.linspace(0, 1, 101)


def sampled(trajectory):
    return trajectory.at(TIMES * trajectory.seconds)


@given(ANGLES, ANGLES, st.floats(0.1, 5))
def test_the_way_back_is_the_way_there(a, b, seconds):
    there = between(a, b, seconds)
    (q, v), (q_back, v_back) = sampled(there), sampled(there.reversed())
    np.testing.assert_allclose(q_back, q[::-1], atol=1e-9)
    np.testing.assert_allclose(v_back, -v[::-1], atol=1e-9)


@given(ANGLES, ANGLES, arrays(np.float64, 2, elements=st.floats(-0.1, 0.1)))
def test_a_motion_is_led_to_from_where_the_arm_is_within_the_limits(a, b, off):
    led = between(a, b, 6.0).from_where(a + off, LIMITS)
    q, v = led.at(np.linspace(0, led.seconds, 2001))
    np.testing.assert_allclose(q[[0, -1]], [a + off, b], atol=1e-6)
    assert np.abs(v).max() <= 1.5 * LIMITS.speed * (1 + 1e-6)  # that of the trajectory itself, 4 rad in 6 s
    lead = led.seconds - 6.0
    inside = v[np.linspace(0, led.seconds, 2001) <= lead]
    assert np.abs(inside).max(initial=0) <= LIMITS.speed * (1 + 1e-6)
    if len(inside) > 3:
        assert np.abs(np.diff(inside, axis=0)).max() <= LIMITS.acceleration * led.seconds / 2000 * 1.01


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"times": [0, 1, 1]}, "as many positions"),
        ({"times": [0.5, 1]}, "begin with 0 and increase"),
        ({"times": [0, 0]}, "begin with 0 and increase"),
        ({"positions": [[0, np.nan], [0, 0]]}, "finite"),
    ],
)
def test_what_is_no_trajectory_is_refused(values, said):
    fine = {"times": [0, 1], "positions": np.zeros((2, 2)), "velocities": np.zeros((2, 2))}
    with pytest.raises(ValueError, match=said):
        Trajectory(**{**fine, **values})


def test_paths_are_timed_at_the_robots_limits():
    panda = ROBOTS["panda"]
    with closing(Client()) as client:
        clearance = Clearance(Robot(client, panda, np.eye(4)), margin=0.002)
    limits = Limits(speed=1.0, acceleration=5.0, effort=10.0)
    home = np.array(panda.home)
    path = home + np.array([[0.0] * 7, [0.5, -0.3, 0.2, 0, 0, 0, 0], [1.0, 0.1, 0, 0.4, 0.1, -0.3, 0.2]])
    for speed in (1.0, 0.5):
        timed = Timer(clearance, limits, joint_speed=speed, line_speed=0.2).free(path)
        _, v = timed.at(np.arange(0, timed.seconds, 1e-3))
        assert 0.98 * speed < np.abs(v).max() < 1.01 * speed  # as fast as it may be, and no faster
        gained = np.diff(timed.velocities, axis=0) / np.diff(timed.times)[:, None]
        assert np.abs(gained).max() < 1.01 * limits.acceleration * speed
        np.testing.assert_allclose([timed.start, timed.end], path[[0, -1]], atol=1e-9)
        np.testing.assert_allclose(timed.velocities[[0, -1]], 0, atol=1e-9)
        corner = np.abs(timed.positions - path[1]).max(axis=1).min()
        assert corner < 0.03  # cut, by little
    assert Timer(clearance, limits, 1.0, 0.2).line(path[:1]).seconds == 0


@pytest.fixture
def simulated():
    with closing(Bench(ROBOTS["panda"], np.eye(4), [], [])) as bench:
        yield Simulated(bench, lambda T_world_camera: T_world_camera), bench


SMALL = Limits(speed=1.0, acceleration=4.0, effort=70.0)


def test_the_simulated_arm_does_what_a_driver_is_asked_for(simulated):
    driver, bench = simulated
    home = driver.state().positions
    away = home + 0.1
    ended = perform(driver, Follow(trajectory=between(home, away, 0.5), phase="moving"), SMALL)
    np.testing.assert_allclose(ended.positions, away, atol=5e-3)
    assert bench.seconds == pytest.approx(0.5, abs=0.01)
    for opening in (0.03, 0.06):
        ended = perform(driver, Grip(opening_m=opening, phase="opening", effort=10.0), SMALL)
        assert ended.opening_m == pytest.approx(opening, abs=4e-3)
    seen_from = driver.picture()  # 7 cm beside the hand's axis, and looking toward where the fingers meet
    mounted = make_transform(Rotation.from_euler("y", -0.35).as_matrix(), np.array([0.07, 0, 0]))
    np.testing.assert_allclose(invert(bench.robot.T_world_hand()) @ seen_from, mounted, atol=1e-6)


def test_ctrl_c_stops_the_simulated_arm_in_its_tracks(simulated):
    driver, bench = simulated
    home = driver.state().positions

    def interrupt():
        if bench.seconds > 0.25:
            bench.on_step = None
            raise KeyboardInterrupt

    bench.on_step = interrupt
    with pytest.raises(KeyboardInterrupt):
        perform(driver, Follow(trajectory=between(home, home + 0.2, 0.5), phase="moving"), SMALL)
    stopped = driver.state().positions
    assert 0.05 < np.abs(stopped - home).max() < 0.15
    assert not driver.advance()
    bench.wait(0.3, "standing", None)
    np.testing.assert_allclose(driver.state().positions, stopped, atol=0.03)


class Misbehaving(Recorded):
    """A robot that does something else after some time."""

    def __init__(self, after=2, **becomes):
        super().__init__(HOME)
        self.after, self.becomes, self.stopped = after, becomes, 0

    def advance(self):
        self.after -= 1
        if self.after <= 0 and "raises" in self.becomes:
            raise self.becomes["raises"]
        return super().advance()

    def state(self):
        state = super().state()
        if self.after > 0:
            return state
        return None if self.becomes.get("lost") else state.model_copy(update=self.becomes)

    def stop(self):
        self.stopped += 1
        super().stop()


LIFT = Follow(trajectory=between(HOME, HOME + 0.5, 2.0), phase="lifting")


@pytest.mark.parametrize(
    ("becomes", "said"),
    [
        ({"lost": True}, "lifting: no state of the robot comes, so it is stopped; look whether it is connected"),
        ({"age_s": 0.7}, "lifting: the robot's last state is 0.7 s old, so it is stopped; look at its connection"),
        ({"raises": DriverError("the power is gone")}, "the power is gone"),
    ],
)
def test_a_robot_that_is_lost_is_stopped_and_that_is_said_in_a_sentence(becomes, said):
    robot = Misbehaving(**becomes)
    with pytest.raises(DriverError) as error:
        perform(robot, LIFT, LIMITS)
    assert str(error.value) == said and robot.stopped == 1


def test_an_arm_that_ends_elsewhere_has_met_something():
    robot = Misbehaving(after=100)
    robot._at = lambda q: JointState(positions=HOME, opening_m=0.0, holding=None)
    with pytest.raises(DriverError, match=r"lifting: the arm ended 0\.50 rad from where it was sent"):
        perform(robot, LIFT, LIMITS)
    assert robot.stopped == 1


@pytest.mark.parametrize("end", [KeyboardInterrupt, SystemExit, ZeroDivisionError])
def test_ctrl_c_stops_the_robot_before_anything_else(end):
    robot = Misbehaving(raises=end())
    with pytest.raises(end):
        carry_out_plan(plan(), robot)
    assert robot.stopped == 1


@pytest.mark.parametrize(
    ("request_", "said"),
    [
        (Follow(trajectory=between(HOME, HOME + 3), phase="carrying"), "faster than the robot's limit of 1 rad/s"),
        (Follow(trajectory=between(HOME + 1, HOME), phase="carrying"), "1.00 rad from where this motion starts"),
        (Grip(opening_m=0.0, phase="grasping", effort=50.0), "is asked for 50, and its limit is 20"),
    ],
)
def test_what_exceeds_the_limits_is_not_begun(request_, said):
    robot = Misbehaving(after=100)
    with pytest.raises(DriverError, match=said):
        perform(robot, request_, LIMITS)
    np.testing.assert_array_equal(robot.state().positions, HOME)


def test_a_plan_is_carried_out_and_recorded_and_played_back(tmp_path):
    ticks, moves = [], []
    robot = Recorder(Recorded(HOME, on_tick=ticks.append), tmp_path / "log.jsonl")
    assert carry_out_plan(plan(), robot, moves.append) is None
    assert [move.object for move in moves] == [2]
    np.testing.assert_array_equal(robot.state().positions, HOME)
    assert max(np.abs(b.positions - a.positions).max() for a, b in pairwise(ticks)) < 0.2
    entries = read_recording(tmp_path / "log.jsonl")
    phases = "opening, going to the grasp, approaching, grasping, lifting, carrying, lowering, releasing, retreating"
    assert ", ".join(entry.request.phase for entry in entries) == f"{phases}, going home"
    assert carry_out_plan(plan(), Recorded(HOME, entries)) is None
    with pytest.raises(DriverError, match="opening: the recording has another request here, going to the grasp"):
        carry_out_plan(plan(), Recorded(HOME, entries[1:]))
    with pytest.raises(DriverError, match="going home: the recording ends before this"):
        carry_out_plan(plan(), Recorded(HOME, entries[:-1]))
    with pytest.raises(DriverError, match="no further picture"):
        Recorded(HOME).picture()


def test_what_slips_while_it_is_lifted_is_put_back(tmp_path):
    path = tmp_path / "log.jsonl"
    carry_out_plan(plan(), Recorder(Recorded(HOME), path))
    entries = read_recording(path)
    lifted = entries[4]
    slipped = lifted.model_copy(update={"state": lifted.state.model_copy(update={"holding": False})})
    move = plan().moves[0].way
    back = [
        entries[6].model_copy(update={"request": Follow(trajectory=move.lift.reversed(), phase="putting back")}),
        entries[7],
        entries[8].model_copy(update={"request": Follow(trajectory=move.approach.reversed(), phase="retreating")}),
    ]
    robot = Recorded(HOME, [*entries[:4], slipped, *back])
    robot._end = lambda request, told, end=robot._end: end(request, told).model_copy(
        update={"positions": told.positions}
    )
    failure = carry_out_plan(plan(), robot)
    assert failure.reason == "the object slipped in the gripper while it was lifted"
    np.testing.assert_allclose(robot.state().positions, HOME + np.array([0.3, 0]))


def test_a_plan_is_read_as_it_was_written(tmp_path):
    plan().write(tmp_path / "plan.json")
    read = read_plan(tmp_path / "plan.json")
    assert read.model_dump_json() == plan().model_dump_json()
    assert read.in_words() == [
        "1. object 0 (instance #2) to its goal, 6 s: its goal is free",
        "not moved: object 3 (instance #1): there is no room for the fingers",
    ]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda data: data.update(schema=7), "is of schema 7; 1 is read"),
        (lambda data: data["robot"].update(speed=1), r"is no plan: robot\.speed: Extra inputs"),
        (lambda data: data["moves"][0]["way"]["lift"].update(times=[0, 0]), r"is no plan: moves\.0\.way\.lift: Value"),
    ],
)
def test_what_is_no_plan_is_refused_in_a_sentence(tmp_path, change, said):
    data = json.loads(plan().model_dump_json(by_alias=True))
    change(data)
    (tmp_path / "plan.json").write_text(json.dumps(data))
    with pytest.raises(ToolkitError, match=said):
        read_plan(tmp_path / "plan.json")


def test_a_damaged_recording_is_refused_with_its_line(tmp_path):
    (tmp_path / "log.jsonl").write_text("{}\n")
    with pytest.raises(ToolkitError, match="is damaged in line 1"):
        read_recording(tmp_path / "log.jsonl")
    with pytest.raises(ToolkitError, match="cannot be read"):
        read_recording(tmp_path / "none.jsonl")


def test_the_schema_in_the_docs_is_that_of_the_files():
    written = Path(__file__).parents[2] / "docs" / "plan.schema.json"
    assert json.loads(written.read_text()) == ArmPlan.model_json_schema()
