"""Pictures, depth and lists of files in folders of recordings."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from toolkit.data.bop.depth import metres
from toolkit.data.bop.images import read_color, read_depth, turned
from toolkit.errors import ToolkitError
from toolkit.types import Float, Image

SchemaT = TypeVar("SchemaT", bound=BaseModel)

TOLERANCE_S = 0.02
"""Seconds that stamps of colour, depth and pose may lie apart, as the TUM benchmark's own tools have it."""


def picture(path: Path, size: tuple[int, int] | None = None) -> Image:
    """(H, W, 3) uint8 as its camera sees it: as it is stored, or turned as EXIF says where only that has its size.

    Args:
        path: its file.
        size: (H, W) that its camera states, if any.

    Raises:
        ToolkitError: it cannot be read, has another size, or its size does not tell whether EXIF counts.
    """
    stored, orientation = read_color(path)
    ways = [stored] if orientation == 1 else [stored, turned(stored, orientation)]
    fitting = [rgb for rgb in ways if size is None or rgb.shape[:2] == size]
    if size is not None and not fitting:
        height, width = stored.shape[:2]
        raise ToolkitError(f"'{path}' is {width}x{height}, but its camera says {size[1]}x{size[0]}")
    if len(fitting) > 1:
        raise ToolkitError(
            f"'{path}' has EXIF orientation {orientation}, and its size does not tell whether its camera is that of "
            "the picture as it is stored or as it is turned; store the pixels as the camera sees them, without the tag"
        )
    return fitting[0]


def depth_image(path: Path, depth_scale: float) -> Float:
    """(H, W) float32 metres, 0 where nothing was measured.

    Raises:
        ToolkitError: it cannot be read, or `depth_scale` (millimetres per unit) cannot be that of the file.
    """
    return metres(read_depth(path), depth_scale, path, "the setting depth_scale")


def by_number(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    """Its files with these suffixes, by the numbers in their names: `9.png` before `10.png`."""
    files = folder.iterdir() if folder.is_dir() else ()
    return sorted((f for f in files if f.suffix.lower() in suffixes and not f.name.startswith(".")), key=_natural)


def rows(path: Path, counts: tuple[int, ...], holds: str) -> Iterator[tuple[str, list[str]]]:
    """The lines of a text file with values between spaces, `#` before remarks: where each stands, and its values.

    Raises:
        ToolkitError: it cannot be read, or a line has another number of values; `holds` says what belongs there.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ToolkitError(f"'{path}' cannot be read; it holds {holds}") from error
    for number, line in enumerate(lines, start=1):
        values = line.partition("#")[0].replace(",", " ").split()
        if values and len(values) not in counts:
            raise ToolkitError(f"'{path}', line {number}: {holds} is wanted, got '{line[:60]}'")
        if values:
            yield f"'{path}', line {number}", values


def checked(schema: type[SchemaT], data: object, where: str) -> SchemaT:
    """What a file has of one camera or frame, as its schema says.

    Raises:
        ToolkitError: a key does not fit; the first that does not is named.
    """
    try:
        return schema.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        raise ToolkitError(f"{where}: {'.'.join(map(str, first['loc']))}: {first['msg']}") from error


def numbers(values: list[str], where: str) -> list[float]:
    """Values of a line as numbers; raises ToolkitError where one is none."""
    try:
        return [float(value) for value in values]
    except ValueError as error:
        raise ToolkitError(f"{where}: numbers are wanted, got '{' '.join(values)[:60]}'") from error


def _natural(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split("([0-9]+)", path.name)]
