"""Masks that come with a capture: the true ones by instance, a user's own by number."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from toolkit.data.bop.images import read_labels
from toolkit.data.bop.lens import Lens
from toolkit.errors import ToolkitError
from toolkit.types import Mask

SCENES = ("current", "goal")

_SUFFIXES = (".png", ".tif", ".tiff", ".bmp")
"""Lossy pictures have no masks: values blur at borders."""

_NAME = re.compile("([0-9]{1,9})(?:_([0-9]{1,9}))?")
_OVERLAP = 0.02
"""Part of a mask that may lie in others: resizing blurs borders."""

_MOST_LABELS = 1000
"""A picture with more values is no label image."""


def masked_scenes(folder: Path) -> list[str]:
    """Which of `current` and `goal` a folder of a user's own masks has masks for.

    Raises:
        ToolkitError: neither.
    """
    scenes = [name for name in SCENES if (folder / name).is_dir()]
    if not scenes:
        raise ToolkitError(
            f"masks '{folder}' must hold current/ and goal/, with a label image IMAGE.png "
            "or one IMAGE_OBJECT.png per object for every image"
        )
    return scenes


@dataclass(frozen=True)
class MaskFolder:
    """A folder of masks: `IMAGE.png` is a label image, `IMAGE_OBJECT.png` shows one object; any zero padding.

    Attributes:
        path: the folder.
        labels: label images by image id.
        objects: the pictures of single objects, by image id and number.
    """

    path: Path
    labels: Mapping[int, Path]
    objects: Mapping[int, Mapping[int, Path]]

    @staticmethod
    def of(path: Path) -> MaskFolder:
        """Look into a folder.

        Raises:
            ToolkitError: two files are the same image's, or the same object's.
        """
        labels: dict[int, Path] = {}
        objects: dict[int, dict[int, Path]] = {}
        for file in sorted(path.iterdir()):
            match = _NAME.fullmatch(file.stem)
            if match is None or file.suffix.lower() not in _SUFFIXES:
                continue
            image, number = match.groups()
            group, key = (labels, int(image)) if number is None else (objects.setdefault(int(image), {}), int(number))
            if key in group or (int(image) in labels and int(image) in objects):
                former = group.get(key) or labels[int(image)]
                raise ToolkitError(f"'{path}': '{former.name}' and '{file.name}' show the same; keep one")
            group[key] = file
        return MaskFolder(path, labels, objects)

    def own(self, image: int, size: tuple[int, int], lens: Lens | None) -> dict[int, Mask]:
        """A user's own masks of one image by number, disjoint; none where the folder has no file of the image.

        Args:
            image: its id.
            size: (H, W) of the picture.
            lens: takes distortion out of them, as out of the picture.

        Raises:
            ToolkitError: a file is damaged or of another size, is no mask, or two masks overlap.
        """
        if image in self.labels:
            path = self.labels[image]
            values = _read(path, size, lens)
            numbers = [int(number) for number in np.unique(values) if number > 0]
            if len(numbers) > _MOST_LABELS:
                raise ToolkitError(f"'{path}' has {len(numbers)} different values; a label image has one per object")
            return {number: values == number for number in numbers}
        found = self._single(self.objects.get(image, {}), size, lens)
        self._check_disjoint(image, found)
        free = np.ones(size, bool)
        disjoint: dict[int, Mask] = {}
        for number in sorted(found, key=lambda number: (int(found[number].sum()), number)):
            disjoint[number] = found[number] & free
            free &= ~found[number]
        return {number: disjoint[number] for number in sorted(disjoint) if disjoint[number].any()}

    def true(self, image: int, instances: Sequence[int], size: tuple[int, int], lens: Lens | None) -> dict[int, Mask]:
        """The masks of the objects that scene_gt.json lists for one image, by instance id.

        Args:
            image: its id.
            instances: of the objects, in that order.
            size: (H, W) of the picture.
            lens: as for `own`.

        Raises:
            ToolkitError: a file is missing, or as for `own`.
        """
        files = self.objects.get(image, {})
        missing = next((number for number in range(len(instances)) if number not in files), None)
        if missing is not None:
            name = f"{image:06d}_{missing:06d}.png"
            raise ToolkitError(
                f"'{self.path / name}' is missing; scene_gt.json lists {len(instances)} objects for image {image}, "
                "and each needs its mask, a black one where it is not seen"
            )
        by_number = self._single({number: files[number] for number in range(len(instances))}, size, lens)
        masks = {instances[number]: mask for number, mask in by_number.items()}
        self._check_disjoint(image, masks)
        return masks

    def _single(self, files: Mapping[int, Path], size: tuple[int, int], lens: Lens | None) -> dict[int, Mask]:
        masks = {number: _read(path, size, lens) > 0 for number, path in files.items()}
        return {number: mask for number, mask in masks.items() if mask.any()}

    def _check_disjoint(self, image: int, masks: Mapping[int, Mask]) -> None:
        total = sum((mask.astype(np.uint16) for mask in masks.values()), np.zeros(1, np.uint16))
        doubled = total > 1
        for number, mask in masks.items():
            if doubled.any() and (mask & doubled).sum() > _OVERLAP * mask.sum():
                raise ToolkitError(
                    f"'{self.path}', image {image}: the visible mask of object {number} overlaps another one; "
                    "every pixel belongs to the object that is seen there"
                )


def _read(path: Path, size: tuple[int, int], lens: Lens | None) -> np.ndarray:
    values = read_labels(path)
    if values.shape != size:
        raise ToolkitError(
            f"'{path}' is {values.shape[1]}x{values.shape[0]}, but its picture is {size[1]}x{size[0]}; resize it"
        )
    return values if lens is None else lens.nearest(values)
