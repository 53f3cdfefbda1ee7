"""Folders of scanned objects: which file is the mesh, which the texture, and what `objects.json` says of them.

How these become what the renderer draws is in `toolkit.data.meshes`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, Field

from toolkit.errors import ToolkitError
from toolkit.registry import validated

Symmetry = Literal["none", "discrete_z_180", "continuous_z"]
Unit = Literal["m", "cm", "mm"]


class ScanNotes(BaseModel, frozen=True):
    """What `objects.json` may say of one object; other keys are ignored, since boxes are measured on the mesh."""

    category: str = Field("scan", description="The object's category.")
    mass_kg: float | None = Field(
        None, gt=0, description="Mass in kg; estimated from the volume of the hulls where it is absent."
    )
    symmetry: Symmetry = Field("none", description="Symmetry of shape and texture about the vertical axis.")
    unit: Unit | None = Field(
        None, description="Of its files; told by the size of the set's objects where it is absent."
    )
    up: Literal["y", "z"] = Field("z", description="The axis of its files that points up.")


@dataclass(frozen=True)
class Scan:
    """The files of one scanned object, all of which exist.

    Attributes:
        name: the folder's name, or the mesh's, where that lies in no folder of its own.
        mesh: OBJ, PLY, GLB, glTF or STL.
        texture: an image beside the mesh; None where there is none.
        hulls: convex collision meshes; empty where the scan brings none.
        notes: what `objects.json` says.
    """

    name: str
    mesh: Path
    texture: Path | None
    hulls: tuple[Path, ...]
    notes: ScanNotes


# Mesh, texture without its suffix; the first whose mesh exists is used.
_LAYOUTS = (
    ("textured.obj", "texture_map"),  # YCB, one resolution unpacked
    ("textured_simple.obj", "texture_map"),  # YCB-Video models
    ("google_16k/textured.obj", "google_16k/texture_map"),  # YCB, as downloaded
    ("meshes/model.obj", "materials/textures/texture"),  # Google Scanned Objects
)
_IMAGES = (".png", ".jpg", ".jpeg")
_MESHES = (".obj", ".ply", ".glb", ".gltf", ".stl")
_HULLS = "textured_coacd_*.*"
_EVERY = "*"


def find_scans(folder: Path) -> list[Scan]:
    """List the objects of a folder of scans, sorted by name: one sub-folder per object, or one mesh.

    Layouts: YCB (Calli et al., ICAR 2015) and Google Scanned Objects (Downs et al., ICRA 2022); else the only mesh in a
    sub-folder, with the only image beside it. `objects.json` beside them is optional: object name -> `ScanNotes`; what
    it says of "*" goes for all objects that it does not name.

    Raises:
        ToolkitError: there is no such folder, no object in it, a sub-folder lacks a mesh or holds several, or
            `objects.json` does not fit.
    """
    if not folder.is_dir():
        raise ToolkitError(f"object set '{folder}' is not a folder; give 'procedural' or a folder of scans")
    if any((folder / mesh).is_file() for mesh, _ in _LAYOUTS):
        raise ToolkitError(f"'{folder}' is the folder of one object; name the folder that holds it: '{folder.parent}'")
    entries = sorted(entry for entry in folder.iterdir() if not entry.name.startswith("."))
    objects = [entry for entry in entries if entry.is_dir() or entry.suffix.lower() in _MESHES]
    if not objects:
        raise ToolkitError(
            f"object set '{folder}' holds no object: put one sub-folder, or one mesh, per object into it"
        )
    notes = _read_notes(folder / "objects.json")
    usual = notes.get(_EVERY, ScanNotes.model_construct())
    return [_read_scan(entry, notes.get(entry.stem if entry.is_file() else entry.name, usual)) for entry in objects]


def _read_scan(entry: Path, notes: ScanNotes) -> Scan:
    if entry.is_file():
        return Scan(entry.stem, entry, _image(entry.with_suffix("")), (), notes)
    for mesh, texture in _LAYOUTS:
        if (entry / mesh).is_file():
            image = _image(entry / texture) or _only_image((entry / mesh).parent)
            return Scan(entry.name, entry / mesh, image, tuple(sorted((entry / mesh).parent.glob(_HULLS))), notes)
    hulls = sorted(entry.glob(_HULLS))
    meshes = sorted(p for p in entry.iterdir() if p.suffix.lower() in _MESHES and p not in hulls)
    if len(meshes) > 1:
        named = ", ".join(f"'{path.name}'" for path in meshes)
        raise ToolkitError(f"object '{entry}' has several meshes: {named}; keep one")
    if not meshes:
        expected = ", ".join(mesh for mesh, _ in _LAYOUTS)
        raise ToolkitError(
            f"object '{entry}' has no mesh: expected one of {expected}, or one {' '.join(_MESHES)} file; add it or "
            "remove the folder"
        )
    return Scan(entry.name, meshes[0], _only_image(entry), tuple(hulls), notes)


def _image(stem: Path) -> Path | None:
    return next((path for path in (stem.with_name(stem.name + suffix) for suffix in _IMAGES) if path.is_file()), None)


def _only_image(folder: Path) -> Path | None:
    images = [path for path in folder.iterdir() if path.suffix.lower() in _IMAGES]
    return images[0] if len(images) == 1 else None


def _read_notes(path: Path) -> dict[str, ScanNotes]:
    if not path.is_file():
        return {}
    try:
        content = json.loads(path.read_text())
    except ValueError as error:
        raise ToolkitError(f"'{path}' is not valid JSON: {error}") from error
    if not isinstance(content, dict) or not all(isinstance(entry, dict) for entry in content.values()):
        raise ToolkitError(f"'{path}' must map object names to mappings of category, mass_kg and symmetry")
    return {name: validated(ScanNotes, entry, f"'{path}', object '{name}'") for name, entry in content.items()}
