"""Uncertainty of what an ablation reports: intervals that respect that objects of one scene stand or fall together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # whose parts load when they are first used: a report's statistics take a third of a second
from numpy.typing import NDArray

from toolkit.types import Float

Interval = tuple[float, float]


def wilson_interval(successes: int, total: int, level: float = 0.95) -> Interval:
    """Wilson's interval of a proportion, 0..1 (Wilson, JASA 1927); (0, 1) when nothing was tried."""
    if total == 0:
        return 0.0, 1.0
    interval = scipy.stats.binomtest(successes, total).proportion_ci(level, method="wilson")
    return float(interval.low), float(interval.high)


def newcombe_interval(a: Sequence[bool], b: Sequence[bool], level: float = 0.95) -> Interval:
    """Interval of the share of a less that of b, -1..1, on the same objects; (-1, 1) when nothing was tried.

    It is one for any number of pairs, also where a and b never disagree. (Newcombe, Improved confidence intervals for
    the difference between binomial proportions based on paired data, Statistics in Medicine 1998, method 10.)
    """
    n, (in_a, in_b) = len(a), (sum(a), sum(b))
    if n == 0:
        return -1.0, 1.0
    (low_a, high_a), (low_b, high_b) = wilson_interval(in_a, n, level), wilson_interval(in_b, n, level)
    share_a, share_b = in_a / n, in_b / n
    both = sum(x and y for x, y in zip(a, b, strict=True))
    # Cross products of the two-by-two table, a positive one corrected for continuity.
    cross = n * both - in_a * in_b
    spread = np.sqrt(float(in_a) * (n - in_a) * in_b * (n - in_b))
    correlation = (max(cross - n / 2, 0) if cross > 0 else cross) / spread if spread else 0.0

    def away(of_a: float, of_b: float) -> float:
        return float(np.sqrt(of_a**2 - 2 * correlation * of_a * of_b + of_b**2))

    difference = share_a - share_b
    return difference - away(share_a - low_a, high_b - share_b), difference + away(high_a - share_a, share_b - low_b)


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


@dataclass(frozen=True)
class PairedDifference:
    """The mean of a - b over the same objects.

    Attributes:
        mean: the difference.
        interval: its interval, by resampling whole scenes.
        scenes: how many there are.
        deviation: s, where s / sqrt(scenes) is the standard error of the mean; it grows with what the objects of one
            scene have in common. NaN for a single scene.
    """

    mean: float
    interval: Interval
    scenes: int
    deviation: float


def paired_difference(
    a: Sequence[float],
    b: Sequence[float],
    scenes: Sequence[int],
    level: float = 0.95,
    resamples: int = 2000,
    seed: int = 0,
) -> PairedDifference:
    """Mean of a - b over the same objects, with its interval by resampling scenes.

    The percentile interval is expanded for few scenes: its tails are those of Student's t, which plain percentiles miss
    (Hesterberg, What Teachers Should Know About the Bootstrap, The American Statistician 2015).

    Raises:
        ValueError: the three differ in length, or are empty.
    """
    differences = np.array([x - y for x, y in zip(a, b, strict=True)], np.float64)
    if len(scenes) != len(differences) or not len(differences):
        raise ValueError("paired_difference needs objects, and one scene per object")
    _, groups = np.unique(np.asarray(scenes, np.int64), return_inverse=True)
    sums, counts = np.bincount(groups, differences), np.bincount(groups)
    n, mean = len(sums), float(differences.mean())
    if n == 1:
        return PairedDifference(mean, (-np.inf, np.inf), 1, np.nan)
    drawn = np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), resamples)
    means = (drawn @ sums) / (drawn @ counts)
    tail = float(scipy.stats.norm.cdf(np.sqrt(n / (n - 1)) * scipy.stats.t.ppf((1 - level) / 2, n - 1)))
    low, high = np.quantile(means, [tail, 1 - tail])
    error = np.sqrt(n / (n - 1) * np.sum((sums - mean * counts) ** 2)) / len(differences)
    return PairedDifference(mean, (float(low), float(high)), n, float(error * np.sqrt(n)))


def scenes_to_resolve(difference: float, deviation: float, alpha: float = 0.05, power: float = 0.8) -> float:
    """How many scenes it takes to find a difference of that size, by the normal approximation.

    Args:
        difference: the true mean difference.
        deviation: of a scene, as `PairedDifference.deviation`.
        alpha: chance of claiming one where there is none, two-sided.
        power: chance of finding it.

    Returns:
        A whole number, or infinity where the difference is 0.
    """
    if difference == 0:
        return np.inf
    quantiles = scipy.stats.norm.ppf(1 - alpha / 2) + scipy.stats.norm.ppf(power)
    return max(2.0, float(np.ceil((quantiles * deviation / difference) ** 2)))


def resolvable_difference(scenes: int, deviation: float, alpha: float = 0.05, power: float = 0.8) -> float:
    """The smallest difference that so many scenes find, arguments as in `scenes_to_resolve`."""
    return float((scipy.stats.norm.ppf(1 - alpha / 2) + scipy.stats.norm.ppf(power)) * deviation / np.sqrt(scenes))


def mcnemar(a: Sequence[bool], b: Sequence[bool]) -> float:
    """Exact McNemar test: two-sided p-value that two cells succeed equally often on the same objects.

    It takes objects as independent, which those of one scene are not quite: read it beside a clustered interval.
    (McNemar, Psychometrika 1947.)
    """
    pairs = list(zip(a, b, strict=True))
    only_a = sum(x and not y for x, y in pairs)
    only_b = sum(y and not x for x, y in pairs)
    return float(scipy.stats.binomtest(only_a, only_a + only_b).pvalue) if only_a + only_b else 1.0


def objects_for_mcnemar(difference: float, discordant: float, alpha: float = 0.05, power: float = 0.8) -> float:
    """How many objects McNemar's test needs to find a difference (Connor, Biometrics 1987).

    Args:
        difference: of the two cells' success, -1..1.
        discordant: share of objects on which they disagree, at least as large.
        alpha: chance of claiming a difference where there is none, two-sided.
        power: chance of finding it.

    Returns:
        A whole number, or infinity where the difference is 0.
    """
    if difference == 0:
        return np.inf
    spread = scipy.stats.norm.ppf(1 - alpha / 2) * np.sqrt(discordant) + scipy.stats.norm.ppf(power) * np.sqrt(
        discordant - difference**2
    )
    return float(np.ceil((spread / difference) ** 2))


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm's step-down adjustment of p-values for several comparisons (Holm, Scand. J. Statistics 1979)."""
    order = np.argsort(p_values)
    adjusted = np.empty(len(p_values))
    largest = 0.0
    for rank, i in enumerate(order):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[i]))
        adjusted[i] = largest
    return adjusted.tolist()
