"""What large things look like: wood, laminate, stone, cloth, carpet, walls; drawn from a generator."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import cv2
import numpy as np

from toolkit.data.procedural import textures
from toolkit.data.procedural.textures import Color, grain
from toolkit.types import Float, Image

Drawer = Callable[[np.random.Generator, int, int], Image]
"""Draws a picture of a width and a height."""


def table_top(rng: np.random.Generator, width: int, height: int) -> Image:
    """The top of a table: wooden twice as often as anything else; one in three has stains."""
    drawers: tuple[Drawer, ...] = (planks, planks, veneer, veneer, laminate, stone, checked, printed_cloth, painted)
    sheet = drawers[int(rng.integers(len(drawers)))](rng, width, height)
    sheet = stained(rng, sheet) if rng.random() < 0.35 else sheet
    # Finer than what the renderers sample without patterns of their own.
    return np.asarray(cv2.GaussianBlur(sheet, (0, 0), 0.9), np.uint8)


def veneer(rng: np.random.Generator, width: int, height: int) -> Image:
    """One sheet of wood, its year rings cut lengthwise."""
    return _wood(rng, width, height, _wood_color(rng))


def planks(rng: np.random.Generator, width: int, height: int) -> Image:
    """Boards side by side, each of its own wood, with dark joints."""
    sheet = np.zeros((height, width, 3), np.uint8)
    base, boards = _wood_color(rng), int(rng.integers(4, 14))
    edges = np.linspace(0, height, boards + 1).astype(int)
    joint = int(rng.integers(0, 4))
    for top, bottom in pairwise(edges.tolist()):
        cuts = [0, *sorted(rng.integers(0, width, int(rng.integers(0, 3))).tolist()), width]
        for left, right in pairwise(cuts):
            if right - left > 8:
                board = _wood(rng, right - left, bottom - top, base + rng.normal(0, 9) + rng.normal(0, 3, 3))
                sheet[top:bottom, left:right] = board
                cv2.rectangle(sheet, (left, top), (right, bottom), (base * 0.4).tolist(), joint)
    return sheet


def laminate(rng: np.random.Generator, width: int, height: int) -> Image:
    """Almost one colour, as office tables are; half of them white or grey, now and then black."""
    kind = rng.random()
    if kind < 0.5:
        base = np.full(3, rng.uniform(150, 240)) + rng.normal(0, 5, 3)
    elif kind < 0.7:
        base = np.full(3, rng.uniform(25, 70))
    else:
        base = np.array(textures.color(rng, (0.1, 0.6)), np.float64)
    return _shaded(rng, np.broadcast_to(base, (height, width, 3)), rng.uniform(1, 4))


def painted(rng: np.random.Generator, width: int, height: int) -> Image:
    """Worn paint: scratches on one colour."""
    sheet = _shaded(rng, np.broadcast_to(np.array(textures.color(rng, (0.0, 0.7))), (height, width, 3)), 4)
    for _ in range(int(rng.integers(5, 40))):
        start = rng.uniform(0, [width, height])
        end = start + rng.normal(0, 0.05 * width, 2)
        (x0, y0), (x1, y1) = np.rint([start, end]).astype(int).tolist()
        cv2.line(sheet, (x0, y0), (x1, y1), (int(rng.integers(60, 230)),) * 3, 1, cv2.LINE_AA)
    return sheet


def stone(rng: np.random.Generator, width: int, height: int) -> Image:
    """Granite: grains of three colours; or marble: veins."""
    base = np.full(3, rng.uniform(60, 220)) + rng.normal(0, 12, 3)
    if rng.random() < 0.5:
        fine, coarse = grain(rng, width, height, (1.5, 1.5)), grain(rng, width, height, (4, 4))
        shade = 14 * fine + 45 * (coarse > 1.3) - 50 * (coarse < -1.3)
    else:
        bent = grain(rng, width, height, (30, 60)) + 0.3 * grain(rng, width, height, (6, 6))
        shade = -55 * np.exp(-((bent / 0.09) ** 2)) + 6 * grain(rng, width, height, (25, 25))
    return _clipped(base + shade[..., None])


def checked(rng: np.random.Generator, width: int, height: int) -> Image:
    """A woven cloth of crossing stripes."""
    y, x = np.mgrid[:height, :width]
    step = int(rng.integers(24, 120))
    share = rng.uniform(0.3, 0.7)
    stripes = ((x % step) < share * step).astype(np.float32) + ((y % step) < share * step)
    ground, other = (np.array(textures.color(rng, (0.0, 0.8), 1.0), np.float64) for _ in range(2))
    weave = rng.uniform(3, 9) * grain(rng, width, height, (0.8, 0.8))
    return _clipped(ground + (other - ground) * stripes[..., None] / 2 + weave[..., None])


def printed_cloth(rng: np.random.Generator, width: int, height: int) -> Image:
    """Flowers and dots in rows on a plain cloth."""
    ground = textures.color(rng, (0.0, 0.5), 1.0)
    sheet = textures.canvas(width, height, ground)
    inks = [textures.color(rng, (0.3, 0.95), 1.0) for _ in range(3)]
    step = int(rng.integers(70, 180))
    for row, y in enumerate(range(0, height + step, step)):
        for x in range((row % 2) * step // 2, width + step, step):
            _flower(rng, sheet, (x, y), step * rng.uniform(0.15, 0.3), inks[int(rng.integers(3))])
    return _shaded(rng, sheet, 4)


def carpet(rng: np.random.Generator, width: int, height: int) -> Image:
    """Short pile, mottled."""
    base = np.array(textures.color(rng, (0.0, 0.4), rng.uniform(0.3, 0.8)), np.float64)
    shade = rng.uniform(8, 22) * grain(rng, width, height, (1.2, 1.2)) + 4 * grain(rng, width, height, (20, 20))
    return _clipped(base + shade[..., None])


def tiles(rng: np.random.Generator, width: int, height: int) -> Image:
    """Square tiles with joints."""
    sheet = stone(rng, width, height).astype(np.float64)
    count = int(rng.integers(2, 6))
    shade = rng.normal(0, 6, (count, count, 1))
    sheet += np.kron(shade, np.ones((-(-height // count), -(-width // count), 1)))[:height, :width]
    for k in range(count):
        y, x = k * height // count, k * width // count
        sheet[y : y + 4] = sheet[:, x : x + 4] = (90.0, 88.0, 84.0)
    return _clipped(sheet)


def floor(rng: np.random.Generator, width: int, height: int) -> Image:
    """What a table stands on."""
    drawers: tuple[Drawer, ...] = (planks, carpet, carpet, tiles, laminate)
    return drawers[int(rng.integers(len(drawers)))](rng, width, height)


def wall(rng: np.random.Generator, width: int, height: int) -> Image:
    """A painted wall, in every second one with posters or a window on it."""
    base = np.array(textures.color(rng, (0.0, 0.25), rng.uniform(0.7, 1.0)), np.float64)
    sheet = _shaded(rng, np.broadcast_to(base, (height, width, 3)), 2)
    for _ in range(int(rng.integers(0, 6)) * int(rng.random() < 0.6)):
        w, h = int(width * rng.uniform(0.05, 0.22)), int(height * rng.uniform(0.08, 0.3))
        x, y = int(rng.uniform(0, width - w)), int(rng.uniform(0, height - h))
        sheet[y : y + h, x : x + w] = poster(rng, w, h)
        cv2.rectangle(sheet, (x, y), (x + w, y + h), (60, 60, 60), int(rng.integers(1, 4)))
    return sheet


def poster(rng: np.random.Generator, width: int, height: int) -> Image:
    """Something printed: a label, a sheet of text, a plain board."""
    drawn = int(rng.integers(3))
    if drawn == 0:
        return cv2.resize(textures.label(rng, 320, 400), (width, height), interpolation=cv2.INTER_AREA).astype(np.uint8)
    if drawn == 1:
        return cv2.resize(paper(rng, 300, 420), (width, height), interpolation=cv2.INTER_AREA).astype(np.uint8)
    return laminate(rng, width, height)


def paper(rng: np.random.Generator, width: int, height: int) -> Image:
    """A sheet with a heading and lines of text, sometimes a figure."""
    white, black = int(rng.integers(225, 252)), int(rng.integers(20, 90))
    sheet, ink = textures.canvas(width, height, (white, white, white)), (black, black, black)
    margin, line = int(0.1 * width), max(6, int(height * rng.uniform(0.022, 0.035)))
    y = int(0.09 * height)
    cv2.rectangle(sheet, (margin, y), (margin + int(rng.uniform(0.3, 0.8) * (width - 2 * margin)), y + line), ink, -1)
    figure = rng.uniform(0.2, 0.7) * height if rng.random() < 0.4 else 2.0 * height
    y += 3 * line
    while y < height - 2 * line:
        if figure <= y < figure + 0.2 * height:
            cv2.rectangle(sheet, (margin, y), (width - margin, int(figure + 0.2 * height)), textures.color(rng), -1)
            y = int(figure + 0.2 * height) + line
            continue
        end = width - margin - int((rng.random() < 0.2) * rng.uniform(0.2, 0.7) * width)
        cv2.line(sheet, (margin, y), (max(margin + 4, end), y), ink, max(1, line // 5), cv2.LINE_4)
        y += line
    return textures.speckled(rng, sheet, 1.5)


def stained(rng: np.random.Generator, sheet: Image) -> Image:
    """Rings of cups, spots and darker patches over a sheet."""
    height, width = sheet.shape[:2]
    shade = np.zeros((height, width), np.float32)
    for _ in range(int(rng.integers(2, 10))):
        center = (int(rng.integers(width)), int(rng.integers(height)))
        radius = int(width * rng.uniform(0.01, 0.05))
        cv2.circle(shade, center, radius, float(rng.uniform(10, 45)), int(rng.choice([-1, 3, 6])), cv2.LINE_AA)
    shade = cv2.GaussianBlur(shade, (0, 0), 2.0)
    return _clipped(sheet - shade[..., None])


def _wood_color(rng: np.random.Generator) -> Float:
    """From pale birch over oak and cherry to near-black wenge."""
    tones = np.array([[214, 184, 140], [186, 146, 98], [160, 104, 62], [122, 84, 58], [150, 138, 122], [74, 54, 42]])
    a, b = tones[rng.integers(len(tones), size=2)]
    return a + (b - a) * rng.random() + rng.normal(0, 6, 3)


def _wood(rng: np.random.Generator, width: int, height: int, base: Float) -> Image:
    """Year rings as level lines of a stretched, bent field, and pores along them."""
    stretch = rng.uniform(8, 25)
    field = (
        grain(rng, width, height, (12 * stretch, 24)) * rng.uniform(1, 5)
        + np.linspace(0, rng.uniform(2, 9), height)[:, None]
    )
    rings = np.sin(2 * np.pi * field) * rng.uniform(3, 13)
    pores = rng.uniform(2, 7) * grain(rng, width, height, (20, 0.9))
    slow = rng.uniform(2, 8) * grain(rng, width, height, (120, 12))
    tint = base / max(float(base.max()), 1.0)
    return _clipped(base + (rings + pores + slow)[..., None] * (0.4 + 0.6 * tint))


def _flower(rng: np.random.Generator, sheet: Image, center: tuple[int, int], size: float, ink: Color) -> None:
    petals = int(rng.integers(0, 7))
    for k in range(petals):
        angle = 2 * np.pi * k / petals
        tip = (int(center[0] + size * np.cos(angle)), int(center[1] + size * np.sin(angle)))
        cv2.ellipse(
            sheet, tip, (int(size * 0.6), int(size * 0.3)), float(np.degrees(angle)), 0, 360, ink, -1, cv2.LINE_AA
        )
    cv2.circle(sheet, center, max(1, int(size * 0.4)), textures.contrasting(rng, ink), -1, cv2.LINE_AA)


def _shaded(rng: np.random.Generator, sheet: Float | Image, strength: float) -> Image:
    height, width = sheet.shape[:2]
    shade = strength * (0.6 * grain(rng, width, height, (1, 1)) + grain(rng, width, height, (60, 60)))
    return _clipped(sheet + shade[..., None])


def _clipped(sheet: Float) -> Image:
    return np.asarray(sheet).clip(0, 255).astype(np.uint8)
