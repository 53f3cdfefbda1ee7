"""The fewest moves: dependencies, cycles broken by a minimum feedback vertex set, the shortest order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from toolkit.rearrangement.dependencies import Dependencies, dependencies, lower_bound, screen
from toolkit.rearrangement.feedback import feedback_vertex_set
from toolkit.rearrangement.footprints import Footprint
from toolkit.rearrangement.moves import Item, Layout, Move, Plan
from toolkit.rearrangement.planners.ordering.buffers import nearest_spot
from toolkit.rearrangement.planners.ordering.order import shortest_order
from toolkit.types import Failure


def plan(layout: Layout) -> Plan:
    """Plan all moves.

    Every wanted item moves once, items that stand in a goal without having one of their own move aside, and of every
    cycle of dependencies the fewest items wait at a free place.
    """
    layout, failures = screen(layout)
    bound = lower_bound(layout)
    kept = 0
    while True:
        graph = dependencies(layout)
        found = feedback_vertex_set(graph.in_cycles, kept)
        if found is None:
            stuck = [layout.items[i] for i in graph.wanted if kept >> i & 1]
            layout, failures = _give_up(stuck[0], layout, failures)
            kept = 0
            continue
        waiting = (*found.vertices, *graph.evicted)
        moves = _moves(layout, graph, waiting)
        if isinstance(moves, int):
            if moves in graph.evicted:
                layout, failures = _give_up(layout.items[moves], layout, failures)
            else:
                kept |= 1 << moves
            continue
        return Plan(moves, failures, bound)


def _give_up(item: Item, layout: Layout, failures: dict[int, Failure]) -> tuple[Layout, dict[int, Failure]]:
    """Leave an item for which there is no free place where it stands, and what needs it gone with it."""
    layout, more = screen(layout.with_item(replace(item, fixed=True)))
    own = Failure("planner", "there is no free place on the table for it to stand aside")
    kept = {key: failure for key, failure in more.items() if key != item.object}
    return layout, {**failures, **kept, item.object: own}


@dataclass(frozen=True)
class _Step:
    """A move before its place is known: position of the item, and whether it goes to its goal or stands aside."""

    item: int
    to_goal: bool


def _moves(layout: Layout, graph: Dependencies, waiting: Sequence[int]) -> tuple[Move, ...] | int:
    """The moves in order; or the position of a waiting item that has no free place."""
    steps = [_Step(i, False) for i in waiting] + [_Step(i, True) for i in graph.wanted]
    before = _precedence(steps, graph)
    everywhere = [item.footprint for item in layout.items]
    everywhere += [item.goal for item in layout.items if item.goal is not None]
    spots: dict[int, Move] = {}
    for i in waiting:
        taken = everywhere + [spot.footprint for spot in spots.values()]
        spot = nearest_spot(layout.items[i], layout, taken, _why(i, layout, graph))
        if spot is None:
            return _moves_in_tight_space(layout, graph, steps, before)
        spots[i] = spot
    ends = [layout.items[s.item].goal if s.to_goal else spots[s.item].footprint for s in steps]
    starts = [
        spots[s.item].footprint if s.to_goal and s.item in spots else layout.items[s.item].footprint for s in steps
    ]
    picks = np.array([start.center for start in starts]).reshape(-1, 2)
    places = np.array([end.center for end in ends if end is not None]).reshape(-1, 2)
    return _carry_out(layout, [steps[k] for k in shortest_order(picks, places, before)], spots)


def _precedence(steps: Sequence[_Step], graph: Dependencies) -> list[int]:
    """By step, bits of the steps that come before it."""
    leaving: dict[int, int] = {}
    for k, step in enumerate(steps):
        leaving.setdefault(step.item, k)  # an item that stands aside leaves with that step, which is listed first
    before = [0] * len(steps)
    for k, step in enumerate(steps):
        if step.to_goal:
            blocking = [j for j in leaving if graph.leave_first[step.item] >> j & 1]
            before[k] = sum(1 << leaving[j] for j in blocking)
            if leaving[step.item] != k:
                before[k] |= 1 << leaving[step.item]
    return before


def _moves_in_tight_space(
    layout: Layout, graph: Dependencies, steps: Sequence[_Step], before: Sequence[int]
) -> tuple[Move, ...] | int:
    """Where no place keeps clear of everything, one that is free for as long as it is needed."""
    order = _short_stays(steps, before)
    sequence = [steps[k] for k in order]
    spots: dict[int, Move] = {}
    now = layout
    for at, step in enumerate(sequence):
        item = now.items[step.item]
        if not step.to_goal:
            until = next((i for i, s in enumerate(sequence) if s.item == step.item and s.to_goal), len(sequence))
            taken = [other.footprint for other in now.items if other is not item]
            taken += _filled(now, sequence[at:until])
            spot = nearest_spot(item, layout, taken, _why(step.item, layout, graph), tight=True)
            if spot is None:
                return step.item
            spots[step.item] = spot
        now = now.after(item.to_goal() if step.to_goal else spots[step.item])
    return _carry_out(layout, sequence, spots)


def _short_stays(steps: Sequence[_Step], before: Sequence[int]) -> list[int]:
    """An order in which items stand aside as late and for as short as can be.

    First comes what an item that stands aside waits for, then goals that are free, then standing aside.
    """
    order: list[int] = []
    done = 0
    while len(order) < len(steps):
        aside = {steps[k].item for k in order if not steps[k].to_goal}
        awaited = sum(1 << k for k in range(len(steps)) if steps[k].to_goal and steps[k].item in aside) & ~done
        while (more := awaited | _all_before(awaited, before)) != awaited:
            awaited = more
        ready = [k for k in range(len(steps)) if not done >> k & 1 and before[k] & done == before[k]]
        k = max(ready, key=lambda k: (steps[k].to_goal, awaited >> k & 1, sum(row >> k & 1 for row in before), -k))
        order.append(k)
        done |= 1 << k
    return order


def _all_before(mask: int, before: Sequence[int]) -> int:
    found = 0
    for k, row in enumerate(before):
        if mask >> k & 1:
            found |= row
    return found


def _filled(layout: Layout, steps: Sequence[_Step]) -> list[Footprint]:
    goals = [layout.items[step.item].goal for step in steps if step.to_goal]
    return [goal for goal in goals if goal is not None]


def _carry_out(layout: Layout, sequence: Sequence[_Step], spots: dict[int, Move]) -> tuple[Move, ...]:
    moves: list[Move] = []
    for step in sequence:
        move = layout.items[step.item].to_goal() if step.to_goal else spots[step.item]
        moves.append(move)
        layout = layout.after(move)
    return tuple(moves)


def _why(position: int, layout: Layout, graph: Dependencies) -> str:
    blocked = [layout.items[i].object for i in graph.wanted if graph.leave_first[i] >> position & 1]
    return f"it stands in the goal of object {', '.join(map(str, blocked))}"
