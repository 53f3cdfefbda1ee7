"""Parametric families of objects. A family draws one object from a generator: shape, texture and what is true of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from toolkit.data.procedural import textures
from toolkit.data.procedural.meshes import Rect, Surface, box, lathe, loft, merge, on_table, tube
from toolkit.types import Image

TEXTURE_PX = 768

Symmetry = Literal["none", "continuous_z"]


@dataclass(frozen=True, eq=False)
class Drawn:
    """One object of a family, standing on z = 0."""

    surface: Surface
    texture: Image
    symmetry: Symmetry = "none"


Family = Callable[[np.random.Generator], Drawn]


class _Atlas:
    """A texture filled piece by piece; hands out the rectangle each piece went to."""

    def __init__(self) -> None:
        self.image = textures.canvas(TEXTURE_PX, TEXTURE_PX, (128, 128, 128))

    def paint(self, piece: Image, place: Rect) -> Rect:
        """Put a picture at (u0, v0, u1, v1) and return that rectangle, half a texel inside."""
        u0, v0, u1, v1 = place
        x0, x1 = round(u0 * TEXTURE_PX), round(u1 * TEXTURE_PX)
        y0, y1 = round((1 - v1) * TEXTURE_PX), round((1 - v0) * TEXTURE_PX)
        self.image[y0:y1, x0:x1] = cv2.resize(piece, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA)
        edge = 0.75 / TEXTURE_PX
        return u0 + edge, v0 + edge, u1 - edge, v1 - edge


def carton(rng: np.random.Generator) -> Drawn:
    """A printed box: two different fronts, facts on the sides, a brand on top."""
    size = np.array([rng.uniform(0.06, 0.15), rng.uniform(0.03, 0.08), rng.uniform(0.06, 0.19)])
    if rng.random() < 0.35:
        # Some lie flat.
        size = np.sort(size)[[1, 2, 0]]
    base = textures.color(rng)
    atlas = _Atlas()
    rects = [
        atlas.paint(textures.label(rng, 480, 640, base), (0.0, 0.5, 0.36, 1.0)),
        atlas.paint(textures.label(rng, 480, 640), (0.36, 0.5, 0.72, 1.0)),
        atlas.paint(textures.facts(rng, 300, 640, base), (0.72, 0.5, 1.0, 1.0)),
        atlas.paint(textures.facts(rng, 300, 640, textures.color(rng)), (0.0, 0.0, 0.28, 0.5)),
        atlas.paint(textures.label(rng, 640, 480), (0.28, 0.0, 0.72, 0.5)),
        atlas.paint(textures.painted(rng, 300, 480, base), (0.72, 0.0, 1.0, 0.5)),
    ]
    return Drawn(on_table(box(size, rects)), atlas.image)


def _wrapped(rng: np.random.Generator, base: textures.Color) -> Image:
    """A label that goes all around: a front, a back and facts between them."""
    return np.hstack(
        [textures.label(rng, 420, 400, base), textures.facts(rng, 220, 400, base), textures.label(rng, 420, 400, base)]
    )


def can(rng: np.random.Generator) -> Drawn:
    """A tin with a paper label."""
    r, h = rng.uniform(0.026, 0.05), rng.uniform(0.06, 0.15)
    rim = 0.0025
    atlas = _Atlas()
    around = atlas.paint(_wrapped(rng, textures.color(rng)), (0, 0.3, 1, 1))
    metal = atlas.paint(textures.painted(rng, 512, 220, (178, 180, 186)), (0, 0, 1, 0.28))
    body = lathe(np.array([[r, rim], [r, h - rim]]), around)
    bottom = lathe(np.array([[0, rim], [r - rim, 0], [r, rim]]), metal)
    top = lathe(np.array([[r, h - rim], [r - rim, h], [r - 2 * rim, h - 2 * rim], [0, h - 2 * rim]]), metal)
    return Drawn(on_table(merge([bottom, body, top])), atlas.image)


def bottle(rng: np.random.Generator) -> Drawn:
    """A bottle: body with a label, shoulder, neck and cap."""
    r, h = rng.uniform(0.025, 0.042), rng.uniform(0.13, 0.22)
    neck, shoulder = r * rng.uniform(0.3, 0.5), h * rng.uniform(0.55, 0.72)
    t = np.linspace(0, 1, 12)
    curve = np.stack(
        [neck + (r - neck) * (0.5 + 0.5 * np.cos(np.pi * t)), shoulder + t * (0.86 * h - shoulder)], axis=1
    )
    atlas = _Atlas()
    base = textures.color(rng)
    around = atlas.paint(_wrapped(rng, textures.color(rng)), (0, 0.4, 1, 1))
    glass = atlas.paint(textures.painted(rng, 512, 160, base), (0, 0.2, 1, 0.38))
    cap = atlas.paint(textures.painted(rng, 512, 160, textures.color(rng)), (0, 0, 1, 0.18))
    foot = lathe(np.array([[0, 0], [r * 0.92, 0], [r, 0.006], [r, 0.18 * h]]), glass)
    body = lathe(np.array([[r, 0.18 * h], [r, shoulder]]), around)
    upper = lathe(curve, glass)
    c = neck * 1.18
    lid = lathe(np.array([[neck, 0.86 * h], [c, 0.86 * h], [c, h], [0, h]]), cap)
    return Drawn(on_table(merge([foot, body, upper, lid])), atlas.image)


def mug(rng: np.random.Generator) -> Drawn:
    """A hollow mug with a handle and a print."""
    r, h, wall = rng.uniform(0.034, 0.046), rng.uniform(0.075, 0.115), 0.0035
    flare = rng.uniform(0.85, 1.0)
    atlas = _Atlas()
    glaze = textures.glazed(rng, 1024, 420) if rng.random() < 0.5 else _wrapped(rng, textures.color(rng))
    outside = atlas.paint(glaze, (0, 0.45, 1, 1))
    lining = textures.canvas(512, 200, textures.color(rng, (0, 0.3), 1))
    inside = atlas.paint(textures.speckled(rng, lining, 3.0), (0, 0.2, 1, 0.43))
    grip = atlas.paint(textures.painted(rng, 512, 150, textures.color(rng)), (0, 0, 1, 0.18))
    shell = lathe(np.array([[r * flare, 0.0], [r, h]]), outside, hollow=True)
    inner = np.array([[r, h], [r - wall, h], [r * flare - wall, wall], [0, wall]])
    cup = lathe(inner, inside, hollow=True)
    foot = lathe(np.array([[0, 0], [r * flare, 0]]), inside)
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 16)
    height, reach = 0.34 * h, rng.uniform(0.022, 0.032)
    path = np.stack([0.96 * r + reach * np.cos(angle), 0 * angle, 0.5 * h + height * np.sin(angle)], axis=1)
    handle = tube(path, rng.uniform(0.004, 0.006), grip)
    floor = np.concatenate([foot.vertices, foot.vertices + np.array([0, 0, wall])])
    hulls = (*shell.hulls[:-1], floor, *handle.hulls)
    whole = merge([shell, cup, foot, handle])
    return Drawn(on_table(Surface(whole.vertices, whole.uv, whole.faces, hulls)), atlas.image)


def bowl(rng: np.random.Generator) -> Drawn:
    """A bowl or a deep plate, its glaze painted all around; one in eight is plain."""
    r, h, wall = rng.uniform(0.055, 0.095), rng.uniform(0.03, 0.07), 0.004
    t = np.linspace(0, 1, 14)
    bend = rng.uniform(0.4, 0.75)
    outer = np.stack([r * (0.45 + 0.55 * t**bend), h * t ** rng.uniform(1.3, 2.2)], axis=1)
    inner = outer[::-1] + np.array([-wall, wall * 0.6])
    inner[0] = outer[-1] - np.array([wall, 0])
    plain = rng.random() < 0.125
    atlas = _Atlas()
    if plain:
        tint = textures.color(rng, (0.2, 0.8), 1.0)
        outside = atlas.paint(textures.canvas(512, 256, tint), (0, 0.5, 1, 1))
        inside = atlas.paint(textures.canvas(512, 256, textures.color(rng, (0.0, 0.3), 1.0)), (0, 0, 1, 0.48))
    else:
        outside = atlas.paint(textures.glazed(rng, 1024, 400), (0, 0.5, 1, 1))
        inside = atlas.paint(textures.glazed(rng, 1024, 400), (0, 0, 1, 0.48))
    shell = lathe(np.concatenate([[[0, 0]], outer]), outside, hollow=True)
    cup = lathe(np.concatenate([outer[-1:], inner, [[0, inner[-1, 1]]]]), inside)
    whole = merge([shell, cup])
    drawn = on_table(Surface(whole.vertices, whole.uv, whole.faces, shell.hulls))
    return Drawn(drawn, atlas.image, "continuous_z" if plain else "none")


def shoe(rng: np.random.Generator) -> Drawn:
    """A shoe: a lofted upper with an opening, on a sole; laces and stripes."""
    length, width, tall = rng.uniform(0.14, 0.2), rng.uniform(0.05, 0.065), rng.uniform(0.05, 0.07)
    x = np.linspace(0, 1, 14)
    outline = width / 2 * (0.72 + 0.28 * np.sin(np.pi * (0.15 + 0.85 * x)) - 0.35 * np.clip(x - 0.85, 0, 1))
    rise = tall / 2 * (1.0 - 0.62 * x ** rng.uniform(1.2, 2.2))
    rise[0] *= 0.9
    rise[-1] *= 0.55
    bend = 0.006 * np.sin(np.pi * x) * (1 if rng.random() < 0.5 else -1)
    centers = np.stack([length * (x - 0.5), bend, rise + 0.012], axis=1)
    atlas = _Atlas()
    base = textures.color(rng)
    side = textures.painted(rng, 1024, 512, base)
    stripe = textures.color(rng, value=1.0)
    for k in range(int(rng.integers(2, 5))):
        at = 380 + 70 * k
        cv2.line(side, (at, 60), (at + 60, 460), stripe, 16, cv2.LINE_AA)
    for k in range(6):
        cv2.line(side, (330 + 60 * k, 330), (380 + 60 * k, 410), textures.contrasting(rng, base), 7, cv2.LINE_AA)
    upper = loft(centers, np.stack([outline, rise], axis=1), 2.6, atlas.paint(side, (0, 0.3, 1, 1)))
    sole_rect = atlas.paint(textures.label(rng, 1024, 240), (0, 0, 0.75, 0.28))
    cuff_rect = atlas.paint(textures.painted(rng, 256, 240, (52, 48, 46)), (0.76, 0, 1, 0.28))
    cuff = lathe(np.array([[0.9, -0.018], [0.8, 0.012], [0.68, 0.012], [0.6, 0.0], [0, -0.004]]), cuff_rect, 32)
    heel = np.array([-0.24 * length, 0, 2 * rise[3] + 0.008])
    cuff = Surface(cuff.vertices * np.array([0.24 * length, width / 2, 1]) + heel, cuff.uv, cuff.faces, ())
    low = np.stack([length * 1.03 * (x - 0.5), bend, np.full_like(x, 0.009)], axis=1)
    sole = loft(low, np.stack([outline * 1.06, np.full_like(x, 0.009)], axis=1), 4.0, sole_rect)
    return Drawn(on_table(merge([upper, sole, cuff])), atlas.image)


def hammer(rng: np.random.Generator) -> Drawn:
    """A hammer lying on its side: wooden handle, steel head."""
    length, head = rng.uniform(0.17, 0.25), rng.uniform(0.07, 0.1)
    atlas = _Atlas()
    handle_rect = atlas.paint(textures.wood(rng, 900, 300), (0, 0.5, 1, 1))
    steel = textures.painted(rng, 512, 256, (120, 124, 132))
    paint = textures.label(rng, 512, 256)
    metal = atlas.paint(steel, (0, 0, 0.5, 0.48))
    band = atlas.paint(paint, (0.5, 0, 1, 0.48))
    x = np.linspace(0, 1, 10)
    thick = 0.011 * (1 + 0.25 * np.sin(np.pi * x * rng.uniform(1.5, 2.5)))
    # Level with the head's underside, so that it lies flat.
    centers = np.stack([length * x, 0 * x, 0.8 * thick - 0.012], axis=1)
    handle = loft(centers, np.stack([thick, thick * 0.8], axis=1), 2.5, handle_rect)
    block = box(np.array([0.03, head, 0.024]), [band, metal, band, metal, band, metal])
    block = block.moved(np.eye(3), np.array([length, 0.01, 0]))
    face = lathe(np.array([[0, 0], [0.012, 0], [0.012, 0.02], [0, 0.02]]), metal, 24)
    face = face.moved(Rotation.from_euler("x", 90, degrees=True).as_matrix(), np.array([length, 0.01 - head / 2, 0]))
    return Drawn(on_table(merge([handle, block, face])), atlas.image)


def screwdriver(rng: np.random.Generator) -> Drawn:
    """A screwdriver lying on the table: ribbed grip, bright shaft, printed band."""
    grip, shaft = rng.uniform(0.08, 0.11), rng.uniform(0.06, 0.12)
    r = rng.uniform(0.012, 0.017)
    atlas = _Atlas()
    colors = textures.label(rng, 900, 300)
    grip_rect = atlas.paint(colors, (0, 0.5, 1, 1))
    metal = atlas.paint(textures.painted(rng, 512, 200, (176, 180, 188)), (0, 0, 1, 0.45))
    x = np.linspace(0, 1, 12)
    thick = r * (1 - 0.18 * np.cos(2 * np.pi * x * rng.integers(1, 4)) - 0.25 * x**3)
    centers = np.stack([grip * x, 0 * x, 0 * x], axis=1)
    handle = loft(centers, np.stack([thick, thick], axis=1), 3.2, grip_rect)
    y = np.linspace(0, 1, 4)
    rod = loft(
        np.stack([grip + shaft * y, 0 * y, 0 * y], axis=1),
        np.stack([0.0035 + 0.001 * y, 0.0035 - 0.0022 * (y > 0.9)], axis=1),
        2.0,
        metal,
        16,
    )
    return Drawn(on_table(merge([handle, rod])), atlas.image)


def car(rng: np.random.Generator) -> Drawn:
    """A toy car: body, cabin and four wheels."""
    length, width, tall = rng.uniform(0.08, 0.13), rng.uniform(0.04, 0.055), rng.uniform(0.02, 0.03)
    atlas = _Atlas()
    base = textures.color(rng)
    side = atlas.paint(textures.label(rng, 640, 260, base), (0, 0.6, 0.6, 1))
    other = atlas.paint(textures.label(rng, 640, 260, base), (0, 0.2, 0.6, 0.58))
    end = atlas.paint(textures.painted(rng, 300, 260, base), (0.62, 0.6, 1, 1))
    roof = atlas.paint(textures.label(rng, 300, 260), (0.62, 0.2, 1, 0.58))
    tire = atlas.paint(textures.painted(rng, 512, 128, (36, 36, 40)), (0, 0, 1, 0.18))
    body = box(np.array([length, width, tall]), [side, other, end, end, roof, end])
    where = rng.uniform(-0.12, 0.12)
    cabin = box(np.array([length * rng.uniform(0.4, 0.6), width * 0.84, tall]), [other, side, roof, end, side, end])
    cabin = cabin.moved(np.eye(3), np.array([where * length, 0, tall]))
    wheel = lathe(np.array([[0, 0], [0.011, 0], [0.011, 0.008], [0, 0.008]]), tire, 24)
    turn = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    wheels = [
        wheel.moved(turn, np.array([sx * 0.3 * length, sy * width / 2 + 0.004, -tall / 2]))
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]
    return Drawn(on_table(merge([body, cabin, *wheels])), atlas.image)


def fruit(rng: np.random.Generator) -> Drawn:
    """Fruit or vegetable: a bent, uneven ball with a stalk."""
    r = rng.uniform(0.026, 0.042)
    t = np.linspace(0, 1, 24)
    tall = rng.uniform(0.75, 1.35)
    neck = 1 - rng.uniform(0.0, 0.38) * t**1.5
    profile = np.stack([r * np.sin(np.pi * t) ** 0.85 * neck, r * tall * (1 - np.cos(np.pi * t))], axis=1)
    # A flat place to stand on, as settled fruit has.
    profile[:, 1] = np.maximum(profile[:, 1], 0.06 * r)
    atlas = _Atlas()
    body = lathe(profile, atlas.paint(textures.skin(rng, 900, 600), (0, 0.12, 1, 1)))
    lobes, depth, phase = int(rng.integers(2, 6)), rng.uniform(0.02, 0.07), rng.uniform(0, 6)
    angle = np.arctan2(body.vertices[:, 1], body.vertices[:, 0])
    swell = 1 + depth * np.cos(lobes * angle + phase) + 0.04 * np.cos(angle)
    vertices = body.vertices * np.stack([swell, swell, np.ones_like(swell)], axis=1)
    bent = Surface(vertices, body.uv, body.faces, (vertices,))
    stalk_rect = atlas.paint(textures.wood(rng, 256, 64), (0, 0, 1, 0.1))
    top = float(vertices[:, 2].max())
    path = np.stack([0.004 * t[:6] * 4, 0 * t[:6], top - 0.004 + 0.016 * np.linspace(0, 1, 6)], axis=1)
    return Drawn(on_table(merge([bent, tube(path, 0.0022, stalk_rect, 8)])), atlas.image)


def block(rng: np.random.Generator) -> Drawn:
    """A wooden toy: two or three painted blocks glued into one piece."""
    atlas = _Atlas()
    rects = [
        atlas.paint(
            textures.wood(rng, 300, 300) if rng.random() < 0.3 else textures.label(rng, 300, 300),
            (k % 3 / 3, 0.5 * (k // 3), (k % 3 + 1) / 3, 0.5 * (k // 3) + 0.5),
        )
        for k in range(6)
    ]
    base = np.array([rng.uniform(0.06, 0.1), rng.uniform(0.035, 0.05), rng.uniform(0.025, 0.04)])
    parts = [box(base, rects)]
    for _ in range(int(rng.integers(1, 3))):
        size = np.array([rng.uniform(0.02, 0.035), base[1] * rng.uniform(0.6, 1.0), rng.uniform(0.02, 0.045)])
        at = np.array([rng.uniform(-0.3, 0.3) * base[0], 0, (base[2] + size[2]) / 2])
        order = rng.permutation(6)
        parts.append(box(size, [rects[k] for k in order]).moved(np.eye(3), at))
    return Drawn(on_table(merge(parts)), atlas.image)


FAMILIES: dict[str, tuple[Family, int]] = {
    "carton": (carton, 14),
    "can": (can, 11),
    "bottle": (bottle, 11),
    "mug": (mug, 11),
    "bowl": (bowl, 11),
    "shoe": (shoe, 11),
    "hammer": (hammer, 11),
    "screwdriver": (screwdriver, 11),
    "car": (car, 11),
    "fruit": (fruit, 11),
    "block": (block, 11),
}
"""Category -> its family and how many objects it has in the set."""
