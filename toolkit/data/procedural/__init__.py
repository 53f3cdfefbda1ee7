"""The built-in object set: shapes and product-like textures drawn by the package itself."""

from __future__ import annotations

from pathlib import Path


def procedural_folder(parent: Path) -> Path:
    raise NotImplementedError
