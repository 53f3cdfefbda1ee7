"""The table: a textured square at z = 0, drawn once and kept; or one of another shape and look, drawn for a scene."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from toolkit.data.conditions import TableLook, TableShape
from toolkit.data.procedural.meshes import Surface, lathe, merge, panel
from toolkit.data.scenery import surfaces
from toolkit.data.scenery.props import Prop, block
from toolkit.files import make_once
from toolkit.geometry import rotation_z
from toolkit.types import Float, Image

HALF_SIDE_M = 0.62
_TEXTURE_PX = 1024
_VERSION = 1

_MARGIN_M = 0.03
"""Objects stand at least this far from the table's edge."""


@dataclass(frozen=True, eq=False)
class Table:
    """A table's top, at z = 0.

    Attributes:
        T_world_table: (4, 4) its middle.
        half: (2,) half its length and width, metres.
        height: of the top above the floor.
        thickness: of the top.
    """

    shape: Literal["rectangle", "round"]
    T_world_table: Float
    half: Float
    height: float
    thickness: float

    def holds(self, xy: Float) -> bool:
        """Say whether all of (..., 2) points of the world lie on the top."""
        local = (np.asarray(xy) - self.T_world_table[:2, 3]) @ self.T_world_table[:2, :2] / self.half
        if self.shape == "round":
            return bool((np.linalg.norm(local, axis=-1) <= 1).all())
        return bool((np.abs(local) <= 1).all())

    def outline(self, corners: int = 64) -> Float:
        """(K, 2) points of the top's edge in the world, counter-clockwise."""
        if self.shape == "round":
            angles = 2 * np.pi * np.arange(corners) / corners
            local = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        else:
            local = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        return local * self.half @ self.T_world_table[:2, :2].T + self.T_world_table[:2, 3]


def draw_table(shape: TableShape, radius: float, rng: np.random.Generator) -> Table:
    """A table that holds a disc around the world's origin: the usual square, or one of random size and place."""
    if shape == "any":
        shape = ("square", "rectangle", "rectangle", "round")[int(rng.integers(4))]
    height, thickness = float(rng.uniform(0.42, 0.8)), float(rng.uniform(0.015, 0.045))
    if shape == "square":
        return Table("rectangle", np.eye(4), np.full(2, HALF_SIDE_M), height, thickness)
    least = radius + _MARGIN_M
    T = rotation_z(float(rng.uniform(-np.pi, np.pi)))
    if shape == "round":
        half = np.full(2, least + float(rng.uniform(0, 0.25)))
        aside = (half[0] - least) * np.sqrt(rng.random())
        T[:2, 3] = aside * T[:2, 0]
        return Table("round", T, half, height, thickness)
    half = np.array([least + rng.uniform(0, 0.45), least + rng.uniform(0, 0.2)])
    T[:2, 3] = T[:2, :2] @ (rng.uniform(-1, 1, 2) * (half - least))
    return Table("rectangle", T, half, height, thickness)


def table_prop(table: Table, look: TableLook, rng: np.random.Generator) -> Prop:
    """The top of a table, its rim, and what carries it."""
    shape = np.rint(table.half / table.half.max() * _TEXTURE_PX).astype(int)
    top = _drawn(look, rng, int(shape[0]), int(shape[1]))
    # Rim and legs wear the lowest strip of the picture, darkened.
    strip = (cv2.resize(top[:64], (int(shape[0]), 64)) * 0.7).astype(np.uint8)
    picture = np.vstack([top, strip])
    return Prop(_table_surface(table, 64 / len(picture)), picture)


def _drawn(look: TableLook, rng: np.random.Generator, width: int, height: int) -> Image:
    if look == "varied":
        return surfaces.table_top(rng, width, height)
    return _DRAWERS[look]()[:height, :width]


