"""What every registration must do."""

from __future__ import annotations

from typing import Any

import numpy as np

from toolkit.errors import ToolkitError
from toolkit.plugin_kit.conformance.kit import Check, Subject, require, require_same_twice, same
from toolkit.plugin_kit.conformance.scene import bare_frames, current_frames, dark_frame, goal_frame
from toolkit.types import Frame

_MOST_M = 0.02
"""True poses may not be moved further than this."""


def frames_keep_all_but_their_pose(subject: Subject) -> None:
    """The same frames in the same order; images, depths and intrinsics untouched."""
    frames = list(current_frames())
    registered = subject.make().register(frames)
    require(len(registered) == len(frames), f"register() gives {len(registered)} frames for {len(frames)}")
    for before, after in zip(frames, registered, strict=True):
        _require_kept(before, after)
    _require_kept(goal_frame(), subject.make().locate(goal_frame(), registered))


def true_poses_stay(subject: Subject) -> None:
    """Poses without error are not made worse by more than 2 cm (metres in, metres out)."""
    registered = subject.make().register(list(current_frames()))
    goal = subject.make().locate(goal_frame(), registered)
    for before, after in zip((*current_frames(), goal_frame()), (*registered, goal), strict=True):
        moved = np.linalg.norm(before.camera.T_world_camera[:3, 3] - after.camera.T_world_camera[:3, 3])
        require(moved <= _MOST_M, f"frame {before.index}: its true pose is moved by {100 * moved:.1f} cm")


def one_frame_is_enough(subject: Subject) -> None:
    """A single current frame is registered to itself."""
    require(len(subject.make().register(list(current_frames())[:1])) == 1, "register() loses the only frame")


def nothing_to_see_is_no_crash(subject: Subject) -> None:
    """A bare table, and an image without depth: frames come back, or ToolkitError says why not."""
    for frames in (list(bare_frames()), [dark_frame()]):
        try:
            require(len(subject.make().register(frames)) == len(frames), "register() loses frames")
        except ToolkitError as error:
            require(str(error), "register() raises ToolkitError without a reason")


def the_same_input_gives_the_same_bytes(subject: Subject) -> None:
    """New instances agree, whatever the global random generators are at."""

    def work() -> object:
        registered = subject.make().register(list(current_frames()))
        goal = subject.make().locate(goal_frame(), registered)
        return [frame.camera.T_world_camera for frame in (*registered, goal)]

    require_same_twice(work, "the poses")


def _require_kept(before: Frame, after: Any) -> None:
    require(isinstance(after, Frame), f"must return Frames, got {type(after).__name__}")
    require(after.index == before.index, f"frame {before.index} comes back as frame {after.index}")
    kept = same(before.rgb, after.rgb) and same(before.depth, after.depth) and same(before.camera.K, after.camera.K)
    require(kept, f"frame {before.index}: only the camera's pose may change")


CHECKS: tuple[Check, ...] = (
    frames_keep_all_but_their_pose,
    true_poses_stay,
    one_frame_is_enough,
    nothing_to_see_is_no_crash,
    the_same_input_gives_the_same_bytes,
)
