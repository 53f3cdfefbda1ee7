"""Monte-Carlo tree search over arrangements.

Labbe et al., "Monte-Carlo tree search for efficient visually guided rearrangement planning", RA-L 2020.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from toolkit.rearrangement.bits import any_bit
from toolkit.rearrangement.planners.arrangements.table import GOAL, Arrangement, Step, Table


class _Node:
    """An arrangement, with what was found below it."""

    def __init__(self, table: Table, arrangement: Arrangement, step: Step | None, parent: _Node | None) -> None:
        self.arrangement = arrangement
        self.step = step
        self.parent = parent
        self.untried = table.waiting(arrangement)
        self.children: list[_Node] = []
        self.visits = 0
        self.reward = 0.0

    def lineage(self) -> Iterator[_Node]:
        """This node and those above it."""
        node: _Node | None = self
        while node is not None:
            yield node
            node = node.parent

    def favourite(self, exploration: float) -> _Node:
        """The child with the highest upper confidence bound."""
        visits = np.array([child.visits for child in self.children])
        means = np.array([child.reward for child in self.children]) / visits
        return self.children[int((means + exploration * np.sqrt(2 * np.log(self.visits) / visits)).argmax())]


def tree_search(table: Table, rng: np.random.Generator, iterations: int, exploration: float) -> list[Step]:
    """Steps to an arrangement with everything at its goal, or with as much as was reached.

    An iteration follows the highest upper confidence bounds to a node with an action that was not tried, and takes that
    action. There is one action for every object that is not at its goal: it goes there where the goal is free, and
    where not, the nearest object in it is put at a random free place beside it. The reward, the number of objects at
    their goals, is read off the new arrangement without playing on to an end.

    Args:
        table: where.
        rng: chooses actions and places.
        iterations: after which the search ends.
        exploration: weight of the bounds' width, in objects.
    """
    root = best = _Node(table, table.start, None, None)
    for _ in range(iterations):
        if not table.waiting(best.arrangement):
            break
        node = root
        while not node.untried and node.children:
            node = node.favourite(exploration)
        if node.untried:
            node = _tried(table, node, rng) or node
        reward = node.arrangement.there.bit_count()
        for above in node.lineage():
            above.visits += 1
            above.reward += reward
        if reward > best.arrangement.there.bit_count():
            best = node
    return [node.step for node in best.lineage() if node.step is not None][::-1]


def _tried(table: Table, node: _Node, rng: np.random.Generator) -> _Node | None:
    """The child of an action drawn at random; None where that finds no place."""
    item = any_bit(node.untried, rng)
    node.untried &= ~(1 << item)
    step = _action(table, node.arrangement, item, rng)
    if step is None:
        return None
    child = _Node(table, node.arrangement.after(step), step, node)
    node.children.append(child)
    return child


def _action(table: Table, arrangement: Arrangement, item: int, rng: np.random.Generator) -> Step | None:
    blocking = table.in_goal(item, arrangement)
    if not blocking:
        return Step(item, GOAL)
    other = table.nearest_in_goal(item, arrangement)
    free = table.free(other, arrangement) & ~table.in_goals(other, 1 << item)
    return Step(other, any_bit(free, rng)) if free else None
