"""What every descriptor must do."""

from __future__ import annotations

import numpy as np

from toolkit.plugin_kit.conformance.kit import Check, Subject, require, require_array, require_same_twice, same
from toolkit.plugin_kit.conformance.scene import blank_crop, crops
from toolkit.stages import AdaptiveDescriptor
from toolkit.types import Crop


def rows_are_float32_of_unit_length(subject: Subject) -> str:
    """(N, d) float32 rows whose inner product is a similarity."""
    descriptor = subject.make()
    given = _crops(descriptor)
    rows = require_array(descriptor.describe(given), (len(given), None), np.float32, "describe()'s rows")
    lengths = np.linalg.norm(rows, axis=1)
    require(
        np.allclose(lengths, 1, atol=1e-4), f"rows must have length 1, got {lengths.min():.4f} to {lengths.max():.4f}"
    )
    return f"{rows.shape[1]} dimensions"


def a_batch_gives_what_single_crops_give(subject: Subject) -> None:
    """A row depends on its own crop alone."""
    descriptor = subject.make()
    given = _crops(descriptor)
    together = descriptor.describe(given)
    alone = np.concatenate([descriptor.describe([crop]) for crop in given])
    off = float(np.abs(together - alone).max())
    require(off <= 1e-5, f"rows of a batch and of single crops differ by up to {off:.2g}")


def objects_are_told_apart(subject: Subject) -> None:
    """A crop, slightly darker, is nearest to one of the same box."""
    descriptor = subject.make()
    given = _crops(descriptor)
    darker = [Crop((c.image * 0.95).astype(np.uint8), c.mask, c.scale, c.origin_xy) for c in given]
    nearest = (descriptor.describe(darker) @ descriptor.describe(given).T).argmax(axis=1)
    wrong = int((nearest % 3 != np.arange(len(given)) % 3).sum())  # three boxes, two frames
    require(wrong == 0, f"{wrong} of {len(given)} crops, made 5 % darker, are nearest to another box")


def a_blank_crop_is_described(subject: Subject) -> None:
    """A black crop with one pixel of mask gives a finite row."""
    descriptor = subject.make()
    require(
        np.isfinite(descriptor.describe([blank_crop(descriptor.crop_size)])).all(), "a blank crop's row is not finite"
    )


def what_it_learns_from_a_scene_keeps_rows_of_unit_length(subject: Subject) -> str:
    """Where it adapts to a scene (`AdaptiveDescriptor`): unit rows, finite for a scene of one region, repeatable."""
    descriptor = subject.make()
    rows = descriptor.describe(_crops(descriptor))
    if not isinstance(descriptor, AdaptiveDescriptor):
        return "does not adapt"
    boxes = np.arange(len(rows)) % 3
    for given, instances in ((rows, boxes), (rows[:1], boxes[:1])):
        adapted = descriptor.adapt(given, instances)(rows)
        require_array(adapted, (len(rows), None), np.float32, "adapted rows")
        lengths = np.linalg.norm(adapted, axis=1)
        require(np.allclose(lengths, 1, atol=1e-4), f"adapted rows must have length 1, got {lengths.min():.4f}")
        require(same(adapted, descriptor.adapt(given, instances)(rows)), "adapted rows differ between two runs")
    return "adapts to the scene"


def the_same_input_gives_the_same_bytes(subject: Subject) -> None:
    """New instances agree, whatever the global random generators are at."""
    require_same_twice(lambda: (made := subject.make()).describe(_crops(made)), "the rows")


def _crops(descriptor: object) -> list[Crop]:
    size = getattr(descriptor, "crop_size", None)
    require(isinstance(size, int) and size > 0, f"crop_size must be a positive int, got {size!r}")
    assert isinstance(size, int)
    return crops(size)


CHECKS: tuple[Check, ...] = (
    rows_are_float32_of_unit_length,
    a_batch_gives_what_single_crops_give,
    objects_are_told_apart,
    a_blank_crop_is_described,
    what_it_learns_from_a_scene_keeps_rows_of_unit_length,
    the_same_input_gives_the_same_bytes,
)
