"""What a planner does when every move succeeds."""

from __future__ import annotations

from toolkit.rearrangement.dependencies import lower_bound, screen
from toolkit.rearrangement.moves import Finished, Layout, Move, Plan
from toolkit.rearrangement.stages import Planner
from toolkit.types import Failure

MAX_MOVES = 1000


def rollout(planner: Planner, layout: Layout, seed: int) -> Plan:
    """Ask a planner for move after move and carry each out as meant.

    Every planner is measured against the same lower bound. One that has not finished after `MAX_MOVES` is stopped.
    """
    schedule = planner.start(seed)
    moves: list[Move] = []
    bound = lower_bound(screen(layout)[0])
    while True:
        step = schedule.next(layout)
        if isinstance(step, Finished):
            return Plan(tuple(moves), step.failures, bound)
        if len(moves) == MAX_MOVES:
            unfinished = [item.object for item in layout.items if item.wanted]
            failure = Failure("planner", f"not finished after {MAX_MOVES} moves")
            return Plan(tuple(moves), dict.fromkeys(unfinished, failure), bound)
        moves.append(step)
        layout = layout.after(step)
