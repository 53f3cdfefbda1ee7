"""Textured surfaces: lathes, boxes, lofts and tubes, and the files they are written to. Metres, z up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from toolkit.types import Float

Rect = tuple[float, float, float, float]
"""(u0, v0, u1, v1): the part of the texture a surface is painted with; v = 0 is the image's lower edge."""

_SHARP_COSINE = np.cos(np.radians(40))


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles with texture coordinates. Vertices shared by faces are shaded smoothly, doubled ones sharply.

    Attributes:
        vertices: (V, 3) float64.
        uv: (V, 2) float64.
        faces: (F, 3) int64, counter-clockwise from outside.
        hulls: point sets (N, 3) whose convex hulls together approximate the solid.
    """

    vertices: Float
    uv: Float
    faces: NDArray[np.int64]
    hulls: tuple[Float, ...]

    def moved(self, R: Float, t: Float) -> Surface:
        """Rotate by (3, 3) R, then shift by (3,) t."""
        return Surface(self.vertices @ R.T + t, self.uv, self.faces, tuple(h @ R.T + t for h in self.hulls))


def merge(parts: Sequence[Surface]) -> Surface:
    """Join surfaces into one."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    return Surface(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.uv for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=False)]),
        tuple(hull for part in parts for hull in part.hulls),
    )


def on_table(surface: Surface) -> Surface:
    """Centre a surface over the origin, its lowest point at z = 0."""
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    return surface.moved(np.eye(3), -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]]))


def box(size: Float, rects: Sequence[Rect]) -> Surface:
    """A box of (3,) `size` centred at the origin; rects for front, back, left, right, top, bottom."""
    x, y, z = np.asarray(size) / 2
    corners = [
        [(-x, -y, -z), (x, -y, -z), (x, -y, z), (-x, -y, z)],
        [(x, y, -z), (-x, y, -z), (-x, y, z), (x, y, z)],
        [(-x, y, -z), (-x, -y, -z), (-x, -y, z), (-x, y, z)],
        [(x, -y, -z), (x, y, -z), (x, y, z), (x, -y, z)],
        [(-x, -y, z), (x, -y, z), (x, y, z), (-x, y, z)],
        [(-x, y, -z), (x, y, -z), (x, -y, -z), (-x, -y, -z)],
    ]
    vertices = np.array(corners, np.float64).reshape(-1, 3)
    uv = np.array([[(a, b), (c, b), (c, d), (a, d)] for a, b, c, d in rects], np.float64).reshape(-1, 2)
    quads = np.arange(24).reshape(6, 4)
    return Surface(vertices, uv, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]), (vertices,))


def panel(corner: Float, along: Float, up: Float, rect: Rect, cell: float = 0.3) -> Surface:
    """A flat rectangle, seen from where `along` (3,) turns to `up` (3,) counter-clockwise, in cells of about `cell`.

    Small triangles, because TinyRenderer drops those that reach behind the camera.
    """
    columns, rows = (max(1, round(float(np.linalg.norm(side)) / cell)) + 1 for side in (along, up))
    v, u = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
    vertices = corner + u[..., None] * along + v[..., None] * up
    u0, v0, u1, v1 = rect
    uv = np.stack([u0 + (u1 - u0) * u, v0 + (v1 - v0) * v], axis=-1)
    return Surface(vertices.reshape(-1, 3), uv.reshape(-1, 2), _grid(rows, columns), (vertices.reshape(-1, 3),))


def lathe(profile: Float, rect: Rect, segments: int = 48, hollow: bool = False) -> Surface:
    """Turn a (P, 2) profile of (radius, z), listed so that the outside lies to its right, about the z axis.

    u runs around, v along the profile's length. A hollow one is approximated by hulls of eight sectors.
    """
    rings = _split_sharp(profile)
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(profile, axis=0), axis=1))]) / _length(profile)
    angles = np.linspace(0, 2 * np.pi, segments + 1)
    u0, v0, u1, v1 = rect
    parts: list[Surface] = []
    for first, last in rings:
        r, z = profile[first : last + 1].T
        vertices = np.stack(
            [r[:, None] * np.cos(angles), r[:, None] * np.sin(angles), np.repeat(z[:, None], len(angles), axis=1)], -1
        )
        uv = np.stack(
            np.broadcast_arrays(
                u0 + (u1 - u0) * angles / (2 * np.pi), (v0 + (v1 - v0) * length[first : last + 1])[:, None]
            ),
            axis=-1,
        )
        parts.append(Surface(vertices.reshape(-1, 3), uv.reshape(-1, 2), _grid(len(r), len(angles)), ()))
    joined = merge(parts)
    return Surface(
        joined.vertices, joined.uv, joined.faces, _sectors(joined.vertices) if hollow else (joined.vertices,)
    )


def loft(centers: Float, halves: Float, power: float, rect: Rect, segments: int = 32) -> Surface:
    """Superelliptic cross sections along x: (S, 3) centres, (S, 2) half extents in y and z, closed at both ends."""
    t = np.linspace(0, 2 * np.pi, segments + 1)
    y = np.sign(np.cos(t)) * np.abs(np.cos(t)) ** (2 / power)
    z = np.sign(np.sin(t)) * np.abs(np.sin(t)) ** (2 / power)
    rings = np.stack([np.zeros((len(centers), len(t))), halves[:, :1] * y, halves[:, 1:] * z], -1) + centers[:, None]
    # Closing rings of no size, so that the ends are shaded with the rest.
    rings = np.concatenate([np.broadcast_to(centers[0], rings[:1].shape), rings, rings[-1:] * 0 + centers[-1]])
    along = np.linspace(0, 1, len(rings))
    u0, v0, u1, v1 = rect
    uv = np.stack(np.broadcast_arrays((u0 + (u1 - u0) * along)[:, None], v0 + (v1 - v0) * t / (2 * np.pi)), -1)
    vertices = rings.reshape(-1, 3)
    pieces = tuple(rings[i : i + 2].reshape(-1, 3) for i in range(1, len(rings) - 2))
    return Surface(vertices, uv.reshape(-1, 2), _grid(len(rings), len(t)), pieces)


