"""Points of the table followed from image to image.

Seen from above, warped by the homography of its plane, the table looks the same from everywhere, and a camera that is a
little off shifts the picture by a few pixels: pyramidal Lucas-Kanade (Bouguet, 2001) finds those.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.errors import ToolkitError
from toolkit.perception.tabletop.plane import on_plane, table_homography
from toolkit.perception.tabletop.table import find_table
from toolkit.types import Camera, Float, Frame, Image, Mask

_PIXEL_M = 0.002
_SIDE_M = 1.2
_BORDER_PX = 6
"""Pixels of table next to what is no table are not used: shadows, and the objects themselves."""
_POINTS = 120
_WINDOW = (21, 21)
_MOST_SHIFT_PX = 20.0
_MOST_RETURN_PX = 0.3
"""A point followed there and back again must come home within this."""
_CONTRAST_PX = 12.0


@dataclass(frozen=True, eq=False)
class TopView:
    """One image of the table, seen from above.

    Attributes:
        camera: that took it.
        gray: (S, S) uint8, contrast evened out, so that light does not matter.
        table: (S, S) bool, where it shows bare table, or where it may do so.
    """

    camera: Camera
    gray: Image
    table: Mask

    @cached_property
    def corners(self) -> Float:
        """(N, 1, 2) float32 points that are well to follow."""
        mask = self.table.astype(np.uint8)
        # None, whatever OpenCV's annotations say, where there is nothing.
        found: Any = cv2.goodFeaturesToTrack(self.gray, _POINTS, 0.01, 8, mask=mask)
        return np.zeros((0, 1, 2), np.float32) if found is None else found


@dataclass(frozen=True, eq=False)
class Tracks:
    """Points of the table, each seen in two images.

    Attributes:
        first: number of the first image; (M,) int64.
        second: of the second.
        first_xy: (M, 2) pixels there.
        second_xy: (M, 2).
    """

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    first_xy: Float
    second_xy: Float


@dataclass(frozen=True, eq=False)
class Tabletop:
    """The table's place in the world, and what of every current frame shows it.

    Attributes:
        T_world_table: (4, 4), z = 0 is its surface.
        masks: one (H, W) bool a frame; nothing is True where a frame's depth shows no table.
    """

    T_world_table: Float
    masks: tuple[Mask, ...]

    def top_view(self, frame: Frame, mask: Mask | None) -> TopView:
        """The frame from above; without a (H, W) mask any part of it may be table."""
        size = round(_SIDE_M / _PIXEL_M)
        to_view = self._to_view(frame.camera)
        rgb = cv2.warpPerspective(frame.rgb, to_view, (size, size), flags=cv2.INTER_LINEAR)
        seen = np.ones(frame.rgb.shape[:2], np.uint8) if mask is None else mask.astype(np.uint8)
        seen[[0, -1]] = seen[:, [0, -1]] = 0
        table = cv2.warpPerspective(seen, to_view, (size, size), flags=cv2.INTER_NEAREST)
        table = cv2.erode(table, np.ones((2 * _BORDER_PX + 1,) * 2, np.uint8), borderValue=0)
        return TopView(frame.camera, _even(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)), table > 0)

    def top_views(self, frames: Sequence[Frame]) -> list[TopView]:
        """The frames it was found in, from above."""
        return [self.top_view(frame, mask) for frame, mask in zip(frames, self.masks, strict=True)]

    def pixels(self, camera: Camera, view_xy: Float) -> Float:
        """(N, 2) pixels of a camera's image from (N, 2) places in its top view."""
        back = np.linalg.inv(self._to_view(camera))
        pixels = cv2.perspectiveTransform(view_xy.reshape(-1, 1, 2).astype(np.float64), back)
        return np.asarray(pixels, np.float64).reshape(-1, 2)

    def _to_view(self, camera: Camera) -> Float:
        """(3, 3) from pixels to the view from above."""
        middle = _SIDE_M / _PIXEL_M / 2
        to_view = np.array([[1 / _PIXEL_M, 0, middle], [0, 1 / _PIXEL_M, middle], [0, 0, 1]])
        return to_view @ np.linalg.inv(table_homography(self.T_world_table, camera))


