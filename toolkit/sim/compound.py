"""Collision shapes of many convex pieces."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import numpy as np

from toolkit.sim.bullet import pybullet
from toolkit.sim.client import Client
from toolkit.types import Float


def add_compound(client: Client, hulls: Sequence[Path]) -> int:
    """Make one collision shape of convex meshes (OBJ or STL) in a client; returns its id.

    PyBullet's own list of shapes ends at 16 and drops the rest without a word; the objects of one OBJ file become
    pieces without such a limit. It keeps what it read by file name, so the name is a new one every time.
    """
    with tempfile.TemporaryDirectory(prefix="toolkit-") as folder:
        file = Path(folder) / "compound.obj"
        file.write_text(_obj_text(tuple(hulls)))
        return int(client.createCollisionShape(pybullet.GEOM_MESH, fileName=str(file)))


@lru_cache(maxsize=512)
def convex_pieces(hulls: tuple[Path, ...]) -> list[Any]:
    """Convex meshes (trimesh) as they are read from files."""
    import trimesh

    return [cast(Any, trimesh.load(hull, force="mesh")).convex_hull for hull in hulls]


def mass_center(hulls: Sequence[Path]) -> Float:
    """(3,) centre of mass of convex meshes of even density, in their own coordinates."""
    pieces = convex_pieces(tuple(hulls))
    return np.average([piece.center_mass for piece in pieces], axis=0, weights=[abs(piece.volume) for piece in pieces])


@lru_cache(maxsize=512)
def _obj_text(hulls: tuple[Path, ...]) -> str:
    lines: list[str] = []
    seen = 0
    for number, mesh in enumerate(convex_pieces(hulls)):
        lines.append(f"o piece_{number}")
        lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.vertices]
        lines += ["f " + " ".join(str(seen + 1 + vertex) for vertex in face) for face in mesh.faces]
        seen += len(mesh.vertices)
    return "\n".join(lines) + "\n"
