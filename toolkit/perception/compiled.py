"""What JAX has traced and compiled, kept on disk: it is half of what a process that estimates one capture computes."""

from __future__ import annotations

import hashlib
import os
import platform
import warnings
import zlib
from collections.abc import Callable
from contextlib import suppress
from functools import update_wrapper
from pathlib import Path
from typing import Any, Generic, TypeVar

import jax
import numpy as np
from jax import export

from toolkit.digests import digest, source_digest
from toolkit.files import write_bytes
from toolkit.paths import cache_root

_Result = TypeVar("_Result")
_Type = TypeVar("_Type", bound=type)

_SEAL = hashlib.sha256().digest_size


class Compiled(Generic[_Result]):
    """A function of arrays as `jax.jit` makes it, its traced program kept where JAX keeps the compiled one.

    JAX keeps what XLA makes of a program, and finds it by the program; so every process traces it first, which takes
    longer than to load it. Where `keep_compiled` was not called, or JAX computes elsewhere than on the processor, this
    is `jax.jit`. What it returns is made of arrays, tuples and types that are `kept_type`.

    Args:
        function: of arrays, and of named tuples of them.
    """

    def __init__(self, function: Callable[..., _Result]) -> None:
        update_wrapper(self, function)
        self._function = function
        self._jitted: Any = jax.jit(function)
        self._programs: dict[Any, Any] = {}
        self.lower = self._jitted.lower

    def __call__(self, *args: Any) -> _Result:
        """What the function returns."""
        folder = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
        if folder is None or jax.default_backend() != "cpu":
            return self._jitted(*args)
        leaves, tree = jax.tree.flatten(args)
        kind = (tree, jax.config.jax_enable_x64, *map(_kind, leaves))  # type: ignore[attr-defined]
        if kind not in self._programs:
            self._programs[kind] = jax.jit(self._traced(Path(folder), kind, leaves).call)
        return self._programs[kind](*leaves)

    def _traced(self, folder: Path, kind: tuple[Any, ...], leaves: list[Any]) -> export.Exported:
        """The program for arguments of one kind, read where it is kept."""
        tree, name = kind[0], f"{self._function.__module__}.{self._function.__qualname__}"
        key = digest([name, source_digest(self._function.__module__), jax.__version__, *map(str, kind)])
        path = folder / f"{name}-{key}-traced"
        with suppress(OSError):
            kept = path.read_bytes()
            seal, program = kept[:_SEAL], kept[_SEAL:]
            if seal == hashlib.sha256(program).digest():
                return export.deserialize(bytearray(program))

        def flat(*leaves: Any) -> Any:
            return self._function(*jax.tree.unflatten(tree, leaves))

        traced = export.export(jax.jit(flat))(*leaves)
        program = bytes(traced.serialize())
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            write_bytes(path, hashlib.sha256(program).digest() + program)
        return traced


def _kind(argument: Any) -> Any:
    """What a program depends on of an argument; `jax.typeof` of NumPy's arrays takes longer than some programs."""
    if isinstance(argument, jax.Array):
        return argument.aval
    return type(argument), np.shape(argument), np.result_type(argument)


def kept_type(named_tuple: _Type) -> _Type:
    """Let what a `Compiled` function returns be a named tuple of this type."""
    name = f"{named_tuple.__module__}.{named_tuple.__qualname__}"
    return export.register_namedtuple_serialization(named_tuple, serialized_name=name)


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
