"""Recordings of an executor, and the executor that plays one back: tests and debugging without a robot."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field, TypeAdapter, ValidationError

from toolkit.data.bop import load_capture, write_capture
from toolkit.errors import ToolkitError
from toolkit.files import read_json, write_json
from toolkit.geometry import transform_points
from toolkit.rearrangement.moves import Outcome, PickPlace
from toolkit.rearrangement.stages import Executor
from toolkit.rearrangement.trajectories import Part, Row, Rows
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Failure, Float, Frame, TrueObject

_LOG = "moves.json"


def _of_shape(*shape: int) -> AfterValidator:
    def checked(array: Float) -> Float:
        if array.shape != shape:
            raise ValueError(f"its shape is {array.shape} instead of {shape}")
        return array

    return AfterValidator(checked)


_Motion = Annotated[Rows, _of_shape(4, 4)]


class _Move(Part):
    """What was asked for, and what became of it: an entry of moves.json. Older recordings lack what has a default."""

    pick: Annotated[Row, _of_shape(3)]
    T_place_pick: _Motion
    object: int | None
    seconds: float
    picks: int = 1
    T_moved: _Motion | None = None
    stage: str | None
    reason: str | None


class Recorder(Executor):
    """An executor that hands everything on to another and writes down what comes back.

    FOLDER/000000/, FOLDER/000001/, ... are captures, one per observation; moves.json lists what was asked and what
    became of it.

    Args:
        executor: does the work.
        folder: made when absent.
        truth: true objects by instance id at the start, where known; with it the captures hold masks.
    """

    def __init__(self, executor: Executor, folder: Path, truth: Mapping[int, TrueObject] | None = None) -> None:
        self._executor = executor
        self._folder = folder
        self._truth = truth
        self._observations = 0
        self._moves: list[_Move] = []

    def begin(self, task: Any) -> Frame:
        self._goal = self._executor.begin(task)
        self._folder.mkdir(parents=True, exist_ok=True)
        return self._goal

    def observe(self) -> list[Frame]:
        frames = self._executor.observe()
        truth = self._truth
        state = self._executor.state()
        if truth is not None and state is not None:
            truth = {i: TrueObject(o.model, state[i], o.T_world_goal, i) for i, o in truth.items()}
        write_capture(self._folder / f"{self._observations:06d}", frames, self._goal, truth)
        self._observations += 1
        return frames

    def pick_place(self, request: PickPlace) -> Outcome:
        outcome = self._executor.pick_place(request)
        failure = outcome.failure
        self._moves.append(
            _Move(
                pick=request.points.mean(axis=0),
                T_place_pick=request.T_place_pick,
                object=outcome.object,
                seconds=outcome.seconds,
                picks=outcome.picks,
                T_moved=outcome.T_moved,
                stage=failure.stage if failure else None,
                reason=failure.reason if failure else None,
            )
        )
        write_json(self._folder / _LOG, [move.model_dump(mode="json") for move in self._moves])
        return outcome

    def home(self) -> None:
        self._executor.home()

    def state(self) -> Mapping[int, Float] | None:
        return self._executor.state()

    def close(self) -> None:
        self._executor.close()


class ReplayConfig(PluginConfig):
    """Settings of `replay`."""

    folder: Path = Field(Path("recording"), description="What a Recorder wrote.")
    tolerance_m: float = Field(0.005, gt=0, description="A move this near to the recorded one is the same.")


class Replay(Plugin[ReplayConfig], Executor):
    """Plays a recording back: the recorded frames in order, and the recorded outcomes for the recorded moves."""

    stage = "executor"
    name = "replay"

    def check_ready(self) -> None:
        if not (self.config.folder / "000000").is_dir():
            raise ToolkitError(f"'{self.config.folder}' is no recording: it has no observation 000000")

    def begin(self, task: Any) -> Frame:
        """Start at the recording's first observation and return its goal image; `task` is not used."""
        self.check_ready()
        self._captures = sorted(path for path in self.config.folder.iterdir() if path.is_dir())
        self._moves = _read_moves(self.config.folder / _LOG)
        self._seen = 0
        return load_capture(self._captures[0]).goal

    def observe(self) -> list[Frame]:
        """Return the frames of the recording's next observation.

        Raises:
            ToolkitError: the recording has no further observation.
        """
        if self._seen == len(self._captures):
            raise ToolkitError(f"'{self.config.folder}' holds {self._seen} observations, one more is asked for")
        self._seen += 1
        return list(load_capture(self._captures[self._seen - 1]).current)

    def pick_place(self, request: PickPlace) -> Outcome:
        """Return the recorded outcome of the next move; a failure where the recording has another move, or none."""
        if not self._moves:
            return Outcome(Failure("executor", "the recording has no further move"))
        move = self._moves.pop(0)
        wanted, recorded = (transform_points(T, move.pick) for T in (request.T_place_pick, move.T_place_pick))
        off = max(np.linalg.norm(request.points.mean(axis=0) - move.pick), np.linalg.norm(wanted - recorded))
        if off > self.config.tolerance_m:
            return Outcome(Failure("executor", f"the recorded move lies {100 * off:.1f} cm from the one asked for"))
        failure = None if move.stage is None else Failure(move.stage, move.reason or "")
        return Outcome(failure, move.object, move.seconds, move.T_moved, picks=move.picks)

    def home(self) -> None:
        """Do nothing: the recorded frames were taken without a robot in sight."""

    def state(self) -> None:
        """Return None: a recording does not know where objects truly are."""

    def close(self) -> None:
        """Let go of the task: nothing, since no file stays open between observations."""


def _read_moves(path: Path) -> list[_Move]:
    if not path.exists():
        return []
    try:
        return TypeAdapter(list[_Move]).validate_python(read_json(path))
    except ValidationError as error:
        first = error.errors()[0]
        where = "".join(f"{part}: " for part in first["loc"])
        raise ToolkitError(f"'{path}' is no list of recorded moves: {where}{first['msg']}") from error