def find_tabletop(frames: Sequence[Frame]) -> Tabletop:
    """Find the table in the depth of current frames, its origin amid what they see of it.

    Raises:
        ToolkitError: no frame's depth shows a table.
    """
    if not frames:
        raise ToolkitError("cameras are registered by the table in the current frames, and there is no frame")
    table = find_table(frames)
    masks = [
        np.zeros(frame.rgb.shape[:2], bool) if plane is None else on_plane(plane, frame)
        for frame, plane in zip(frames, table.planes, strict=True)
    ]
    T = table.T_world_table.copy()
    T[:3, 3] = _middle(T, frames, masks)
    return Tabletop(T, tuple(masks))


def follow(tabletop: Tabletop, views: Sequence[TopView], pairs: Sequence[tuple[int, int]]) -> Tracks:
    """Follow the table's points from the first to the second view of every pair."""
    found = [(i, j, *_follow(views[i], views[j])) for i, j in pairs]
    first = [np.full(len(a), i) for i, _, a, _ in found]
    second = [np.full(len(a), j) for _, j, a, _ in found]
    first_xy = [tabletop.pixels(views[i].camera, a) for i, _, a, _ in found if len(a)]
    second_xy = [tabletop.pixels(views[j].camera, b) for _, j, _, b in found if len(b)]
    none = np.zeros((0, 2))
    return Tracks(
        np.concatenate([np.zeros(0, np.int64), *first]),
        np.concatenate([np.zeros(0, np.int64), *second]),
        np.concatenate([none, *first_xy]),
        np.concatenate([none, *second_xy]),
    )


def _follow(first: TopView, second: TopView) -> tuple[Float, Float]:
    """(N, 2) places in the two views."""
    start = first.corners
    none = np.zeros((0, 2))
    if not len(start):
        return none, none
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.01)
    end, there, _ = cv2.calcOpticalFlowPyrLK(
        first.gray, second.gray, start, start.copy(), winSize=_WINDOW, maxLevel=2, criteria=criteria
    )
    home, back, _ = cv2.calcOpticalFlowPyrLK(
        second.gray, first.gray, end, end.copy(), winSize=_WINDOW, maxLevel=2, criteria=criteria
    )
    a, b = start[:, 0], end[:, 0]
    size = len(second.table)
    cell = np.rint(b).astype(np.int64).clip(0, size - 1)
    kept = (there[:, 0] > 0) & (back[:, 0] > 0) & (np.linalg.norm(home[:, 0] - a, axis=1) < _MOST_RETURN_PX)
    kept &= (np.linalg.norm(b - a, axis=1) < _MOST_SHIFT_PX) & second.table[cell[:, 1], cell[:, 0]]
    return a[kept].astype(np.float64), b[kept].astype(np.float64)


def _even(gray: NDArray[Any]) -> Image:
    """Local mean 128 and local deviation 40."""
    value = gray.astype(np.float32)
    mean = _smooth(value)
    deviation = np.sqrt(np.maximum(_smooth(value**2) - mean**2, 4.0))
    return (128 + 40 * (value - mean) / deviation).clip(0, 255).astype(np.uint8)


def _smooth(value: Float) -> Float:
    """Blurred by _CONTRAST_PX, at a quarter of the size."""
    small = cv2.resize(value, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    blurred = cv2.GaussianBlur(small, (0, 0), _CONTRAST_PX / 4)
    return np.asarray(cv2.resize(blurred, value.shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)


def _middle(T_world_table: Float, frames: Sequence[Frame], masks: Sequence[Mask]) -> Float:
    """(3,) world point: the median of where the frames see the table."""
    places: list[NDArray[Any]] = []
    for frame, mask in zip(frames, masks, strict=True):
        y, x = np.nonzero(mask[::8, ::8])
        if len(x):
            to_table = np.linalg.inv(table_homography(T_world_table, frame.camera))
            pixels = np.stack([x, y], axis=1)[:, None].astype(np.float64) * 8
            places.append(cv2.perspectiveTransform(pixels, to_table)[:, 0])
    middle = np.median(np.concatenate(places), axis=0)
    return T_world_table[:3, :3] @ np.array([*middle, 0.0]) + T_world_table[:3, 3]
