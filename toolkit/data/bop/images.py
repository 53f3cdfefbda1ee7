"""Files of a scene's folders as arrays: which file is an image's, and what it holds, as it is stored."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pictures
from rapidfuzz import process

from toolkit.errors import ToolkitError
from toolkit.types import Float, Image

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp")
DEPTHS = (".png", ".tif", ".tiff", ".npy", ".exr")

Pictures.init()
_FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "WEBP")
_ORIENTATION = 0x0112
_NUMBERS_ONLY = ("I", "F")
"""First letters of Pillow's modes of pictures with one number a pixel, 16 bits or more."""


@dataclass(frozen=True)
class ImageFolder:
    """A folder with one file an image, named by the image's id: `7.png`, `000007.png`, `7.JPG`.

    Attributes:
        path: the folder, which need not be there.
        suffixes: endings of files that are read, lower case.
        files: the files of every image id.
        others: names of other files.
    """

    path: Path
    suffixes: tuple[str, ...]
    files: Mapping[int, tuple[Path, ...]]
    others: tuple[str, ...]

    @staticmethod
    def of(path: Path, suffixes: tuple[str, ...]) -> ImageFolder:
        """Look into a folder; files of other names are kept in mind, to be named where one is missing."""
        files: dict[int, tuple[Path, ...]] = {}
        others: list[str] = []
        for file in sorted(path.iterdir()) if path.is_dir() else ():
            if file.suffix.lower() in suffixes and re.fullmatch("[0-9]{1,10}", file.stem):
                number = int(file.stem)
                files[number] = (*files.get(number, ()), file)
            elif not file.name.startswith("."):
                others.append(file.name)
        return ImageFolder(path, suffixes, files, tuple(others))

    def find(self, image: int) -> Path | None:
        """The file of an image, or None.

        Raises:
            ToolkitError: there are two.
        """
        files = self.files.get(image, ())
        if len(files) > 1:
            names = " and ".join(f"'{file.name}'" for file in files)
            raise ToolkitError(f"'{self.path}' holds image {image} twice: {names}; keep one")
        return files[0] if files else None

    def missing(self, image: int) -> str:
        """Say that an image has no file, and which file may have been meant."""
        name = f"{image:06d}"
        said = f"'{self.path / (name + self.suffixes[0])}' is missing"
        if not self.files and not self.others:
            return f"{said}; {'the folder is empty' if self.path.is_dir() else 'there is no such folder'}"
        near = self._near(image)
        if near is None:
            there = [str(number) for number in sorted(self.files)]
            listed = ", ".join(there[:5]) + (f" and {len(there) - 5} more" if len(there) > 5 else "")
            return f"{said}; the folder holds the images {listed}" if there else f"{said}; no file has its number"
        suffix = Path(near).suffix.lower()
        if suffix in self.suffixes:
            return f"{said}; '{near}' is there: rename it to '{name}{suffix}'"
        return f"{said}; '{near}' is there, but only files in {' '.join(self.suffixes)} are read"

    def _near(self, image: int) -> str | None:
        """The file that may have been meant: the one with the number, the only one, or one named alike."""
        numbered = [n for n in self.others if image in map(int, re.findall("[0-9]{1,10}", n))]
        if numbered or (len(self.others) == 1 and not self.files):
            return (numbered or self.others)[0]
        names = [f"{image}{suffix}" for suffix in self.suffixes]
        found = [process.extractOne(name, self.others, score_cutoff=80) for name in names] if self.others else []
        return next((match[0] for match in found if match), None)


def read_color(path: Path) -> tuple[Image, int]:
    """Read a picture.

    Returns:
        (H, W, 3) uint8 as it is stored, and its EXIF orientation, 1 to 8; 1 where none is stated.

    Raises:
        ToolkitError: it cannot be read or is damaged, or holds one number of 16 bits or more a pixel.
    """
    picture, orientation = _open(path)
    if picture.mode.startswith(_NUMBERS_ONLY):
        raise ToolkitError(f"'{path}' holds one number a pixel, as depth does; a colour picture is wanted")
    return _stored(np.asarray(picture.convert("RGB"), np.uint8), picture.format, orientation), orientation


