"""The monotone solver, and its extension to problems in which objects must stand aside.

Krontiris and Bekris, "Dealing with difficult instances of object rearrangement", RSS 2015, and "Efficiently solving
general rearrangement tasks: a fast extension primitive for an incremental sampling-based planner", ICRA 2016; Wang et
al., "Uniform object rearrangement: from complete monotone primitives to efficient non-monotone informed search", ICRA
2021.
"""

from __future__ import annotations

import numpy as np

from toolkit.rearrangement.bits import any_bit, bits
from toolkit.rearrangement.planners.arrangements.growth import grow
from toolkit.rearrangement.planners.arrangements.table import GOAL, Arrangement, Step, Table


def monotone(table: Table, arrangement: Arrangement) -> list[Step]:
    """Bring as many items to their goals as can be with one move each.

    Wang's dynamic programme looks for an order among the sets of items at their goals. Where the hand comes from above
    and goals do not overlap, an item at its goal is in nobody's way, so that every order ends with the same set, the
    largest: there is nothing to go back on.
    """
    steps: list[Step] = []
    stuck = False
    while not stuck:
        stuck = True
        for item in bits(table.waiting(arrangement)):
            if not table.in_goal(item, arrangement):
                steps.append(Step(item, GOAL))
                arrangement = arrangement.after(steps[-1])
                stuck = False
    return steps


def perturbed(table: Table, rng: np.random.Generator, perturbations: int) -> list[Step]:
    """Search over arrangements: solve as a monotone problem, put an item that stands in a goal aside, and go on.

    Args:
        table: where.
        rng: chooses the item and its place, which reaches into no open goal where there is such a one.
        perturbations: after which the search ends.
    """

    def expand(arrangement: Arrangement) -> list[Step]:
        if steps := monotone(table, arrangement):
            return steps
        aside = _aside(table, arrangement, rng)
        return aside + monotone(table, arrangement.after(*aside))

    return grow(table, expand, 1 + perturbations)


def _aside(table: Table, arrangement: Arrangement, rng: np.random.Generator) -> list[Step]:
    blocking = 0
    for item in bits(table.waiting(arrangement)):
        blocking |= table.in_goal(item, arrangement)
    item = any_bit(blocking, rng)
    free = table.free(item, arrangement)
    clear = free & ~table.in_goals(item, table.waiting(arrangement))
    return [Step(item, any_bit(clear or free, rng))] if free else []
