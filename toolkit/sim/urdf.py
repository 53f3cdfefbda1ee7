"""Robot descriptions (URDF): read as XML, with file names that hold wherever the text goes."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

from toolkit.errors import ToolkitError, suggest
from toolkit.sim.robots import RobotModel

_PACKAGE = "package://"


@cache
def absolute_text(urdf: Path) -> str:
    """The text of a URDF file, in which meshes have absolute file names.

    A name that begins with `package://` is looked for below the file's folder, as PyBullet does, and with the
    package's own name left out.

    Raises:
        ToolkitError: the file is not there or is no XML, or a mesh is not there.
    """
    root = parsed(urdf)
    for mesh in root.iter("mesh"):
        mesh.set("filename", str(_found(urdf, mesh.get("filename", ""))))
    return ET.tostring(root, encoding="unicode")


def parsed(urdf: Path) -> ET.Element:
    """The `robot` element of a URDF file.

    Raises:
        ToolkitError: the file is not there, or is no URDF.
    """
    try:
        root = ET.parse(urdf).getroot()
    except OSError as error:
        raise ToolkitError(f"the robot's description '{urdf}' cannot be read: {error.strerror}") from error
    except ET.ParseError as error:
        raise ToolkitError(f"the robot's description '{urdf}' is no XML: {error}") from error
    if root.tag != "robot":
        raise ToolkitError(f"'{urdf}' is no URDF: it describes a '{root.tag}' instead of a 'robot'")
    return root


def require_parts(model: RobotModel) -> None:
    """Make sure that a robot's description has every part that its robot.yaml names, and every mesh.

    Raises:
        ToolkitError: one is missing; the links are no tree; the arm's joints do not lie in a row from the base to the
            hand; or the gripper moves no fingertip.
    """
    urdf = model.urdf()
    absolute_text(urdf)
    root = parsed(urdf)
    joints = {joint.get("name", ""): joint for joint in root.findall("joint")}
    links = [link.get("name", "") for link in root.findall("link")]
    _require_tree(model, joints, links)
    _require_names(model, [*joints], links)
    _require_chains(model, joints)


def _require_tree(model: RobotModel, joints: Mapping[str, ET.Element], links: list[str]) -> None:
    for name, joint in joints.items():
        for end in ("parent", "child"):
            link = _link(joint, end)
            if link not in links:
                raise _lacks(model, f"link '{link}', the {end} of joint '{name}',", link, links)
    children = [_link(joint, "child") for joint in joints.values()]
    roots = [link for link in links if link not in children]
    if len(roots) != 1 or len({*children}) < len(children):
        raise ToolkitError(f"robot '{model.name}': the links of {model.file.urdf} are no tree; its roots are {roots}")


def _require_names(model: RobotModel, joints: list[str], links: list[str]) -> None:
    file, gripper = model.file, model.file.gripper
    for part, names in (("arm", file.arm), ("gripper", [*gripper.joints])):
        for name in names:
            if name not in joints:
                raise _lacks(model, f"joint '{name}' of `{part}`", name, joints)
    for part, name in (("hand", file.hand), *(("tips", tip) for tip in gripper.tips), ("camera", file.camera.link)):
        if name not in links:
            raise _lacks(model, f"link '{name}' of `{part}`", name, links)


def _require_chains(model: RobotModel, joints: Mapping[str, ET.Element]) -> None:
    above = {_link(joint, "child"): (name, _link(joint, "parent")) for name, joint in joints.items()}
    moving = [name for name in _way_up(above, model.hand) if joints[name].get("type") != "fixed"]
    if tuple(reversed(moving)) != model.arm:
        found, said = ", ".join(moving[::-1]), ", ".join(model.arm)
        raise ToolkitError(f"robot '{model.name}': from its base to its hand lie the joints {found}; `arm` says {said}")
    for tip in model.tips:
        if not {*_way_up(above, tip)} & {*model.fingers}:
            raise ToolkitError(f"robot '{model.name}': none of the `gripper`'s joints moves its tip '{tip}'")


def _lacks(model: RobotModel, what: str, name: str, choices: list[str]) -> ToolkitError:
    return ToolkitError(f"robot '{model.name}': {what} is not in {model.file.urdf}{suggest(name, choices)}")


def _link(joint: ET.Element, end: str) -> str:
    """Name of the link at one end of a joint, `parent` or `child`."""
    found = joint.find(end)
    return "" if found is None else found.get("link", "")


def _way_up(above: Mapping[str, tuple[str, str]], link: str) -> Iterator[str]:
    """Joints between a link and the root of its tree, the link's own first."""
    while link in above:
        joint, link = above[link]
        yield joint


def _found(urdf: Path, name: str) -> Path:
    inside = Path(name.removeprefix(_PACKAGE).removeprefix("file://"))
    folder = urdf.resolve().parent
    tails = [inside, *(Path(*inside.parts[i:]) for i in range(1, len(inside.parts)) if name.startswith(_PACKAGE))]
    found = next((folder / tail for tail in tails if (folder / tail).is_file()), None)
    if found is None:
        raise ToolkitError(f"the robot's description '{urdf}' names the mesh '{name}', which is not below its folder")
    return found
