"""What is drawn for one scene only: meshes with their pictures, and the files a renderer reads them from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from toolkit.data.procedural.meshes import Rect, Surface, bare_obj_text, merge, panel
from toolkit.geometry import make_transform
from toolkit.types import Float, Image

AWAY = make_transform(np.eye(3), np.array([0, 0, -100.0]))
"""(4, 4) a pose at which nothing is seen."""


@dataclass(frozen=True, eq=False)
class Prop:
    """Something that is no object of the task, in world coordinates (metres)."""

    surface: Surface
    texture: Image

    def write(self, folder: Path, name: str) -> tuple[Path, Path]:
        """Write mesh and texture into a folder; returns their paths."""
        mesh, texture = folder / f"{name}.obj", folder / f"{name}.bmp"
        mesh.write_text(bare_obj_text(self.surface))
        # Read once and thrown away: packing it would take most of the time.
        texture.write_bytes(cv2.imencode(".bmp", self.texture[..., ::-1])[1].tobytes())
        return mesh, texture


def sheet_of(pictures: Sequence[Image], columns: int, tile_px: int) -> tuple[Image, list[Rect]]:
    """One texture with pictures as square tiles, and the rectangle of each, a texel inside."""
    rows = -(-len(pictures) // columns)
    sheet = np.zeros((rows * tile_px, columns * tile_px, 3), np.uint8)
    rects: list[Rect] = []
    for number, picture in enumerate(pictures):
        row, column = divmod(number, columns)
        tile = cv2.resize(picture, (tile_px, tile_px), interpolation=cv2.INTER_AREA)
        sheet[row * tile_px : (row + 1) * tile_px, column * tile_px : (column + 1) * tile_px] = tile
        edge = 1 / tile_px
        low, high = 1 - (row + 1 - edge) / rows, 1 - (row + edge) / rows
        rects.append(((column + edge) / columns, low, (column + 1 - edge) / columns, high))
    return sheet, rects


def block(low: Float, high: Float, rects: Sequence[Rect]) -> Surface:
    """A box between two corners (3,); rects for its sides and its top. It has no lower side."""
    x, y, z = np.eye(3) * (np.asarray(high) - np.asarray(low))
    low = np.asarray(low, np.float64)
    sides = [(low, x, z), (low + x, y, z), (low + x + y, -x, z), (low + y, -y, z), (low + z, x, y)]
    return merge([panel(c, a, b, r, 0.5) for (c, a, b), r in zip(sides, rects, strict=True)])
