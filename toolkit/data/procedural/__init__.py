"""The built-in object set: shapes and product-like textures drawn by the package itself."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from toolkit.data.procedural.families import FAMILIES, Drawn
from toolkit.data.procedural.meshes import hull_stl, obj_text
from toolkit.digests import source_digest
from toolkit.files import make_once


def procedural_folder(parent: Path) -> Path:
    """The set as a folder of scans (see `toolkit.data.scans`), written below `parent` when absent.

    Every object comes from its own name's seed, so that the set can grow without changing what is in it.
    """
    counts = {category: count for category, (_, count) in FAMILIES.items()}
    return make_once(parent / f"procedural-{source_digest(__name__)[:16]}", lambda folder: write_set(folder, counts))


def write_set(folder: Path, counts: Mapping[str, int]) -> None:
    """Write the first `counts[category]` objects of each category as a folder of scans."""
    notes: dict[str, dict[str, object]] = {}
    for category, count in counts.items():
        family, _ = FAMILIES[category]
        for number in range(count):
            name = f"{category}_{number:02d}"
            drawn = family(_generator(name))
            _write(folder / name, drawn)
            notes[name] = {"category": category, "symmetry": drawn.symmetry}
    (folder / "objects.json").write_text(json.dumps(notes, indent=1))


def _generator(name: str) -> np.random.Generator:
    return np.random.default_rng(np.frombuffer(hashlib.sha256(name.encode()).digest(), np.uint32).tolist())


def _write(folder: Path, drawn: Drawn) -> None:
    folder.mkdir(parents=True)
    obj, mtl = obj_text(drawn.surface, "texture_map.jpg")
    (folder / "textured.obj").write_text(obj)
    (folder / "textured.mtl").write_text(mtl)
    texture = cv2.imencode(".jpg", drawn.texture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 92])[1]
    (folder / "texture_map.jpg").write_bytes(texture.tobytes())
    pieces = [stl for stl in map(hull_stl, drawn.surface.hulls) if stl is not None]
    for number, stl in enumerate(pieces):
        (folder / f"textured_coacd_{number}.stl").write_bytes(stl)