def _table_surface(table: Table, strip: float) -> Surface:
    """Top, rim and legs; v below `strip` is what rim and legs are painted with."""
    a, b = table.half
    low, rim = -table.height, (0.02, 0.1 * strip, 0.98, 0.9 * strip)
    if table.shape == "round":
        top = lathe(np.stack([np.linspace(a, 0, 9), np.zeros(9)], axis=1), rim)
        edge = lathe(np.array([[a, -table.thickness], [a, 0]]), rim)
        legs = [block(np.array([-0.05, -0.05, low]), np.array([0.05, 0.05, -table.thickness]), [rim] * 5)]
    else:
        top = panel(np.array([-a, -b, 0]), np.array([2 * a, 0, 0]), np.array([0, 2 * b, 0]), rim, 0.15)
        corner, (x, y, z) = np.array([-a, -b, -table.thickness]), np.diag([2 * a, 2 * b, table.thickness])
        sides = [(corner, x), (corner + x, y), (corner + x + y, -x), (corner + y, -y)]
        edge = merge([panel(c, along, z, rim) for c, along in sides])
        places = [np.array([sx * (a - 0.06), sy * (b - 0.06), 0]) for sx in (-1, 1) for sy in (-1, 1)]
        half = np.array([0.025, 0.025, 0])
        legs = [block(p - half + [0, 0, low], p + half - [0, 0, table.thickness], [rim] * 5) for p in places]
    uv = (top.vertices[:, :2] / table.half + 1) / 2 * [1, 1 - strip] + [0, strip]
    whole = merge([Surface(top.vertices, uv, top.faces, ()), edge, *legs])
    return whole.moved(table.T_world_table[:3, :3], table.T_world_table[:3, 3])


def table_files(look: str, cache: Path) -> tuple[Path, Path]:
    """Mesh and texture of a table that looks `plain`, `wood` or `cloth`, made below `cache` when absent."""

    def write(folder: Path) -> None:
        (folder / "table.obj").write_text(_mesh())
        (folder / "table.png").write_bytes(cv2.imencode(".png", _DRAWERS[look]()[..., ::-1])[1].tobytes())

    folder = make_once(cache / "objects" / f"table-{_VERSION}-{look}", write)
    return folder / "table.obj", folder / "table.png"


def _mesh(cells: int = 8) -> str:
    """A grid of small triangles: TinyRenderer shades and clips by triangle."""
    ticks = np.linspace(0, 1, cells + 1)
    lines = [f"v {(2 * u - 1) * HALF_SIDE_M:.6f} {(2 * v - 1) * HALF_SIDE_M:.6f} 0" for v in ticks for u in ticks]
    lines += [f"vt {u:.6f} {v:.6f}" for v in ticks for u in ticks] + ["vn 0 0 1"]
    row = cells + 1
    for j in range(cells):
        for i in range(cells):
            a, b = j * row + i + 1, (j + 1) * row + i + 1
            for triangle in ((a, a + 1, b + 1), (a, b + 1, b)):
                lines.append("f " + " ".join(f"{k}/{k}/1" for k in triangle))
    return "\n".join(lines) + "\n"


def _grain(seed: int, stretch: tuple[float, float]) -> np.ndarray:
    """Noise of zero mean and unit deviation, stretched along one axis."""
    noise = np.random.default_rng(seed).standard_normal((_TEXTURE_PX, _TEXTURE_PX))
    smooth = cv2.GaussianBlur(noise, (0, 0), sigmaX=stretch[0], sigmaY=stretch[1])
    return smooth / smooth.std()


def _plain() -> Image:
    shade = 205 + 1.5 * _grain(1, (1.0, 1.0))
    return np.repeat(shade[..., None], 3, axis=2).clip(0, 255).astype(np.uint8)


def _wood() -> Image:
    grain = 0.6 * _grain(2, (60, 1.2)) + 0.8 * _grain(3, (120, 6))
    base = np.array([176.0, 138.0, 98.0])
    return (base + grain[..., None] * np.array([10.0, 9.0, 8.0])).clip(0, 255).astype(np.uint8)


def _cloth() -> Image:
    y, x = np.mgrid[:_TEXTURE_PX, :_TEXTURE_PX]
    stripes = ((x // 64) % 2 + (y // 64) % 2).astype(float)
    weave = 6 * _grain(4, (0.8, 0.8))
    base = np.array([196.0, 204.0, 214.0]) - stripes[..., None] * np.array([26.0, 18.0, 8.0])
    return (base + weave[..., None]).clip(0, 255).astype(np.uint8)


_DRAWERS = {"plain": _plain, "wood": _wood, "cloth": _cloth}
