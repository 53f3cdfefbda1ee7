"""Which instances stand where, decided together: the whole goal image is to be explained at the least cost.

Perception as a search over what could be rendered (Narayanan and Likhachev, "PERCH", ICRA 2016). Here every instance
has few hypotheses, placed one after another, the one that explains most first, and all are tried again after each.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from toolkit.perception.explainers.searching.renderings import Rendering
from toolkit.types import Float

_PRESENT, _MOVED = 0.4, 0.3
"""Cost of an instance for every pixel it shows in, and of one that was moved: what stood still is the simpler story."""

_LEAST_PX = 30.0
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class Candidate:
    """An instance at one place.

    Attributes:
        T_goal_current: (4, 4).
        moved: whether that is another place than now.
        rendering: what it would show.
    """

    T_goal_current: Float
    moved: bool
    rendering: Rendering

    @property
    def cost(self) -> Float:
        """(P,) of its pixels where they are seen: what they look like, and what it costs that something is there."""
        return self.rendering.cost + _PRESENT + _MOVED * self.moved


@dataclass(frozen=True, eq=False)
class Composition:
    """Candidates drawn over the background, the nearest surface in every pixel.

    Attributes:
        depth: (P,) metres, inf where nothing stands.
        cost: (P,).
        owner: (P,) int64 the instance, -1 for the background.
    """

    depth: Float
    cost: Float
    owner: NDArray[np.int64]


def compose(chosen: Mapping[int, Candidate], background: Float) -> Composition:
    """Draw the chosen candidates, by instance, over a background of (P,) costs."""
    depth, cost = np.full(background.shape, np.inf), background.copy()
    owner = np.full(background.shape, -1, np.int64)
    for instance, candidate in chosen.items():
        r = candidate.rendering
        nearest = r.depth < depth[r.pixels]
        pixels = r.pixels[nearest]
        depth[pixels], cost[pixels], owner[pixels] = r.depth[nearest], candidate.cost[nearest], instance
    return Composition(depth, cost, owner)


def explain_jointly(
    candidates: Mapping[int, Sequence[Candidate]], background: Float, start: Mapping[int, Candidate]
) -> dict[int, Candidate]:
    """Choose for every instance one of its candidates or none.

    Args:
        candidates: by instance.
        background: (P,) cost of the image without any of them.
        start: those chosen beforehand, each to be tried against the others.

    Returns:
        By instance, those that are there; together they explain the image at a cost that no change of one lowers.
    """
    chosen = _settled(dict(start), candidates, background)
    while True:
        drawn = compose(chosen, background)
        changes = [
            (change(drawn, candidate), instance, number)
            for instance, options in candidates.items()
            if instance not in chosen
            for number, candidate in enumerate(options)
        ]
        least, instance, number = min(changes, default=(0.0, 0, 0))
        if least >= 0:
            return chosen
        chosen[instance] = candidates[instance][number]
        chosen = _settled(chosen, candidates, background)


def change(drawn: Composition, candidate: Candidate) -> float:
    """What it adds to the cost of a composition to place a candidate in it too; negative where it explains more."""
    r = candidate.rendering
    nearest = r.depth < drawn.depth[r.pixels]
    return float((candidate.cost[nearest] - drawn.cost[r.pixels[nearest]]).sum()) + _LEAST_PX


def total_cost(chosen: Mapping[int, Candidate], background: Float) -> float:
    """What the image costs with the chosen candidates in it."""
    return float(compose(chosen, background).cost.sum()) + _LEAST_PX * len(chosen)


def _settled(
    chosen: dict[int, Candidate], candidates: Mapping[int, Sequence[Candidate]], background: Float
) -> dict[int, Candidate]:
    """Try every other candidate, and none, for each instance in turn until nothing changes."""
    for _ in range(_ROUNDS):
        before = dict(chosen)
        for instance in list(chosen):
            rest = {i: c for i, c in chosen.items() if i != instance}
            drawn = compose(rest, background)
            changes = [(change(drawn, candidate), number) for number, candidate in enumerate(candidates[instance])]
            least, number = min(changes)
            chosen = rest if least >= 0 else {**rest, instance: candidates[instance][number]}
        if chosen == before:
            break
    return chosen
