"""The fewest moves: dependencies, cycles broken by a minimum feedback vertex set, the shortest order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from toolkit.rearrangement.dependencies import Dependencies, dependencies, screen
from toolkit.rearrangement.feedback import feedback_vertex_set
from toolkit.rearrangement.footprints import Footprint, gaps, supports
from toolkit.rearrangement.moves import Layout, Move, Plan
from toolkit.rearrangement.planners.arrangements.growth import solved
from toolkit.rearrangement.planners.arrangements.lazy import fewest_buffers
from toolkit.rearrangement.planners.arrangements.table import Step, Table
from toolkit.rearrangement.planners.ordering.buffers import nearest_spot
from toolkit.rearrangement.planners.ordering.order import shortest_order

_PLANS = 100
"""Of each search where space is tight."""


def plan(layout: Layout) -> Plan:
    """Plan all moves.

    Every wanted item moves once, items that stand in a goal without having one of their own move aside, and of every
    cycle of dependencies the fewest items wait at a free place. Where there is no place that keeps clear of everything,
    one is looked for that is free for as long as it is needed; where there is none of these either, more items wait.
    """
    layout, failures = screen(layout)
    graph = dependencies(layout)
    found = feedback_vertex_set(graph.in_cycles)
    bound = graph.moves(found.lower_bound)
    waiting = (*found.vertices, *graph.evicted)
    moves = _with_room(layout, graph, waiting)
    if moves is None:

        def search(table: Table, rng: np.random.Generator) -> list[Step]:
            return fewest_buffers(table, sum(1 << i for i in waiting), rng, _PLANS)

        tight = solved(layout, search, 0, "there is no free place on the table for what must stand aside")
        moves, failures = tight.moves, {**failures, **tight.failures}
    return Plan(reordered(layout, moves), failures, bound)


def reordered(layout: Layout, moves: Sequence[Move]) -> tuple[Move, ...]:
    """The same moves in the order in which the empty hand travels least.

    What leaves a place still leaves it before another item reaches into it, and an item's own moves keep their order.
    """
    starts: list[Footprint] = []
    before = [0] * len(moves)
    for k, move in enumerate(moves):
        touched = gaps(supports(starts), move.footprint.support) < layout.clearance
        before[k] = sum(1 << j for j in range(k) if touched[j] or moves[j].object == move.object)
        starts.append(layout.item(move.object).footprint)
        layout = layout.after(move)
    picks = np.array([start.center for start in starts]).reshape(-1, 2)
    places = np.array([move.footprint.center for move in moves]).reshape(-1, 2)
    return tuple(moves[k] for k in shortest_order(picks, places, before))


def _with_room(layout: Layout, graph: Dependencies, waiting: Sequence[int]) -> list[Move] | None:
    """Moves in some order; None where a waiting item has no place that keeps clear of everything."""
    taken = [item.footprint for item in layout.items]
    taken += [item.goal for item in layout.items if item.goal is not None]
    moves: list[Move] = []
    gone = 0
    for i in waiting:
        spot = nearest_spot(layout.items[i], layout, taken, _why(i, layout, graph))
        if spot is None:
            return None
        taken.append(spot.footprint)
        moves.append(spot)
        gone |= 1 << i
        layout = layout.after(spot)
    left = list(graph.wanted)
    while left:
        i = next(i for i in left if not graph.leave_first[i] & ~gone)
        left.remove(i)
        moves.append(layout.items[i].to_goal())
        gone |= 1 << i
    return moves


def _why(position: int, layout: Layout, graph: Dependencies) -> str:
    blocked = [layout.items[i].object for i in graph.wanted if graph.leave_first[i] >> position & 1]
    return f"it stands in the goal of object {', '.join(map(str, blocked))}"
