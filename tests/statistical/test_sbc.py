"""Simulation-based calibration, reduced: truths are ranked evenly by their posteriors."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from mfd_bayes.calibration.effort import EFFORTS, Effort
from mfd_bayes.records.trace import Trace
from tests.statistical import sbc_study as sbc
from tests.statistical import uniformity as uniform

SAMPLED = ("Fc_fwd", "d2", "start", "offset", "noise_sd", "noise_time")
TESTS, CONTROLS = 24, 8
DRAWS = 31


@pytest.fixture(scope="module")
def ranks() -> dict[str, dict[str, list[int]]]:
    """Ranks by noise that the posterior assumes, and quantity; the records are the same."""
    time = np.arange(80) / 16.0
    study = sbc.Study(
        priors=sbc.narrow_priors(SAMPLED, noise_time=0.4),
        motion=Trace.from_arrays(time, 0.5 * np.sin(2 * np.pi * 0.25 * time)),
        effort=replace(EFFORTS["quick"], ess=90, limit=800, r_hat=1.05, ensembles=2, starts=6),
        draws=DRAWS,
        seed=5,
    )
    tests = {
        noise: [sbc.run_test(study, index, noise) for index in range(count)]
        for noise, count in ((sbc.TRUE, TESTS), (sbc.WRONG, CONTROLS))
    }
    assert not any(test.error for series in tests.values() for test in series)
    return {noise: sbc.ranks_by_quantity(series) for noise, series in tests.items()}


@pytest.mark.slow
def test_truths_are_ranked_evenly(ranks):
    true_ranks = ranks[sbc.TRUE]
    assert {*SAMPLED, sbc.LIKELIHOOD} == set(true_ranks)
    assert uniform.failures(true_ranks, uniform.Uniformity(TESTS, DRAWS)) == {}  # familywise 1 %


@pytest.mark.slow
def test_a_wrong_likelihood_ranks_them_unevenly(ranks):
    failed = uniform.failures(ranks[sbc.WRONG], uniform.Uniformity(CONTROLS, DRAWS))
    assert sbc.LIKELIHOOD in failed


@pytest.mark.slow
def test_truths_of_all_parameters_are_inside_their_intervals():
    time = np.arange(0.0, 8.0, 0.04)
    fade = np.minimum(1.0, time / 4.0)
    study = sbc.Study(
        priors=sbc.narrow_priors(),
        motion=Trace.from_arrays(time, 0.5 * np.sin(2 * np.pi * 0.25 * time) * fade),
        effort=Effort(ess=80, limit=400, r_hat=1.05, length=1.0, ensembles=2, starts=6),
        draws=79,
        seed=17,
    )
    ranks_by_name = sbc.ranks_by_quantity([sbc.run_test(study, i) for i in range(12)])
    watched = ("Fc_fwd", "Fc_bwd", "k3", "d2", "ell", "noise_sd")
    share = (np.array([ranks_by_name[name] for name in watched]) + 0.5) / 80.0
    # 72 trials at 0.8: mean 57.6; three and a half standard deviations of a binomial leave 45.7 to
    # 69.5, and some tests are correlated within
    assert 45 <= np.sum(np.abs(share - 0.5) <= 0.4) <= 70
    # the control: the same medians with half the spread
    assert np.sum(np.abs(norm.cdf(2.0 * norm.ppf(share)) - 0.5) <= 0.4) < 45


def test_uniform_ranks_fail_as_rarely_as_stated():
    uniformity = uniform.Uniformity(60, DRAWS, 20_000)
    rng = np.random.default_rng(1)
    p_values = [uniformity.p_value(rng.integers(0, DRAWS + 1, 60)) for _ in range(2000)]
    for level in (0.05, 0.2):
        share = np.mean(np.array(p_values) < level)
        assert abs(share - level) < 4.0 * np.sqrt(level * (1 - level) / 2000)
