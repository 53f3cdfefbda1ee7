"""What was moved as one is one: pieces of an object that depth cut apart."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import combinations

import numpy as np

from toolkit.perception.explainers.searching.jointly import Candidate, total_cost
from toolkit.perception.fusion import FusedModel
from toolkit.perception.tabletop.joining import are_close
from toolkit.types import Float

_AS_GOOD = 1.0
"""A piece is moved with another if that explains its pixels at no more than this above the cost of its own place."""


def moved_together(
    chosen: Mapping[int, Candidate],
    models: Mapping[int, FusedModel],
    background: Float,
    place: Callable[[int, Float], Candidate],
    search: Callable[[Collection[int], Mapping[int, Candidate]], Sequence[Float]],
) -> tuple[tuple[tuple[int, ...], ...], dict[int, Candidate]]:
    """Groups of instances that touch, and that one motion, not that of standing still, explains as well as their own.

    Args:
        chosen: the candidates of an explanation, by instance.
        models: of all instances.
        background: (P,) cost of the image without any of them.
        place: makes the candidate of an instance for a (4, 4) motion.
        search: finds (4, 4) motions of some instances as one object, when others are where they were chosen to be. A
            handle alone may be turned any way; with its shaft it may not.

    Returns:
        Groups of two or more, the largest instance of each first; and the explanation with each group moved as one.
    """
    now = dict(chosen)
    group = {instance: {instance} for instance in models}
    by_size = sorted(models, key=lambda i: -len(models[i].points))
    for large, small in combinations(by_size, 2):
        whole = group[large] | group[small]
        moved = [now[i].T_goal_current for i in whole if i in now and now[i].moved]
        if small in group[large] or not moved or not are_close(models[large].points, models[small].points):
            continue
        rest = {i: c for i, c in now.items() if i not in whole}
        together = [rest | {i: place(i, T) for i in whole} for T in (*moved, *search(whole, rest))]
        best = min(together, key=lambda placed: total_cost(placed, background))
        spared = _AS_GOOD * sum(len(best[i].rendering.pixels) for i in group[small]) * (small in now)
        if total_cost(best, background) < total_cost(now, background) + spared:
            now = best
            for instance in whole:
                group[instance] = whole
    wholes = {frozenset(whole) for whole in group.values() if len(whole) > 1}
    return tuple(sorted(tuple(sorted(whole, key=by_size.index)) for whole in wholes)), now


def owners(owner: np.ndarray, groups: tuple[tuple[int, ...], ...]) -> np.ndarray:
    """(P,) instances with every piece of a group named after its first one."""
    named = owner.copy()
    for first, *rest in groups:
        named[np.isin(owner, rest)] = first
    return named
