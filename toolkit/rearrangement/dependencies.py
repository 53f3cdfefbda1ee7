"""Which object must leave before which, which goals cannot be reached, and how many moves are needed at least."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from toolkit.rearrangement.bits import bits
from toolkit.rearrangement.feedback import feedback_vertex_set
from toolkit.rearrangement.footprints import gaps, supports
from toolkit.rearrangement.moves import Item, Layout
from toolkit.types import Failure


@dataclass(frozen=True)
class Dependencies:
    """The dependency graph of a layout.

    Attributes:
        wanted: positions in `layout.items` of the items that are to be brought to a goal.
        leave_first: by position of every item, bits of the positions of the items that stand in its goal.
    """

    wanted: tuple[int, ...]
    leave_first: tuple[int, ...]

    @property
    def in_cycles(self) -> tuple[int, ...]:
        """`leave_first` among the wanted items only; only those can lie on a cycle."""
        inside = sum(1 << i for i in self.wanted)
        return tuple(row & inside if inside >> i & 1 else 0 for i, row in enumerate(self.leave_first))

    @property
    def evicted(self) -> tuple[int, ...]:
        """Positions of the items that have no goal of their own and stand in another's."""
        blocking = 0
        for row in self.leave_first:
            blocking |= row
        return tuple(j for j in bits(blocking) if j not in self.wanted)

    def moves(self, twice: int) -> int:
        """Moves it takes when so many wanted items move twice."""
        return len(self.wanted) + len(self.evicted) + twice


def dependencies(layout: Layout) -> Dependencies:
    """The dependency graph: an edge where an item's goal collides with another's present place."""
    wanted = tuple(i for i, item in enumerate(layout.items) if item.wanted)
    here = supports([item.footprint for item in layout.items])
    rows = [0] * len(layout.items)
    for i in wanted:
        goal = layout.items[i].goal
        assert goal is not None
        blocking = np.flatnonzero(gaps(goal.support, here) < layout.clearance)
        rows[i] = sum(1 << int(j) for j in blocking if j != i)
    return Dependencies(wanted, tuple(rows))


def lower_bound(layout: Layout) -> int:
    """No plan brings every wanted item of a screened layout to its goal in fewer moves.

    Items that move once only leave and arrive in one move, so no cycle of dependencies joins them: a feedback vertex
    set moves twice (Han et al., "Complexity results and fast methods for optimal tabletop rearrangement with
    overhand grasps", IJRR 2018). An item without a goal moves once where it stands in another's.
    """
    graph = dependencies(layout)
    return graph.moves(feedback_vertex_set(graph.in_cycles).lower_bound)


def screen(layout: Layout) -> tuple[Layout, dict[int, Failure]]:
    """Give up goals that cannot be reached whatever the order.

    Returns:
        The layout without those goals, and by object why they were given up.
    """
    failures: dict[int, Failure] = {}
    while found := _impossible(layout):
        item, reason = found
        failures[item.object] = Failure("planner", reason)
        layout = layout.with_item(replace(item, goal=None, T_goal_current=None))
    return layout, failures


def _impossible(layout: Layout) -> tuple[Item, str] | None:
    """The first goal that must be given up, with the reason."""
    for item in layout.items:
        if item.goal is None or item.settled:
            continue
        if item.fixed:
            return item, "it cannot be moved"
        if not layout.holds(item.goal):
            excess = item.goal.reach(np.array(layout.center)) - layout.radius
            return item, f"its goal lies {100 * excess:.1f} cm outside the reachable table"
        lasting = [other for other in layout.items if other is not item and (other.settled or other.fixed)]
        for other in lasting:
            if gaps(item.goal.support, other.footprint.support) < layout.clearance:
                why = "stands at its own goal" if other.settled else "cannot be moved"
                return item, f"its goal overlaps object {other.object}, which {why}"
    return _overlapping_goals(layout)


def _overlapping_goals(layout: Layout) -> tuple[Item, str] | None:
    """Of the wanted items whose goals overlap, the one in most overlaps; of those the least sure."""
    wanted = [item for item in layout.items if item.wanted]
    goals = supports([item.goal for item in wanted if item.goal is not None])
    overlap = gaps(goals[:, None], goals[None]) < layout.clearance
    np.fill_diagonal(overlap, False)
    counts: Sequence[int] = overlap.sum(axis=1).tolist()
    if not any(counts):
        return None
    worst = max(range(len(wanted)), key=lambda i: (counts[i], -wanted[i].confidence, wanted[i].object))
    other = wanted[int(np.flatnonzero(overlap[worst])[0])]
    return wanted[worst], f"its goal overlaps the goal of object {other.object}"
