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

_SPLAT_RADIUS_PX = 3
_MAX_FRAMES = 3


def overlay(goal: Frame, outlines: Sequence[tuple[str, Float, Color]]) -> Image:
    """Draw outlines of moved point clouds on the goal image.

    Args:
        goal: the goal image and its camera.
        outlines: label, (N, 3) world points already moved to the goal, and colour, one per object.

    Returns:
        (H, W, 3) uint8.
    """
    picture = goal.rgb.copy()
    for label, points, color in outlines:
        contours = _silhouette(goal, points)
        if not contours:
            continue
        cv2.polylines(picture, contours, True, (0, 0, 0), 4, cv2.LINE_AA)
        cv2.polylines(picture, contours, True, color, 2, cv2.LINE_AA)
        x, y, w, _ = cv2.boundingRect(np.concatenate(contours))
        write_label(picture, label, (x + w // 2, y - 6), color)
    return picture


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
    font, size, thickness = cv2.FONT_HERSHEY_SIMPLEX, 0.48, 1
    (width, height), base = cv2.getTextSize(text, font, size, thickness)
    x = int(np.clip(center[0] - width // 2, 3, max(3, picture.shape[1] - width - 3)))
    y = int(np.clip(center[1], height + 3, max(height + 3, picture.shape[0] - base - 3)))
    cv2.rectangle(picture, (x - 4, y - height - 4), (x + width + 4, y + base + 1), (24, 24, 28), -1)
    cv2.putText(picture, text, (x, y), font, size, color, thickness, cv2.LINE_AA)
