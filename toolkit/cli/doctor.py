"""What this machine has, in lines a person can send with a question."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Iterator
from pathlib import Path

from toolkit import __version__
from toolkit.errors import ToolkitError
from toolkit.harness.cache import library_versions
from toolkit.parallel import cores
from toolkit.paths import cache_root
from toolkit.sim.bullet import best_renderer, require_pybullet
from toolkit.stages import REGISTRIES


def diagnose() -> Iterator[str]:
    """Yield what was found, line by line."""
    yield f"toolkit {__version__}, Python {platform.python_version()}, {platform.platform()}"
    yield f"cores: {cores()}"
    yield "libraries: " + ", ".join(f"{name} {number}" for name, number in library_versions().items())
    yield f"accelerator: {_accelerator()}"
    yield from _simulator()
    yield f"cache: {cache_root()} ({_cache_state()})"
    for registry in REGISTRIES.values():
        for entry in registry.entries():
            try:
                registry.get(entry.name)
            except ToolkitError as error:
                yield f"broken: {error}"
    yield f"interpreter: {sys.executable}"


def _accelerator() -> str:
    import torch

    return torch.cuda.get_device_name() if torch.cuda.is_available() else "none seen by torch; stages run on the CPU"


def _simulator() -> Iterator[str]:
    try:
        require_pybullet()
    except ToolkitError as error:
        yield f"simulator: none here; {error}"
        yield "renderer: none without the simulator"
        return
    yield "simulator: PyBullet"
    chosen = (
        "PyBullet's EGL plug-in" if best_renderer() == "egl" else "TinyRenderer; the EGL plug-in does not load here"
    )
    yield f"renderer: {chosen}"


def _cache_state() -> str:
    root = cache_root()
    if not root.exists():
        return "not made yet"
    size = sum(_size(Path(folder) / name) for folder, _, files in os.walk(root) for name in files)
    return f"{size / 1e9:.2f} GB" if os.access(root, os.W_OK) else "cannot be written; nothing will be kept"


def _size(path: Path) -> int:
    """Bytes of a file, 0 where another process has just removed it."""
    try:
        return path.lstat().st_size
    except OSError:
        return 0
