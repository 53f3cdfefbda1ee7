"""Robot descriptions (URDF): read as XML, with file names that hold wherever the text goes."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from functools import cache
from pathlib import Path

from toolkit.errors import ToolkitError

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


def _found(urdf: Path, name: str) -> Path:
    inside = Path(name.removeprefix(_PACKAGE).removeprefix("file://"))
    folder = urdf.resolve().parent
    tails = [inside, *(Path(*inside.parts[i:]) for i in range(1, len(inside.parts)) if name.startswith(_PACKAGE))]
    found = next((folder / tail for tail in tails if (folder / tail).is_file()), None)
    if found is None:
        raise ToolkitError(f"the robot's description '{urdf}' names the mesh '{name}', which is not below its folder")
    return found
