"""A tree of arrangements that grows from the start until one has everything at its goal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count

import numpy as np

from toolkit.rearrangement.bits import bits
from toolkit.rearrangement.dependencies import screen
from toolkit.rearrangement.moves import Layout, Solution
from toolkit.rearrangement.planners.arrangements.table import Arrangement, Step, Table
from toolkit.types import Failure

Expand = Callable[[Arrangement], list[Step]]
"""Steps on from an arrangement; none where it is at a loss."""

Search = Callable[[Table, np.random.Generator], list[Step]]
"""Steps from the start of a table, as far as they lead."""


@dataclass(frozen=True, eq=False)
class _Node:
    arrangement: Arrangement
    parent: _Node | None
    steps: list[Step]

    def path(self) -> list[Step]:
        return [*(self.parent.path() if self.parent else []), *self.steps]


def grow(table: Table, expand: Expand, expansions: int) -> list[Step]:
    """Steps to an arrangement with everything at its goal, or with as much as was reached.

    The next node to expand is one with the fewest objects away from their goals; each expansion counts as one more.

    Args:
        table: where.
        expand: goes on from an arrangement; another time it may go elsewhere.
        expansions: after which the search ends.
    """
    root = _Node(table.start, None, [])
    best, numbers = root, count()
    seen = {root.arrangement}
    frontier = [(table.waiting(root.arrangement).bit_count(), next(numbers), root)]
    for _ in range(expansions):
        if not table.waiting(best.arrangement):
            break
        away, _, node = heappop(frontier)
        heappush(frontier, (away + 1, next(numbers), node))
        steps = expand(node.arrangement)
        reached = node.arrangement.after(*steps)
        if reached in seen:
            continue
        seen.add(reached)
        new = _Node(reached, node, steps)
        heappush(frontier, (table.waiting(reached).bit_count(), next(numbers), new))
        if table.waiting(reached).bit_count() < table.waiting(best.arrangement).bit_count():
            best = new
    return best.path()


def solved(layout: Layout, search: Search, seed: int, gave_up: str) -> Solution:
    """What a search makes of a layout: its moves, and a failure for every goal that it does not reach.

    Args:
        layout: any.
        search: gives steps from the start of a table.
        seed: of the search, and of the places at which objects may stand aside.
        gave_up: why an object is left over.
    """
    layout, failures = screen(layout)
    table = Table(layout, seed)
    steps = search(table, np.random.default_rng(seed))
    end = table.start.after(*steps)
    left = {layout.items[i].object: Failure("planner", gave_up) for i in bits(table.waiting(end))}
    return Solution(table.moves(steps), {**failures, **left})
