"""A capture taken with a RealSense camera: one picture for every pose that an arm, or a person, tells."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from toolkit.data.bop import write_capture
from toolkit.data.importing.recording import Shot, pinhole_frame
from toolkit.data.importing.settings import told_pose
from toolkit.data.importing.streams import Stream
from toolkit.errors import ToolkitError
from toolkit.files import writing
from toolkit.types import Float, Frame

GOAL = "goal"
"""A line that begins with this word is of the goal image."""

_STALE = 2
"""Sets of frames that may have been taken before a pose was told."""


def record_capture(stream: Stream, lines: Iterable[str], T_body_camera: Float, out: Path) -> int:
    """Take a picture for every line, and write a capture when the lines end.

    Args:
        stream: the camera.
        lines: `x y z qx qy qz qw` in metres, or 16 numbers row by row: where the body is when the line is told; with
            `goal` before it, once, where the goal image is taken.
        T_body_camera: (4, 4) pose of the colour camera on the body.
        out: the capture folder, which must not be there.

    Returns:
        The number of current frames.

    Raises:
        ToolkitError: a line is no pose, the camera gives no frames, there are not one goal image and a current one, or
            `out` is there already.
    """
    if out.exists():
        raise ToolkitError(f"'{out}' is there already; name a new folder")
    current: list[Frame] = []
    goals: list[Frame] = []
    frames = stream.frames()
    for number, line in enumerate(filter(str.strip, lines)):
        told = line.strip().removeprefix(GOAL)
        of_goal = told != line.strip()
        T_world_body = told_pose(told, f"pose {number}")
        shot = Shot(0 if of_goal else len(current), f"pose {number}", T_world_body @ T_body_camera)
        (goals if of_goal else current).append(_picture(stream, frames, shot))
    if len(goals) != 1 or not current:
        raise ToolkitError(
            f"a capture has one goal image and at least one current frame, got {len(goals)} and {len(current)}; "
            f"begin the line with the pose of the goal image with '{GOAL}'"
        )
    with writing(f"'{out}'"):
        write_capture(out, current, goals[0])
    return len(current)


def _picture(stream: Stream, frames: Iterator[object], shot: Shot) -> Frame:
    for _ in range(_STALE):
        next(frames, None)
    taken = next(frames, None)
    if taken is None:
        raise ToolkitError(f"the camera gave no frame for {shot.name}; is it connected, at USB 3?")
    pixels = stream.pixels(taken)
    return pinhole_frame(shot, pixels.rgb, pixels.depth, pixels.K, pixels.distortion)
