"""Films of rearrangements: the goal image beside the table as it changes, as MP4."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Protocol, runtime_checkable

import cv2
import numpy as np

from toolkit.errors import ToolkitError
from toolkit.types import Image

_FRAMES_PER_S = 25
_HELD_FRAMES = 2 * _FRAMES_PER_S
"""The end stays in the picture for two seconds."""

_CODEC = cv2.VideoWriter.fourcc(*"vp09")
"""VP9: free, and played by browsers; OpenCV's wheels carry no H.264 encoder."""


@runtime_checkable
class Filmable(Protocol):
    """An executor that can be filmed."""

    on_step: Callable[[], None] | None
    """Called at every step of a motion."""

    def snapshot(self) -> Image:
        """(H, W, 3) uint8 picture of the table now, from the home view."""
        ...

    def goal_picture(self) -> Image:
        """(H, W, 3) uint8 goal image of the task."""
        ...


class Film:
    """Films an executor for as long as the `with` block lasts.

    Args:
        executor: what to film.
        path: the MP4 file.
        every: steps of motion a frame.

    Raises:
        ToolkitError: the file cannot be written.
    """

    def __init__(self, executor: Filmable, path: Path, every: int = 3) -> None:
        self._executor = executor
        self._path = path
        self._every = every
        self._steps = 0
        self._writer: cv2.VideoWriter | None = None

    def __enter__(self) -> Film:
        self._executor.on_step = self._step
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.on_step = None
        if kind is None:
            self._shoot(_HELD_FRAMES)
        if self._writer is not None:
            self._writer.release()

    def _step(self) -> None:
        if self._steps % self._every == 0:
            self._shoot()
        self._steps += 1

    def _shoot(self, frames: int = 1) -> None:
        picture = np.hstack([self._executor.goal_picture(), self._executor.snapshot()])
        for text, x in (("goal", 0), ("now", picture.shape[1] // 2)):
            cv2.putText(picture, text, (x + 16, 32), cv2.FONT_HERSHEY_SIMPLEX, 0.9, (255, 255, 255), 2, cv2.LINE_AA)
        if self._writer is None:
            height, width = picture.shape[:2]
            self._writer = cv2.VideoWriter(str(self._path), _CODEC, _FRAMES_PER_S, (width, height))
            if not self._writer.isOpened():
                raise ToolkitError(f"film '{self._path}' cannot be written")
        for _ in range(frames):
            self._writer.write(np.ascontiguousarray(picture[..., ::-1]))
