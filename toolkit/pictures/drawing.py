"""Pictures a person can judge at a glance: re-projected outlines, and the correspondences a pose was solved from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.errors import ToolkitError
from toolkit.geometry import invert, project
from toolkit.types import Float, Frame, Image, Mask

Color = tuple[int, int, int]
"""RGB, 0..255."""

INLIER: Color = (46, 204, 113)
OUTLIER: Color = (231, 76, 60)

_SHIFT = 4
"""Fractional bits of OpenCV's sub-pixel drawing."""

_TINT = 0.35
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_PLATE = (24, 24, 28)
_SPLAT_RADIUS_PX = 3

_LABEL_WORTH = 100
"""What a label's pixel is worth beside one of an object: two labels on each other cannot be read."""

_MAX_FRAMES = 3

_AROUND, _LEAST_PART = 0.04, 0.2
"""Of a picture's size: the margin around points that are zoomed in on, and the smallest part that is shown."""


@dataclass(frozen=True)
class _Lettering:
    """How large letters and lines are: as on a picture of 640x480, and larger on a larger one, never smaller.

    Attributes:
        scale: 1 on 640x480.
    """

    scale: float

    @staticmethod
    def of(picture: Image) -> _Lettering:
        """That of a picture, by its shorter side."""
        return _Lettering(max(1.0, min(picture.shape[:2]) / 480))

    def px(self, pixels: float) -> int:
        """A length on 640x480, on this picture."""
        return round(pixels * self.scale)

    @property
    def line_px(self) -> int:
        """From one line of text to the next."""
        return self.px(20)

    @property
    def margin_px(self) -> int:
        """Beside and below text."""
        return self.px(8)

    def size(self, text: str) -> tuple[int, int, int]:
        """Width, height above the base line, and depth below it, pixels."""
        (width, height), base = cv2.getTextSize(text, _FONT, 0.48 * self.scale, self.px(1))
        return width, height, base

    def write(self, picture: Image, text: str, at: tuple[int, int], color: Color) -> None:
        """Write text in place; `at` is where its base line begins."""
        cv2.putText(picture, text, at, _FONT, 0.48 * self.scale, color, self.px(1), cv2.LINE_AA)

    def fold(self, text: str, width_px: int) -> list[str]:
        """Lines of whole words, as wide as they may be."""
        lines = [""]
        for word in text.split():
            longer = f"{lines[-1]} {word}".lstrip()
            if lines[-1] and self.size(longer)[0] > width_px:
                lines.append(word)
            else:
                lines[-1] = longer
        return lines


def overlay(
    goal: Frame,
    outlines: Sequence[tuple[str, Float, Color]],
    masks: Sequence[tuple[str, Mask, Color]] = (),
    places: Sequence[tuple[str, Mask, Color]] = (),
) -> Image:
    """Draw outlines of moved point clouds and of masks on the goal image.

    Args:
        goal: the goal image and its camera.
        outlines: label, (N, 3) world points already moved to the goal, and colour, one per object.
        masks: label, (H, W) bool, and colour, one per object without a motion; they are tinted.
        places: label, which may be empty, (H, W) bool, and colour, of what is outlined and not tinted.

    Returns:
        (H, W, 3) uint8.
    """
    picture, letters = goal.rgb.copy(), _Lettering.of(goal.rgb)
    for _, mask, color in masks:
        picture[mask] = np.rint((1 - _TINT) * picture[mask] + _TINT * np.array(color)).astype(np.uint8)
    drawn = [
        *((label, _contours(mask), color) for label, mask, color in places),
        *((label, _silhouette(goal, points), color) for label, points, color in outlines),
        *((label, _contours(mask), color) for label, mask, color in masks),
    ]
    drawn = [entry for entry in drawn if entry[1]]
    for _, contours, color in drawn:
        cv2.polylines(picture, contours, True, (0, 0, 0), letters.px(4), cv2.LINE_AA)
        cv2.polylines(picture, contours, True, color, letters.px(2), cv2.LINE_AA)
    worth = np.zeros(picture.shape[:2], np.int32)
    for _, contours, _ in drawn:
        cv2.drawContours(worth, contours, -1, 1, cv2.FILLED)
    for label, contours, color in (entry for entry in drawn if entry[0]):
        center = _free_place(picture, label, cv2.boundingRect(np.concatenate(contours)), worth, letters)
        left, top, right, bottom = _plate(picture, label, center, letters)
        worth[top:bottom, left:right] = _LABEL_WORTH
        _write_label(picture, label, center, color, letters)
    return picture