def tube(path: Float, radius: float, rect: Rect, segments: int = 12) -> Surface:
    """Sweep a disc along a (P, 3) path that lies in the xz plane."""
    tangents = np.gradient(path, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    side = np.array([0.0, 1.0, 0.0])
    normals = np.cross(tangents, side)
    t = np.linspace(0, 2 * np.pi, segments + 1)
    ring = np.cos(t)[:, None] * side + np.sin(t)[:, None] * normals[:, None]
    vertices = (path[:, None] + radius * ring).reshape(-1, 3)
    u0, v0, u1, v1 = rect
    along = np.linspace(0, 1, len(path))
    uv = np.stack(np.broadcast_arrays((u0 + (u1 - u0) * along)[:, None], v0 + (v1 - v0) * t / (2 * np.pi)), -1)
    step = len(t) * max(1, len(path) // 5)
    pieces = tuple(vertices[i : i + step + len(t)] for i in range(0, len(vertices) - len(t), step))
    return Surface(vertices, uv.reshape(-1, 2), _grid(len(path), len(t)), pieces)


def _grid(rows: int, columns: int) -> NDArray[np.int64]:
    """Faces of a (rows, columns) grid of vertices."""
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    b, c, d = a + 1, a + columns + 1, a + columns
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def _length(profile: Float) -> float:
    return float(np.linalg.norm(np.diff(profile, axis=0), axis=1).sum())


def _split_sharp(profile: Float) -> list[tuple[int, int]]:
    """Stretches (first, last) of a profile between its sharp corners."""
    steps = np.diff(profile, axis=0)
    steps = steps / np.maximum(np.linalg.norm(steps, axis=1, keepdims=True), 1e-12)
    sharp = np.flatnonzero((steps[:-1] * steps[1:]).sum(axis=1) < _SHARP_COSINE) + 1
    stops = [0, *sharp.tolist(), len(profile) - 1]
    return list(pairwise(stops))


def _sectors(vertices: Float, count: int = 8) -> tuple[Float, ...]:
    """Split a shell into sectors about z, each closed by the neighbouring one's edge."""
    turn = (np.arctan2(vertices[:, 1], vertices[:, 0]) % (2 * np.pi)) * count / (2 * np.pi)
    off_axis = np.hypot(vertices[:, 0], vertices[:, 1]) > 1e-6
    beside = [np.abs((turn - k - 0.5 + count / 2) % count - count / 2) <= 0.51 for k in range(count)]
    floor = vertices[vertices[:, 2] < vertices[:, 2].min() + 0.006]
    return (*(_outer_shell(vertices[off_axis & sector]) for sector in beside), floor)


def _outer_shell(points: Float) -> Float:
    """Points of the wall only: those in the outer part of the sector's radii."""
    radius = np.hypot(points[:, 0], points[:, 1])
    return points[radius > 0.6 * radius.max()]


def obj_text(surface: Surface, texture: str) -> tuple[str, str]:
    """OBJ and MTL text of a surface painted with `texture`."""
    material = f"newmtl material_0\nKa 1 1 1\nKd 1 1 1\nmap_Kd {texture}\n"
    return "mtllib textured.mtl\nusemtl material_0\n" + bare_obj_text(surface), material


def bare_obj_text(surface: Surface) -> str:
    """OBJ text of a surface that names no texture."""
    normals = _normals(surface)
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in surface.vertices.tolist()]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in surface.uv.tolist()]
    lines += [f"vn {x:.5f} {y:.5f} {z:.5f}" for x, y, z in normals.tolist()]
    lines += [f"f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}" for a, b, c in (surface.faces + 1).tolist()]
    return "\n".join(lines) + "\n"


def _normals(surface: Surface) -> Float:
    """(V, 3) area-weighted vertex normals; vertices at one place in a seam share theirs."""
    a, b, c = (surface.vertices[surface.faces[:, i]] for i in range(3))
    face = np.cross(b - a, c - a)
    normals = np.zeros_like(surface.vertices)
    for i in range(3):
        np.add.at(normals, surface.faces[:, i], face)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    # The first and the last column of a turned grid coincide: average them, or the seam shows.
    key = np.rint(np.concatenate([surface.vertices * 1e6, normals * 1.2], axis=1)).astype(np.int64)
    _, groups = np.unique(key, axis=0, return_inverse=True)
    total = np.zeros((int(groups.max()) + 1, 3))
    np.add.at(total, groups.ravel(), normals)
    shared = total[groups.ravel()]
    return shared / np.maximum(np.linalg.norm(shared, axis=1, keepdims=True), 1e-12)


def hull_stl(points: Float) -> bytes | None:
    """Binary STL of the convex hull of points; None where they span no volume."""
    import trimesh

    try:
        hull = trimesh.convex.convex_hull(np.unique(np.round(points, 6), axis=0))
    except Exception:
        # Qhull's ways to say that the points are flat differ by version.
        return None
    return bytes(hull.export(file_type="stl"))
