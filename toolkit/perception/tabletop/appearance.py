"""The empty table as a camera would see it, put together from the current frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from toolkit.perception.tabletop.plane import table_homography
from toolkit.perception.tabletop.relief import Relief, survey
from toolkit.perception.tabletop.table import Table, find_table
from toolkit.types import Camera, Float, Frame, Image, Mask

_OBJECT_MARGIN_PX = 4
_HEADROOM = 1.2
_LEAST_HEIGHT_M = 0.05
_MIN_HEIGHT_M = 0.0015
_COARSEST_PX = 4


@dataclass(frozen=True, eq=False)
class TableScan:
    """What the current frames show of the table.

    Attributes:
        table: the table.
        reliefs: of the frames that see it.
        bare: one (H, W) bool for each of them, the pixels that show the table, away from what stands on it.
        height: of what stands on it, metres, with some room above.
    """

    table: Table
    reliefs: tuple[Relief, ...]
    bare: tuple[Mask, ...]
    height: float


@dataclass(frozen=True, eq=False)
class TableView:
    """The empty table in one camera.

    Attributes:
        rgb: (H, W, 3) uint8, the median of the frames that saw the table there; where none did, what is around it.
        seen: (H, W) bool, where one did.
        table: (H, W) bool, the table's surface.
        reach: (H, W) bool, where things that stand on the table can appear.
    """

    rgb: Image
    seen: Mask
    table: Mask
    reach: Mask


def scan_table(current: Sequence[Frame]) -> TableScan:
    """Find the table in the current RGB-D frames, and what of every frame shows it. The last scene's is kept.

    Raises:
        ToolkitError: no frame's depth shows a table.
    """
    return _scan(tuple(current))


@lru_cache(maxsize=2)
def _scan(current: tuple[Frame, ...]) -> TableScan:
    table = find_table(current)
    reliefs = survey(table, _MIN_HEIGHT_M)
    kernel = np.ones((2 * _OBJECT_MARGIN_PX + 1,) * 2, np.uint8)
    bare = tuple(r.bare & (cv2.dilate(r.things.astype(np.uint8), kernel) == 0) for r in reliefs)
    tops = [float(np.percentile(r.places[r.certain][:, 2], 99)) for r in reliefs if r.certain.any()]
    return TableScan(table, reliefs, bare, max([_LEAST_HEIGHT_M, *tops]) * _HEADROOM)


def render_table(scan: TableScan, camera: Camera) -> TableView:
    """Draw the empty table as `camera` sees it: every frame warped by the table's homography, then their median."""
    size = (camera.width, camera.height)
    to_camera = table_homography(scan.table.T_world_table, camera)
    colours, counts = [], np.zeros((camera.height, camera.width), np.uint8)
    for r, mask in zip(scan.reliefs, scan.bare, strict=True):
        warp = table_homography(scan.table.T_world_table, r.frame.camera) @ np.linalg.inv(to_camera)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        rgb = cv2.warpPerspective(r.frame.rgb, warp, size, flags=flags)
        seen = cv2.warpPerspective(mask.astype(np.uint8) * 255, warp, size, flags=flags) == 255
        # What a frame did not see sorts last, behind the `counts` samples that the median is taken of.
        rgb[~seen] = 255
        colours.append(rgb)
        counts += seen
    stack = _sorted(colours)
    middle = (np.maximum(counts, 1).astype(np.int64) - 1) // 2
    rgb = np.take_along_axis(stack, middle[None, :, :, None], axis=0)[0]
    surface = scan.table.surface(camera)
    seen = (counts > 0) & surface
    filled = fill(rgb.astype(np.float32), seen).clip(0, 255).astype(np.uint8) if seen.any() else rgb
    return TableView(filled, seen, surface, scan.table.surface(camera, (0.0, scan.height)))


def fill(image: Float, known: Mask) -> Float:
    """(H, W, C) float32 with what is not known filled from around it: push-pull (Gortler et al., SIGGRAPH 1996)."""
    levels: list[tuple[Any, Any]] = [(image * known[..., None], known.astype(np.float32))]
    while min(levels[-1][1].shape) > _COARSEST_PX:
        total, weight = levels[-1]
        levels.append((cv2.pyrDown(total), cv2.pyrDown(weight)))
    total, weight = levels[-1]
    filled = total.reshape(*weight.shape, -1) / np.maximum(weight, 1e-4)[..., None]
    for total, weight in levels[-2::-1]:
        coarse = cv2.resize(filled, weight.shape[::-1], interpolation=cv2.INTER_LINEAR).reshape(*weight.shape, -1)
        own = total.reshape(*weight.shape, -1) / np.maximum(weight, 1e-4)[..., None]
        share = (4 * weight).clip(0, 1)[..., None]
        filled = share * own + (1 - share) * coarse
    return np.where(known[..., None], image, filled).astype(np.float32)


def _sorted(images: list[Image]) -> Image:
    """Sort along a new first axis by odd-even transposition, each step over whole images: faster than np.sort."""
    rows = list(images)
    for step in range(len(rows)):
        for i in range(step % 2, len(rows) - 1, 2):
            rows[i], rows[i + 1] = np.minimum(rows[i], rows[i + 1]), np.maximum(rows[i], rows[i + 1])
    return np.stack(rows)
