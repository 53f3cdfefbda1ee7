"""Printed labels, wood, glaze and paint, drawn with OpenCV from a generator: what makes a shape a product."""

from __future__ import annotations

import math

import cv2
import numpy as np

from toolkit.types import Float, Image

Color = tuple[int, int, int]

_FONTS = (cv2.FONT_HERSHEY_DUPLEX, cv2.FONT_HERSHEY_TRIPLEX, cv2.FONT_HERSHEY_COMPLEX, cv2.FONT_HERSHEY_SIMPLEX)
_BRANDS = (
    "NORVA", "Kestrel", "Oatly Bay", "ZUMI", "Palermo", "Fjord", "Bruno's", "TAKO", "Solano", "Minty", "HARBOR",
    "Juniper", "Crumbs", "Vela", "ORBIT", "Pico", "Maple Co", "Tundra", "Lumo", "Sable", "Quill", "RAVO",
)  # fmt: skip
_WORDS = (
    "original", "classic", "extra fine", "whole grain", "sea salt", "family size", "no sugar", "dark roast", "premium",
    "crispy", "organic", "net wt 12 oz", "made with care", "new recipe", "since 1962", "100% natural", "best quality",
)  # fmt: skip


def color(
    rng: np.random.Generator,
    saturation: tuple[float, float] = (0.45, 0.95),
    value: float = 0.85,
    hue: tuple[int, int] = (0, 180),
) -> Color:
    """A random hue (OpenCV's 0..180) as RGB."""
    hsv = np.array([[[rng.integers(*hue), 255 * rng.uniform(*saturation), 255 * value * rng.uniform(0.75, 1.0)]]])
    r, g, b = cv2.cvtColor(hsv.astype(np.uint8), cv2.COLOR_HSV2RGB)[0, 0].tolist()
    return int(r), int(g), int(b)


def contrasting(rng: np.random.Generator, base: Color) -> Color:
    """Near white on dark colours, dark on light ones."""
    light = 0.3 * base[0] + 0.59 * base[1] + 0.11 * base[2]
    shade = rng.integers(225, 256, 3) if light < 140 else rng.integers(10, 60, 3)
    return int(shade[0]), int(shade[1]), int(shade[2])


def canvas(width: int, height: int, base: Color) -> Image:
    """A sheet of one colour."""
    return np.full((height, width, 3), base, np.uint8)


def text(sheet: Image, words: str, center: tuple[float, float], height: float, ink: Color, font: int) -> None:
    """Write words centred at a relative place, at a relative height, shrunk to fit; in place."""
    size = height * sheet.shape[0] / cv2.getTextSize(words, font, 1.0, 1)[0][1]
    widest = 0.9 * sheet.shape[1] / max(1, cv2.getTextSize(words, font, 1.0, 1)[0][0])
    size = min(size, widest)
    thickness = max(1, round(1.6 * size))
    (w, h), _ = cv2.getTextSize(words, font, size, thickness)
    x, y = int(center[0] * sheet.shape[1] - w / 2), int(center[1] * sheet.shape[0] + h / 2)
    cv2.putText(sheet, words, (x, y), font, size, ink, thickness, cv2.LINE_AA)


def label(rng: np.random.Generator, width: int, height: int, base: Color | None = None) -> Image:
    """The front of a package: bands, an emblem, a brand, small words, fine print."""
    base = base or color(rng)
    sheet = canvas(width, height, base)
    other, ink = color(rng, value=1.0), contrasting(rng, base)
    _background(rng, sheet, other)
    _emblem(rng, sheet, color(rng, value=1.0), ink)
    font = int(rng.choice(_FONTS))
    y = rng.uniform(0.14, 0.3)
    plate = color(rng, (0.0, 0.2), 1.0)
    cv2.rectangle(
        sheet,
        (int(0.04 * width), int((y - 0.11) * height)),
        (int(0.96 * width), int((y + 0.11) * height)),
        plate,
        -1,
        cv2.LINE_AA,
    )
    text(sheet, str(rng.choice(_BRANDS)), (0.5, y), 0.13, contrasting(rng, plate), font)
    text(sheet, str(rng.choice(_WORDS)), (rng.uniform(0.4, 0.6), y + rng.uniform(0.18, 0.24)), 0.05, ink, _FONTS[0])
    for line in range(int(rng.integers(2, 5))):
        words = " ".join(rng.choice(_WORDS, 2))
        text(sheet, words, (rng.uniform(0.4, 0.6), 0.86 + 0.035 * line), 0.02, ink, _FONTS[3])
    return speckled(rng, sheet, 2.0)


