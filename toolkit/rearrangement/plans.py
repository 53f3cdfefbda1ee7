"""What an arm does to move objects, before it does it: a way per move, and plan.json. SI units, world coordinates."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, ValidationError

from toolkit.errors import ToolkitError
from toolkit.files import read_json, write_text
from toolkit.rearrangement.trajectories import Limits, Part, Row, Rows, Trajectory

PLAN = "plan.json"
SCHEMA = 1


class Way(Part):
    """Everything an arm does to move one object."""

    T_world_gripper: Rows
    """(4, 4) the grasp: origin between the fingertips, x from one finger to the other, z the way they approach."""
    opening_m: float
    """Distance of the fingers as they come, and as they leave."""
    closed_m: float
    """Distance of the fingers when both touch the object."""
    to_grasp: Trajectory
    """A free path to above the grasp."""
    approach: Trajectory
    """Along the gripper's axis; then the gripper closes."""
    lift: Trajectory
    """Straight up."""
    transfer: Trajectory
    """A free path with the object."""
    lower: Trajectory
    """Straight down; then the gripper opens."""
    retreat: Trajectory
    """Back along the gripper's axis."""

    @property
    def seconds(self) -> float:
        """How long its motions take, without the gripper's."""
        parts = (self.to_grasp, self.approach, self.lift, self.transfer, self.lower, self.retreat)
        return sum(part.seconds for part in parts)


class PlannedMove(Part):
    """One object picked up and put down."""

    object: int
    """The instance of the current scene, as poses.json counts them."""
    goal_object: int | None
    """The object of the goal image that it is taken for."""
    to: Literal["goal", "buffer"]
    """Its goal, or a free place for the time being."""
    reason: str
    """Why this move, in a few words."""
    confidence: float | None
    """Probability that the motion to its goal is right; null where the pipeline gives none."""
    T_place_pick: Rows
    """(4, 4) motion from where it stands to where it is put."""
    way: Way


class Unplanned(Part):
    """An object that is not brought to its goal."""

    object: int | None
    """The instance; null where none is known."""
    goal_object: int | None
    """The object of the goal image; null where it is none of them."""
    stage: str
    """What could not answer."""
    sentence: str
    """Why, in plain words."""


class PlannedRobot(Part):
    """Whom the plan is for."""

    name: str
    joints: tuple[str, ...]
    """Names of the joints, in the order of every trajectory."""
    home: Row
    """(J,) joint angles that the plan starts from and ends at."""
    limits: Limits
    opens_m: float
    """How far its gripper opens."""
    T_world_base: Rows
    """(4, 4) where it stands in the capture's world."""


class ArmPlan(Part):
    """What an arm does to set a table right."""

    schema_: Literal[1] = Field(SCHEMA, alias="schema")
    capture: str
    """The capture folder's name."""
    robot: PlannedRobot
    moves: tuple[PlannedMove, ...]
    """In order; every motion starts where the one before it ends."""
    to_home: Trajectory | None
    """Back home; null where no free path was found."""
    not_planned: tuple[Unplanned, ...]
    """One per object that is not brought to its goal."""

    @property
    def seconds(self) -> float:
        """How long all motions take, without the gripper's."""
        return sum(move.way.seconds for move in self.moves) + (self.to_home.seconds if self.to_home else 0.0)

    def in_words(self) -> list[str]:
        """What is done and what is not, a line each."""
        where = {"goal": "its goal", "buffer": "a free place for the time being"}
        done = [
            f"{number}. {_called(move)} to {where[move.to]}, {move.way.seconds:.0f} s: {move.reason}"
            for number, move in enumerate(self.moves, 1)
        ]
        return [*done, *(f"not moved: {_called(one)}: {one.sentence}" for one in self.not_planned)]

    def write(self, path: Path) -> None:
        """Write it as JSON."""
        write_text(path, self.model_dump_json(by_alias=True) + "\n")


def _called(one: PlannedMove | Unplanned) -> str:
    """An object by the numbers that poses.json and the overlay give it."""
    instance = "" if one.object is None else f"instance #{one.object}"
    return instance if one.goal_object is None else f"object {one.goal_object}" + (f" ({instance})" if instance else "")


def read_plan(path: Path) -> ArmPlan:
    """Read plan.json.

    Raises:
        ToolkitError: it is missing, damaged, or of another schema.
    """
    data = read_json(path)
    schema = data.get("schema") if isinstance(data, dict) else None
    if schema != SCHEMA:
        raise ToolkitError(f"'{path}' is of schema {schema}; {SCHEMA} is read: plan anew with `toolkit plan`")
    try:
        return ArmPlan.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise ToolkitError(f"'{path}' is no plan: {where}: {first['msg']}") from error
