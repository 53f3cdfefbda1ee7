"""What JAX has compiled, kept on disk: half of what a process that estimates one capture computes is compiling."""

from __future__ import annotations

import os
import platform
import warnings
import zlib
from contextlib import suppress
from pathlib import Path

import jax

from toolkit.paths import cache_root


def keep_compiled() -> None:
    """Let JAX keep its programs below the toolkit's cache, apart for each machine, unless it was given a folder.

    What a process that was killed left half-written is removed. A folder that cannot be written costs the time only.
    """
    if jax.config.jax_compilation_cache_dir is not None:  # type: ignore[attr-defined]
        return
    # A program holds the instructions of the processor that it was compiled for.
    folder = cache_root() / "compiled" / (platform.node() or "machine")
    with suppress(OSError):
        for program in folder.glob("*-cache"):
            if not _is_whole(program):
                program.unlink(missing_ok=True)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache entry")


def share_accelerator() -> None:
    """Let JAX take a GPU's memory as it needs it, and keep the processor beside it; call it before JAX first computes.

    JAX takes three quarters of the memory at once by default, and torch and other workers need room there too. A
    person's own XLA_PYTHON_CLIENT_PREALLOCATE stays. Poses are polished in float64 on the processor, which
    JAX_PLATFORMS=cuda alone leaves out.
    """
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    platforms = jax.config.jax_platforms  # type: ignore[attr-defined]
    if platforms and "cpu" not in platforms.split(","):
        jax.config.update("jax_platforms", f"{platforms},cpu")


def _is_whole(program: Path) -> bool:
    """Whether a program can be unpacked: JAX writes in place, so that it may end early."""
    data = program.read_bytes()
    if not data.startswith(b"\x78"):
        return bool(data)  # packed by a library that checks it itself
    unpacking = zlib.decompressobj()
    try:
        unpacking.decompress(data)
    except zlib.error:
        return False
    return unpacking.eof
