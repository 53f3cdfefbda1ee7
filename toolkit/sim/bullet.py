"""PyBullet, imported when it is first used and without what its C code prints; which renderer this machine has."""

from __future__ import annotations

import contextlib
import functools
import importlib
import os
import subprocess
import sys
from collections.abc import Generator
from typing import Any, Literal

from toolkit.errors import ToolkitError

Renderer = Literal["tiny", "egl"]

_PROBE_TIMEOUT_S = 30


@contextlib.contextmanager
def silence() -> Generator[None]:
    """Keep PyBullet's C code from printing: it writes to the process's descriptors, not to sys.stdout."""
    kept = [os.dup(descriptor) for descriptor in (1, 2)]
    null = os.open(os.devnull, os.O_WRONLY)
    try:
        for descriptor in (1, 2):
            os.dup2(null, descriptor)
        yield
    finally:
        for descriptor, saved in zip((1, 2), kept, strict=True):
            os.dup2(saved, descriptor)
            os.close(saved)
        os.close(null)


class _Deferred:
    """A module that is imported when something of it is first asked for: not every machine can have PyBullet."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        value = getattr(_import(self._name), attribute)
        setattr(self, attribute, value)
        return value


pybullet: Any = _Deferred("pybullet")
pybullet_data: Any = _Deferred("pybullet_data")


def require_pybullet() -> None:
    """Make sure of PyBullet before any work starts.

    Raises:
        ToolkitError: it is not installed here.
    """
    _import("pybullet")


def _import(name: str) -> Any:
    try:
        with silence():
            return importlib.import_module(name)
    except ImportError as error:
        raise ToolkitError(
            "simulating scenes needs PyBullet, which has wheels for CPython 3.11 on Linux (x86-64) only; "
            "use such a machine, or build it here: pip install pybullet"
        ) from error


@functools.cache
def best_renderer() -> Renderer:
    """`egl` where PyBullet's plug-in loads, about twice as fast; else `tiny`, which always works.

    Tried in a process of its own: without a usable driver the plug-in ends the process it is loaded into.
    """
    probe = "from toolkit.sim.client import Client; raise SystemExit(not Client().load_egl())"
    try:
        done = subprocess.run([sys.executable, "-c", probe], capture_output=True, timeout=_PROBE_TIMEOUT_S)
    except (OSError, subprocess.TimeoutExpired):
        return "tiny"
    return "egl" if done.returncode == 0 else "tiny"
