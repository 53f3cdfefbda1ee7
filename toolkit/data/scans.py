"""Folders of scanned objects: which file is the mesh, which the texture, and what `objects.json` says of them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, Field

from toolkit.errors import ToolkitError
from toolkit.registry import validated

Symmetry = Literal["none", "discrete_z_180", "continuous_z"]


class ScanNotes(BaseModel, frozen=True):
    """What `objects.json` may say of one object; other keys are ignored, since boxes are measured on the mesh."""

    category: str = Field("scan", description="The object's category.")
    mass_kg: float | None = Field(
        None, gt=0, description="Mass in kg; estimated from the volume of the hulls where it is absent."
    )
    symmetry: Symmetry = Field("none", description="Symmetry of shape and texture about the vertical axis.")


@dataclass(frozen=True)
class Scan:
    """The files of one scanned object, all of which exist.

    Attributes:
        name: the folder's name.
        mesh: OBJ with texture coordinates; metres, z up.
        texture: the image it is painted with.
        hulls: convex collision meshes; empty where the scan brings none.
        notes: what `objects.json` says.
    """

    name: str
    mesh: Path
    texture: Path
    hulls: tuple[Path, ...]
    notes: ScanNotes


# Mesh, texture without its suffix; the first whose mesh exists is used.
_LAYOUTS = (
    ("textured.obj", "texture_map"),  # YCB, one resolution unpacked
    ("textured_simple.obj", "texture_map"),  # YCB-Video models
    ("google_16k/textured.obj", "google_16k/texture_map"),  # YCB, as downloaded
    ("meshes/model.obj", "materials/textures/texture"),  # Google Scanned Objects
)
_TEXTURE_SUFFIXES = (".png", ".jpg", ".jpeg")


def find_scans(folder: Path) -> list[Scan]:
    """List the objects of a folder of scans, one sub-folder per object, sorted by name.

    Layouts: YCB (Calli et al., ICAR 2015) and Google Scanned Objects (Downs et al., ICRA 2022). `objects.json` beside
    the sub-folders is optional: object name -> `ScanNotes`.

    Raises:
        ToolkitError: there is no such folder, no object in it, an object lacks its mesh or texture, or `objects.json`
            does not fit.
    """
    if not folder.is_dir():
        raise ToolkitError(f"object set '{folder}' is not a folder; give 'procedural' or a folder of scans")
    objects = sorted(entry for entry in folder.iterdir() if entry.is_dir() and not entry.name.startswith("."))
    if not objects:
        raise ToolkitError(f"object set '{folder}' holds no object: put one sub-folder per object into it")
    notes = _read_notes(folder / "objects.json")
    return [_read_scan(entry, notes.get(entry.name, ScanNotes.model_construct())) for entry in objects]


def _read_scan(folder: Path, notes: ScanNotes) -> Scan:
    for mesh, texture in _LAYOUTS:
        if (folder / mesh).is_file():
            images = [folder / f"{texture}{suffix}" for suffix in _TEXTURE_SUFFIXES]
            image = next((path for path in images if path.is_file()), None)
            if image is None:
                raise ToolkitError(f"object '{folder}' has no texture: put its image at '{images[0]}' (or .jpg)")
            hulls = tuple(sorted((folder / mesh).parent.glob("textured_coacd_*.*")))
            return Scan(folder.name, folder / mesh, image, hulls, notes)
    expected = ", ".join(mesh for mesh, _ in _LAYOUTS)
    raise ToolkitError(f"object '{folder}' has no mesh: expected one of {expected}; add it or remove the folder")


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
