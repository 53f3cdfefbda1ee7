"""The order of moves that the hand travels least in, under precedence: exact for few moves, local search beyond."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from toolkit.types import Float

EXACT_UP_TO = 12
"""Moves that are ordered exactly: Held and Karp look at 2^n sets of them."""


def shortest_order(picks: Float, places: Float, before: Sequence[int]) -> list[int]:
    """Order moves so that the empty hand travels least between them.

    Args:
        picks: (M, 2) where each move starts, metres.
        places: (M, 2) where it ends.
        before: by move, bits of the moves that come before it; free of cycles.

    Returns:
        The moves in order.
    """
    if len(picks) == 0:
        return []
    travel = np.linalg.norm(places[:, None] - picks[None], axis=2)
    if len(picks) <= EXACT_UP_TO:
        return _held_karp(travel, before)
    return _improve(_nearest_first(travel, before), travel, before)


def travelled(order: Sequence[int], picks: Float, places: Float) -> float:
    """Length of the empty hand's way, metres."""
    return float(sum(np.linalg.norm(places[a] - picks[b]) for a, b in pairwise(order)))


def _held_karp(travel: Float, before: Sequence[int]) -> list[int]:
    """Dynamic programming over sets of done moves and the last of them (Held and Karp, J. SIAM 1962)."""
    n = len(travel)
    sets = np.arange(1 << n)
    sizes = np.array([int(s).bit_count() for s in sets])
    cost = np.full((1 << n, n), np.inf)
    last = np.zeros((1 << n, n), np.int64)
    for j in range(n):
        if before[j] == 0:
            cost[1 << j, j] = 0.0
    for size in range(1, n):
        layer = sets[sizes == size]
        for j in range(n):
            ready = layer[(layer >> j & 1 == 0) & (layer & before[j] == before[j])]
            through = cost[ready] + travel[:, j]
            last[ready | 1 << j, j] = through.argmin(axis=1)
            cost[ready | 1 << j, j] = through.min(axis=1)
    done, at = (1 << n) - 1, int(cost[-1].argmin())
    order = [at]
    while len(order) < n:
        done, at = done ^ 1 << at, int(last[done, at])
        order.append(at)
    return order[::-1]


def _nearest_first(travel: Float, before: Sequence[int]) -> list[int]:
    order: list[int] = []
    done = 0
    while len(order) < len(travel):
        ready = [j for j in range(len(travel)) if not done >> j & 1 and before[j] & done == before[j]]
        nearest = min(ready, key=lambda j: travel[order[-1], j] if order else 0.0)
        order.append(nearest)
        done |= 1 << nearest
    return order


def _improve(order: list[int], travel: Float, before: Sequence[int]) -> list[int]:
    """Move single entries to where they shorten the way, until none does."""
    steps = travel.tolist()
    improved = True
    while improved:
        improved = False
        for move in list(order):
            i = order.index(move)
            rest = order[:i] + order[i + 1 :]
            first = max((rest.index(j) + 1 for j in rest if before[move] >> j & 1), default=0)
            final = min((rest.index(j) for j in rest if before[j] >> move & 1), default=len(rest))
            costs = {at: _detour(rest, at, move, steps) for at in range(first, final + 1)}
            best = min(costs, key=lambda at: costs[at])
            if costs[best] < costs[i] - 1e-12:
                order = [*rest[:best], move, *rest[best:]]
                improved = True
    return order


def _detour(order: list[int], at: int, move: int, steps: list[list[float]]) -> float:
    """What inserting `move` at a place adds to the way."""
    left = order[at - 1] if at > 0 else None
    right = order[at] if at < len(order) else None
    added = 0.0
    if left is not None:
        added += steps[left][move]
    if right is not None:
        added += steps[move][right]
    if left is not None and right is not None:
        added -= steps[left][right]
    return added
