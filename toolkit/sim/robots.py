"""Robots as data: a folder with a URDF, its meshes, and robot.yaml, which says what the URDF does not."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator
from scipy.spatial.transform import Rotation

from toolkit.errors import ToolkitError, suggest
from toolkit.geometry import make_transform
from toolkit.registry import validated
from toolkit.settings import read_settings
from toolkit.sim.robot_urdfs import gen3_urdf, panda_urdf
from toolkit.types import Float, Gripper

FILE = "robot.yaml"

_Three = tuple[float, float, float]
_Positive = Annotated[float, Field(gt=0)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class FingerJoint(_Part):
    """A joint of a gripper's linkage."""

    ratio: float = Field(description="How far it turns (or slides) when the drive turns by one.")
    follows: str | None = Field(
        None, description="The driven joint of its side, whose angle it takes; else it is driven."
    )


class Drive(_Part):
    """The value of the gripper's drive, radians or metres."""

    open: float = Field(description="The drive's value with the fingers apart, radians or metres.")
    closed: float = Field(description="The drive's value with the fingers together, radians or metres.")


class GripperPart(_Part):
    """A parallel gripper on the hand."""

    closes: _Three = Field(description="From one finger to the other, in the hand's frame.")
    approaches: _Three = Field(description="The way it comes to an object, in the hand's frame.")
    drive: Drive
    force: _Positive = Field(description="Largest force (N) or torque (Nm) of a driven joint.")
    joints: dict[str, FingerJoint] = Field(description="All joints of the gripper; two are driven, one per side.")
    tips: tuple[str, str] = Field(description="The two links that touch.")
    stroke_m: _Positive = Field(description="Widest opening.")
    finger_m: tuple[_Positive, _Positive, _Positive] = Field(
        description="A finger: thickness, width, length to the palm."
    )
    palm_m: tuple[_Positive, _Positive, _Positive] = Field(description="What is behind the fingers: along x, y and z.")

    @model_validator(mode="after")
    def _has_two_sides(self) -> GripperPart:
        driven = [name for name, joint in self.joints.items() if joint.follows is None]
        if len(driven) != 2:
            raise ValueError(f"two joints must be driven, one per side, and follow none; here these do: {driven}")
        lost = sorted({str(joint.follows) for joint in self.joints.values()} - {*driven, "None"})
        if lost:
            raise ValueError(f"a joint follows '{lost[0]}', which is none of the driven joints {driven}")
        if abs(np.dot(self.closes, self.approaches)) > 1e-6 or not all(map(np.any, (self.closes, self.approaches))):
            raise ValueError("`closes` and `approaches` must be at right angles to each other")
        return self


class CameraPart(_Part):
    """A camera on a link: where it looks from, with OpenCV's axes (z forward, y down)."""

    link: str = Field(description="The link it is mounted on.")
    xyz: _Three = Field((0.0, 0.0, 0.0), description="Metres, in the link's frame.")
    rpy: _Three = Field((0.0, 0.0, 0.0), description="Radians, as in a URDF.")

    @property
    def T_link_camera(self) -> Float:
        """(4, 4) pose of the camera in the link's frame."""
        return make_transform(Rotation.from_euler("xyz", self.rpy).as_matrix(), np.array(self.xyz))


class RobotFile(_Part):
    """robot.yaml."""

    urdf: str = Field(description="The description's file, in the same folder.")
    arm: tuple[str, ...] = Field(min_length=1, description="Names of the arm's joints, base first.")
    home: tuple[float, ...] = Field(description="Joint angles at rest: out of the way, the gripper pointing down.")
    speed: _Positive = Field(description="Largest speed of a joint, rad/s.")
    acceleration: _Positive = Field(description="Largest acceleration of a joint, rad/s^2.")
    hand: str = Field(description="The link that carries the fingers.")
    gripper: GripperPart
    camera: CameraPart

    @model_validator(mode="after")
    def _is_complete(self) -> RobotFile:
        if len(self.home) != len(self.arm):
            raise ValueError(f"`home` has {len(self.home)} angles for {len(self.arm)} joints of `arm`")
        return self


@dataclass(frozen=True, eq=False)
class RobotModel:
    """An arm with a parallel gripper, as its URDF calls the parts.

    Attributes:
        name: what it is called in answers.
        urdf: finds the description, fetching it where it is not on this machine; raises ToolkitError.
        file: what its robot.yaml says.
    """

    name: str
    urdf: Callable[[], Path]
    file: RobotFile

    @property
    def arm(self) -> tuple[str, ...]:
        """Names of the arm's joints, base first."""
        return self.file.arm

    @property
    def home(self) -> tuple[float, ...]:
        """(J,) joint angles at rest, radians."""
        return self.file.home

    @property
    def hand(self) -> str:
        """Link that carries the fingers."""
        return self.file.hand

    @property
    def R_hand_gripper(self) -> Float:
        """(3, 3) gripper axes in the hand's: x closes, z approaches."""
        x, z = (
            np.array(axis) / np.linalg.norm(axis) for axis in (self.file.gripper.closes, self.file.gripper.approaches)
        )
        return np.stack([x, np.cross(z, x), z], axis=1)

    @property
    def fingers(self) -> Mapping[str, FingerJoint]:
        """The joints of the gripper by name; two are driven, one per side."""
        return self.file.gripper.joints

    @property
    def tips(self) -> tuple[str, str]:
        """The two links that touch."""
        return self.file.gripper.tips

    @property
    def drive(self) -> tuple[float, float]:
        """The drive's value with the gripper open, and closed."""
        return self.file.gripper.drive.open, self.file.gripper.drive.closed

    @property
    def grip(self) -> float:
        """Largest force (N) or torque (Nm) of a driven joint."""
        return self.file.gripper.force

    @property
    def gripper(self) -> Gripper:
        """Its measures."""
        part = self.file.gripper
        return Gripper(stroke_m=part.stroke_m, finger_m=part.finger_m, palm_m=part.palm_m)


def read_robot(folder: Path, urdf: Callable[[], Path] | None = None) -> RobotModel:
    """Read a robot's folder.

    Args:
        folder: holds robot.yaml, and the URDF that it names with its meshes.
        urdf: finds the URDF where it does not lie in the folder.

    Raises:
        ToolkitError: robot.yaml is not there, or says something that does not fit.
    """
    if not (folder / FILE).is_file():
        raise ToolkitError(f"'{folder}' is no robot: it holds no {FILE}; docs/rearrange.md shows what stands in one")
    data = read_settings(folder / FILE, "robot file", "urdf, arm, home, hand, gripper and camera")
    file = validated(RobotFile, data, f"robot '{folder}'")
    return RobotModel(folder.name, urdf or (lambda: folder / file.urdf), file)


def find_robot(choice: str) -> RobotModel:
    """A robot that the toolkit knows by name, or one's own by its folder.

    Raises:
        ToolkitError: it is neither; or as `read_robot`.
    """
    if choice in ROBOTS:
        return ROBOTS[choice]
    if Path(choice).is_dir():
        return read_robot(Path(choice))
    hint = suggest(choice, sorted(ROBOTS)) or "; choose from: " + ", ".join(sorted(ROBOTS))
    raise ToolkitError(f"unknown robot '{choice}': no robot of that name and no folder with a {FILE}{hint}")


_HERE = Path(__file__).parent / "described"

ROBOTS: dict[str, RobotModel] = {
    name: read_robot(_HERE / name, urdf) for name, urdf in (("gen3", gen3_urdf), ("panda", panda_urdf))
}
"""The robots there are."""
