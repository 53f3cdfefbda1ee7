"""Minimum feedback vertex sets: the fewest vertices whose removal leaves a directed graph without cycles.

Branch and bound on the reductions of Levy and Low, "A contraction algorithm for finding small cycle cutsets",
J. Algorithms 1988, with disjoint cycles as the bound. Vertices are bits, graphs are lists of bit masks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import connected_components

from toolkit.rearrangement.bits import bits

EXACT_UP_TO = 15
"""Components of this many vertices are always solved exactly; larger ones within the budget."""

_BUDGET = 3000
"""Branches tried in a component of more vertices."""


@dataclass(frozen=True)
class FeedbackSet:
    """A feedback vertex set.

    Attributes:
        vertices: ascending.
        lower_bound: no feedback vertex set is smaller.
    """

    vertices: tuple[int, ...]
    lower_bound: int


def feedback_vertex_set(successors: Sequence[int]) -> FeedbackSet:
    """Find a feedback vertex set, the smallest where the components are small.

    Args:
        successors: bit j of successors[i] is the edge from i to j.
    """
    chosen: list[int] = []
    bound = 0
    for component in _components(successors):
        graph = _Graph.of(successors, component)
        search = _Search(None if component.bit_count() <= EXACT_UP_TO else _BUDGET)
        search.run(graph, [])
        assert search.best is not None
        chosen += search.best
        bound += len(search.best) if search.complete else search.root_bound
    return FeedbackSet(tuple(sorted(chosen)), bound)


def is_acyclic(successors: Sequence[int], vertices: int) -> bool:
    """Say whether the graph has no cycle among `vertices` (bits)."""
    remaining = vertices
    while remaining:
        sinks = sum(1 << v for v in bits(remaining) if not successors[v] & remaining)
        if not sinks:
            return False
        remaining &= ~sinks
    return True


def _components(successors: Sequence[int]) -> list[int]:
    """Strongly connected components of more than one vertex, as bits."""
    n = len(successors)
    matrix = np.array([[row >> j & 1 for j in range(n)] for row in successors], np.int8).reshape(n, n)
    _, labels = connected_components(matrix, directed=True, connection="strong")
    masks = [sum(1 << int(v) for v in np.flatnonzero(labels == label)) for label in np.unique(labels)]
    return [mask for mask in masks if mask.bit_count() > 1]


@dataclass
class _Graph:
    """A graph that shrinks. `alive` are the vertices left; masks hold living vertices only."""

    successors: list[int]
    predecessors: list[int]
    alive: int

    @classmethod
    def of(cls, successors: Sequence[int], vertices: int) -> _Graph:
        n = len(successors)
        inside = [successors[v] & vertices if vertices >> v & 1 else 0 for v in range(n)]
        predecessors = [sum(1 << u for u in range(n) if inside[u] >> v & 1) for v in range(n)]
        return cls(inside, predecessors, vertices)

    def copy(self) -> _Graph:
        return _Graph(self.successors.copy(), self.predecessors.copy(), self.alive)

    def remove(self, v: int) -> None:
        """Take a vertex out with its edges."""
        clear = ~(1 << v)
        for u in bits(self.predecessors[v] & clear):
            self.successors[u] &= clear
        for w in bits(self.successors[v] & clear):
            self.predecessors[w] &= clear
        self.successors[v] = self.predecessors[v] = 0
        self.alive &= clear

    def contract(self, v: int) -> None:
        """Take a vertex out that will not be chosen: every path through it becomes an edge.

        A vertex with an edge to itself stays: it lies on a cycle of its own.
        """
        before, after = self.predecessors[v], self.successors[v]
        if before >> v & 1:
            return
        self.remove(v)
        for u in bits(before):
            self.successors[u] |= after
        for w in bits(after):
            self.predecessors[w] |= before

    def reduce(self) -> list[int]:
        """Take out what is decided; returns the vertices that every smallest set may be taken to hold."""
        chosen: list[int] = []
        changed = True
        while changed:
            changed = False
            for v in bits(self.alive):
                before, after = self.predecessors[v], self.successors[v]
                if before >> v & 1:
                    chosen.append(v)
                    self.remove(v)
                elif not before or not after:
                    self.remove(v)
                elif before & (before - 1) == 0 or after & (after - 1) == 0:
                    self.contract(v)
                else:
                    continue
                changed = True
        return chosen

    def disjoint_cycles(self) -> int:
        """A number of cycles that share no vertex: each needs a vertex of its own."""
        graph = self.copy()
        count = len(graph.reduce())
        while graph.alive:
            for v in bits(graph.shortest_cycle()):
                graph.remove(v)
            count += 1 + len(graph.reduce())
        return count

    def shortest_cycle(self) -> int:
        """Vertices of a shortest cycle as bits. A reduced graph that is not empty has one."""
        best = 0
        for v in bits(self.alive):
            limit = best.bit_count() or len(self.successors) + 1
            layers = [1 << v]
            seen = 0
            while layers[-1] and len(layers) < limit:
                reached = 0
                for u in bits(layers[-1]):
                    reached |= self.successors[u]
                if reached >> v & 1:
                    best = self._trace(v, layers)
                    break
                layers.append(reached & ~seen)
                seen |= reached
            if best.bit_count() == 2:
                break
        return best

    def _trace(self, start: int, layers: list[int]) -> int:
        """Walk back from `start` through breadth-first layers; the vertices passed."""
        cycle, at = 0, start
        for layer in reversed(layers):
            at = (self.predecessors[at] & layer).bit_length() - 1
            cycle |= 1 << at
        return cycle


class _Search:
    """Depth-first branch and bound: a vertex is chosen, or kept and contracted."""

    def __init__(self, budget: int | None) -> None:
        self.best: list[int] | None = None
        self.complete = True
        self.root_bound = 0
        self._budget = budget
        self._branches = 0

    def run(self, graph: _Graph, chosen: list[int]) -> None:
        """Explore a graph, which it consumes, with `chosen` vertices taken out already."""
        chosen = chosen + graph.reduce()
        bound = len(chosen) + graph.disjoint_cycles()
        if self._branches == 0:
            self.root_bound = bound
        if self.best is not None and bound >= len(self.best):
            return
        if not graph.alive:
            self.best = chosen
            return
        if self._budget is not None and self._branches >= self._budget and self.best is not None:
            self.complete = False
            return
        self._branches += 1
        v = max(
            bits(graph.alive),
            key=lambda u: graph.successors[u].bit_count() * graph.predecessors[u].bit_count(),
        )
        without = graph.copy()
        without.remove(v)
        self.run(without, [*chosen, v])
        graph.contract(v)
        self.run(graph, chosen)
