"""Object sets: what the tabletop benchmark puts on its table, made by the package or scanned."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import pdist

from toolkit.data.procedural import procedural_folder
from toolkit.data.scans import Scan, Symmetry, find_scans
from toolkit.errors import ToolkitError
from toolkit.files import make_once
from toolkit.geometry import invert, rotation_z
from toolkit.types import Float, ObjectModel

# Household objects are hollow or soft: about a third of the weight of water for what their hull encloses.
_DEFAULT_DENSITY_KG_M3 = 350.0
_HULL_DIRECTIONS = 512


@dataclass(frozen=True)
class ObjectAsset:
    """One object, ready for a simulator.

    Attributes:
        name: unique in its set.
        category: the kind of thing it is.
        mesh: OBJ with texture coordinates; metres, z up.
        texture: the image it is painted with.
        hulls: convex collision meshes (OBJ or STL), in the mesh's coordinates; at least one.
        mass_kg: mass.
        model: box, diameter and symmetries, for scoring; `object_id` is the position in the set, from 1.
    """

    name: str
    category: str
    mesh: Path
    texture: Path
    hulls: tuple[Path, ...]
    mass_kg: float
    model: ObjectModel


@dataclass(frozen=True)
class ObjectSet:
    """The objects scenes are drawn from.

    Attributes:
        name: `procedural`, or the folder's name.
        digest: sha256 hex of every file's bytes and of what is said about the objects.
        assets: sorted by name.
    """

    name: str
    digest: str
    assets: tuple[ObjectAsset, ...]


def load_object_set(source: str, cache_dir: Path) -> ObjectSet:
    """Load an object set.

    Args:
        source: `procedural` for the set the package makes itself (written once below `cache_dir`), else a folder of
            scans (see `toolkit.data.scans`).
        cache_dir: where files that scans lack, and the procedural set, are kept.

    Raises:
        ToolkitError: the folder is no object set, or an object in it lacks a file or has an unusable mesh.
    """
    folder = procedural_folder(cache_dir / "objects") if source == "procedural" else Path(source).expanduser()
    scans = find_scans(folder)
    hasher = hashlib.sha256()
    assets: list[ObjectAsset] = []
    for object_id, scan in enumerate(scans, start=1):
        hasher.update(f"{scan.name} {scan.notes.model_dump_json()}".encode())
        for path in (scan.mesh, scan.texture, *scan.hulls):
            hasher.update(hashlib.sha256(path.read_bytes()).digest())
        assets.append(_make_asset(scan, object_id, cache_dir / "objects" / "hulls"))
    name = source if source == "procedural" else folder.resolve().name
    return ObjectSet(name, hasher.hexdigest(), tuple(assets))


def _make_asset(scan: Scan, object_id: int, hull_cache: Path) -> ObjectAsset:
    vertices = _read_vertices(scan.mesh)
    try:
        hull = ConvexHull(vertices)
    except (QhullError, ValueError) as error:
        raise ToolkitError(f"mesh '{scan.mesh}' is flat or has fewer than four vertices; replace it") from error
    extreme = vertices[hull.vertices]
    model = _make_model(object_id, scan.name, extreme, scan.notes.symmetry)
    mass = scan.notes.mass_kg or _DEFAULT_DENSITY_KG_M3 * hull.volume
    hulls = scan.hulls or (_write_hull(extreme, hull_cache),)
    return ObjectAsset(scan.name, scan.notes.category, scan.mesh, scan.texture, hulls, mass, model)


def _make_model(object_id: int, name: str, points: Float, symmetry: Symmetry) -> ObjectModel:
    low, high = points.min(axis=0), points.max(axis=0)
    center = (low + high) / 2
    to_center = np.eye(4)
    to_center[:3, 3] = center
    half_turn = to_center @ rotation_z(np.pi) @ invert(to_center)
    return ObjectModel(
        object_id=object_id,
        name=name,
        box_min=low,
        box_size=high - low,
        diameter=float(pdist(points).max()),
        discrete_symmetries=half_turn[None] if symmetry == "discrete_z_180" else np.zeros((0, 4, 4)),
        continuous_axes=np.array([[0, 0, 1, *center]]) if symmetry == "continuous_z" else np.zeros((0, 6)),
    )


def _read_vertices(mesh: Path) -> Float:
    """(V, 3) float64 positions. Parsing nothing but the `v` lines keeps loading a set of scans at about a second."""
    lines = re.findall(rb"^v[ \t]+(.+)$", mesh.read_bytes(), re.MULTILINE)
    try:
        vertices = np.loadtxt(BytesIO(b"\n".join(lines)), usecols=(0, 1, 2), ndmin=2)
    except ValueError as error:
        raise ToolkitError(f"mesh '{mesh}' has a vertex line that is not three numbers; export it again") from error
    if not np.isfinite(vertices).all():
        raise ToolkitError(f"mesh '{mesh}' has a vertex that is not finite; export it again")
    return vertices


def _write_hull(points: Float, folder: Path) -> Path:
    """Write one convex mesh around (V, 3) points, few enough vertices for fast contacts, under its digest's name."""
    ascending = np.arange(_HULL_DIRECTIONS) + 0.5
    z, azimuth = 1 - 2 * ascending / _HULL_DIRECTIONS, ascending * np.pi * (3 - np.sqrt(5))  # Fibonacci sphere
    ring = np.sqrt(1 - z**2)
    directions = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], axis=1)
    directions = np.concatenate([directions, np.eye(3), -np.eye(3)])
    support = np.unique(np.argmax(points @ directions.T, axis=0))
    text = trimesh.convex.convex_hull(points[support]).export(file_type="obj", header=None)
    content = str(text).encode()
    made = make_once(folder / hashlib.sha256(content).hexdigest(), lambda to: (to / "hull.obj").write_bytes(content))
    return made / "hull.obj"
