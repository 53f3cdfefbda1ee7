"""Pictures a person can judge at a glance: re-projected outlines, and the correspondences a pose was solved from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.geometry import invert, project
from toolkit.types import Float, Frame, Image, Mask

Color = tuple[int, int, int]
"""RGB, 0..255."""

INLIER: Color = (46, 204, 113)
OUTLIER: Color = (231, 76, 60)

_SHIFT = 4
"""Fractional bits of OpenCV's sub-pixel drawing."""

_TINT = 0.35
_FONT, _FONT_SIZE, _LINE_PX, _MARGIN_PX = cv2.FONT_HERSHEY_SIMPLEX, 0.48, 20, 8
_PLATE = (24, 24, 28)
_SPLAT_RADIUS_PX = 3
_MAX_FRAMES = 3


def overlay(
    goal: Frame, outlines: Sequence[tuple[str, Float, Color]], masks: Sequence[tuple[str, Mask, Color]] = ()
) -> Image:
    """Draw outlines of moved point clouds and of masks on the goal image.

    Args:
        goal: the goal image and its camera.
        outlines: label, (N, 3) world points already moved to the goal, and colour, one per object.
        masks: label, (H, W) bool, and colour, one per object without a motion; they are tinted.

    Returns:
        (H, W, 3) uint8.
    """
    picture = goal.rgb.copy()
    drawn = [(label, _silhouette(goal, points), color) for label, points, color in outlines]
    for label, mask, color in masks:
        picture[mask] = np.rint((1 - _TINT) * picture[mask] + _TINT * np.array(color)).astype(np.uint8)
        contours = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
        drawn.append((label, [np.asarray(c, np.int32) for c in contours], color))
    drawn = [entry for entry in drawn if entry[1]]
    for _, contours, color in drawn:
        cv2.polylines(picture, contours, True, (0, 0, 0), 4, cv2.LINE_AA)
        cv2.polylines(picture, contours, True, color, 2, cv2.LINE_AA)
    taken: list[tuple[int, int, int, int]] = []
    for label, contours, color in drawn:
        center = _free_place(picture, label, cv2.boundingRect(np.concatenate(contours)), taken)
        taken.append(_plate(picture, label, center))
        write_label(picture, label, center, color)
    return picture


def _free_place(
    picture: Image, label: str, box: Sequence[int], taken: Sequence[tuple[int, int, int, int]]
) -> tuple[int, int]:
    """Where a label covers no other one: above what it names, below it, or further down."""
    x, y, w, h = box
    places = [(x + w // 2, y - 6), *((x + w // 2, y + h + 14 + _LINE_PX * k) for k in range(4))]
    for place in places:
        left, top, right, bottom = _plate(picture, label, place)
        if not any(left < x1 and x0 < right and top < y1 and y0 < bottom for x0, y0, x1, y1 in taken):
            return place
    return places[0]


def with_legend(picture: Image, entries: Sequence[tuple[str, Color]]) -> Image:
    """The picture on top of lines of text, each in its colour, as many beside each other as fit."""
    width, rows = picture.shape[1], list[list[tuple[str, Color, int]]]()
    x = width
    for text, color in entries:
        wide = cv2.getTextSize(text, _FONT, _FONT_SIZE, 1)[0][0] + 2 * _MARGIN_PX
        if x + wide > width:
            rows.append([])
            x = 0
        rows[-1].append((text, color, x))
        x += wide
    strip = np.full((_LINE_PX * len(rows) + _MARGIN_PX, width, 3), _PLATE, np.uint8)
    for number, row in enumerate(rows, start=1):
        for text, color, x in row:
            cv2.putText(strip, text, (x + _MARGIN_PX, _LINE_PX * number), _FONT, _FONT_SIZE, color, 1, cv2.LINE_AA)
    return np.vstack([picture, strip])


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
    inliers: Mask,
    max_lines: int = 24,
) -> Image:
    """Draw correspondences from the goal (left) to the current frames with most inliers (right, stacked).

    Args:
        goal_rgb: (H, W, 3) uint8.
        goal_xy: (N, 2) pixels in the goal.
        frame_rgbs: current images by frame index, (H', W', 3) uint8 of any sizes.
        frame_of: (N,) frame index of every correspondence.
        frame_xy: (N, 2) pixels in its frame.
        inliers: (N,) bool; green lines, the others red.
        max_lines: lines drawn per frame, evenly picked.

    Returns:
        (H, W', 3) uint8.
    """
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
    for row, index in enumerate(best):
        write_label(picture, f"frame {index}", (width + 34, row * tile_height + 18), (255, 255, 255))
    counted = f"goal: {int(inliers.sum())} inliers of {len(inliers)}"
    write_label(picture, counted, (110, 18), (255, 255, 255))
    return picture


def scaled_to_height(picture: Image, height: int) -> Image:
    """An image of (height, W', 3) uint8 with the same content in the same proportions."""
    width = max(round(picture.shape[1] * height / picture.shape[0]), 1)
    finer = height > picture.shape[0]
    return np.asarray(
        cv2.resize(picture, (width, height), interpolation=cv2.INTER_CUBIC if finer else cv2.INTER_AREA), np.uint8
    )


def _evenly(rows: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    return rows if len(rows) <= count else rows[np.linspace(0, len(rows) - 1, count).astype(np.int64)]


def _line(picture: Image, start: Float, end: Float, color: Color) -> None:
    a, b = (tuple(int(v) for v in np.rint(np.asarray(p) * 2**_SHIFT)) for p in (start, end))
    cv2.line(picture, a, b, color, 1, cv2.LINE_AA, _SHIFT)
    for point in (a, b):
        cv2.circle(picture, point, 2 << _SHIFT, color, 1, cv2.LINE_AA, _SHIFT)


def write_label(picture: Image, text: str, center: tuple[int, int], color: Color) -> None:
    """Write text centred at a pixel on a dark plate, in place, kept inside the picture."""
    left, top, right, bottom = _plate(picture, text, center)
    cv2.rectangle(picture, (left, top), (right, bottom), _PLATE, -1)
    base = cv2.getTextSize(text, _FONT, _FONT_SIZE, 1)[1]
    cv2.putText(picture, text, (left + 4, bottom - base - 1), _FONT, _FONT_SIZE, color, 1, cv2.LINE_AA)


def _plate(picture: Image, text: str, center: tuple[int, int]) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of a label's plate, pixels."""
    (width, height), base = cv2.getTextSize(text, _FONT, _FONT_SIZE, 1)
    x = int(np.clip(center[0] - width // 2, 3, max(3, picture.shape[1] - width - 3)))
    y = int(np.clip(center[1], height + 3, max(height + 3, picture.shape[0] - base - 3)))
    return x - 4, y - height - 4, x + width + 4, y + base + 1
