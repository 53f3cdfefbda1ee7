"""What every associator must do."""

from __future__ import annotations

import numpy as np

from toolkit.plugin_kit.conformance.kit import Check, Subject, require, require_array, require_same_twice
from toolkit.plugin_kit.conformance.scene import current_frames, regions


def every_region_gets_an_id_and_every_id_occurs(subject: Subject) -> str:
    """(R,) int64 ids 0..K-1 without gaps."""
    found, _ = regions()
    ids = _associate(subject, len(found))
    return f"{ids.max() + 1} instances of 3 boxes"


def no_region_gives_no_id(subject: Subject) -> None:
    """An empty (0,) int64 array."""
    require_array(subject.make().associate([], current_frames()), (0,), np.int64, "the ids of no region")


def one_region_is_instance_0(subject: Subject) -> None:
    """A single region is an instance of its own."""
    require(_associate(subject, 1)[0] == 0, "a single region must get id 0")


def the_same_input_gives_the_same_bytes(subject: Subject) -> None:
    """New instances agree, whatever the global random generators are at."""
    require_same_twice(lambda: subject.make().associate(regions()[0], current_frames()), "the list of ids")


def _associate(subject: Subject, count: int) -> np.ndarray:
    ids = subject.make().associate(regions()[0][:count], current_frames())
    ids = require_array(ids, (count,), np.int64, "the ids")
    require(
        np.array_equal(np.unique(ids), np.arange(ids.max() + 1)),
        f"ids must be 0..K-1, each used; got {sorted(set(ids.tolist()))}",
    )
    return ids


CHECKS: tuple[Check, ...] = (
    every_region_gets_an_id_and_every_id_occurs,
    no_region_gives_no_id,
    one_region_is_instance_0,
    the_same_input_gives_the_same_bytes,
)