def facts(rng: np.random.Generator, width: int, height: int, base: Color) -> Image:
    """The side of a package: a table of facts and a barcode."""
    sheet = canvas(width, height, base)
    x0, y0, x1, y1 = int(0.1 * width), int(0.08 * height), int(0.9 * width), int(0.68 * height)
    cv2.rectangle(sheet, (x0, y0), (x1, y1), (245, 245, 242), -1)
    cv2.rectangle(sheet, (x0, y0), (x1, y1), (20, 20, 20), 2)
    rows = int(rng.integers(7, 12))
    for row in range(rows):
        y = y0 + int((row + 0.8) * (y1 - y0) / rows)
        cv2.line(sheet, (x0 + 4, y + 3), (x1 - 4, y + 3), (60, 60, 60), 1)
        words = str(rng.choice(_WORDS)) if row else "Facts"
        cv2.putText(sheet, words, (x0 + 6, y), _FONTS[3], 0.001 * height, (20, 20, 20), 1, cv2.LINE_AA)
        amount = f"{int(rng.integers(0, 90))}%"
        cv2.putText(sheet, amount, (x1 - 34, y), _FONTS[3], 0.001 * height, (20, 20, 20), 1, cv2.LINE_AA)
    barcode(rng, sheet, (x0, int(0.74 * height), x1, int(0.93 * height)))
    return speckled(rng, sheet, 2.0)


def barcode(rng: np.random.Generator, sheet: Image, place: tuple[int, int, int, int]) -> None:
    """Print a barcode on white; in place."""
    x0, y0, x1, y1 = place
    cv2.rectangle(sheet, (x0, y0), (x1, y1), (250, 250, 250), -1)
    x = x0 + 4
    while x < x1 - 6:
        width = int(rng.integers(1, 4))
        sheet[y0 + 3 : y1 - 3, x : x + width] = 15
        x += width + int(rng.integers(1, 4))


def _background(rng: np.random.Generator, sheet: Image, ink: Color) -> None:
    height, width = sheet.shape[:2]
    kind = rng.integers(4)
    if kind == 0:
        for y in range(0, height, int(rng.integers(24, 64))):
            cv2.rectangle(sheet, (0, y), (width, y + int(rng.integers(4, 18))), ink, -1)
    elif kind == 1:
        step = int(rng.integers(30, 70))
        for x in range(-height, width, step):
            cv2.line(sheet, (x, height), (x + height, 0), ink, int(rng.integers(3, 12)), cv2.LINE_AA)
    elif kind == 2:
        for _ in range(int(rng.integers(25, 60))):
            place = (int(rng.integers(width)), int(rng.integers(height)))
            cv2.circle(sheet, place, int(rng.integers(4, 26)), ink, -1, cv2.LINE_AA)
    else:
        ramp = np.linspace(0, 1, height)[:, None, None]
        sheet[:] = (sheet * (1 - ramp) + np.array(ink) * ramp).astype(np.uint8)


def _emblem(rng: np.random.Generator, sheet: Image, fill: Color, edge: Color) -> None:
    height, width = sheet.shape[:2]
    center = (rng.uniform(0.35, 0.65) * width, rng.uniform(0.56, 0.68) * height)
    radius = rng.uniform(0.12, 0.2) * min(width, height) * 1.3
    spikes = int(rng.integers(3, 9))
    angle = np.arange(2 * spikes) * np.pi / spikes + rng.uniform(0, 1)
    reach = radius * np.where(np.arange(2 * spikes) % 2, rng.uniform(0.45, 0.9), 1.0)
    points = np.stack([center[0] + reach * np.cos(angle), center[1] + reach * np.sin(angle)], axis=1)
    cv2.fillPoly(sheet, [np.rint(points).astype(np.int32)], fill, cv2.LINE_AA)
    cv2.polylines(sheet, [np.rint(points).astype(np.int32)], True, edge, 3, cv2.LINE_AA)
    cv2.circle(sheet, (int(center[0]), int(center[1])), int(radius * 0.35), edge, -1, cv2.LINE_AA)


