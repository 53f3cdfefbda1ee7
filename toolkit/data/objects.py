"""Object sets: what the tabletop benchmark puts on its table, made by the package or scanned."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import pdist

from toolkit.data.meshes import Drawable, drawable, read_points, unit_of
from toolkit.data.procedural import procedural_folder
from toolkit.data.scans import Scan, Symmetry, find_scans
from toolkit.errors import ToolkitError
from toolkit.files import make_once
from toolkit.geometry import invert, rotation_z
from toolkit.types import Float, ObjectModel

# Household objects are hollow or soft: about a third of the weight of water for what their hull encloses.
_DEFAULT_DENSITY_KG_M3 = 350.0
_HULL_DIRECTIONS = 512

_NAMED = 5
"""Objects that a note names."""

_TOUCHING, _BROADER = 0.02, 0.2
"""What is as near to the table, as a part of an object's size, stands on it; how much more of an outline is a base."""


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
        notes: what was taken for granted or done to them, in sentences.
    """

    name: str
    digest: str
    assets: tuple[ObjectAsset, ...]
    notes: tuple[str, ...] = ()


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
    points = [read_points(scan.mesh) for scan in scans]
    unit, said = unit_of([float(np.ptp(own, axis=0).max(initial=0)) for own in points], str(folder))
    said = said if any(scan.notes.unit is None for scan in scans) else None
    hasher = hashlib.sha256()
    assets: list[ObjectAsset] = []
    notes = [said] if said else []
    done: dict[str, list[str]] = {}
    for object_id, (scan, own) in enumerate(zip(scans, points, strict=True), start=1):
        drawn = drawable(scan, scan.notes.unit or unit, cache_dir)
        hasher.update(f"{scan.name} {scan.notes.model_dump_json(exclude={'unit', 'up'})}".encode())
        for path in (drawn.mesh, drawn.texture, *drawn.hulls):
            hasher.update(hashlib.sha256(path.read_bytes()).digest())
        vertices = own if drawn.mesh == scan.mesh else read_points(drawn.mesh)
        assets.append(_make_asset(scan, drawn, vertices, object_id, cache_dir / "objects" / "hulls"))
        for what in drawn.said:
            done.setdefault(what, []).append(scan.name)
    notes += [f"{_listed(names)}: {what}" for what, names in done.items()]
    name = source if source == "procedural" else folder.resolve().name
    if _looks_y_up(points) and all(scan.notes.up == "z" for scan in scans):
        notes.append(
            f"most objects of '{folder}' stand with y up, not z: if that is meant, say "
            f'{{"*": {{"up": "y"}}}} in objects.json'
        )
    return ObjectSet(name, hasher.hexdigest(), tuple(assets), tuple(notes))


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{', '.join(names[:_NAMED])}{more}"


def _looks_y_up(points: Sequence[Float]) -> bool:
    """Whether far more objects have a base at the low end of y than at that of z."""
    broader = np.array([_base(own, 1) - _base(own, 2) for own in points])
    return int((broader > _BROADER).sum()) > 2 * int((broader < -_BROADER).sum())


def _base(points: Float, axis: int) -> float:
    """What part of its outline, seen along an axis, an object touches the table with, at that axis' low end."""
    across = np.delete(points, axis, axis=1)
    height = points[:, axis] - points[:, axis].min()
    try:
        touching = ConvexHull(across[height < _TOUCHING * np.ptp(points, axis=0).max()]).volume
        return float(touching / ConvexHull(across).volume)
    except (QhullError, ValueError):
        return 0.0


def _make_asset(scan: Scan, drawn: Drawable, vertices: Float, object_id: int, hull_cache: Path) -> ObjectAsset:
    try:
        hull = ConvexHull(vertices)
    except (QhullError, ValueError) as error:
        raise ToolkitError(f"mesh '{scan.mesh}' is flat or has fewer than four vertices; replace it") from error
    extreme = vertices[hull.vertices]
    model = _make_model(object_id, scan.name, extreme, scan.notes.symmetry)
    mass = scan.notes.mass_kg or _DEFAULT_DENSITY_KG_M3 * hull.volume
    hulls = drawn.hulls or (_write_hull(extreme, hull_cache),)
    return ObjectAsset(scan.name, scan.notes.category, drawn.mesh, drawn.texture, hulls, mass, model)


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


def _write_hull(points: Float, folder: Path) -> Path:
    """Write one convex mesh around (V, 3) points, few enough vertices for fast contacts, under its digest's name."""
    import trimesh

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
