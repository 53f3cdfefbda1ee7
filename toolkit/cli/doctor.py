"""What this machine has, in lines a person can send with a question."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Iterator
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from toolkit import __version__
from toolkit.errors import ToolkitError
from toolkit.files import may_write
from toolkit.parallel import cores
from toolkit.paths import cache_root
from toolkit.sim.bullet import best_renderer, require_pybullet
from toolkit.stages import REGISTRIES


def diagnose() -> Iterator[str]:
    """Yield what was found, line by line."""
    yield f"toolkit {__version__}, Python {platform.python_version()}, {platform.platform()}"
    yield f"cores: {cores()}"
    yield "imported: " + ", ".join(_imported(module) for module in _MODULES)
    yield from _opencvs()
    yield f"torch's devices: {_torch_devices()}"
    yield f"JAX's devices: {_jax_devices()}"
    yield from _simulator()
    yield f"cache: {cache_root()} ({_cache_state()})"
    for registry in REGISTRIES.values():
        for entry in registry.entries():
            try:
                registry.get(entry.name)
            except ToolkitError as error:
                yield f"broken: {error}"
    yield f"interpreter: {sys.executable}"


_MODULES = ("numpy", "scipy", "cv2", "torch", "kornia", "onnxruntime", "jax", "faiss", "poselib", "PIL", "pydantic")
"""What stage outputs depend on most."""

_OPENCVS = ("opencv-python", "opencv-python-headless", "opencv-contrib-python", "opencv-contrib-python-headless")


def _imported(module: str) -> str:
    """Name and version of what an import really gives, which need not be what pip lists."""
    try:
        loaded = import_module(module)
    except Exception as error:
        # A broken wheel may raise anything while it is imported.
        return f"{module} (not to be imported: {' '.join(str(error).split())})"
    return f"{module} {getattr(loaded, '__version__', '(states no version)')}"


def _opencvs() -> Iterator[str]:
    """A finding where several distributions fill the one folder cv2: which files it holds depends on their order."""
    there = [f"{name} {version(name)}" for name in _OPENCVS if _is_installed(name)]
    if len(there) > 1:
        yield (
            f"broken: {' and '.join(there)} overwrite each other's cv2; pip uninstall all of them, "
            "then pip install opencv-python-headless"
        )


def _is_installed(distribution: str) -> bool:
    try:
        version(distribution)
    except PackageNotFoundError:
        return False
    return True


def _torch_devices() -> str:
    import torch

    names = [f"cuda:{i} {torch.cuda.get_device_name(i)}" for i in range(torch.cuda.device_count())]
    return ", ".join(["cpu", *names])


def _jax_devices() -> str:
    import jax

    try:
        return ", ".join(f"{device.platform}:{device.id} {device.device_kind}" for device in jax.devices())
    except RuntimeError as error:
        return f"none; {' '.join(str(error).split())}"


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
        return "not made yet" if may_write(root) else "cannot be made; name another in $TOOLKIT_CACHE"
    size = sum(_size(Path(folder) / name) for folder, _, files in os.walk(root) for name in files)
    return f"{size / 1e9:.2f} GB" if may_write(root) else "cannot be written; nothing will be kept"


def _size(path: Path) -> int:
    """Bytes of a file, 0 where another process has just removed it."""
    try:
        return path.lstat().st_size
    except OSError:
        return 0
