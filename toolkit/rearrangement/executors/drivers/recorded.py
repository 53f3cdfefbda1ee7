"""A robot that is not there: a recording of one that is played back, or one on which everything goes as told."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from toolkit.errors import ToolkitError
from toolkit.rearrangement.drivers import Driver, DriverError, Follow, Grip, JointState
from toolkit.rearrangement.trajectories import Part
from toolkit.types import Float, Frame

_SAME_RAD, _SAME_M = 0.01, 0.002


class Entry(Part):
    """What a robot was asked for, and how that ended: a line of a recording."""

    request: Follow | Grip
    state: JointState


class Recorder(Driver):
    """A driver that hands everything on to another, and writes down every request that came to its end.

    Args:
        driver: the robot.
        path: the recording, a JSON object per line.
    """

    def __init__(self, driver: Driver, path: Path) -> None:
        self._driver = driver
        self._path = path
        self._asked: Follow | Grip | None = None
        path.write_text("")

    def state(self) -> JointState | None:
        return self._driver.state()

    def follow(self, request: Follow) -> None:
        self._asked = request
        self._driver.follow(request)

    def grip(self, request: Grip) -> None:
        self._asked = request
        self._driver.grip(request)

    def advance(self) -> bool:
        goes_on = self._driver.advance()
        state = None if goes_on else self._driver.state()
        if state is not None and self._asked is not None:
            with self._path.open("a") as file:
                file.write(Entry(request=self._asked, state=state).model_dump_json() + "\n")
            self._asked = None
        return goes_on

    def picture(self) -> Frame:
        return self._driver.picture()

    def stop(self) -> None:
        self._asked = None
        self._driver.stop()


class Recorded(Driver):
    """Plays a recording back, or, without one, does what it is told: a dry run.

    Args:
        q: (J,) where the arm is at first.
        entries: of a recording, to be asked for again in their order; without any, every request ends as it should,
            and the gripper holds what it closes on.
        tick_s: the time that `advance` lets pass; a dry run waits for nothing.
        on_tick: called whenever time has passed, with the state.
        pictures: what the camera takes, one after the other.
    """

    def __init__(
        self,
        q: Float,
        entries: Iterable[Entry] | None = None,
        *,
        tick_s: float = 0.2,
        on_tick: Callable[[JointState], None] | None = None,
        pictures: Iterable[Frame] = (),
    ) -> None:
        self._state = JointState(positions=q, opening_m=0.0, holding=None)
        self._entries = None if entries is None else iter(entries)
        self._tick_s = tick_s
        self._on_tick = on_tick
        self._pictures = iter(pictures)
        self._doing: Iterator[JointState] = iter(())
        self.seconds = 0.0
        """On the robot's clock."""

    def state(self) -> JointState:
        return self._state

    def follow(self, request: Follow) -> None:
        self._doing = self._follow(request)

    def grip(self, request: Grip) -> None:
        told = JointState(positions=self._state.positions, opening_m=request.opening_m, holding=request.holds)
        self._doing = iter([self._end(request, told)])

    def advance(self) -> bool:
        state = next(self._doing, None)
        if state is None:
            return False
        self._state = state
        if self._on_tick is not None:
            self._on_tick(state)
        return True

    def picture(self) -> Frame:
        frame = next(self._pictures, None)
        if frame is None:
            raise DriverError("the recording holds no further picture")
        return frame

    def stop(self) -> None:
        self._doing = iter(())

    def _follow(self, request: Follow) -> Iterator[JointState]:
        trajectory = request.trajectory
        end = self._end(request, self._at(trajectory.end))
        times = np.arange(self._tick_s, trajectory.seconds, self._tick_s)
        for q in trajectory.at(times)[0]:
            self.seconds += self._tick_s
            yield self._at(q)
        self.seconds += trajectory.seconds - self._tick_s * len(times)
        yield end

    def _at(self, q: Float) -> JointState:
        return self._state.model_copy(update={"positions": q})

    def _end(self, request: Follow | Grip, told: JointState) -> JointState:
        """How a request ends: as it was recorded, or as told."""
        if self._entries is None:
            return told
        entry = next(self._entries, None)
        if entry is None:
            raise DriverError(f"{request.phase}: the recording ends before this")
        if not _same(entry.request, request):
            raise DriverError(f"{request.phase}: the recording has another request here, {entry.request.phase}")
        return entry.state


def read_recording(path: Path) -> list[Entry]:
    """Read what a Recorder wrote.

    Raises:
        ToolkitError: it is missing, or a line of it is damaged.
    """
    try:
        lines = path.read_text().splitlines()
    except OSError as error:
        raise ToolkitError(f"recording '{path}' cannot be read: {error.strerror or error}") from error
    entries: list[Entry] = []
    for number, line in enumerate(lines, 1):
        try:
            entries.append(Entry.model_validate_json(line))
        except ValidationError as error:
            raise ToolkitError(f"recording '{path}' is damaged in line {number}") from error
    return entries


def _same(recorded: Follow | Grip, asked: Follow | Grip) -> bool:
    if isinstance(recorded, Grip) and isinstance(asked, Grip):
        return recorded.holds == asked.holds and abs(recorded.opening_m - asked.opening_m) <= _SAME_M
    if isinstance(recorded, Follow) and isinstance(asked, Follow):
        return bool(np.abs(recorded.trajectory.end - asked.trajectory.end).max() <= _SAME_RAD)
    return False
