"""Scans in any form -> what the renderer draws: OBJ with texture coordinates and one image, in metres, z up."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pictures
from scipy.spatial import KDTree

from toolkit.data.scans import Scan, Unit
from toolkit.errors import ToolkitError
from toolkit.files import make_once
from toolkit.types import Float, Image

METRES: dict[Unit, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_NAMES: dict[Unit, str] = {"m": "metres", "cm": "centimetres", "mm": "millimetres"}

_USUAL_M, _LEAST_M = 0.12, 0.005
"""The largest side of a usual object, and one below which no set of them is, whatever its unit."""

_MOST_FACES = 80_000
"""PyBullet's EGL renderer draws nothing of a mesh once a scene has about 1.2 million faces, and does not say so."""

_ALIGNED_PX = 4
"""The renderer skews the rows of images whose width is no multiple of this."""

_ATLAS_PX, _LEAST_TILE, _MOST_TILE = 2048, 4, 64
_GREY = (170, 170, 170)

_VERSION = 4
"""Of what is written here: raise it when that changes."""


@dataclass(frozen=True)
class Drawable:
    """A scan as the renderer draws it.

    Attributes:
        mesh: OBJ with texture coordinates; metres, z up.
        texture: the image it is painted with.
        hulls: convex collision meshes in the mesh's coordinates; empty where the scan brings none.
        said: what was done to it, of which a person should know, each without its name.
    """

    mesh: Path
    texture: Path
    hulls: tuple[Path, ...]
    said: tuple[str, ...] = ()


def read_points(mesh: Path) -> Float:
    """(V, 3) float64 positions of a mesh, in its file's unit and axes.

    Raises:
        ToolkitError: it cannot be read, or a position is not three finite numbers.
    """
    points = _obj_points(mesh) if mesh.suffix.lower() == ".obj" else np.asarray(_load(mesh).vertices, np.float64)
    if not np.isfinite(points).all():
        raise ToolkitError(f"mesh '{mesh}' has a vertex that is not finite; export it again")
    return points


def _obj_points(mesh: Path) -> Float:
    """Parsing nothing but the `v` lines keeps loading a set of scans at about a second."""
    lines = re.findall(rb"^v[ \t]+(.+)$", mesh.read_bytes(), re.MULTILINE)
    try:
        return np.loadtxt(BytesIO(b"\n".join(lines)), usecols=(0, 1, 2), ndmin=2)
    except ValueError as error:
        raise ToolkitError(f"mesh '{mesh}' has a vertex line that is not three numbers; export it again") from error


def unit_of(sides: Sequence[float], source: str) -> tuple[Unit, str | None]:
    """The unit in which a set of objects is of the size that things on tables have, and a sentence where it is not m.

    Args:
        sides: the largest side of every object's box, in the files' unit.
        source: names the set.

    Raises:
        ToolkitError: there is none.
    """
    middle = float(np.median(sides))
    unit = min(METRES, key=lambda unit: abs(np.log(max(middle * METRES[unit], 1e-12) / _USUAL_M)))
    if middle * METRES[unit] < _LEAST_M:
        raise ToolkitError(
            f"the objects of '{source}' are {middle * METRES[unit] * 1000:.2g} mm large, by the middle one and in "
            "metres; scale them, or give their unit (m, cm, mm) in objects.json"
        )
    if unit == "m":
        return unit, None
    size = f"the middle one is {middle:.3g} large"
    return unit, f"'{source}' is taken to be in {_NAMES[unit]}: {size}; another unit can be given in objects.json"


