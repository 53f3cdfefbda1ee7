"""Objects that are easily taken for each other: two of the same kind, or the same shape in other colours."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from toolkit.data.objects import ObjectAsset
from toolkit.errors import ToolkitError
from toolkit.files import make_once
from toolkit.types import Image

Lookalikes = Literal["none", "twins", "recolored"]

_HUE_STEPS = 60
"""A third of the hue circle, which is 180 in OpenCV."""

_LEAST_SATURATION = 70
"""Grey turned in hue stays grey: it is given a colour."""

_RECOLORED_ID = 100_000
"""Object ids of recoloured objects start here, apart from those of any object set."""


def with_lookalikes(assets: Sequence[ObjectAsset], kind: Lookalikes, cache: Path) -> tuple[ObjectAsset, ...]:
    """Put a lookalike of the object before it in the place of every second object.

    Args:
        assets: what a scene is made of.
        kind: `twins` share a model, so that they may swap their goal places; `recolored` ones have the same shape and
            are objects of their own; `none` changes nothing.
        cache: recoloured textures are kept below it.

    Raises:
        ToolkitError: a texture cannot be read.
    """
    if kind == "none":
        return tuple(assets)
    alike = list(assets)
    for i in range(1, len(alike), 2):
        alike[i] = alike[i - 1] if kind == "twins" else _recolored(alike[i - 1], cache)
    return tuple(alike)


def _recolored(asset: ObjectAsset, cache: Path) -> ObjectAsset:
    shape, image = asset.mesh.read_bytes(), asset.texture.read_bytes()

    def write(folder: Path) -> None:
        pixels = cv2.imdecode(np.frombuffer(image, np.uint8), cv2.IMREAD_COLOR)
        if pixels is None:
            raise ToolkitError(f"texture '{asset.texture}' is not an image")
        turned = cv2.imencode(".png", _turned_in_hue(np.asarray(pixels, np.uint8)))[1]
        (folder / "mesh.obj").write_bytes(_without_material(shape))
        (folder / "texture.png").write_bytes(turned.tobytes())

    files = hashlib.sha256(shape).hexdigest()[:32] + hashlib.sha256(image).hexdigest()[:32]
    folder = make_once(cache / "objects" / "recolored" / files, write)
    name = f"{asset.name}_recolored"
    model = replace(asset.model, object_id=asset.model.object_id + _RECOLORED_ID, name=name)
    return replace(asset, name=name, mesh=folder / "mesh.obj", texture=folder / "texture.png", model=model)


def _without_material(obj: bytes) -> bytes:
    """An OBJ file that names no image: PyBullet's EGL renderer prefers the one it names to the one it is given."""
    lines = obj.splitlines(keepends=True)
    return b"".join(line for line in lines if not line.startswith((b"mtllib", b"usemtl")))


def _turned_in_hue(bgr: Image) -> Image:
    hue, saturation, value = cv2.split(cv2.cvtColor(bgr, cv2.COLOR_BGR2HSV))
    turned = ((hue.astype(np.int32) + _HUE_STEPS) % 180).astype(np.uint8)
    return np.asarray(
        cv2.cvtColor(cv2.merge([turned, np.maximum(saturation, _LEAST_SATURATION), value]), cv2.COLOR_HSV2BGR), np.uint8
    )
