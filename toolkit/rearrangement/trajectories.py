"""Paths of an arm with times. Radians, seconds."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, PlainSerializer, WithJsonSchema, model_validator
from scipy.interpolate import CubicHermiteSpline

from toolkit.types import Float

_DIGITS = 9
"""Decimals in files: a billionth of a radian, or of a metre."""


def _numbers(value: object) -> Float:
    try:
        array = np.array(value, np.float64)
    except TypeError as error:
        raise ValueError("numbers are wanted") from error
    if not np.isfinite(array).all():
        raise ValueError("every number must be finite")
    array.setflags(write=False)
    return array


def _array(numbers: int) -> WithJsonSchema:
    schema: dict[str, object] = {"type": "number"}
    for _ in range(numbers):
        schema = {"type": "array", "items": schema}
    return WithJsonSchema(schema)


_Read, _Written = BeforeValidator(_numbers), PlainSerializer(lambda array: np.round(array, _DIGITS).tolist())
Row = Annotated[Float, _Read, _Written, _array(1)]
"""(N,) float64; in files a list."""

Rows = Annotated[Float, _Read, _Written, _array(2)]
"""(N, M) float64; in files a list of rows."""


class Part(BaseModel):
    """A part of what is written down: frozen, and nothing else may stand in it."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", arbitrary_types_allowed=True, use_attribute_docstrings=True, allow_inf_nan=False
    )


class Limits(Part):
    """What a robot is not to exceed, whoever asks."""

    speed: float
    """Largest speed of a joint, rad/s."""
    acceleration: float
    """Largest acceleration of a joint, rad/s^2."""
    effort: float
    """Largest force (N) or torque (Nm) of a joint of the gripper that is driven."""
    late_s: float = 0.2
    """A state of the robot that is older than this is none to move by."""


class Trajectory(Part):
    """Where an arm's joints are at what time, and how fast: from rest to rest, cubic between its points."""

    times: Row
    """(N,) seconds from the start, the first of them 0."""
    positions: Rows
    """(N, J) joint angles, radians."""
    velocities: Rows
    """(N, J) radians per second."""

    @model_validator(mode="after")
    def _fits(self) -> Trajectory:
        shape = self.positions.shape
        if len(shape) != 2 or self.velocities.shape != shape or self.times.shape != shape[:1]:
            raise ValueError("a trajectory needs as many positions and velocities as times")
        if not len(self.times) or self.times[0] != 0 or (np.diff(self.times) <= 0).any():
            raise ValueError("a trajectory's times must begin with 0 and increase")
        return self

    @property
    def seconds(self) -> float:
        """How long it takes."""
        return float(self.times[-1])

    @property
    def start(self) -> Float:
        """(J,) where it begins."""
        return self.positions[0]

    @property
    def end(self) -> Float:
        """(J,) where it ends."""
        return self.positions[-1]

    @classmethod
    def resting(cls, q: Float) -> Trajectory:
        """Staying at (J,) angles, for no time."""
        return cls(times=np.zeros(1), positions=q[None], velocities=np.zeros((1, len(q))))

    @cached_property
    def _spline(self) -> CubicHermiteSpline:
        return CubicHermiteSpline(self.times, self.positions, self.velocities)

    def at(self, seconds: Float) -> tuple[Float, Float]:
        """(T, J) angles and (T, J) speeds at (T,) times; before and after it the arm rests."""
        if len(self.times) == 1:
            rest = np.repeat(self.positions, len(seconds), axis=0)
            return rest, np.zeros_like(rest)
        inside = np.clip(seconds, 0, self.seconds)
        return self._spline(inside), self._spline(inside, 1)

    def reversed(self) -> Trajectory:
        """The same way back."""
        times = self.times[-1] - self.times[::-1]
        return Trajectory(times=times, positions=self.positions[::-1], velocities=-self.velocities[::-1])

    def from_where(self, q: Float, limits: Limits) -> Trajectory:
        """Begun at (J,) angles that are not quite its own: a cubic from rest to rest leads to its start."""
        away = float(np.abs(self.start - q).max())
        if away < 1e-6:
            return self
        # A cubic from rest to rest is fastest in its middle, and hardest on the motors at its ends.
        lead = max(1.5 * away / limits.speed, float(np.sqrt(6 * away / limits.acceleration)))
        return Trajectory(
            times=np.concatenate([[0.0], self.times + lead]),
            positions=np.concatenate([q[None], self.positions]),
            velocities=np.concatenate([np.zeros((1, len(q))), self.velocities]),
        )

    def too_fast(self, limits: Limits) -> bool:
        """Say whether a joint is faster than the limits allow, at a point or between two."""
        between = np.diff(self.positions, axis=0) / np.diff(self.times)[:, None]
        fastest = max(np.abs(self.velocities).max(initial=0), np.abs(between).max(initial=0))
        return bool(fastest > 1.02 * limits.speed)  # sampled splines exceed what they were timed with by a thousandth
