"""Robots as data: a folder is a robot, and what is wrong with one is said in one sentence."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from toolkit.errors import ToolkitError
from toolkit.plugin_kit.conformance.robot import check_robot
from toolkit.rearrangement.executors.arm import Arm, ArmConfig
from toolkit.sim.client import Client
from toolkit.sim.robot import Robot
from toolkit.sim.robots import FILE, ROBOTS, find_robot, read_robot

DESCRIBED = Path(sys.modules["toolkit.sim.robots"].__file__).parent / "described"


@pytest.fixture
def folder(tmp_path):
    """A Panda of one's own: its URDF, its meshes and its robot.yaml in one folder."""
    urdf = ROBOTS["panda"].urdf()
    own = tmp_path / "own"
    shutil.copytree(urdf.parent / "meshes", own / "meshes")
    for file in (urdf, DESCRIBED / "panda" / FILE):
        shutil.copy(file, own)
    return own


def edit(folder, **changes):
    """Change values of robot.yaml, by their paths: `gripper__stroke_m=0.05`."""
    file = folder / FILE
    data = yaml.safe_load(file.read_text())
    for path, value in changes.items():
        *parents, key = path.split("__")
        part = data
        for parent in parents:
            part = part[parent]
        part[key] = value
    file.write_text(yaml.safe_dump(data))


def edit_urdf(folder, old, new):
    """Replace a piece of the description."""
    file = folder / "panda.urdf"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


def refused(folder):
    """The sentence with which a robot is refused before anything moves."""
    with pytest.raises(ToolkitError) as error:
        Arm(ArmConfig(robot=str(folder))).check_ready()
    assert "\n" not in str(error.value)
    return str(error.value)


def failed(folder):
    """Check -> what is wrong, of the checks that fail."""
    return {outcome.check: outcome.note for outcome in check_robot(read_robot(folder)) if not outcome.passed}


@pytest.mark.parametrize("name", ["panda", pytest.param("gen3", marks=pytest.mark.slow)])
def test_the_robots_there_are_pass_their_checks(name):
    assert [outcome.note for outcome in check_robot(find_robot(name)) if not outcome.passed] == []


def test_a_folder_is_a_robot(folder):
    own = find_robot(str(folder))
    assert own.file == ROBOTS["panda"].file and own.name == "own"
    assert failed(folder) == {}
    np.testing.assert_array_equal(own.R_hand_gripper, [[0, -1, 0], [1, 0, 0], [0, 0, 1]])


