"""docs/examples/ros2_arm.py as it is, against made-up action servers: rclpy has no wheels."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from made_plans import HOME, plan

FILE = Path(__file__).parents[2] / "docs" / "examples" / "ros2_arm.py"
TICK_S = 0.02


class Message(SimpleNamespace):
    """A message, or a goal with everything that is set in one."""

    def __getattr__(self, name):
        if name.startswith("_"):
            raise AttributeError(name)
        value = [] if name == "points" else Message()
        setattr(self, name, value)
        return value


def is_grip(goal):
    return "command" in vars(goal)


class Future:
    def __init__(self, answer=None):
        self.answer = answer

    def done(self):
        return self.answer is not None

    def result(self):
        return self.answer


class Robot:
    """Two action servers and a topic, on a clock that goes on as a node is spun."""

    def __init__(self):
        self.seconds, self.q, self.heard = 0.0, HOME.copy(), None
        self.goals, self.canceled, self.doing = [], 0, None
        self.silent_from = self.spins_until_ctrl_c = np.inf
        self.servers, self.accepts, self.error_code, self.answers_cancel = True, True, 0, True

    def spin(self):
        self.seconds += TICK_S
        self.spins_until_ctrl_c -= 1
        if self.spins_until_ctrl_c <= 0:
            self.spins_until_ctrl_c = np.inf
            raise KeyboardInterrupt
        if self.doing is not None:
            self._go_on(*self.doing)
        if self.heard is not None and self.seconds < self.silent_from:
            self.heard(Message(name=["a", "finger", "b"], position=[self.q[0], 0.0, self.q[1]]))

    def _go_on(self, goal, since, answer):
        if is_grip(goal):
            answer.answer = Message(status=4, result=Message(stalled=goal.command.position == 0.8))
            self.doing = None
            return
        points = goal.trajectory.points
        times = [point.time_from_start.sec + point.time_from_start.nanosec / 1e9 for point in points]
        angles = np.array([point.positions for point in points])
        self.q = np.array([np.interp(self.seconds - since, times, column) for column in angles.T])
        if self.error_code or self.seconds - since >= times[-1]:
            said = "path tolerance violated" if self.error_code else ""
            answer.answer = Message(status=4, result=Message(error_code=self.error_code, error_string=said))
            self.doing = None

    def send(self, goal):
        self.goals.append(goal)
        answer = Future()
        if self.accepts:
            self.doing = goal, self.seconds, answer
        return Future(Message(accepted=self.accepts, get_result_async=lambda: answer, cancel_goal_async=self._cancel))

    def _cancel(self):
        self.canceled += 1
        self.doing = None
        return Future(True if self.answers_cancel else None)


@pytest.fixture
def robot(monkeypatch):
    made = Robot()

    def client(node, kind, name):
        return SimpleNamespace(wait_for_server=lambda timeout_sec: made.servers, send_goal_async=made.send)

    node = SimpleNamespace(
        create_subscription=lambda kind, topic, heard, depth: setattr(made, "heard", heard),
        get_clock=lambda: SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=round(made.seconds * 1e9))),
    )
    action = SimpleNamespace(Goal=Message)
    modules = {
        "rclpy": {
            "init": lambda signal_handler_options: None,
            "create_node": lambda name: node,
            "spin_once": lambda node, timeout_sec: made.spin(),
            "try_shutdown": lambda: None,
        },
        "rclpy.action": {"ActionClient": client},
        "rclpy.signals": {"SignalHandlerOptions": SimpleNamespace(NO=0)},
        "builtin_interfaces.msg": {"Duration": Message},
        "control_msgs.action": {"FollowJointTrajectory": action, "GripperCommand": action},
        "sensor_msgs.msg": {"JointState": Message},
        "trajectory_msgs.msg": {"JointTrajectoryPoint": Message},
    }
    for name, contents in modules.items():
        module = ModuleType(name)
        vars(module).update(contents)
        monkeypatch.setitem(sys.modules, name, module)
    return made


@pytest.fixture
def run(tmp_path):
    plan().write(tmp_path / "plan.json")

    def run(answer="move"):
        asked = []
        main = runpy.run_path(str(FILE))["main"]
        code = main([str(tmp_path / "plan.json")], ask=lambda text: asked.append(text) or answer)
        assert len(asked) <= 1
        return code

    return run


def test_a_plan_is_shown_and_confirmed_and_then_carried_out(robot, run, capsys):
    assert run() == 0
    said = capsys.readouterr().out
    assert "1. object 0 (instance #2) to its goal" in said and "plan.mp4" in said and "done; look again" in said
    followed = [goal for goal in robot.goals if not is_grip(goal)]
    assert len(followed) == 7 and len(robot.goals) == 10
    assert all(goal.trajectory.joint_names == ["a", "b"] for goal in followed)
    np.testing.assert_allclose(robot.q, HOME, atol=1e-6)
    gripped = [(goal.command.position, goal.command.max_effort) for goal in robot.goals if is_grip(goal)]
    np.testing.assert_allclose(gripped, [(0.2, 20.0), (0.8, 20.0), (0.2, 20.0)], atol=1e-9)
    assert robot.canceled == 0


def test_nothing_moves_that_was_not_confirmed(robot, run, capsys):
    assert run("yes") == 1
    assert robot.goals == [] and "nothing was moved" in capsys.readouterr().out


FAILURES = {
    "no server": ({"servers": False}, "no action server answers at /joint_trajectory_controller", 0),
    "refused": ({"accepts": False}, "opening: the controller refuses the goal", None),
    "given up": ({"error_code": -4}, "going to the grasp: the controller gave up: path tolerance violated", None),
    "late": ({"silent_from": 0.5}, "going to the grasp: the robot's last state is 0.2 s old, so it is stopped", 1),
    "never there": ({"silent_from": 0.0}, "opening: no state of the robot comes", 0),
    "elsewhere": ({"q": HOME + 0.3}, "going to the grasp: the arm is 0.30 rad from where this motion starts", 0),
    "deaf": ({"silent_from": 0.5, "answers_cancel": False}, "use the emergency stop", 1),
}


@pytest.mark.parametrize("what", FAILURES)
def test_what_goes_wrong_stops_the_arm_and_is_said_in_one_sentence(robot, run, capsys, what):
    changes, said, canceled = FAILURES[what]
    for name, value in changes.items():
        setattr(robot, name, value)
    assert run() == 2
    (sentence,) = capsys.readouterr().err.splitlines()
    assert sentence.startswith("error: ") and said in sentence
    assert canceled is None or robot.canceled == canceled


def test_ctrl_c_cancels_the_goal(robot, run, capsys):
    robot.spins_until_ctrl_c = 30
    assert run() == 130
    assert robot.canceled == 1 and robot.doing is None
    assert capsys.readouterr().err == "stopped: the arm holds where it is\n"