def drawable(scan: Scan, unit: Unit, cache: Path) -> Drawable:
    """A scan as it is, where the renderer can draw it so; else what was made of it, kept below `cache`.

    Colours are those of its textures (several are put into one image), else of its vertices or faces, baked into an
    image; a mesh without any is grey. Meshes of more than 80,000 faces are thinned out.

    Raises:
        ToolkitError: the mesh or its image cannot be read, its texture is missing, or what thins it out is not
            installed.
    """
    if unit == "m" and scan.notes.up == "z" and scan.texture is not None and _is_plain(scan.mesh, scan.texture):
        return Drawable(scan.mesh, scan.texture, scan.hulls)
    files = [scan.mesh, *([scan.texture] if scan.texture else []), *scan.hulls]
    key = hashlib.sha256(f"{_VERSION} {unit} {scan.notes.up}".encode())
    for path in files:
        key.update(hashlib.sha256(path.read_bytes()).digest())
    T = np.eye(4)
    T[:3, :3] *= METRES[unit]
    if scan.notes.up == "y":
        T[:3, :3] = T[:3, :3] @ [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    folder = make_once(cache / "objects" / "drawable" / key.hexdigest(), lambda to: _write(scan, T, to))
    said = (folder / "said.txt").read_text().splitlines()
    hulls = sorted(folder.glob("hull_*.stl"))
    return Drawable(folder / "mesh.obj", folder / "texture.png", tuple(hulls), tuple(said))


def _is_plain(mesh: Path, texture: Path) -> bool:
    """Whether the renderer draws these files as they are meant."""
    if mesh.suffix.lower() != ".obj":
        return False
    content = mesh.read_bytes()
    # Counting is much faster, and most files name one material once.
    named = content.count(b"usemtl") > 1 and set(re.findall(rb"^usemtl[ \t]+(\S+)", content, re.MULTILINE))
    if (named and len(named) > 1) or b"\nvt" not in content or content.count(b"\nf ") > _MOST_FACES:
        return False
    picture = _open(texture)
    return picture.mode in ("RGB", "L") and picture.width % _ALIGNED_PX == 0


def _write(scan: Scan, T: Float, folder: Path) -> None:
    mesh, said = _load(scan.mesh), list[str]()
    picture = _picture(scan, mesh, said)
    if len(mesh.faces) > _MOST_FACES:
        said.append(f"thinned out to {_MOST_FACES} faces, since the renderer draws no more")
        mesh, corners = _thinned(mesh, _vertex_colors(mesh, picture, said))
        picture = None
    else:
        corners = None if picture is not None else _vertex_colors(mesh, None, said)[mesh.faces]
    # After colours are read, which trimesh may look up by vertex.
    mesh.apply_transform(T)
    if corners is not None:
        image, uv = bake(corners)
        picture = Pictures.fromarray(image)
        places, normals = mesh.vertices[mesh.faces].reshape(-1, 3), mesh.vertex_normals[mesh.faces].reshape(-1, 3)
        faces = np.arange(len(places)).reshape(-1, 3)
    else:
        places, normals, uv, faces = mesh.vertices, mesh.vertex_normals, mesh.visual.uv, mesh.faces
    assert picture is not None
    aligned = -(-picture.width // _ALIGNED_PX) * _ALIGNED_PX
    picture.convert("RGB").resize((aligned, picture.height)).save(folder / "texture.png")
    _write_obj(folder / "mesh.obj", places, normals, uv, faces)
    for number, hull in enumerate(scan.hulls):
        moved: Any = _load(hull)
        moved.apply_transform(T)
        moved.export(folder / f"hull_{number:03d}.stl")
    (folder / "said.txt").write_text("\n".join(said))


def _load(path: Path) -> Any:
    """A mesh of one part, its materials' images put into one; raises ToolkitError where it cannot be read."""
    import trimesh

    try:
        mesh: Any = trimesh.load(path, force="mesh", process=False)
        if path.suffix.lower() == ".obj" and _image_of(mesh) is None:
            mesh = _colored_obj(path) or mesh
        empty = not len(mesh.faces)
    except Exception as error:
        # trimesh's readers raise whatever their libraries do.
        raise ToolkitError(f"mesh '{path}' cannot be read ({' '.join(str(error).split())}); export it again") from error
    if empty:
        raise ToolkitError(f"mesh '{path}' has no face; is it a cloud of points?")
    return mesh


def _colored_obj(path: Path) -> Any:
    """An OBJ with a colour at every vertex, which trimesh drops where there are texture coordinates; else None."""
    import trimesh

    content = path.read_bytes()
    if not re.search(rb"^v([ \t]+\S+){6}[ \t\r]*$", content, re.MULTILINE):
        return None
    bare = re.sub(rb"^(vt|mtllib|usemtl)\b.*$", b"", content, flags=re.MULTILINE)
    bare = re.sub(rb"(?<=\d)/\d*(/-?\d+)?", b"", bare)
    return trimesh.load(BytesIO(bare), file_type="obj", force="mesh", process=False)


def _image_of(mesh: Any) -> Pictures.Image | None:
    from trimesh.visual.material import empty_material

    material = getattr(mesh.visual, "material", None)
    image = getattr(material, "image", None) or getattr(material, "baseColorTexture", None)
    # What trimesh takes where a mesh names no material.
    return None if image == empty_material().image else image


def _picture(scan: Scan, mesh: Any, said: list[str]) -> Pictures.Image | None:
    """What a mesh with texture coordinates is painted with; None where its colours are its own, or it has none."""
    uv = getattr(mesh.visual, "uv", None)
    named = _image_of(mesh)
    if uv is None:
        if scan.texture is not None and mesh.visual.kind not in ("vertex", "face"):
            said.append(f"'{scan.texture.name}' is not used, since there are no texture coordinates")
        return None
    if named is not None:
        return named
    if scan.texture is None:
        raise ToolkitError(
            f"object '{scan.name}' has no texture: put its image beside '{scan.mesh}' as texture_map.png"
        )
    return _open(scan.texture)


def _open(texture: Path) -> Pictures.Image:
    try:
        return Pictures.open(texture)
    except OSError as error:
        raise ToolkitError(f"texture '{texture}' is not an image; write or copy it again") from error


def _vertex_colors(mesh: Any, picture: Pictures.Image | None, said: list[str]) -> Image:
    """(V, 3) uint8: of the picture where there is one, else the mesh's own, else grey."""
    if picture is not None:
        pixels = np.asarray(picture.convert("RGB"), np.uint8)
        height, width = pixels.shape[:2]
        at = np.mod(np.asarray(mesh.visual.uv, np.float64), 1) * [width, height]
        return pixels[height - 1 - at[:, 1].astype(int).clip(0, height - 1), at[:, 0].astype(int).clip(0, width - 1)]
    if mesh.visual.kind in ("vertex", "face"):
        return np.asarray(mesh.visual.vertex_colors[:, :3], np.uint8)
    said.append("drawn grey, since there are no colours")
    return np.full((len(mesh.vertices), 3), _GREY, np.uint8)


def _thinned(mesh: Any, colors: Image) -> tuple[Any, Image]:
    """A mesh of fewer faces, and (F, 3, 3) the colours of their corners: those of the nearest vertices before."""
    import trimesh

    whole = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    # Seams of a texture are no holes of the surface.
    whole.merge_vertices()
    try:
        thin: Any = whole.simplify_quadric_decimation(face_count=_MOST_FACES)
    except ImportError as error:
        raise ToolkitError(
            f"a mesh has {len(mesh.faces)} faces, more than {_MOST_FACES}, and what thins it out is not installed; "
            "run: pip install 'rearrange-toolkit[scans]'"
        ) from error
    nearest = KDTree(mesh.vertices).query(thin.vertices)[1]
    return thin, colors[nearest][thin.faces]


def bake(corners: Image) -> tuple[Image, Float]:
    """Put the colours of triangles' corners into an image, two triangles to a square tile.

    Args:
        corners: (F, 3, 3) uint8, the colour of each corner of each triangle.

    Returns:
        (S, S, 3) uint8, and (3 F, 2) texture coordinates of all corners, (0, 0) at the lower left.
    """
    pairs = np.concatenate([corners, corners[: len(corners) % 2]]).reshape(-1, 2, 3, 3).astype(np.float32)
    across = int(np.ceil(np.sqrt(len(pairs))))
    side = int(np.clip(_ATLAS_PX // across, _LEAST_TILE, _MOST_TILE)) // _ALIGNED_PX * _ALIGNED_PX
    y, x = np.mgrid[:side, :side]
    # The first has its corners at pixels (0, 0), (side - 3, 0), (0, side - 3), the second the same, turned by half.
    ends = np.array([[0, 0], [side - 3, 0], [0, side - 3]])
    first = np.stack([side - 3.0 - x - y, x, y], axis=-1) / (side - 3)
    weights = np.where((x + y < side)[..., None], first, first[::-1, ::-1]).clip(0, 1)
    weights /= weights.sum(axis=-1, keepdims=True)
    which = (x + y >= side).astype(int)
    tiles = np.zeros((across**2, side, side, 3), np.uint8)
    for triangle in (0, 1):
        painted = np.einsum("yxc,pcv->pyxv", weights, pairs[:, triangle])
        tiles[: len(pairs)][:, which == triangle] = np.rint(painted)[:, which == triangle]
    image = tiles.reshape(across, across, side, side, 3).swapaxes(1, 2).reshape(across * side, across * side, 3)
    origin = np.stack(np.divmod(np.arange(len(pairs)), across)[::-1], axis=-1) * side
    pixels = origin[:, None, None] + np.stack([ends, side - 1 - ends])
    uv = (pixels.reshape(-1, 2)[: 3 * len(corners)] + 0.5) / (across * side)
    return image, np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1)


def _write_obj(path: Path, places: Float, normals: Float, uv: Float, faces: NDArray[np.integer[Any]]) -> None:
    """Names no material: the renderer would prefer its image to the one it is given."""
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in np.asarray(places).tolist()]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in np.asarray(uv).tolist()]
    lines += [f"vn {x:.4f} {y:.4f} {z:.4f}" for x, y, z in np.asarray(normals).tolist()]
    lines += [f"f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}" for a, b, c in (np.asarray(faces) + 1).tolist()]
    path.write_text("\n".join(lines) + "\n")
