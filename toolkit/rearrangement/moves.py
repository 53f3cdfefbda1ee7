"""What planners see and say: objects on the table with their goals, and moves. Metres, world coordinates."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from toolkit.geometry import invert, transform_points
from toolkit.rearrangement.footprints import Footprint, gaps, supports
from toolkit.types import ArmWorld, Failure, Float, Gripper


@dataclass(frozen=True, eq=False)
class Item:
    """An object on the table.

    Attributes:
        object: its id, unique in its layout.
        footprint: where it is now.
        T_goal_current: (4, 4) motion that takes it from here to its goal; None where that is not known.
        goal: its footprint there; None where that is not known.
        confidence: 0..1 of the motion.
        settled: it stands at its goal already.
        fixed: it cannot be moved.
    """

    object: int
    footprint: Footprint
    T_goal_current: Float | None = None
    goal: Footprint | None = None
    confidence: float = 1.0
    settled: bool = False
    fixed: bool = False

    @classmethod
    def seen(
        cls,
        object_id: int,
        points: Float,
        T_goal_current: Float | None,
        *,
        confidence: float = 1.0,
        settled: bool = False,
    ) -> Item:
        """An item from its (N, 3) points and its motion."""
        goal = None if T_goal_current is None else Footprint.of(transform_points(T_goal_current, points))
        return cls(object_id, Footprint.of(points), T_goal_current, goal, confidence, settled)

    @property
    def wanted(self) -> bool:
        """It is to be brought to a goal, and can be."""
        return self.goal is not None and not self.settled and not self.fixed

    def to_goal(self, reason: str = "its goal is free") -> Move:
        """The move to its goal, which must be known."""
        assert self.goal is not None and self.T_goal_current is not None
        return Move(self.object, self.T_goal_current, self.goal, "goal", reason)

    def after(self, move: Move) -> Item:
        """The item when `move` was carried out as meant."""
        T = None if self.T_goal_current is None else self.T_goal_current @ invert(move.T_place_pick)
        return replace(self, footprint=move.footprint, T_goal_current=T, settled=move.to == "goal")


@dataclass(frozen=True, eq=False)
class Layout:
    """What stands where on the table, and where it may stand.

    Attributes:
        items: the objects, ids unique.
        radius: of the disc that footprints must stay in.
        center: (x, y) of the disc.
        clearance: footprints closer than this collide.
    """

    items: tuple[Item, ...]
    radius: float = 0.5
    center: tuple[float, float] = (0.0, 0.0)
    clearance: float = 0.0

    def item(self, object_id: int) -> Item:
        """The item of one object."""
        return next(item for item in self.items if item.object == object_id)

    def with_item(self, changed: Item) -> Layout:
        """This layout with one item replaced by its namesake."""
        items = tuple(changed if item.object == changed.object else item for item in self.items)
        return replace(self, items=items)

    def after(self, move: Move) -> Layout:
        """The layout when `move` was carried out as meant."""
        return self.with_item(self.item(move.object).after(move))

    def in_the_way(self, footprint: Footprint, of: int) -> list[int]:
        """Objects other than `of` that `footprint` collides with where they stand now."""
        others = [item for item in self.items if item.object != of]
        distances = gaps(footprint.support, supports([item.footprint for item in others]))
        return [item.object for item, gap in zip(others, distances, strict=True) if gap < self.clearance]

    def holds(self, footprint: Footprint) -> bool:
        """Say whether a footprint lies on the table."""
        return footprint.reach(np.array(self.center)) <= self.radius


@dataclass(frozen=True, eq=False)
class Move:
    """One object picked up and put down.

    Attributes:
        object: the item's id.
        T_place_pick: (4, 4) motion from where it stands to where it is put.
        footprint: where it then stands.
        to: its goal, or a free place for the time being.
        reason: why this move, in a few words.
    """

    object: int
    T_place_pick: Float
    footprint: Footprint
    to: Literal["goal", "buffer"]
    reason: str


@dataclass(frozen=True, eq=False)
class PickPlace:
    """What an executor is asked to do.

    Attributes:
        points: (N, 3) seen points of the object where it stands, world coordinates.
        T_place_pick: (4, 4) motion from where it stands to where it is to be put.
        others: (M, 3) points of all that is elsewhere: what was seen, and space that nobody saw into.
        empty: (K, 3) points just below those of the object where it was seen not to be (`hidden.empty_below`).
    """

    points: Float
    T_place_pick: Float
    others: Float
    empty: Float = field(default_factory=lambda: np.zeros((0, 3)))

    def after(self, T: Float) -> PickPlace:
        """What is left to do when the object was moved by (4, 4) `T`."""
        points, empty = transform_points(T, self.points), transform_points(T, self.empty)
        return PickPlace(points, self.T_place_pick @ invert(T), self.others, empty)


@dataclass(frozen=True, eq=False)
class GraspRequest:
    """What a grasper is asked: where may this gripper take hold of an object?

    Attributes:
        points: (N, 3) seen points of the object where it stands, world coordinates.
        T_place_pick: (4, 4) motion from where it stands to where it is to be put.
        others: (M, 3) points of all that is elsewhere: what was seen, and space that nobody saw into.
        gripper: what takes hold.
        approach_m: straight way along which it comes to the object, and leaves it where it was put.
    """

    points: Float
    T_place_pick: Float
    others: Float
    gripper: Gripper
    approach_m: float

    @classmethod
    def of(cls, move: PickPlace, gripper: Gripper, approach_m: float) -> GraspRequest:
        """The grasp that a move needs."""
        return cls(move.points, move.T_place_pick, move.others, gripper, approach_m)


@dataclass(frozen=True, eq=False)
class Grasp:
    """A pose of a parallel gripper that holds an object.

    Attributes:
        T_world_gripper: (4, 4); origin between the fingertips, x from one finger to the other, z the way it approaches.
        opening: distance of the fingers before they close, metres.
        spare: room between each of them and the object then, metres.
        score: 0..1, higher is better.
    """

    T_world_gripper: Float
    opening: float
    spare: float
    score: float

    @property
    def closed(self) -> float:
        """Distance of the fingers when both touch the object, metres."""
        return max(self.opening - 2 * self.spare, 0.0)

    def placed(self, T_place_pick: Float) -> Float:
        """(4, 4) pose of the gripper where it lets go: the motion applied to the grasp (Sec. Method)."""
        return T_place_pick @ self.T_world_gripper


@dataclass(frozen=True, eq=False)
class MotionProblem:
    """From one pose of an arm to another.

    Attributes:
        start: (J,) joint angles, radians.
        goal: (J,) the same.
        lower: (J,) smallest angles.
        upper: (J,) largest angles.
        free: says of (J,) angles whether the arm, and what it carries, touches nothing there.
        world: the same as data: the arm and the shapes around it, for planners that check contacts themselves.
    """

    start: Float
    goal: Float
    lower: Float
    upper: Float
    free: Callable[[Float], bool]
    world: ArmWorld


@dataclass(frozen=True)
class Outcome:
    """What became of a PickPlace.

    Attributes:
        failure: why the object was not put where it should be; None where it was.
        object: instance id of the object that was taken, where the executor knows.
        seconds: how long the move took, on the robot's clock.
        T_moved: (4, 4) motion that the object has really had, by what the executor measured, whether or not that is
            what it was asked for; None where it was not measured: then it is what was asked for, and none where that
            failed.
        touched: robot or object touched something that the move was not meant to touch.
        picks: how often it was taken: twice where it stood aside in between, since no single grasp serves both places.
    """

    failure: Failure | None
    object: int | None = None
    seconds: float = 0.0
    T_moved: Float | None = field(default=None, compare=False)
    touched: bool = False
    picks: int = 1


@dataclass(frozen=True)
class Finished:
    """No move is left.

    Attributes:
        failures: by object, why it was not brought to its goal.
    """

    failures: Mapping[int, Failure] = field(default_factory=dict[int, Failure])


@dataclass(frozen=True, eq=False)
class Solution:
    """All moves of a planner whose moves all succeed.

    Attributes:
        moves: in order.
        failures: by object, why it is not brought to its goal.
    """

    moves: tuple[Move, ...]
    failures: Mapping[int, Failure]


@dataclass(frozen=True, eq=False)
class Plan(Solution):
    """A solution, and how good it can be.

    Attributes:
        lower_bound: no plan that brings the objects that have not failed to their goals has fewer moves.
    """

    lower_bound: int

    @property
    def proven_optimal(self) -> bool:
        """Every object gets to its goal in the fewest moves there can be."""
        return not self.failures and len(self.moves) == self.lower_bound

    @property
    def buffer_moves(self) -> int:
        """Moves that bring an object to a free place instead of its goal."""
        return sum(move.to == "buffer" for move in self.moves)
