"""Flat things on the table that are not to be moved: paper, magazines, coasters, mats, cloths. At most 1 mm high."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from toolkit.data.procedural import textures
from toolkit.data.procedural.meshes import Surface, lathe, panel
from toolkit.data.scenery import surfaces
from toolkit.data.scenery.props import Prop
from toolkit.data.table import Table
from toolkit.geometry import rotation_z
from toolkit.types import Float, Image

Presence = Literal["both", "goal", "current"]

_LEAST_M, _MOST_M = 0.0002, 0.001
_TRIES = 40
_PICTURE_PX = 420
_BOTH = 0.6
"""Share of the flat things that lie in both scenes, at the same place."""


@dataclass(frozen=True, eq=False)
class FlatThing:
    """A flat thing, and the scenes it lies in."""

    prop: Prop
    presence: Presence


def draw_clutter(table: Table, most: int, rng: np.random.Generator) -> list[FlatThing]:
    """Up to `most` flat things on a table, those drawn later on top; none reaches beyond the table's edge."""
    things: list[FlatThing] = []
    for _ in range(int(rng.integers(0, most + 1))):
        surface, picture = _thing(rng)
        place = _place(surface, table, rng)
        if place is None:
            continue
        height = _LEAST_M + (_MOST_M - _LEAST_M) * (len(things) + rng.random()) / max(most, 1)
        drawn = rng.random()
        presence: Presence = "both" if drawn < _BOTH else "goal" if drawn < (1 + _BOTH) / 2 else "current"
        R, xy = place
        things.append(FlatThing(Prop(surface.moved(R, np.array([*xy, height])), picture), presence))
    return things


def _place(surface: Surface, table: Table, rng: np.random.Generator) -> tuple[Float, Float] | None:
    """A turn (3, 3) and a place (2,) at which a surface lies on the table."""
    for _ in range(_TRIES):
        R = rotation_z(rng.uniform(-np.pi, np.pi))[:3, :3]
        xy = rng.uniform(-1, 1, 2) * table.half @ table.T_world_table[:2, :2].T + table.T_world_table[:2, 3]
        if table.holds(surface.vertices[:, :2] @ R[:2, :2].T + xy):
            return R, xy
    return None


def _thing(rng: np.random.Generator) -> tuple[Surface, Image]:
    kind = int(rng.integers(6))
    size = _PICTURE_PX
    if kind == 0:
        return _rectangle(0.210, 0.297), surfaces.paper(rng, size, round(size * 1.414))
    if kind == 1:
        return _rectangle(0.21, 0.28), textures.label(rng, size, round(size * 1.33))
    if kind == 2:
        return _disc(rng.uniform(0.04, 0.055)), surfaces.laminate(rng, 128, 128)
    if kind == 3:
        w, h = rng.uniform(0.25, 0.45), rng.uniform(0.2, 0.35)
        drawers = (surfaces.checked, surfaces.printed_cloth, surfaces.laminate, surfaces.carpet)
        return _rectangle(w, h), drawers[int(rng.integers(4))](rng, size, round(size * h / w))
    if kind == 4:
        side = rng.uniform(0.07, 0.16)
        note = textures.canvas(128, 128, textures.color(rng, (0.1, 0.7), 1.0))
        return _rectangle(side, side), _written(rng, note)
    return _cloth(rng), surfaces.checked(rng, size, size)


def _rectangle(width: float, height: float) -> Surface:
    corner = -np.array([width, height, 0]) / 2
    return panel(corner, np.array([width, 0, 0]), np.array([0, height, 0]), (0, 0, 1, 1), 0.1)


def _disc(radius: float) -> Surface:
    flat = lathe(np.array([[radius, 0.0], [0.5 * radius, 0.0], [0.0, 0.0]]), (0, 0, 1, 1), 32)
    return Surface(flat.vertices, flat.vertices[:, :2] / (2 * radius) + 0.5, flat.faces, ())


def _cloth(rng: np.random.Generator) -> Surface:
    """A napkin whose edge is a little uneven."""
    flat = _disc(rng.uniform(0.1, 0.17))
    angle = np.arctan2(flat.vertices[:, 1], flat.vertices[:, 0])
    corners = 1 / np.maximum(np.abs(np.cos(angle)), np.abs(np.sin(angle)))
    waves = 1 + sum(rng.normal(0, 0.02) * np.cos(k * angle + rng.uniform(0, 6)) for k in range(2, 7))
    return Surface(flat.vertices * (np.minimum(corners, 1.35) * waves)[:, None], flat.uv, flat.faces, ())


def _written(rng: np.random.Generator, note: Image) -> Image:
    for y in range(20, 110, 18):
        cv2.line(note, (12, y), (12 + int(rng.integers(20, 100)), y), (40, 40, 60), 2, cv2.LINE_AA)
    return note
