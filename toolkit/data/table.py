"""The table: a textured square at z = 0, drawn once and kept."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from toolkit.files import make_once
from toolkit.types import Image

HALF_SIDE_M = 0.62
_TEXTURE_PX = 1024
_VERSION = 1


def table_files(look: str, cache: Path) -> tuple[Path, Path]:
    """Mesh and texture of a table that looks `plain`, `wood` or `cloth`, made below `cache` when absent."""

    def write(folder: Path) -> None:
        (folder / "table.obj").write_text(_mesh())
        (folder / "table.png").write_bytes(cv2.imencode(".png", _DRAWERS[look]()[..., ::-1])[1].tobytes())

    folder = make_once(cache / "objects" / f"table-{_VERSION}-{look}", write)
    return folder / "table.obj", folder / "table.png"


def _mesh(cells: int = 8) -> str:
    """A grid of small triangles: TinyRenderer shades and clips by triangle."""
    ticks = np.linspace(0, 1, cells + 1)
    lines = [f"v {(2 * u - 1) * HALF_SIDE_M:.6f} {(2 * v - 1) * HALF_SIDE_M:.6f} 0" for v in ticks for u in ticks]
    lines += [f"vt {u:.6f} {v:.6f}" for v in ticks for u in ticks] + ["vn 0 0 1"]
    row = cells + 1
    for j in range(cells):
        for i in range(cells):
            a, b = j * row + i + 1, (j + 1) * row + i + 1
            for triangle in ((a, a + 1, b + 1), (a, b + 1, b)):
                lines.append("f " + " ".join(f"{k}/{k}/1" for k in triangle))
    return "\n".join(lines) + "\n"


def _grain(seed: int, stretch: tuple[float, float]) -> np.ndarray:
    """Noise of zero mean and unit deviation, stretched along one axis."""
    noise = np.random.default_rng(seed).standard_normal((_TEXTURE_PX, _TEXTURE_PX))
    smooth = cv2.GaussianBlur(noise, (0, 0), sigmaX=stretch[0], sigmaY=stretch[1])
    return smooth / smooth.std()


def _plain() -> Image:
    shade = 205 + 1.5 * _grain(1, (1.0, 1.0))
    return np.repeat(shade[..., None], 3, axis=2).clip(0, 255).astype(np.uint8)


def _wood() -> Image:
    grain = 0.6 * _grain(2, (60, 1.2)) + 0.8 * _grain(3, (120, 6))
    base = np.array([176.0, 138.0, 98.0])
    return (base + grain[..., None] * np.array([10.0, 9.0, 8.0])).clip(0, 255).astype(np.uint8)


def _cloth() -> Image:
    y, x = np.mgrid[:_TEXTURE_PX, :_TEXTURE_PX]
    stripes = ((x // 64) % 2 + (y // 64) % 2).astype(float)
    weave = 6 * _grain(4, (0.8, 0.8))
    base = np.array([196.0, 204.0, 214.0]) - stripes[..., None] * np.array([26.0, 18.0, 8.0])
    return (base + weave[..., None]).clip(0, 255).astype(np.uint8)


_DRAWERS = {"plain": _plain, "wood": _wood, "cloth": _cloth}