MISTAKES = {
    "no robot.yaml": (lambda f: (f / FILE).unlink(), "is no robot: it holds no robot.yaml"),
    "no YAML": (lambda f: (f / FILE).write_text("arm: ["), "line 1"),
    "a key that is none": (lambda f: edit(f, speeed=1.0), "unknown setting 'speeed'; did you mean 'speed'?"),
    "an angle too few": (lambda f: edit(f, home=[0.0] * 6), "`home` has 6 angles for 7 joints"),
    "one driven joint": (
        lambda f: edit(f, gripper__joints__panda_finger_joint2={"ratio": 1, "follows": "panda_finger_joint1"}),
        "two joints must be driven",
    ),
    "slanting axes": (lambda f: edit(f, gripper__closes=[0, 1, 1]), "must be at right angles"),
    "no URDF": (lambda f: (f / "panda.urdf").unlink(), "panda.urdf' cannot be read: No such file"),
    "no XML": (lambda f: (f / "panda.urdf").write_text("<robot><link>"), "is no XML"),
    "another XML": (lambda f: (f / "panda.urdf").write_text("<sdf/>"), "describes a 'sdf' instead of a 'robot'"),
    "a joint to nowhere": (
        lambda f: edit_urdf(f, '<child link="panda_hand"', '<child link="panda_hnad"'),
        "link 'panda_hnad', the child of joint 'panda_hand_joint', is not in panda.urdf; did you mean 'panda_hand'?",
    ),
    "two roots": (
        lambda f: edit_urdf(f, "</robot>", '<link name="lost"/></robot>'),
        "are no tree; its roots are ['panda_link0', 'lost']",
    ),
    "a mesh that is not there": (lambda f: (f / "meshes" / "visual" / "hand.obj").unlink(), "visual/hand.obj"),
    "a joint of another name": (
        lambda f: edit(f, arm=[f"panda_joint{i}" for i in range(1, 7)] + ["panda_joint_7"]),
        "joint 'panda_joint_7' of `arm` is not in panda.urdf; did you mean 'panda_joint7'?",
    ),
    "joints in another order": (
        lambda f: edit(f, arm=[f"panda_joint{i}" for i in (2, 1, 3, 4, 5, 6, 7)]),
        "from its base to its hand lie the joints",
    ),
    "a link of another name": (lambda f: edit(f, hand="hand"), "link 'hand' of `hand` is not in panda.urdf"),
    "tips that nothing moves": (
        lambda f: edit(f, gripper__tips=["panda_hand", "panda_leftfinger"]),
        "none of the `gripper`'s joints moves its tip 'panda_hand'",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_broken_robot_is_refused_in_one_sentence(folder, mistake):
    break_it, said = MISTAKES[mistake]
    break_it(folder)
    assert said in refused(folder)


def test_what_a_simulator_cannot_load_is_said(folder):
    edit_urdf(folder, '<mesh filename="package://meshes/collision/link0.obj"/>', "")
    with pytest.raises(ToolkitError, match="PyBullet cannot load"):
        Robot(Client(), read_robot(folder), np.eye(4))


WRONG = {
    "home beyond a limit": (
        {"home": [0.0, -0.785, 0.0, 0.5, 0.0, 1.571, 0.785]},
        "it stands within its limits at home",
        "panda_joint4 at 0.50 rad, and it goes from -3.14 to 0.00",
    ),
    "home in the table": (
        {"home": [0.0, 1.7, 0.0, -0.5, 0.0, 1.571, 0.785]},
        "it touches nothing at home",
        "at `home` the arm touches the table",
    ),
    "home in itself": (
        {"home": [0.0, -0.785, 0.0, -3.1, 0.0, -0.05, 0.785]},
        "it touches nothing at home",
        "at `home` the arm touches itself",
    ),
    "another stroke": ({"gripper__stroke_m": 0.1}, "its gripper opens and closes", "8.0 cm apart along `closes`"),
    "a drive that ends open": (
        {"gripper__drive__closed": 0.03},
        "its gripper opens and closes",
        "still 6.0 cm apart when it is closed",
    ),
    "a camera that looks up": (
        {"camera__rpy": [3.14159, 0.0, 0.0]},
        "its camera sees the table",
        "0% of its camera's picture show the table",
    ),
    "a camera that looks past the fingers": (
        {"camera__rpy": [0.0, 0.35, 0.0]},
        "its camera sees what it holds",
        "its camera sees 0% of where an object is held",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_a_robot_is_wrong_about_is_measured(folder, case):
    changes, check, said = WRONG[case]
    edit(folder, **changes)
    assert said in failed(folder)[check]


@pytest.mark.slow
def test_the_example_of_a_third_robot_passes_its_checks(tmp_path):
    example = Path(__file__).parents[2] / "docs" / "examples" / "ur5_robot.py"
    subprocess.run([sys.executable, example, tmp_path / "ur5"], check=True)
    assert failed(tmp_path / "ur5") == {}


def test_an_unknown_robot_is_a_mistake():
    with pytest.raises(ToolkitError, match=r"unknown robot 'pandas'.*did you mean 'panda'"):
        Arm(ArmConfig(robot="pandas")).check_ready()


def test_the_command_line_checks_a_folder(folder):
    def toolkit(*arguments):
        code = "from toolkit.cli.commands import main; main()"
        return subprocess.run([sys.executable, "-c", code, *map(str, arguments)], capture_output=True, text=True)

    done = toolkit("check", "robot", folder)
    assert done.returncode == 0, done.stderr
    assert "passes all 5 checks" in done.stdout
    edit(folder, gripper__stroke_m=0.1)
    done = toolkit("check", "robot", folder)
    assert done.returncode == 1 and "fails 1 of 5 checks; its gripper opens" in re.sub(r"\s+", " ", done.stderr)
    (folder / FILE).unlink()
    done = toolkit("check", "robot", folder)
    assert done.returncode == 2 and "Traceback" not in done.stderr
