"""What is done with what clients send, one thing after another; and the last answer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, TypeVar

import numpy as np

from toolkit.data.bop import load_current, load_goal
from toolkit.errors import ToolkitError
from toolkit.harness.estimate import Answer
from toolkit.harness.session import Session
from toolkit.pictures.poses import write_poses
from toolkit.results.answer import rows, to_look_at, why_nothing
from toolkit.serving.uploads import unpack_current, write_goal
from toolkit.types import Capture, Frame

ResultT = TypeVar("ResultT")


class OutdatedError(ToolkitError):
    """A goal for a scene that is not the current one."""


@dataclass(frozen=True)
class Last:
    """The last answer.

    Attributes:
        title: which scene and goal it is about.
        files: what `toolkit estimate` writes (poses.json, overlay.png, masks/...), by name.
        rows: the motions in words (`toolkit.results.answer.COLUMNS`).
        doubts: what a person should look at.
    """

    title: str = "no goal yet"
    files: dict[str, bytes] = field(default_factory=dict[str, bytes])
    rows: tuple[tuple[str, ...], ...] = ()
    doubts: tuple[str, ...] = ()


class Desk:
    """A session with the scene that was sent last, and its last answer. One call at a time.

    Args:
        session: made ready.
        most_bytes: the largest upload.
    """

    def __init__(self, session: Session, most_bytes: int) -> None:
        self._session = session
        self._most_bytes = most_bytes
        self._frames: tuple[Frame, ...] = ()
        self._scene = self._goal = 0
        self.last = Last()

    def look(self, archive: BinaryIO) -> dict[str, Any]:
        """Take a zipped capture folder's current/ as the scene from now on.

        Returns:
            its number, the indices of the frames that are used, the number of instances, findings, and notes.

        Raises:
            RefusedError: the frames cannot be right; there is no scene then.
            ToolkitError: the zip, or what is in it, cannot be read.
        """
        self._frames = ()

        def read(folder: Path) -> tuple[tuple[Frame, ...], tuple[str, ...]]:
            unpack_current(archive, folder / "current", self._most_bytes)
            return load_current(folder / "current")

        frames, notes = _in_a_folder(read)
        database = self._session.database(frames)
        self._frames = frames
        self._scene += 1
        return {
            "scene": self._scene,
            "frames": [frame.index for frame in database.frames],
            "instances": len(np.unique(database.instances)),
            "findings": [asdict(finding) for finding in self._session.findings],
            "notes": notes,
        }

    def answer(self, picture: BinaryIO, camera: str, scene: int | None) -> bytes:
        """Estimate the motions of the scene towards a goal.

        Args:
            picture: an image file.
            camera: JSON, an entry of scene_camera.json.
            scene: the number of the scene that is meant; any where it is None.

        Returns:
            what poses.json holds.

        Raises:
            OutdatedError: there is no scene, or another one by now.
            RefusedError: the goal cannot be right.
            ToolkitError: the image or its camera cannot be read.
        """
        if not self._frames:
            raise OutdatedError("there is no scene yet: send the current frames to /database first")
        if scene not in (None, self._scene):
            raise OutdatedError(f"scene {scene} is not there any more: another client sent scene {self._scene}")

        def read(folder: Path) -> tuple[Frame, tuple[str, ...]]:
            write_goal(picture, camera, folder / "goal")
            return load_goal(folder / "goal")

        goal, notes = _in_a_folder(read)
        estimates = self._session.estimate(goal)
        self._goal += 1
        capture = Capture(f"scene {self._scene}, goal {self._goal}", self._frames, goal, None, "", notes=notes)
        seen = self._session.scene
        answer = Answer(estimates, seen.database, seen.clouds(), self._session.findings)
        self.last = Last(
            capture.name,
            _written(capture, answer),
            tuple(rows(estimates, answer.points())),
            tuple(_doubts(answer, notes)),
        )
        return self.last.files["poses.json"]


def _doubts(answer: Answer, notes: Sequence[str]) -> list[str]:
    doubts = [*notes, *to_look_at(answer.estimates, answer.missing(), answer.findings)]
    if all(estimate.T_goal_current is None for estimate in answer.estimates):
        doubts.append(why_nothing(answer.estimates, len(answer.database)))
    return doubts


def _written(capture: Capture, answer: Answer) -> dict[str, bytes]:
    def write(folder: Path) -> dict[str, bytes]:
        write_poses(folder, capture, answer.database, answer.clouds, answer.estimates, answer.findings)
        files = sorted(path for path in folder.rglob("*") if path.is_file())
        return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}

    return _in_a_folder(write)


def _in_a_folder(work: Callable[[Path], ResultT]) -> ResultT:
    """What `work` makes in a folder that is gone afterwards; its complaints do not name that."""
    with TemporaryDirectory(prefix="toolkit-") as folder:
        try:
            return work(Path(folder))
        except ToolkitError as error:
            raise ToolkitError(str(error).replace(f"{folder}/", "")) from error
