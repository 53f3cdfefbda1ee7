"""What a planner does when every move succeeds."""

from __future__ import annotations

from toolkit.rearrangement.dependencies import lower_bound, screen
from toolkit.rearrangement.moves import Finished, Move, Plan, Table
from toolkit.rearrangement.stages import Planner
from toolkit.types import Failure

MAX_MOVES = 1000


def rollout(planner: Planner, table: Table, seed: int) -> Plan:
    """Ask a planner for move after move and carry each out as meant.

    Every planner is measured against the same lower bound. One that has not finished after `MAX_MOVES` is stopped.
    """
    schedule = planner.start(seed)
    moves: list[Move] = []
    bound = lower_bound(screen(table)[0])
    while True:
        step = schedule.next(table)
        if isinstance(step, Finished):
            return Plan(tuple(moves), step.failures, bound)
        if len(moves) == MAX_MOVES:
            unfinished = [item.object for item in table.items if item.wanted]
            failure = Failure("planner", f"not finished after {MAX_MOVES} moves")
            return Plan(tuple(moves), dict.fromkeys(unfinished, failure), bound)
        moves.append(step)
        table = table.after(step)
