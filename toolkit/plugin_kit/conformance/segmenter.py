"""What every segmenter must do. The goal image has no depth: a segmenter that needs it says so by ToolkitError."""

from __future__ import annotations

import numpy as np

from toolkit.errors import ToolkitError
from toolkit.plugin_kit.conformance.kit import Check, Subject, require, require_array, require_same_twice
from toolkit.plugin_kit.conformance.scene import bare_frames, current_frames, dark_frame, goal_frame
from toolkit.types import Frame, Segment


def masks_are_disjoint_and_of_the_images_size(subject: Subject) -> str:
    """A list of Segments with (H, W) bool masks that share no pixel; scores in 0..1; of a frame, a goal, or both."""
    notes: list[str] = []
    for what, frame in (("RGB-D frame", current_frames()[0]), ("goal image", goal_frame())):
        segments = _segment(subject.make(), frame)
        notes.append(f"{what}: {'refused' if segments is None else len(segments)}")
        _require_segments(frame, segments or [])
    require(not all("refused" in note for note in notes), "it refuses an RGB-D frame and a goal image alike")
    return ", ".join(notes)


def an_empty_table_has_no_object(subject: Subject) -> None:
    """The bare table is not an object."""
    frame = bare_frames()[0]
    try:
        segments = subject.make().segment(frame, bare_frames())
    except ToolkitError:
        return
    _require_segments(frame, segments)
    table = max((float(segment.mask.mean()) for segment in segments), default=0.0)
    require(table < 0.2, f"it finds an object that covers {table:.0%} of the image of a bare table")


def a_covered_camera_is_no_crash(subject: Subject) -> None:
    """A black image without depth gives segments or ToolkitError."""
    _require_segments(dark_frame(), _segment(subject.make(), dark_frame()) or [])


def what_it_saw_before_does_not_matter(subject: Subject) -> None:
    """An instance that has segmented other frames agrees with a new one."""
    used = subject.make()
    for frame in (*current_frames()[1:], goal_frame()):
        _segment(used, frame)
    for frame in (current_frames()[0], goal_frame()):
        mine, fresh = _segment(used, frame), _segment(subject.make(), frame)
        equal = [s.mask.tobytes() for s in mine or []] == [s.mask.tobytes() for s in fresh or []]
        require(equal, "its answer depends on the images it has seen before")


def the_same_input_gives_the_same_bytes(subject: Subject) -> None:
    """New instances agree, whatever the global random generators are at."""
    require_same_twice(
        lambda: [_segment(subject.make(), frame) for frame in (current_frames()[0], goal_frame())], "the list of masks"
    )


def _segment(segmenter: object, frame: Frame) -> list[Segment] | None:
    try:
        return segmenter.segment(frame, current_frames())  # pyright: ignore[reportAttributeAccessIssue]
    except ToolkitError as error:
        require(str(error), "segment() raises ToolkitError without a reason")
        return None


def _require_segments(frame: Frame, segments: object) -> None:
    require(isinstance(segments, list), f"segment() must return a list, got {type(segments).__name__}")
    assert isinstance(segments, list)
    covered = np.zeros(frame.rgb.shape[:2], np.int32)
    for segment in segments:
        require(isinstance(segment, Segment), f"segment() must return Segments, got {type(segment).__name__}")
        covered += require_array(segment.mask, frame.rgb.shape[:2], np.bool_, "a mask")
        require(0 <= segment.score <= 1, f"a score must be in 0..1, got {segment.score}")
    require(covered.max() <= 1, f"{int((covered > 1).sum())} pixels belong to two segments")


CHECKS: tuple[Check, ...] = (
    masks_are_disjoint_and_of_the_images_size,
    an_empty_table_has_no_object,
    a_covered_camera_is_no_crash,
    what_it_saw_before_does_not_matter,
    the_same_input_gives_the_same_bytes,
)
