"""Coloured points as PLY files."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np

from toolkit.errors import ToolkitError
from toolkit.files import write_bytes
from toolkit.types import Float

_CHANNELS = ("red", "green", "blue", "alpha")


def write_cloud(path: Path, points: Float, colors: Float) -> None:
    """Write (N, 3) points in metres with (N, 3) RGB colours, 0..255, as binary PLY: float32 x y z, uint8 colour."""
    # By hand: to import a library that writes it takes longer than to write it.
    vertices = np.zeros(len(points), [("xyz", "<f4", 3), ("rgba", np.uint8, 4)])
    vertices["xyz"], vertices["rgba"] = points, 255
    vertices["rgba"][:, :3] = np.clip(np.rint(colors), 0, 255)
    names = [*(f"float {axis}" for axis in "xyz"), *(f"uchar {channel}" for channel in _CHANNELS)]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    lines = [*header, *(f"property {name}" for name in names), "end_header", ""]
    write_bytes(path, "\n".join(lines).encode() + vertices.tobytes())


def read_cloud(path: Path) -> tuple[Float, Float]:
    """Read what `write_cloud` wrote: (N, 3) float32 points and (N, 3) float32 colours.

    Raises:
        ToolkitError: it is missing or damaged.
    """
    import trimesh

    try:
        cloud = cast(Any, trimesh.load(path, file_type="ply"))
        return np.asarray(cloud.vertices, np.float32), np.asarray(cloud.colors, np.float32)[:, :3]
    except (OSError, ValueError, AttributeError, IndexError, KeyError) as error:
        raise ToolkitError(f"'{path}' is no PLY of coloured points, or cannot be read") from error