def _free_place(
    picture: Image, label: str, box: Sequence[int], worth: NDArray[np.int32], letters: _Lettering
) -> tuple[int, int]:
    """Where a label covers least, of labels and of what is outlined: above what it names, below it, beside it, or away.

    Args:
        picture: to be written on.
        label: the text.
        box: x, y, width and height of what it names, pixels.
        worth: (H, W) what every pixel is worth to be seen.
        letters: how large they are.
    """
    x, y, w, h = box
    wide, high, _ = letters.size(label)
    beside, level = wide // 2 + letters.px(10), y + (h + high) // 2
    above, below = y - letters.px(6), y + h + letters.px(14)
    places = [
        *((x + w // 2, at) for at in (above, below)),
        *((at, level) for at in (x - beside, x + w + beside)),
        *((x + w // 2, at) for k in (1, 2, 3) for at in (below + letters.line_px * k, above - letters.line_px * k)),
    ]

    def covered(place: tuple[int, int]) -> int:
        left, top, right, bottom = _plate(picture, label, place, letters)
        return int(worth[top:bottom, left:right].sum())

    return min(places, key=covered)


def with_legend(picture: Image, entries: Sequence[tuple[str, Color]]) -> Image:
    """The picture on top of texts, each in its colour, as many beside each other as fit; long ones are folded."""
    letters = _Lettering.of(picture)
    margin, width = letters.margin_px, picture.shape[1]
    lines = [(line, color) for entry, color in entries for line in letters.fold(entry, width - 2 * margin)]
    rows = list[list[tuple[str, Color, int]]]()
    x = width
    for text, color in lines:
        wide = letters.size(text)[0] + 2 * margin
        if x + wide > width:
            rows.append([])
            x = 0
        rows[-1].append((text, color, x))
        x += wide
    strip = np.full((letters.line_px * len(rows) + margin, width, 3), _PLATE, np.uint8)
    for number, row in enumerate(rows, start=1):
        for text, color, x in row:
            letters.write(strip, text, (x + margin, letters.line_px * number), color)
    return np.vstack([picture, strip])


def _contours(mask: Mask) -> list[NDArray[np.int32]]:
    found = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    return [np.asarray(contour, np.int32) for contour in found]


def _silhouette(goal: Frame, points: Float) -> list[NDArray[np.int32]]:
    """Outer contours of the projected points, splatted and closed."""
    pixels, _ = project(goal.camera.K, invert(goal.camera.T_world_camera), points)
    height, width = goal.rgb.shape[:2]
    xy = np.rint(pixels[np.isfinite(pixels).all(axis=1)]).astype(np.int64)
    xy = xy[((xy >= 0) & (xy < [width, height])).all(axis=1)]
    hit = np.zeros((height, width), np.uint8)
    hit[xy[:, 1], xy[:, 0]] = 1
    size = 2 * _SPLAT_RADIUS_PX + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    closed = cv2.morphologyEx(hit, cv2.MORPH_CLOSE, disc)
    contours, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return [np.asarray(c, np.int32) for c in contours if cv2.contourArea(c) > 20]


def correspondences(
    goal_rgb: Image,
    goal_xy: Float,
    frame_rgbs: Mapping[int, Image],
    frame_of: NDArray[np.int64],
    frame_xy: Float,
    inliers: Mask | None,
    max_lines: int = 24,
) -> Image:
    """Draw correspondences from the goal (left) to the current frames with most inliers (right, stacked).

    Args:
        goal_rgb: (H, W, 3) uint8.
        goal_xy: (N, 2) pixels in the goal.
        frame_rgbs: current images by frame index, (H', W', 3) uint8 of any sizes.
        frame_of: (N,) frame index of every correspondence.
        frame_xy: (N, 2) pixels in its frame.
        inliers: (N,) bool; green lines, the others red. None where no pose was accepted: all are red.
        max_lines: lines drawn per frame, evenly picked.

    Returns:
        (H, W', 3) uint8.
    """
    counted = f"goal: {len(goal_xy)} matches" + ("" if inliers is None else f", {int(inliers.sum())} inliers")
    inliers = np.zeros(len(goal_xy), bool) if inliers is None else inliers
    best = sorted(frame_rgbs, key=lambda index: (-int(inliers[frame_of == index].sum()), index))[:_MAX_FRAMES]
    height, width = goal_rgb.shape[:2]
    tile_height = max(height // len(best), 1)
    tiles = [scaled_to_height(frame_rgbs[index], tile_height) for index in best]
    picture = np.zeros((height, width + max(tile.shape[1] for tile in tiles), 3), np.uint8)
    picture[:, :width] = goal_rgb
    for row, (index, tile) in enumerate(zip(best, tiles, strict=True)):
        top = row * tile_height
        picture[top : top + tile_height, width : width + tile.shape[1]] = tile
        scale = np.array(tile.shape[1::-1]) / frame_rgbs[index].shape[1::-1]
        rows = np.flatnonzero(frame_of == index)
        for which, color in ((~inliers[rows], OUTLIER), (inliers[rows], INLIER)):
            for i in _evenly(rows[which], max_lines // 2 if color == OUTLIER else max_lines):
                # Pixel centres: (0, 0) stays the centre of the first pixel after scaling.
                end = (frame_xy[i] + 0.5) * scale - 0.5 + [width, top]
                _line(picture, goal_xy[i], end, color)
    letters = _Lettering.of(goal_rgb)
    for row, index in enumerate(best):
        at = (width + letters.px(34), row * tile_height + letters.px(18))
        _write_label(picture, f"frame {index}", at, (255, 255, 255), letters)
    _write_label(picture, counted, (letters.px(110), letters.px(18)), (255, 255, 255), letters)
    return picture


def zoomed(picture: Image, xy: Float) -> tuple[Image, Float]:
    """The part of a picture around points, as large as the picture was.

    Args:
        picture: (H, W, 3) uint8.
        xy: (N, 2) pixels, at least one.

    Returns:
        (H, W, 3) uint8, and where the points are in it.
    """
    size = np.array(picture.shape[1::-1])
    inside = np.clip(xy, 0, size - 1)
    low, high = inside.min(axis=0), inside.max(axis=0)
    part = float(np.clip(((high - low) / size).max() + 2 * _AROUND, _LEAST_PART, 1))
    window = np.maximum(np.rint(part * size), 1).astype(int)
    x, y = np.clip(np.rint((low + high - window) / 2), 0, size - window).astype(int)
    cut = picture[y : y + window[1], x : x + window[0]]
    larger = np.asarray(cv2.resize(cut, (int(size[0]), int(size[1])), interpolation=cv2.INTER_CUBIC), np.uint8)
    # Pixel centres: (0, 0) stays the centre of the first pixel after scaling.
    return larger, (xy - (x, y) + 0.5) * (size / window) - 0.5


def titled(picture: Image, title: str) -> Image:
    """The picture with a title in its upper left corner."""
    picture = picture.copy()
    _write_label(picture, title, (0, 0), (255, 255, 255), _Lettering.of(picture))
    return picture


def scaled_to_height(picture: Image, height: int) -> Image:
    """An image of (height, W', 3) uint8 with the same content in the same proportions."""
    width = max(round(picture.shape[1] * height / picture.shape[0]), 1)
    finer = height > picture.shape[0]
    return np.asarray(
        cv2.resize(picture, (width, height), interpolation=cv2.INTER_CUBIC if finer else cv2.INTER_AREA), np.uint8
    )


def write_png(path: Path, image: Image) -> None:
    """Write (H, W, 3) RGB or (H, W) grey, uint8, as PNG.

    Raises:
        ToolkitError: it cannot be encoded.
    """
    encoded = image if image.ndim == 2 else image[..., ::-1]
    ok, data = cv2.imencode(".png", encoded)
    if not ok:
        raise ToolkitError(f"picture '{path}' cannot be encoded")
    path.write_bytes(data.tobytes())


def _evenly(rows: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    return rows if len(rows) <= count else rows[np.linspace(0, len(rows) - 1, count).astype(np.int64)]


def _line(picture: Image, start: Float, end: Float, color: Color) -> None:
    a, b = (tuple(int(v) for v in np.rint(np.asarray(p) * 2**_SHIFT)) for p in (start, end))
    cv2.line(picture, a, b, color, 1, cv2.LINE_AA, _SHIFT)
    for point in (a, b):
        cv2.circle(picture, point, 2 << _SHIFT, color, 1, cv2.LINE_AA, _SHIFT)


def _write_label(picture: Image, text: str, center: tuple[int, int], color: Color, letters: _Lettering) -> None:
    """Write text centred at a pixel on a dark plate, in place, kept inside the picture."""
    left, top, right, bottom = _plate(picture, text, center, letters)
    cv2.rectangle(picture, (left, top), (right, bottom), _PLATE, -1)
    letters.write(picture, text, (left + letters.px(4), bottom - letters.size(text)[2] - 1), color)


def _plate(picture: Image, text: str, center: tuple[int, int], letters: _Lettering) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of a label's plate, pixels."""
    width, height, base = letters.size(text)
    x = int(np.clip(center[0] - width // 2, 3, max(3, picture.shape[1] - width - 3)))
    y = int(np.clip(center[1], height + 3, max(height + 3, picture.shape[0] - base - 3)))
    around = letters.px(4)
    return x - around, y - height - around, x + width + around, y + base + 1
