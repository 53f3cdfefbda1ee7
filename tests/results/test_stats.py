from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binomtest, ttest_rel
from statsmodels.stats import contingency_tables
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.power import NormalIndPower

from toolkit.results.stats import (
    bootstrap_interval,
    holm,
    mcnemar,
    newcombe_interval,
    objects_for_mcnemar,
    paired_difference,
    resolvable_difference,
    scenes_to_resolve,
    wilson_interval,
)


def test_wilson_matches_published_values():
    # Newcombe, Statistics in Medicine 1998, table I: 81 of 263.
    assert wilson_interval(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)
    assert wilson_interval(0, 0) == (0.0, 1.0)


def pairs(both, only_a, only_b, neither):
    a = [True] * (both + only_a) + [False] * (only_b + neither)
    return a, [True] * both + [False] * only_a + [True] * only_b + [False] * neither


def test_newcombe_matches_published_values():
    # Newcombe, Statistics in Medicine 1998, method 10; Fagerland, Lydersen and Laake, BMC Med. Res. Methodol. 2014.
    assert newcombe_interval(*pairs(36, 12, 2, 0)) == pytest.approx((0.0569, 0.3404), abs=1e-4)
    assert newcombe_interval(*pairs(1, 1, 7, 12)) == pytest.approx((-0.507, -0.026), abs=5e-4)
    assert newcombe_interval([], []) == (-1.0, 1.0)


@pytest.mark.parametrize("outcome", [True, False])
def test_newcombe_is_an_interval_where_nothing_differs(outcome):
    low, high = newcombe_interval([outcome] * 7, [outcome] * 7)
    assert high == -low == pytest.approx(wilson_interval(0, 7)[1])


@pytest.mark.parametrize("scenes", [7, 20, 60])
def test_newcombe_covers_the_truth_as_often_as_it_says(scenes):
    rng = np.random.default_rng(scenes)
    covered = 0
    for _ in range(1000):
        draw = rng.random(scenes)
        a, b = draw < 0.7, (draw < 0.4) | (draw > 0.9)
        low, high = newcombe_interval(a.tolist(), b.tolist())
        covered += low <= 0.2 <= high
    assert 0.93 <= covered / 1000 <= 0.99


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
    found = paired_difference(a + 0.5, a, np.arange(30))
    assert found.mean == pytest.approx(0.5) and found.interval == pytest.approx((0.5, 0.5))
    assert found.scenes == 30 and found.deviation == pytest.approx(0, abs=1e-12)
    with pytest.raises(ValueError, match="argument"):
        paired_difference([1.0], [1.0, 2.0], [0])
    with pytest.raises(ValueError, match="needs objects"):
        paired_difference([], [], [])


def test_one_scene_says_nothing():
    assert paired_difference([1.0, 1.0], [0.0, 1.0], [3, 3]).interval == (-np.inf, np.inf)


def test_the_interval_of_many_single_objects_is_students():
    """With one object a scene, against SciPy's paired t-test."""
    rng = np.random.default_rng(5)
    a, b = rng.normal(0.3, 1, 60), rng.normal(0, 1, 60)
    found = paired_difference(a, b, np.arange(60), resamples=20_000)
    exact = ttest_rel(a, b).confidence_interval()
    assert found.interval == pytest.approx((exact.low, exact.high), abs=0.03 * (exact.high - exact.low))
    assert found.deviation == pytest.approx(np.std(a - b, ddof=1))


def simulated(rng, scenes, difference):
    """Success of two cells on scenes of 1 to 9 objects; a scene's difficulty is shared by its objects and the cells."""
    scene = np.repeat(np.arange(scenes), rng.integers(1, 10, scenes))
    ease = np.clip(rng.normal(0.6, 0.2, scenes), 0.2, 0.85)[scene]
    other = np.clip(rng.normal(0, 0.1, scenes), -0.15, 0.15)[scene]
    a, b = rng.random(len(scene)) < ease + other, rng.random(len(scene)) < ease - difference
    return a, b, scene


@pytest.mark.parametrize("scenes", [20, 100])
def test_paired_intervals_cover_the_truth_as_often_as_they_say(scenes):
    """1,000 experiments with a known difference of 10 points."""
    rng = np.random.default_rng(scenes)
    covered = 0
    for trial in range(1000):
        a, b, scene = simulated(rng, scenes, 0.1)
        low, high = paired_difference(a.astype(float), b.astype(float), scene, resamples=500, seed=trial).interval
        covered += low <= 0.1 <= high
    assert 0.93 <= covered / 1000 <= 0.97


def test_as_many_scenes_as_are_needed_find_the_difference_as_often_as_promised():
    rng = np.random.default_rng(0)
    a, b, scene = simulated(rng, 4000, 0.1)
    deviation = paired_difference(a.astype(float), b.astype(float), scene).deviation
    needed = int(scenes_to_resolve(0.1, deviation))
    assert resolvable_difference(needed, deviation) == pytest.approx(0.1, rel=0.02)
    found = 0
    for trial in range(400):
        a, b, scene = simulated(rng, needed, 0.1)
        low, _ = paired_difference(a.astype(float), b.astype(float), scene, resamples=500, seed=trial).interval
        found += low > 0
    assert 0.74 <= found / 400 <= 0.86


def test_as_many_objects_as_mcnemar_needs_find_the_difference_as_often_as_promised():
    rng = np.random.default_rng(1)
    difference, discordant = 0.15, 0.35
    needed = int(objects_for_mcnemar(difference, discordant))
    only_a = (discordant + difference) / 2
    found = 0
    for _ in range(1000):
        draw = rng.random(needed)
        a, b = draw < only_a, (draw >= only_a) & (draw < discordant)
        found += mcnemar(a.tolist(), b.tolist()) < 0.05
    assert 0.73 <= found / 1000 <= 0.86  # the exact test is a little conservative
    assert objects_for_mcnemar(0.0, 0.3) == np.inf


def test_scenes_to_resolve_matches_statsmodels():
    expected = NormalIndPower(ddof=0).solve_power(0.2 / 0.9, alpha=0.01, power=0.9, ratio=0)
    assert scenes_to_resolve(0.2, 0.9, alpha=0.01, power=0.9) == np.ceil(expected)
    assert scenes_to_resolve(0.0, 0.9) == np.inf


def test_mcnemar_is_the_sign_test_on_discordant_pairs():
    a = [True] * 9 + [False] * 1 + [True] * 20
    b = [False] * 9 + [True] * 1 + [True] * 20
    assert mcnemar(a, b) == pytest.approx(binomtest(9, 10).pvalue)
    assert mcnemar(a, a) == 1.0


def test_mcnemar_and_holm_match_statsmodels():
    rng = np.random.default_rng(3)
    p_values = []
    for _ in range(6):
        a, b = rng.random(60) < 0.7, rng.random(60) < 0.5
        table = [[(a & b).sum(), (a & ~b).sum()], [(~a & b).sum(), (~a & ~b).sum()]]
        p_values.append(mcnemar(a.tolist(), b.tolist()))
        assert p_values[-1] == pytest.approx(contingency_tables.mcnemar(table, exact=True).pvalue)
    assert holm(p_values) == pytest.approx(multipletests(p_values, method="holm")[1])


def test_holm_matches_a_worked_example():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
