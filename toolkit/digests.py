"""sha256 digests of values, arrays and source files: what cache keys and run records are made of."""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.util
import json
import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.types import Crop, Frame


def digest(value: Any) -> str:
    """sha256 hex of a nested value of mappings, sequences, strings, numbers, None and arrays.

    Arrays count with dtype, shape and bytes; mappings regardless of order.

    Raises:
        TypeError: a part is of another type.
    """
    return hashlib.sha256(json.dumps(_canonical(value), sort_keys=True).encode()).hexdigest()


def _canonical(value: Any) -> Any:
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, np.ndarray):
        data = np.ascontiguousarray(value)
        return ["array", str(data.dtype), list(data.shape), hashlib.sha256(data.data).hexdigest()]
    if isinstance(value, Mapping):
        return {str(key): _canonical(item) for key, item in value.items()}
    if isinstance(value, Sequence):
        return [_canonical(item) for item in value]
    raise TypeError(f"cannot digest a {type(value).__name__}")


_frame_digests: weakref.WeakKeyDictionary[Frame, str] = weakref.WeakKeyDictionary()


def frame_digest(frame: Frame) -> str:
    """sha256 hex of everything a stage may read from a frame."""
    if frame not in _frame_digests:
        true, own = (
            masks and {str(key): np.packbits(mask) for key, mask in masks.items()}
            for masks in (frame.true_masks, frame.own_masks)
        )
        camera = frame.camera
        _frame_digests[frame] = digest(
            [frame.index, frame.rgb, frame.depth, camera.K, camera.T_world_camera, true, own]
        )
    return _frame_digests[frame]


def crop_digest(crop: Crop) -> str:
    """sha256 hex of a crop's pixels and mask (where it was cut from does not change what a stage answers)."""
    return digest([crop.image, np.packbits(crop.mask)])


@functools.cache
def source_digest(module: str) -> str:
    """sha256 hex over a module's source and, recursively, every module of `toolkit` or of its own package it imports.

    A change in any line a stage depends on thus changes its cache keys.
    """
    hasher = hashlib.sha256()
    for path in sorted(_closure(module)):
        hasher.update(path.read_bytes())
    return hasher.hexdigest()


@functools.cache
def package_digest() -> str:
    """sha256 hex over every Python file of `toolkit`: two machines with the same one run the same code."""
    root = Path(__file__).parent
    hasher = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        hasher.update(f"{path.relative_to(root)}\n".encode() + path.read_bytes())
    return hasher.hexdigest()


_STATEMENTS = (ast.stmt, ast.ExceptHandler, ast.match_case)
"""What can hold an import; expressions, most of a file, cannot."""


def _closure(module: str) -> set[Path]:
    roots = {"toolkit", module.partition(".")[0]}
    found: set[Path] = set()
    pending = [module]
    while pending:
        path = _module_path(pending.pop())
        if path is None or path in found:
            continue
        found.add(path)
        pending += [name for name in _imported(path) if name.partition(".")[0] in roots]
    return found


@functools.cache
def _imported(path: Path) -> tuple[str, ...]:
    """Names of what a file imports, wherever in it; what is imported from a module may be a module itself."""
    names: list[str] = []
    pending: list[ast.AST] = [ast.parse(path.read_bytes())]
    while pending:
        node = pending.pop()
        if isinstance(node, ast.ImportFrom) and node.module:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        else:
            pending += [child for child in ast.iter_child_nodes(node) if isinstance(child, _STATEMENTS)]
    return tuple(names)


@functools.cache
def _module_path(module: str) -> Path | None:
    """The file of a module, found without importing the packages it lies in; None where there is none."""
    package, *inner = module.split(".")
    try:
        spec = importlib.util.find_spec(package)
    except (ImportError, ValueError):
        return None
    if spec is None or not inner:
        return Path(spec.origin) if spec and spec.origin and spec.origin.endswith(".py") else None
    places = [Path(folder, *inner) for folder in spec.submodule_search_locations or ()]
    files = (file for place in places for file in (place / "__init__.py", place.with_suffix(".py")))
    return next((file for file in files if file.is_file()), None)
