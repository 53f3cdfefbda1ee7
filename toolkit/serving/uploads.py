"""What a client sends, as scene folders of this process's own: no name that a client gives is ever opened as a path."""

from __future__ import annotations

import json
import re
import shutil
import warnings
import zlib
from pathlib import Path, PurePosixPath
from typing import BinaryIO
from zipfile import BadZipFile, ZipFile, ZipInfo

from PIL import Image as Pictures

from toolkit.data.bop.images import DEPTHS, PICTURES
from toolkit.errors import ToolkitError
from toolkit.files import write_json

_CAMERAS = "scene_camera.json"
_FOLDERS = {"rgb": PICTURES, "depth": DEPTHS, "mask_visib": PICTURES}
_NAME = re.compile(r"[0-9A-Za-z][0-9A-Za-z_-]{0,99}\.[A-Za-z]{3,4}")
_MOST_FILES = 2000
_MOST_PIXELS = 200_000_000
"""In all pictures of one upload together: a hundred frames of a megapixel, with depth."""

_UNPACKED = 4
"""A zip may hold this many times its largest allowed size."""


def unpack_current(archive: BinaryIO, folder: Path, most_bytes: int) -> None:
    """Unpack the current/ of a zipped capture folder, and nothing else of it, into `folder`.

    Args:
        archive: the zip; the capture folder may lie in other folders in it.
        folder: takes scene_camera.json, rgb/, depth/ and mask_visib/.
        most_bytes: the largest upload.

    Raises:
        ToolkitError: it is no such zip, is damaged, or holds more than the server takes.
    """
    try:
        with ZipFile(archive) as opened:
            wanted = _wanted(opened.infolist())
            if sum(info.file_size for info in wanted.values()) > _UNPACKED * most_bytes:
                raise ToolkitError(
                    f"the zip holds more than {_UNPACKED * most_bytes / 2**20:.0f} MiB; send fewer frames"
                )
            for name, info in wanted.items():
                target = folder / name
                target.parent.mkdir(parents=True, exist_ok=True)
                with opened.open(info) as source, target.open("wb") as to:
                    shutil.copyfileobj(source, to)
    except (BadZipFile, zlib.error, RuntimeError, NotImplementedError, EOFError, OSError) as error:
        # Encrypted, cut, of an unknown compression: zipfile says it in many ways.
        raise ToolkitError("the upload is no zip that can be unpacked; zip the capture folder again") from error
    _limit_pixels(folder)


def write_goal(picture: BinaryIO, camera: str, folder: Path) -> None:
    """Write a goal picture and its camera as a scene folder.

    Args:
        picture: PNG, JPEG, TIFF, BMP or WebP.
        camera: JSON, one entry of scene_camera.json.
        folder: takes scene_camera.json and rgb/.

    Raises:
        ToolkitError: `camera` is not JSON, or the picture is too large.
    """
    try:
        entry = json.loads(camera)
    except (ValueError, RecursionError) as error:
        raise ToolkitError(f"'camera' is not JSON: {error}; send an entry of scene_camera.json") from error
    (folder / "rgb").mkdir(parents=True)
    with (folder / "rgb" / "0.png").open("wb") as to:
        # What it really is, its bytes say.
        shutil.copyfileobj(picture, to)
    write_json(folder / _CAMERAS, {"0": entry})
    _limit_pixels(folder)


def _wanted(members: list[ZipInfo]) -> dict[str, ZipInfo]:
    """The files of current/ by the place each gets."""
    found: dict[str, ZipInfo] = {}
    tops: set[tuple[str, ...]] = set()
    for info in members:
        parts = PurePosixPath(info.filename.replace("\\", "/")).parts
        if info.is_dir() or "current" not in parts[:-1]:
            continue
        split = parts.index("current")
        below = parts[split + 1 :]
        if below[0] == "depth" and below[-1].lower().endswith(".exr"):
            # Nothing tells how large it gets without unpacking it.
            raise ToolkitError("depth as EXR is not taken over HTTP; send 16-bit PNG, TIFF or NPY")
        if below == (_CAMERAS,) or (len(below) == 2 and below[0] in _FOLDERS and _is_safe(*below)):
            tops.add(parts[:split])
            found["/".join(below)] = info
    if _CAMERAS not in found:
        raise ToolkitError(f"the zip holds no current/{_CAMERAS}; zip a capture folder")
    if len(tops) > 1:
        raise ToolkitError("the zip holds several captures; send one")
    if len(found) > _MOST_FILES:
        raise ToolkitError(f"the zip holds more than {_MOST_FILES} pictures; send fewer frames")
    return found


def _is_safe(folder: str, name: str) -> bool:
    return _NAME.fullmatch(name) is not None and Path(name).suffix.lower() in _FOLDERS[folder]


def _limit_pixels(folder: Path) -> None:
    pixels = sum(map(_pixels, folder.glob("*/*")))
    if pixels > _MOST_PIXELS:
        raise ToolkitError(f"the pictures have {pixels / 1e6:.0f} megapixels, more than {_MOST_PIXELS / 1e6:.0f}")


def _pixels(path: Path) -> int:
    """As its header says; 0 where it is no picture, which reading the scene answers, or NPY, as large as its bytes."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of many pixels, which the caller refuses
            with Pictures.open(path) as picture:
                return picture.width * picture.height
    except Exception:
        return 0
