"""What was moved as one is one: pieces of an object that depth cut apart."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import combinations

import numpy as np

from toolkit.perception.explainers.searching.jointly import Candidate, change, compose
from toolkit.perception.fusion import FusedModel
from toolkit.perception.tabletop.joining import are_close
from toolkit.types import Float

_AS_GOOD = 0.6
"""A piece is moved with another if that explains its pixels at no more than this above the cost of its own place."""


def moved_together(
    chosen: Mapping[int, Candidate],
    models: Mapping[int, FusedModel],
    background: Float,
    place: Callable[[int, Float], Candidate],
) -> tuple[tuple[int, ...], ...]:
    """Groups of instances that touch, and that one motion, not that of standing still, explains as well as their own.

    Args:
        chosen: the candidates of an explanation, by instance.
        models: of all instances.
        background: (P,) cost of the image without any of them.
        place: makes the candidate of an instance for a (4, 4) motion.

    Returns:
        Groups of two or more, the largest instance of each first.
    """
    group = {instance: {instance} for instance in models}
    by_size = sorted(models, key=lambda i: -len(models[i].points))
    for large, small in combinations(by_size, 2):
        if large not in chosen or not chosen[large].moved or small in group[large]:
            continue
        if not are_close(models[large].points, models[small].points):
            continue
        drawn = compose({i: c for i, c in chosen.items() if i != small}, background)
        along = place(small, chosen[large].T_goal_current)
        own = change(drawn, chosen[small]) if small in chosen else 0.0
        if change(drawn, along) < own + _AS_GOOD * len(along.rendering.pixels) * (small in chosen):
            whole = group[large] | group[small]
            for instance in whole:
                group[instance] = whole
    wholes = {frozenset(whole) for whole in group.values() if len(whole) > 1}
    return tuple(sorted(tuple(sorted(whole, key=by_size.index)) for whole in wholes))


def joined(
    chosen: Mapping[int, Candidate],
    groups: tuple[tuple[int, ...], ...],
    place: Callable[[int, Float], Candidate],
) -> dict[int, Candidate]:
    """The explanation with every piece of a group where its first one takes it."""
    motion = {instance: chosen[first].T_goal_current for first, *rest in groups for instance in rest}
    kept = {i: c for i, c in chosen.items() if i not in motion}
    return kept | {i: place(i, T) for i, T in motion.items()}


def owners(owner: np.ndarray, groups: tuple[tuple[int, ...], ...]) -> np.ndarray:
    """(P,) instances with every piece of a group named after its first one."""
    named = owner.copy()
    for first, *rest in groups:
        named[np.isin(owner, rest)] = first
    return named
