"""PyBullet without what its C code prints, and which of its renderers this machine has."""

from __future__ import annotations

import contextlib
import functools
import os
import subprocess
import sys
from collections.abc import Generator
from typing import Literal

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


with silence():
    import pybullet as pybullet


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
