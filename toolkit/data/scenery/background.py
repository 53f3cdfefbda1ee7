"""What stands around the table: a floor, walls, chairs, cupboards, shelves, other tables, boxes; seen, never moved."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from toolkit.data.procedural import textures
from toolkit.data.procedural.meshes import Rect, Surface, merge, panel
from toolkit.data.scenery import surfaces
from toolkit.data.scenery.props import Prop, block, sheet_of
from toolkit.data.table import Table
from toolkit.geometry import rotation_z
from toolkit.types import Float, Image

_NEAREST_WALL_M, _FURTHEST_WALL_M = 1.9, 3.2
"""Beyond the cameras, which stand up to 1.4 m from the table's middle."""

_WALL_TOP_M = 2.0
_FLOOR_TILE_M = 1.6
_TALL_FROM_M = 1.6
"""Nearer to the table's middle nothing rises so high that a camera could stand in it."""

_PATCH_PX = 192

Patches = list[Rect]
"""Rectangles of the furniture's texture."""


def draw_background(table: Table, rng: np.random.Generator) -> list[Prop]:
    """A room around a table, in world coordinates."""
    walls = rng.uniform(_NEAREST_WALL_M, _FURTHEST_WALL_M, 4)
    return [_floor(table, walls, rng), _walls(table, walls, rng), _furniture(table, walls, rng)]


def _floor(table: Table, walls: Float, rng: np.random.Generator) -> Prop:
    """One tile of the floor's picture, again and again."""
    east, north, west, south = walls
    tiles = [
        panel(
            np.array([x, y, -table.height]),
            np.array([_FLOOR_TILE_M, 0, 0]),
            np.array([0, _FLOOR_TILE_M, 0]),
            (0.002, 0.002, 0.998, 0.998),
        )
        for x in np.arange(-west, east, _FLOOR_TILE_M)
        for y in np.arange(-south, north, _FLOOR_TILE_M)
    ]
    return Prop(merge(tiles), surfaces.floor(rng, 768, 768))


def _walls(table: Table, walls: Float, rng: np.random.Generator) -> Prop:
    east, north, west, south = walls
    sheet, rects = sheet_of([surfaces.wall(rng, 640, 480) for _ in range(4)], 2, 512)
    up = np.array([0, 0, _WALL_TOP_M + table.height])
    corners = [(-west, -south), (east, -south), (east, north), (-west, north)]
    points = [np.array([x, y, -table.height]) for x, y in corners]
    sides = [panel(points[k], points[k - 1] - points[k], up, rects[k]) for k in range(4)]
    return Prop(merge(sides), sheet)


def _furniture(table: Table, walls: Float, rng: np.random.Generator) -> Prop:
    sheet, patches = sheet_of(_pictures(rng), 4, _PATCH_PX)
    parts: list[Surface] = []
    for _ in range(int(rng.integers(1, 5))):
        parts.append(_beside_table(_chair(table, patches, rng), table, rng))
    for _ in range(int(rng.integers(0, 3))):
        parts.append(_beside_table(_side_table(table, patches, rng), table, rng))
    for _ in range(int(rng.integers(0, 4))):
        parts.append(_beside_table(_carton(table, patches, rng), table, rng))
    for side in rng.permutation(4)[: int(rng.integers(1, 4))]:
        parts.append(_at_wall(_cupboard(table, patches, rng), walls, int(side), rng))
    return Prop(merge(parts), sheet)


def _pictures(rng: np.random.Generator) -> list[Image]:
    """Eight plain and wooden pictures, then eight printed ones."""
    size = _PATCH_PX
    plain = [surfaces.veneer, surfaces.veneer, surfaces.laminate, surfaces.laminate, surfaces.painted, surfaces.carpet]
    pictures = [draw(rng, size, size) for draw in (*plain, surfaces.laminate, surfaces.checked)]
    pictures += [textures.label(rng, 320, 320) for _ in range(4)]
    return [*pictures, *(surfaces.poster(rng, size, size) for _ in range(4))]


def _one(rng: np.random.Generator, patches: Sequence[Rect]) -> Rect:
    return patches[int(rng.integers(len(patches)))]


def _box(center: Sequence[float], size: Sequence[float], *rects: Rect) -> Surface:
    """A box whose (x, y) middle and lower edge z are `center`; one rect for all sides, or one for each of the five."""
    half = np.array([size[0] / 2, size[1] / 2, 0])
    low, high = np.asarray(center) - half, np.asarray(center) + half + [0, 0, size[2]]
    return block(low, high, rects if len(rects) == 5 else rects * 5)


def _chair(table: Table, patches: Patches, rng: np.random.Generator) -> Surface:
    """Seat, four legs and a back of slats at +y; it faces the table, which is at -y."""
    floor, wood = -table.height, _one(rng, patches[:8])
    w, d, seat = rng.uniform(0.38, 0.48), rng.uniform(0.38, 0.46), rng.uniform(0.4, 0.48)
    back = max(seat + 0.25, table.height + rng.uniform(0.02, 0.25))
    parts = [_box((0, 0, floor + seat), (w, d, 0.03), _one(rng, patches[:8]))]
    parts += [_box((x * (w / 2 - 0.02), y * (d / 2 - 0.02), floor), (0.03, 0.03, seat), wood) for x, y in _CORNERS]
    posts = [_box((x * (w / 2 - 0.02), d / 2 - 0.02, floor + seat), (0.03, 0.03, back - seat), wood) for x in (-1, 1)]
    slats = int(rng.integers(1, 4))
    each = (back - seat - 0.1) / slats
    rails = [
        _box((0, d / 2 - 0.02, floor + seat + 0.1 + k * each), (w, 0.02, each * rng.uniform(0.4, 0.9)), wood)
        for k in range(slats)
    ]
    return merge([*parts, *posts, *rails])