def read_labels(path: Path) -> NDArray[np.int64]:
    """Read a mask or label picture: (H, W) whole numbers as they are stored, those of a palette as its indices.

    Raises:
        ToolkitError: it cannot be read or is damaged, or is in colour.
    """
    picture, orientation = _open(path)
    values = np.asarray(picture)
    if values.ndim == 3 and (values[..., :1] == values[..., :3]).all():
        values = values[..., 0]  # grey, written as colour
    if values.ndim != 2 or values.dtype.kind not in "bui":
        raise ToolkitError(f"'{path}' is in colour; masks hold one whole number a pixel, 0 where no object is")
    return _stored(values.astype(np.int64), picture.format, orientation)


def read_depth(path: Path) -> NDArray[Any]:
    """Read a depth image: (H, W) integers of 16 bits or more, or floats, as they are stored.

    Raises:
        ToolkitError: it cannot be read or is damaged, or is a picture of another kind.
    """
    suffix = path.suffix.lower()
    if suffix in (".npy", ".exr"):
        values = _read_npy(path) if suffix == ".npy" else _read_exr(path)
    else:
        picture, orientation = _open(path)
        values = _stored(np.asarray(picture), picture.format, orientation)
    values = values[..., 0] if values.ndim == 3 and values.shape[2] == 1 else values
    if values.ndim != 2 or values.dtype.kind not in "uif" or values.dtype.itemsize < 2:
        raise ToolkitError(
            f"'{path}' is {values.dtype} {'x'.join(map(str, values.shape))}; depth is one number of 16 bits "
            "or more a pixel, so is it a picture made to be looked at?"
        )
    return values


def turned(image: NDArray[Any], orientation: int) -> NDArray[Any]:
    """An image as its EXIF orientation says that it is to be seen."""
    if orientation >= 5:
        image = image.swapaxes(0, 1)
    down, right = orientation in (3, 4, 7, 8), orientation in (2, 3, 6, 7)
    return np.ascontiguousarray(image[:: -1 if down else 1, :: -1 if right else 1])


def _stored(image: NDArray[Any], kind: str | None, orientation: int) -> NDArray[Any]:
    """Undo that Pillow turns TIFF, and nothing else, on its own."""
    return turned(image, {6: 8, 8: 6}.get(orientation, orientation)) if kind == "TIFF" else image


def _open(path: Path) -> tuple[Pictures.Image, int]:
    """A decoded picture and its EXIF orientation. What follows its end is not looked at."""
    data = read_bytes(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about metadata; pixels that cannot be had raise
            picture = Pictures.open(BytesIO(data), formats=_FORMATS)
            orientation = picture.getexif().get(_ORIENTATION, 1)
            picture.load()
    except Exception as error:
        # Pillow reports damaged files in a dozen ways.
        raise ToolkitError(f"'{path}' is truncated or not an image; write or copy it again") from error
    return picture, orientation if orientation in range(1, 9) else 1


def read_bytes(path: Path) -> bytes:
    """The bytes of a file; raises ToolkitError where it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise ToolkitError(f"'{path}' cannot be read: {error.strerror}") from error


def _read_npy(path: Path) -> NDArray[Any]:
    try:
        return np.asarray(np.load(BytesIO(read_bytes(path)), allow_pickle=False))
    except (ValueError, EOFError, OSError) as error:
        raise ToolkitError(f"'{path}' is truncated or not a NumPy array; write it with numpy.save") from error


def _read_exr(path: Path) -> Float:
    try:
        import OpenEXR
    except ImportError as error:
        raise ToolkitError(f"'{path}' needs OpenEXR: pip install 'rearrange-toolkit[exr]'") from error
    try:
        read_bytes(path)
        channels: dict[str, Any] = OpenEXR.File(str(path)).channels()
        name = next((name for name in ("Z", "Y", "V", "R", "RGB", "RGBA") if name in channels), next(iter(channels)))
        pixels = np.asarray(channels[name].pixels)
    except (RuntimeError, ValueError, StopIteration) as error:
        raise ToolkitError(f"'{path}' is truncated or not an OpenEXR image; write or copy it again") from error
    return pixels[..., 0] if pixels.ndim == 3 else pixels
