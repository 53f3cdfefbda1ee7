"""Chosen images of a recording -> a capture folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from toolkit.data.bop import write_capture
from toolkit.data.importing.choosing import Frames, find
from toolkit.data.importing.folders import picture
from toolkit.data.importing.recording import Recording
from toolkit.errors import ToolkitError
from toolkit.files import writing
from toolkit.types import Frame, Placed, TrueObject


@dataclass(frozen=True)
class Goal:
    """Which picture is the goal.

    Attributes:
        image: name or number of an image, or a picture file of its own.
        recording: the one that shows the goal scene; None where it is that of the current frames.
        camera: for a picture file: the image whose camera took it, from the same place.
    """

    image: str
    recording: Recording | None = None
    camera: str | None = None


def import_capture(recording: Recording, out: Path, goal: Goal, frames: Frames) -> tuple[str, ...]:
    """Write a capture of chosen images; the true objects too, where the recording has them.

    Args:
        recording: of the current scene.
        out: the capture folder, which must not be there.
        goal: the goal image.
        frames: the current frames.

    Returns:
        What was left out, in sentences.

    Raises:
        ToolkitError: an image is not found or cannot be read, or `out` is there already.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise ToolkitError(f"'{out}' is there already; name a new folder")
    of_goal = goal.recording or recording
    own = goal.camera is not None
    if not own and Path(goal.image).is_file():
        raise ToolkitError(
            f"the picture '{goal.image}' has no pose of its own; --goal-camera names the image that was taken from "
            "the same place by the same camera"
        )
    shot = find(of_goal, goal.camera if goal.camera is not None else goal.image)
    chosen = frames.choose(recording, None if own else shot)
    loaded = recording.load(chosen)
    (target,) = of_goal.load([shot])
    if own:
        rgb = picture(Path(goal.image), (target.camera.height, target.camera.width))
        target = Frame(target.index, rgb, target.camera)
    now = None if recording.placed is None else recording.placed(chosen[0])
    then = None if of_goal.placed is None or own else of_goal.placed(shot)
    notes = tuple(dict.fromkeys((*recording.notes, *of_goal.notes)))
    if now is None or then is None:
        bare = [replace(frame, true_masks=None) for frame in loaded]
        with writing(f"'{out}'"):
            write_capture(out, bare, replace(target, true_masks=None))
        return notes
    both = {
        i: TrueObject(now[i].model, now[i].T_world_model, then[i].T_world_model, i) for i in now.keys() & then.keys()
    }
    with writing(f"'{out}'"):
        write_capture(out, loaded, target, dict(sorted(both.items())), _without(now, both), _without(then, both))
    return notes


def _without(placed: Mapping[int, Placed], both: Mapping[int, TrueObject]) -> dict[int, Placed]:
    return {instance: placed[instance] for instance in sorted(placed.keys() - both.keys())}