_CORNERS = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def _side_table(table: Table, patches: Patches, rng: np.random.Generator) -> Surface:
    """Another table, lower than this one or higher, with things on it."""
    floor, look = -table.height, _one(rng, patches[:8])
    high = table.height * rng.uniform(0.55, 1.25)
    w, d = rng.uniform(0.4, 1.1), rng.uniform(0.4, 0.7)
    parts = [_box((0, 0, floor + high - 0.03), (w, d, 0.03), look)]
    parts += [_box((x * (w / 2 - 0.03), y * (d / 2 - 0.03), floor), (0.04, 0.04, high), look) for x, y in _CORNERS]
    for _ in range(int(rng.integers(0, 5))):
        at = (rng.uniform(-0.4, 0.4) * w, rng.uniform(-0.4, 0.4) * d, floor + high)
        parts.append(_thing(at, max(table.height - high, 0) + 0.15, patches, rng))
    return merge(parts)


def _thing(at: Sequence[float], tallest: float, patches: Patches, rng: np.random.Generator) -> Surface:
    """A printed box of the size of a household thing."""
    size = (rng.uniform(0.04, 0.2), rng.uniform(0.04, 0.2), min(rng.uniform(0.02, 0.3), tallest))
    thing = _box((0, 0, 0), size, *(_one(rng, patches[6:]) for _ in range(5)))
    return thing.moved(rotation_z(rng.uniform(-np.pi, np.pi))[:3, :3], np.asarray(at))


def _carton(table: Table, patches: Patches, rng: np.random.Generator) -> Surface:
    """Boxes on the floor, now and then a stack."""
    w, d, h = rng.uniform(0.2, 0.5, 3).tolist()
    lower = _box((0, 0, -table.height), (w, d, h), *(_one(rng, patches) for _ in range(5)))
    if rng.random() < 0.7 or 2 * h > table.height:
        return lower
    upper = _box((0, 0, h - table.height), (0.8 * w, 0.8 * d, 0.8 * h), *(_one(rng, patches) for _ in range(5)))
    return merge([lower, upper])


def _cupboard(table: Table, patches: Patches, rng: np.random.Generator) -> Surface:
    """Doors below, and boards with things above; its back is at +y, its front at -y."""
    floor, look = -table.height, _one(rng, patches[:8])
    w, d, high = rng.uniform(0.7, 2.4), rng.uniform(0.25, 0.5), rng.uniform(0.6, 1.0)
    parts = [_box((0, -d / 2, floor), (w, d, high), look)]
    doors = max(1, round(w / 0.45))
    face = _one(rng, patches[:8])
    for k in range(doors):
        x = (k + 0.5) * w / doors - w / 2
        parts.append(_box((x, -d - 0.01, floor + 0.05), (0.94 * w / doors, 0.02, high - 0.08), face))
        parts.append(_box((x, -d - 0.03, floor + high - 0.2), (0.12, 0.02, 0.015), patches[6]))
    levels = [floor + high + 0.32 * k for k in range(int(rng.integers(1, 4)))]
    for level in levels:
        parts.append(_box((0, -d / 2, level), (w, d, 0.02), look))
        x = -w / 2 + 0.05
        while x < w / 2 - 0.1:
            thing = _thing((0, 0, 0), 0.26, patches, rng)
            parts.append(thing.moved(np.eye(3), np.array([x + 0.05, -d / 2, level + 0.02])))
            x += rng.uniform(0.08, 0.5)
    return merge(parts)


def _beside_table(part: Surface, table: Table, rng: np.random.Generator) -> Surface:
    """Put something beyond the table's edge, its front towards the table."""
    angle = rng.uniform(-np.pi, np.pi)
    out = np.array([np.cos(angle), np.sin(angle)])
    size = part.vertices.max(axis=0) - part.vertices.min(axis=0)
    edge = float((table.outline() @ out).max())
    way = edge + rng.uniform(0.03, 0.35) + float(size[1]) / 2
    if part.vertices[:, 2].max() > 0.3:
        way = max(way, _TALL_FROM_M)
    turn = rotation_z(angle - np.pi / 2 + rng.uniform(-0.3, 0.3))
    return part.moved(turn[:3, :3], np.array([*(way * out), 0]))


_SIDES: tuple[Callable[[Float], tuple[float, float, float]], ...] = (
    lambda walls: (0.0, float(walls[1]), 0.0),
    lambda walls: (-float(walls[2]), 0.0, np.pi / 2),
    lambda walls: (0.0, -float(walls[3]), np.pi),
    lambda walls: (float(walls[0]), 0.0, -np.pi / 2),
)
"""For every wall its middle and the turn that takes +y towards it."""


def _at_wall(part: Surface, walls: Float, side: int, rng: np.random.Generator) -> Surface:
    x, y, turn = _SIDES[side](walls)
    along = rng.uniform(-0.8, 0.8)
    R = rotation_z(turn)[:3, :3]
    return part.moved(R, np.array([x, y, 0]) + along * R[:, 0])
