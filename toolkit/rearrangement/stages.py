"""The rearrangement module's stages (Sec. Method B): a Protocol and a Registry for each."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, Protocol

from toolkit.rearrangement.moves import (
    Finished,
    Grasp,
    GraspRequest,
    Layout,
    MotionProblem,
    Move,
    Outcome,
    PickPlace,
)
from toolkit.registry import Registry
from toolkit.types import Failure, Float, Frame


class Schedule(Protocol):
    """The moves of one rearrangement, decided one at a time."""

    @abstractmethod
    def next(self, layout: Layout) -> Move | Finished:
        """Return the next move from where things stand now, as they are seen or believed after the last move.

        Args:
            layout: the same objects, in the same order, at every call.
        """
        ...


class Planner(Protocol):
    """Decides which object is moved where, and when (Sec. Method B)."""

    @abstractmethod
    def start(self, seed: int) -> Schedule:
        """Begin a rearrangement. The same layouts and seed give the same moves."""
        ...


class Grasper(Protocol):
    """Finds grasps on an object of which only points are known (Sec. Method B)."""

    @abstractmethod
    def grasp(self, request: GraspRequest, seed: int) -> list[Grasp] | Failure:
        """Return grasps that touch nothing else, neither here nor where the object is put; best first.

        A Failure says why there is none. The same request and seed give the same grasps, none of which opens wider
        than the request's gripper.
        """
        ...


class MotionPlanner(Protocol):
    """Finds paths of an arm that touch nothing (Sec. Method B)."""

    @abstractmethod
    def plan(self, problem: MotionProblem, seed: int) -> Float | Failure:
        """Return the (N, J) joint angles of a path, from start to goal, straight between its points.

        A Failure says why there is none. Every search ends, after a number of steps and not after a time: the same
        problem and seed give the same answer on any machine.
        """
        ...


class Executor(Protocol):
    """Moves objects and looks at the table: a simulator, a robot, or a recording.

    Hardware implements the same six methods: `observe` drives a wrist camera to the predefined views, `pick_place`
    grasps the object whose points it is given, and what goes wrong comes back as an `Outcome`.
    """

    @abstractmethod
    def begin(self, task: Any) -> Frame:
        """Take up a task and return its goal image. Where it raises, it has let go of everything again.

        Args:
            task: for simulators a `toolkit.data.tabletop.TabletopScene`, whose objects they put on their table;
                others may ignore it.
        """
        ...

    @abstractmethod
    def observe(self) -> list[Frame]:
        """Return RGB-D frames of the table as it is, from the predefined views, the home view first."""
        ...

    @abstractmethod
    def pick_place(self, request: PickPlace) -> Outcome:
        """Pick one object up and put it down elsewhere. A failure is an Outcome, never an exception."""
        ...

    @abstractmethod
    def home(self) -> None:
        """Move out of the cameras' sight."""
        ...

    @abstractmethod
    def state(self) -> Mapping[int, Float] | None:
        """Return the true (4, 4) model-to-world poses by instance id where they are known; else None."""
        ...

    @abstractmethod
    def close(self) -> None:
        """Let go of the task that was begun."""
        ...


PLANNERS: Registry[Planner] = Registry(
    "planner",
    "toolkit.planners",
    {
        "paper": "toolkit.rearrangement.planners.paper:Paper",
        "optimal": "toolkit.rearrangement.planners.optimal:Optimal",
        "monotone": "toolkit.rearrangement.planners.monotone:Monotone",
        "mcts": "toolkit.rearrangement.planners.mcts:Mcts",
        "trlb": "toolkit.rearrangement.planners.trlb:Trlb",
    },
)
GRASPERS: Registry[Grasper] = Registry(
    "grasp",
    "toolkit.grasps",
    {
        "antipodal": "toolkit.rearrangement.grasps.antipodal:Antipodal",
        "contact_graspnet": "toolkit.rearrangement.grasps.contact_graspnet:ContactGraspnet",
    },
)
MOTION_PLANNERS: Registry[MotionPlanner] = Registry(
    "motion",
    "toolkit.motion",
    {
        "roboplan": "toolkit.rearrangement.motion.roboplan:Roboplan",
        "ompl": "toolkit.rearrangement.motion.ompl:Ompl",
    },
)
EXECUTORS: Registry[Executor] = Registry(
    "executor",
    "toolkit.executors",
    {
        "arm": "toolkit.rearrangement.executors.arm:Arm",
        "kinematic": "toolkit.rearrangement.executors.kinematic:Kinematic",
        "replay": "toolkit.rearrangement.executors.replay:Replay",
    },
)
