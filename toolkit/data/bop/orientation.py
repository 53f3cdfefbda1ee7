"""EXIF orientation: pictures are turned only where their size shows that cam_K is of the turned picture."""

from __future__ import annotations

from pathlib import Path

from toolkit.data.bop.images import turned
from toolkit.data.bop.notes import Notes
from toolkit.data.bop.schemas import CameraEntry
from toolkit.errors import ToolkitError
from toolkit.types import Image

_OFF_CENTRE = 0.1
"""Part of a picture's side by which its principal point may lie off the middle."""


def upright(rgb: Image, orientation: int, entry: CameraEntry, path: Path, image: int, notes: Notes) -> Image:
    """The picture that its camera describes: as it is stored, or turned as EXIF says.

    The camera's width and height decide; where they are not given, its principal point, which lies near the middle.

    Args:
        rgb: (H, W, 3) uint8 as it is stored.
        orientation: from EXIF, 1 to 8.
        entry: its camera.
        path: its file, for the answer.
        image: its id.
        notes: is told what was done.

    Raises:
        ToolkitError: the size is the same either way, or does not tell.
    """
    if orientation == 1:
        return rgb
    height, width = rgb.shape[:2]
    if entry.width is None and entry.height is None:
        as_stored, as_turned = _is_centred(entry, width, height), _is_centred(entry, height, width)
    else:
        as_stored, as_turned = _is_sized(entry, width, height), _is_sized(entry, height, width)
    if orientation < 5 or as_stored == as_turned:
        raise ToolkitError(
            f"'{path}' has EXIF orientation {orientation}, and its size does not tell whether cam_K is of the picture "
            "as it is stored or as it is turned; store the pixels as cam_K sees them, without the tag"
        )
    done = "are turned" if as_turned else "are not turned"
    notes.add(f"'{path.parent}': pictures with EXIF orientation {orientation} {done}, as their cameras are", image)
    return turned(rgb, orientation) if as_turned else rgb


def _is_sized(entry: CameraEntry, width: int, height: int) -> bool:
    return entry.width in (None, width) and entry.height in (None, height)


def _is_centred(entry: CameraEntry, width: int, height: int) -> bool:
    x, y = entry.cam_K[2], entry.cam_K[5]
    return abs((x + 0.5) / width - 0.5) < _OFF_CENTRE and abs((y + 0.5) / height - 0.5) < _OFF_CENTRE