def grain(rng: np.random.Generator, width: int, height: int, sigma: tuple[float, float]) -> Float:
    """(height, width) smooth noise of zero mean and unit deviation."""
    # Wide kernels are slow and need few samples: draw the noise on a grid of a quarter of the kernel's width.
    step_x, step_y = max(1.0, sigma[0] / 4), max(1.0, sigma[1] / 4)
    coarse = rng.standard_normal((math.ceil(height / step_y) + 1, math.ceil(width / step_x) + 1), np.float32)
    blurred = cv2.GaussianBlur(coarse, (0, 0), sigmaX=sigma[0] / step_x, sigmaY=sigma[1] / step_y)
    noise = cv2.resize(blurred, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.asarray(noise / noise.std())


def speckled(rng: np.random.Generator, sheet: Image, strength: float) -> Image:
    """Print noise and slow shading over a sheet."""
    height, width = sheet.shape[:2]
    shade = strength * rng.standard_normal((height, width)) + 2 * strength * grain(rng, width, height, (25, 25))
    return (sheet + shade[..., None]).clip(0, 255).astype(np.uint8)


def wood(rng: np.random.Generator, width: int, height: int) -> Image:
    """Wood with its grain along the width."""
    base = np.array([rng.uniform(130, 205), rng.uniform(85, 150), rng.uniform(45, 95)])
    lines = 13 * grain(rng, width, height, (50, 1.5)) + 9 * grain(rng, width, height, (90, 8))
    knots = -40 * (grain(rng, width, height, (12, 6)) > 2.4)
    return (base + (lines + knots)[..., None]).clip(0, 255).astype(np.uint8)


def painted(rng: np.random.Generator, width: int, height: int, base: Color) -> Image:
    """Worn paint: scratches, stains and a stamped name."""
    sheet = canvas(width, height, base)
    ink = contrasting(rng, base)
    text(sheet, str(rng.choice(_BRANDS)), (rng.uniform(0.3, 0.7), rng.uniform(0.35, 0.65)), 0.16, ink, _FONTS[0])
    for _ in range(int(rng.integers(10, 30))):
        start = rng.uniform(0, [width, height]).astype(int)
        end = start + rng.normal(0, 0.06 * width, 2).astype(int)
        shade = int(rng.integers(60, 230))
        cv2.line(
            sheet, tuple(start.astype(int).tolist()), tuple(end.astype(int).tolist()), (shade,) * 3, 1, cv2.LINE_AA
        )
    return speckled(rng, sheet, 5.0)


def glazed(rng: np.random.Generator, width: int, height: int) -> Image:
    """Ceramic with a painted pattern that differs all around."""
    base = color(rng, (0.05, 0.6), 1.0)
    sheet = canvas(width, height, base)
    ink = contrasting(rng, base)
    for _ in range(int(rng.integers(9, 18))):
        x, y = int(rng.integers(width)), int(rng.uniform(0.05, 0.95) * height)
        petals, size = int(rng.integers(4, 8)), rng.uniform(0.03, 0.08) * width
        tint = color(rng, value=1.0)
        for k in range(petals):
            angle = 360 * k / petals + rng.uniform(0, 30)
            tip = (int(x + size * np.cos(np.radians(angle))), int(y + size * np.sin(np.radians(angle))))
            cv2.ellipse(sheet, tip, (int(size * 0.7), int(size * 0.3)), angle, 0, 360, tint, -1, cv2.LINE_AA)
        cv2.circle(sheet, (x, y), int(size * 0.4), ink, -1, cv2.LINE_AA)
    for y in (0.08, 0.9):
        cv2.line(sheet, (0, int(y * height)), (width, int(y * height)), ink, int(rng.integers(2, 9)))
    return speckled(rng, sheet, 3.0)


def skin(rng: np.random.Generator, width: int, height: int) -> Image:
    """Fruit: two tints blending, mottling, freckles and a sticker."""
    ripe = (0, 60)
    low, high = np.array(color(rng, (0.55, 0.95), hue=ripe)), np.array(color(rng, (0.5, 0.9), 0.95, ripe))
    mix = (0.5 + 0.35 * grain(rng, width, height, (60, 60)) + 0.12 * grain(rng, width, height, (5, 9))).clip(0, 1)
    sheet = (low * (1 - mix[..., None]) + high * mix[..., None]).astype(np.uint8)
    for _ in range(int(rng.integers(120, 260))):
        place = (int(rng.integers(width)), int(rng.integers(height)))
        cv2.circle(sheet, place, int(rng.integers(1, 3)), tuple((0.6 * low).astype(int).tolist()), -1, cv2.LINE_AA)
    center = (int(rng.uniform(0.2, 0.8) * width), int(rng.uniform(0.4, 0.65) * height))
    size = (int(0.07 * width), int(0.1 * height))
    tint = color(rng, value=1.0)
    cv2.ellipse(sheet, center, size, 0, 0, 360, tint, -1, cv2.LINE_AA)
    cv2.ellipse(sheet, center, size, 0, 0, 360, (250, 250, 250), 2, cv2.LINE_AA)
    words = str(rng.choice(_BRANDS))
    cv2.putText(
        sheet, words, (center[0] - size[0] + 4, center[1] + 4), _FONTS[3], 0.35, contrasting(rng, tint), 1, cv2.LINE_AA
    )
    return speckled(rng, sheet, 3.0)
