"""What every planner must do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from toolkit.geometry import is_rigid, make_transform
from toolkit.plugin_kit.conformance.kit import Check, Subject, require, require_same_twice
from toolkit.rearrangement.moves import Finished, Item, Layout, Move
from toolkit.types import Failure

_BOX = 0.04 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
_MOST_MOVES = 200


def a_swap_is_solved_without_a_collision(subject: Subject) -> str:
    """Two boxes change places: every move is free where it ends, stays on the table, and all get to their goals."""
    layout = Layout((_box(0, (0, 0), (0.2, 0)), _box(1, (0.2, 0), (0, 0)), _box(2, (-0.3, 0), (-0.3, 0.2))))
    moves, finished, end = _carry_out(subject, layout)
    require(not finished.failures, f"a swap is given up: {list(finished.failures.values())[:1]}")
    require(all(item.settled for item in end.items), "it finishes before all objects are at their goals")
    return f"{len(moves)} moves, 4 are enough"


def an_empty_table_is_finished(subject: Subject) -> None:
    """Nothing to move: Finished at once, without a failure."""
    settled = _box(0, (0, 0), (0, 0), settled=True)
    for layout in (Layout(()), Layout((settled,))):
        step = subject.make().start(0).next(layout)
        require(isinstance(step, Finished) and not step.failures, f"a finished layout gives {step}")


def a_goal_that_cannot_be_reached_is_named(subject: Subject) -> None:
    """A goal under an object that cannot be moved: a failure names the object, and the rest goes on."""
    items = (_box(0, (0, 0), (0.2, 0)), _box(1, (0.2, 0), fixed=True), _box(9, (0, -0.3), (0.1, -0.3)))
    moves, finished, _ = _carry_out(subject, Layout(items))
    failure = finished.failures.get(0)
    require(failure is not None, "no failure names an object whose goal is taken for good")
    require(isinstance(failure, Failure) and failure.reason, "its failure must be a Failure with a reason")
    require(9 in {move.object for move in moves}, "an object that can be moved is left where it is")


def fixed_and_settled_objects_are_left_alone(subject: Subject) -> None:
    """They are never picked."""
    items = (_box(0, (0, 0), (0, 0), settled=True), _box(1, (-0.2, 0), fixed=True), _box(2, (0.3, 0), (0.15, 0.2)))
    moves, _, _ = _carry_out(subject, Layout(items))
    require({move.object for move in moves} <= {2}, "it moves an object that is fixed or already at its goal")


def the_same_seed_gives_the_same_bytes(subject: Subject) -> None:
    """New instances agree, whatever the global random generators are at."""
    layout = Layout((_box(0, (0, 0), (0.2, 0)), _box(1, (0.2, 0), (0, 0)), _box(2, (-0.3, 0), (0.1, 0.2))))
    require_same_twice(lambda: [(m.object, m.T_place_pick) for m in _carry_out(subject, layout)[0]], "the plan")


def _box(
    object_id: int,
    here: tuple[float, float],
    there: tuple[float, float] | None = None,
    *,
    settled: bool = False,
    fixed: bool = False,
) -> Item:
    """An 8 cm box at `here` that is to go to `there`."""
    motion = None if there is None else make_transform(np.eye(3), np.array([*np.subtract(there, here), 0.0]))
    return replace(Item.seen(object_id, _BOX + np.array([*here, 0.0]), motion, settled=settled), fixed=fixed)


def _carry_out(subject: Subject, layout: Layout) -> tuple[list[Move], Finished, Layout]:
    """All moves of one rearrangement, each checked where it happens and then carried out as meant."""
    schedule, moves = subject.make().start(0), list[Move]()
    while True:
        step = schedule.next(layout)
        if isinstance(step, Finished):
            return moves, step, layout
        require(isinstance(step, Move), f"next() must give Move or Finished, got {type(step).__name__}")
        require(len(moves) < _MOST_MOVES, f"not finished after {_MOST_MOVES} moves of {len(layout.items)} objects")
        require(is_rigid(step.T_place_pick), "T_place_pick must be a rigid (4, 4) transform, metres")
        require(step.object in {item.object for item in layout.items}, f"object {step.object} is not on the table")
        hit = layout.in_the_way(step.footprint, of=step.object)
        require(not hit, f"move {len(moves)} puts object {step.object} onto object {hit}")
        require(layout.holds(step.footprint), f"move {len(moves)} puts object {step.object} beyond the table")
        moves.append(step)
        layout = layout.after(step)


CHECKS: tuple[Check, ...] = (
    a_swap_is_solved_without_a_collision,
    an_empty_table_is_finished,
    a_goal_that_cannot_be_reached_is_named,
    fixed_and_settled_objects_are_left_alone,
    the_same_seed_gives_the_same_bytes,
)
