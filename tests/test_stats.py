from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binomtest

from toolkit.stats import bootstrap_interval, holm, mcnemar, paired_difference, wilson_interval


def test_wilson_matches_published_values():
    # Newcombe, Statistics in Medicine 1998, table I: 81 of 263.
    assert wilson_interval(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)
    assert wilson_interval(0, 0) == (0.0, 1.0)


def test_bootstrap_covers_the_truth_about_as_often_as_it_says():
    rng = np.random.default_rng(0)
    covered = 0
    for trial in range(200):
        clusters = np.repeat(np.arange(40), 3)
        values = rng.normal(size=40)[clusters] + 0.1 * rng.normal(size=120)
        low, high = bootstrap_interval(values, clusters, lambda v: float(v.mean()), resamples=300, seed=trial)
        covered += low <= 0 <= high
    assert 0.89 <= covered / 200 <= 0.99


def test_clustering_widens_the_interval_of_correlated_values():
    values = np.repeat(np.random.default_rng(1).normal(size=20), 10)
    together = np.repeat(np.arange(20), 10)
    wide = np.ptp(bootstrap_interval(values, together, np.mean))
    narrow = np.ptp(bootstrap_interval(values, np.arange(200), np.mean))
    assert wide > 2 * narrow


def test_infinite_errors_are_allowed():
    low, high = bootstrap_interval(np.array([0.0, 1, np.inf, np.inf]), np.arange(4), lambda v: float(np.sort(v)[1]))
    assert low == 0 and high == np.inf


def test_paired_difference_finds_a_constant_one():
    a = np.random.default_rng(2).normal(size=30)
    difference, (low, high) = paired_difference(a + 0.5, a, np.arange(30))
    assert difference == pytest.approx(0.5) and low == pytest.approx(0.5) and high == pytest.approx(0.5)
    with pytest.raises(ValueError, match="argument"):
        paired_difference([1.0], [1.0, 2.0], [0])


def test_mcnemar_is_the_sign_test_on_discordant_pairs():
    a = [True] * 9 + [False] * 1 + [True] * 20
    b = [False] * 9 + [True] * 1 + [True] * 20
    assert mcnemar(a, b) == pytest.approx(binomtest(9, 10).pvalue)
    assert mcnemar(a, a) == 1.0


def test_holm_matches_a_worked_example():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
