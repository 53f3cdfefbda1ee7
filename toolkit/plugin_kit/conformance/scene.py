"""The little scene that checks are made on: three printed boxes on a table, ray-cast, so that its truth is exact."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from toolkit.geometry import make_transform
from toolkit.perception.crops import crop_region
from toolkit.perception.database import Database
from toolkit.perception.fusion import Models, RefineTask, Start
from toolkit.perception.regions import lift_segment
from toolkit.plugin_kit.conformance.raycast import HEIGHT, NOW, THEN, WIDTH, camera, shoot
from toolkit.types import Crop, Float, Frame, Region, Segment

VIEWS = 4
_PRINT = 0.9


@lru_cache
def current_frames() -> tuple[Frame, ...]:
    """RGB-D frames from all around, with true masks; object ids 1 to 3."""
    return tuple(shoot(i, camera(-90 + 360 / VIEWS * i), NOW, print_contrast=_PRINT) for i in range(VIEWS))


@lru_cache
def goal_frame() -> Frame:
    """The goal image: no depth, the same boxes shifted, seen as current frame 0 is."""
    return shoot(0, camera(-90), THEN, depth=False, print_contrast=_PRINT)


@lru_cache
def bare_frames() -> tuple[Frame, ...]:
    """The table without anything on it."""
    return tuple(shoot(i, camera(-90 + 360 / VIEWS * i), []) for i in range(VIEWS))


@lru_cache
def dark_frame() -> Frame:
    """A black image of which no pixel has depth: a covered camera."""
    return Frame(0, np.zeros((HEIGHT, WIDTH, 3), np.uint8), camera(-90), np.zeros((HEIGHT, WIDTH), np.float32), {}, {})


def true_motion(object_id: int) -> Float:
    """(4, 4) T_goal_current of one box, which only shifts."""
    now, then = NOW[object_id - 1][0], THEN[object_id - 1][0]
    return make_transform(np.eye(3), np.subtract(then, now))


def segments_of(frame: Frame) -> list[Segment]:
    """The frame's true masks."""
    return [Segment(mask) for _, mask in sorted((frame.true_masks or {}).items())]


def crops(size: int) -> list[Crop]:
    """Crops of the boxes as the first two frames show them, side `size` pixels."""
    return [crop_region(frame.rgb, segment, size) for frame in current_frames()[:2] for segment in segments_of(frame)]


def blank_crop(size: int) -> Crop:
    """A black crop with one pixel of mask."""
    mask = np.zeros((size, size), bool)
    mask[size // 2, size // 2] = True
    return Crop(np.zeros((size, size, 3), np.uint8), mask, 1.0, np.zeros(2))


@lru_cache
def regions() -> tuple[tuple[Region, ...], np.ndarray]:
    """The regions of all boxes in all frames, and the (R,) int64 box, from 0, that each is of."""
    lifted = [
        (region, object_id - 1)
        for frame in current_frames()
        for object_id, mask in sorted((frame.true_masks or {}).items())
        if isinstance(region := lift_segment(frame, Segment(mask)), Region)
    ]
    return tuple(region for region, _ in lifted), np.array([box for _, box in lifted], np.int64)


def refine_task(object_id: int, starts: tuple[Start, ...] = ()) -> RefineTask:
    """One box in the goal image, with its models made anew."""
    found, instances = regions()
    database = Database(current_frames(), found, instances, np.zeros((len(found), 1), np.float32))
    segments = segments_of(goal_frame())
    return RefineTask.of(goal_frame(), segments, object_id - 1, object_id - 1, Models(database), starts)
