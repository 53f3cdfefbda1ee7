"""poses.json: what is known of one capture, as a file. docs/poses.schema.json is this as JSON Schema."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from toolkit.errors import ToolkitError
from toolkit.files import read_json
from toolkit.types import Ambiguity, Float, Severity, Status

POSES = "poses.json"
SCHEMA = 2

_Row = Annotated[list[float], Field(min_length=4, max_length=4)]
Matrix = Annotated[list[_Row], Field(min_length=4, max_length=4)]
"""4x4 rigid transform, row by row, metres."""

Point = Annotated[list[float], Field(min_length=3, max_length=3)]
_SixNumbers = Annotated[list[float], Field(min_length=6, max_length=6)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


class GoalObject(_Part):
    """One object that the goal image shows."""

    goal_object: int
    """Its number, from 0."""
    bbox_xyxy: Annotated[list[int], Field(min_length=4, max_length=4)]
    """Its box in the goal image, pixels, the last ones inclusive."""
    mask: str
    """Picture of its mask in the goal image, beside this file."""
    instance: int | None
    """The instance of the current scene that it is taken for; null where it is none of them."""
    status: Status
    """Whether there is a motion; `abstained` where one was found and is not believed."""
    T_goal_current: Matrix | None
    """The motion, in world coordinates: x_goal = T_goal_current @ x_current."""
    confidence: Annotated[float, Field(ge=0, le=1)] | None
    """Probability that the motion is right within 5 deg and 2 cm; null where the pipeline gives none."""
    ambiguity: Ambiguity | None = None
    """Why several motions agree with the goal image: none do, they look the same, or what would tell is not in view."""
    covariance: Annotated[list[_SixNumbers], Field(min_length=6, max_length=6)] | None = None
    """Of (turn, shift) about the object's centre, rad^2 and m^2; rows of what was held fixed are 0."""
    equivalents: list[Matrix] | None = None
    """All motions that agree with the goal image, `T_goal_current` the first; null where that was not asked."""
    stage: str | None
    """The stage that could not answer."""
    reason: str | None
    """Why there is no motion."""
    time_ms: dict[str, float]
    """Milliseconds by stage."""


class Instance(_Part):
    """One object of the current scene, as all frames together show it; what no frame saw of it is not in its box."""

    instance: int
    """Its number, which goal objects refer to."""
    center: Point
    """Middle of its box, world coordinates, metres."""
    T_world_box: Matrix
    """Pose of its box: the origin its middle, z up from the table, x and y so that it covers least of the table."""
    size: Point
    """The box's size along its own x, y and z, metres."""
    footprint: Annotated[list[Point], Field(min_length=1)]
    """Convex outline of what it covers seen from above, at its lowest point, counter-clockwise, world coordinates."""
    model: str
    """Its fused model as a PLY of coloured points, in world coordinates and metres, beside this file."""


class Found(_Part):
    """Something about the capture that a person should know."""

    severity: Severity
    sentence: str
    cap: float
    """No confidence is higher than this."""
    frames: list[int]


class Poses(_Part):
    """What was estimated for one capture."""

    model_config = ConfigDict(title="poses.json", frozen=True, extra="forbid", use_attribute_docstrings=True)

    schema_: Literal[2] = Field(SCHEMA, alias="schema")
    capture: str
    """The capture folder's name."""
    objects: list[GoalObject]
    """One per object of the goal image."""
    instances: list[Instance]
    """One per object of the current scene."""
    not_in_goal: list[int]
    """Instances that were seen now only: no goal object is taken for them."""
    not_in_current: list[int]
    """Goal objects that were seen in the goal image only: they are taken for no instance."""
    findings: list[Found]
    """What was found wrong with the capture."""

    def instance(self, number: int | None) -> Instance | None:
        """An instance by its number; None without one, or where the file was written before it told of them."""
        return next((instance for instance in self.instances if instance.instance == number), None)


def matrix(rows: Matrix) -> Float:
    """(4, 4) float64."""
    return np.array(rows, np.float64)


def read_poses(path: Path) -> Poses:
    """Read poses.json of this schema, or of schema 1, which told nothing of instances.

    Raises:
        ToolkitError: it is missing, damaged, or of another schema.
    """
    data = read_json(path)
    schema = data.get("schema") if isinstance(data, dict) else None
    if schema not in (1, SCHEMA):
        raise ToolkitError(f"'{path}' is of schema {schema}; 1 and {SCHEMA} are read")
    try:
        return Poses.model_validate(data if schema == SCHEMA else _from_first(data))
    except (ValidationError, KeyError, TypeError) as error:
        where = ".".join(map(str, error.errors()[0]["loc"])) if isinstance(error, ValidationError) else str(error)
        raise ToolkitError(f"'{path}' is no poses.json of schema {schema}: see {where}") from error


def _from_first(data: dict[str, Any]) -> dict[str, Any]:
    unknown = [entry["goal_object"] for entry in data["objects"] if entry["instance"] is None]
    added: dict[str, Any] = {"instances": [], "not_in_goal": [], "not_in_current": unknown, "findings": []}
    return {**added, **data, "schema": SCHEMA}
