"""Uncertainty of what an ablation reports: intervals that respect that objects of one scene stand or fall together."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from toolkit.types import Float

Interval = tuple[float, float]


def wilson_interval(successes: int, total: int, level: float = 0.95) -> Interval:
    """Wilson's interval of a proportion, 0..1 (Wilson, JASA 1927); (0, 1) when nothing was tried."""
    if total == 0:
        return 0.0, 1.0
    interval = binomtest(successes, total).proportion_ci(level, method="wilson")
    return float(interval.low), float(interval.high)


def bootstrap_interval(
    values: Float,
    clusters: NDArray[np.int64],
    statistic: Callable[[Float], float],
    level: float = 0.95,
    resamples: int = 1000,
    seed: int = 0,
) -> Interval:
    """Percentile interval of a statistic by resampling whole clusters (scenes), not single values.

    Args:
        values: (N,) numbers; infinite ones (failures) are allowed.
        clusters: (N,) cluster of every value.
        statistic: takes (M,) values.
        level: coverage.
        resamples: bootstrap draws.
        seed: of the draws.
    """
    groups = [np.flatnonzero(clusters == cluster) for cluster in np.unique(clusters)]
    rng = np.random.default_rng(seed)
    draws = rng.integers(0, len(groups), (resamples, len(groups)))
    found = np.array([statistic(values[np.concatenate([groups[g] for g in draw])]) for draw in draws])
    tail = (1 - level) / 2
    low, high = np.quantile(found, [tail, 1 - tail], method="closest_observation")
    return float(low), float(high)


def paired_difference(
    a: Sequence[float], b: Sequence[float], scenes: Sequence[int], level: float = 0.95, seed: int = 0
) -> tuple[float, Interval]:
    """Mean of a - b over the same objects, with its interval by resampling scenes.

    Raises:
        ValueError: the three differ in length.
    """
    differences = np.array([x - y for x, y in zip(a, b, strict=True)], np.float64)
    clusters = np.asarray(scenes, np.int64)
    if len(clusters) != len(differences):
        raise ValueError("paired_difference needs one scene an object")
    interval = bootstrap_interval(differences, clusters, lambda v: float(v.mean()), level, seed=seed)
    return float(differences.mean()), interval


def mcnemar(a: Sequence[bool], b: Sequence[bool]) -> float:
    """Exact McNemar test: two-sided p-value that two cells succeed equally often on the same objects."""
    pairs = list(zip(a, b, strict=True))
    only_a = sum(x and not y for x, y in pairs)
    only_b = sum(y and not x for x, y in pairs)
    return float(binomtest(only_a, only_a + only_b).pvalue) if only_a + only_b else 1.0


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm's step-down adjustment of p-values for several comparisons (Holm, Scand. J. Statistics 1979)."""
    order = np.argsort(p_values)
    adjusted = np.empty(len(p_values))
    largest = 0.0
    for rank, i in enumerate(order):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[i]))
        adjusted[i] = largest
    return adjusted.tolist()
