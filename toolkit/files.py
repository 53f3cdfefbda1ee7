"""Files and folders that are there whole or not at all, whoever else makes the same ones at the same time."""

from __future__ import annotations

import fcntl
import json
import os
import secrets
import shutil
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from toolkit.errors import ToolkitError

_LIST = ".whole.json"
"""Names and sizes of all files of a folder that `make_once` made, written last."""

_DEAD_AFTER_S = 24 * 3600
"""Nothing is written for so long without a sign of life: who began it was killed."""


@contextmanager
def new_file(path: Path) -> Generator[Path]:
    """A name of this process alone beside `path`; what is written there becomes `path` when the block ends well."""
    _remove_dead(path)
    temporary = _temporary(path)
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def may_write(folder: Path) -> bool:
    """Whether something can be written in a folder, or the folder be made where there is none yet."""
    return os.access(next(above for above in (folder, *folder.absolute().parents) if above.exists()), os.W_OK)


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file so that a reader never meets half of it."""
    with new_file(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text as `write_bytes` does."""
    write_bytes(path, text.encode())


def write_json(path: Path, value: Any) -> None:
    """Write JSON, indented, as `write_bytes` does."""
    write_text(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


def read_json(path: Path) -> Any:
    """Read a JSON file in any Unicode encoding, with a byte-order mark or without.

    Raises:
        ToolkitError: it is missing, cannot be read or parsed, or gives one key twice.
    """
    try:
        return json.loads(path.read_bytes(), object_pairs_hook=_each_key_once)
    except FileNotFoundError as error:
        raise ToolkitError(f"'{path}' is missing") from error
    except (OSError, ValueError, RecursionError) as error:
        raise ToolkitError(f"'{path}' is not readable JSON: {' '.join(str(error).split())}") from error


def _each_key_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    keys = [key for key, _ in pairs]
    twice = next((key for key in keys if keys.count(key) > 1), None) if len(set(keys)) < len(keys) else None
    if twice is not None:
        raise ValueError(f"the key {json.dumps(twice)} stands in it twice; remove one")
    return dict(pairs)


@contextmanager
def writing(what: str, kept: str = "") -> Generator[None]:
    """Turn a full disk or a folder without permission into one clear sentence.

    Args:
        what: is written; a path in quotes.
        kept: ends the sentence: what is not lost.

    Raises:
        ToolkitError: an OSError was raised inside the block.
    """
    try:
        yield
    except OSError as error:
        raise ToolkitError(f"cannot write {what}: {error.strerror or error}{kept}") from error


def make_once(folder: Path, make: Callable[[Path], object]) -> Path:
    """A folder of files that is made where it is not there whole; returns it.

    Any number of processes may ask for it at once, and any of them may be killed: each writes under a name of its own
    and renames that, the first one's folder stays, and what others made of the same is thrown away.

    Args:
        folder: where it belongs.
        make: called with an empty folder to write into; whoever calls it, it must write the same.

    Raises:
        ToolkitError: the folder cannot be written.
    """
    if is_whole(folder):
        return folder
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        _remove_dead(folder)
        temporary = _temporary(folder)
        temporary.mkdir()
        try:
            make(temporary)
            sizes = {str(path.relative_to(temporary)): path.stat().st_size for path in _files(temporary)}
            write_json(temporary / _LIST, sizes)
            _put(temporary, folder)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
    except OSError as error:
        raise ToolkitError(
            f"'{folder}' cannot be written: {error}; make room there, or name another folder "
            "(in $TOOLKIT_CACHE, where it is the cache's)"
        ) from error
    return folder


def is_whole(folder: Path) -> bool:
    """Say whether `make_once` made a folder to the end, and nothing of it has been lost since."""
    try:
        sizes: dict[str, int] = json.loads((folder / _LIST).read_text())
        return all((folder / name).stat().st_size == size for name, size in sizes.items())
    except (OSError, ValueError, AttributeError):
        return False


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def _put(made: Path, folder: Path) -> None:
    """Rename `made`, unless another process was faster; half a folder in its place is thrown away."""
    broken = _temporary(folder)
    with _alone(folder.parent):
        if not is_whole(folder):
            with suppress(FileNotFoundError):
                folder.rename(broken)  # left by a killed process of an older version, or cleaned up in part
            made.rename(folder)
    shutil.rmtree(broken, ignore_errors=True)


@contextmanager
def _alone(folder: Path) -> Generator[None]:
    """Wait until no other process is in this block with the same folder."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        # Some network file systems lock no folders; at worst, a whole folder is then replaced by its like.
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def _temporary(path: Path) -> Path:
    """A name beside `path` that no other process has, not even one of the same number in another container."""
    return path.with_name(f".{path.name}.{os.getpid()}.{secrets.token_hex(4)}.tmp")


def _remove_dead(path: Path) -> None:
    """Remove what killed processes left of the same thing."""
    with suppress(OSError):
        for other in path.parent.iterdir():
            if other.name.startswith(f".{path.name}.") and time.time() - other.stat().st_mtime > _DEAD_AFTER_S:
                shutil.rmtree(other, ignore_errors=True) if other.is_dir() else other.unlink(missing_ok=True)
