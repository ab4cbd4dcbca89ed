"""Leave-one-cycle-out figures where the truth is known, and the diagnostics of their failure."""

import numpy as np
import pytest
from scipy import stats

from mfd_bayes.calibration.diagnostics import Effort, psis
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.calibration.sampling import sample
from mfd_bayes.evaluation.compare import (
    LARGEST_K,
    CrossValidation,
    cross_validate,
    difference,
    join,
    leave_out,
    log_evidence,
    standard_error,
)
from mfd_bayes.records.trace import Trace

FILE = load_priors("brfd")
SHORT = Effort(ess=60, limit=400, r_hat=1.1, length=2.0, ensembles=2, walkers=32, kept=800)
THETA = {
    "bouc_wen": np.array([[40.0, 0.02, 2.0, 1.7, 0.7, 2.0, 0.01]]),
    "lugre": np.array([[60.0, 0.02, 0.01, 2.2, 2.0, 1.9, 1.7, 0.5]]),
}


def test_psis_weights_are_normalised_and_k_small_where_densities_are_near():
    ratios = np.random.default_rng(0).normal(5.0, 0.3, 4000)
    log_weights, k = psis(ratios, 0.8)
    assert np.exp(log_weights).sum() == pytest.approx(1.0)
    assert k < 0.3
    # the largest weights are smoothed, the others as they are
    small = ratios < np.quantile(ratios, 0.9)
    apart = np.ptp((log_weights - ratios)[small])
    assert apart < 1e-9


@pytest.mark.parametrize("tail", [0.5, 1.0])
def test_psis_finds_the_tail_of_pareto_weights(tail):
    # the control of the one above: weights whose variance, or mean, is infinite
    weights = np.random.default_rng(1).pareto(1 / tail, 20000) + 1.0
    k = psis(np.log(weights))[1]
    assert k == pytest.approx(tail, abs=0.12)
    assert (k > LARGEST_K) == (tail > LARGEST_K)


def normal_mean(blocks, n=4000, seed=0):
    """Draws of a mean with prior N(0, 10²), the blocks' log densities, and their exact elpd."""
    rng = np.random.default_rng(seed)
    every = np.concatenate(blocks)

    def posterior(data):
        precision = 0.01 + data.size
        return data.sum() / precision, precision**-0.5

    mean, sd = posterior(every)
    draws = rng.normal(mean, sd, n)
    given = np.stack([stats.norm.logpdf(b[:, None], draws).sum(axis=0) for b in blocks], axis=1)
    exact = []
    for i, block in enumerate(blocks):
        mean, sd = posterior(np.concatenate([b for j, b in enumerate(blocks) if j != i]))
        cov = np.eye(block.size) + sd**2
        exact.append(stats.multivariate_normal(np.full(block.size, mean), cov).logpdf(block))
    return draws, given, np.array(exact)


def test_elpd_is_exact_where_every_block_tells_little():
    rng = np.random.default_rng(2)
    _, given, exact = normal_mean([rng.normal(size=5) for _ in range(12)])
    found = np.array([leave_out(column) for column in given.T])
    np.testing.assert_allclose(found[:, 0], exact, atol=0.02)
    assert np.all(found[:, 1] > found[:, 0])
    assert np.all(found[:, 2] < LARGEST_K)


def test_a_block_that_moves_the_posterior_far_has_a_large_k():
    rng = np.random.default_rng(3)
    blocks = [rng.normal(size=5), rng.normal(size=5), rng.normal(6.0, 1.0, size=20)]
    draws, given, exact = normal_mean(blocks)
    elpd, _, k = leave_out(given[:, 2])
    assert k > LARGEST_K
    assert elpd > exact[2] + 3.0  # and PSIS is far too good to be true

    # from both evidences it is right, and says so
    def density(data):
        return lambda q: (
            stats.norm.logpdf(q[:, 0], 0, 10) + stats.norm.logpdf(data[:, None], q[:, 0]).sum(0)
        )

    start, flat, found = draws[:, None], np.zeros(draws.size), []
    for _ in range(8):  # each by itself has an error of about 0.06
        whole, first_k = log_evidence(density(np.concatenate(blocks)), start, flat, rng)
        rest, second_k = log_evidence(density(np.concatenate(blocks[:2])), start, -given[:, 2], rng)
        assert max(first_k, second_k) < LARGEST_K
        found.append(whole - rest)
    assert np.mean(found) == pytest.approx(exact[2], abs=0.05)


def test_differences_are_paired_over_cycles():
    rng = np.random.default_rng(4)
    shared = rng.normal(0, 100, 50)  # what is hard for one model is hard for the other
    nothing = np.zeros(50)
    one = CrossValidation(shared + 1.0, shared + 1.0, nothing, nothing)
    other = CrossValidation(shared + rng.normal(0, 0.1, 50), shared, nothing, nothing)
    apart, error = difference(one, other)
    assert apart == pytest.approx(50.0, abs=3.0)
    assert error < 2.0 < 300.0 < standard_error(one.elpd)
    assert standard_error(one.elpd) == pytest.approx(np.sqrt(50) * shared.std(ddof=1))
    both = join([one, other])
    np.testing.assert_array_equal(both.elpd, [*one.elpd, *other.elpd])
    assert np.isnan(standard_error(np.ones(1)))


def test_cycles_of_one_test_are_not_independent():
    rng = np.random.default_rng(6)
    test = np.repeat(np.arange(12), 30)
    totals, errors, wrong = [], [], []
    for _ in range(400):  # a model is better or worse in a whole test at once
        figures = rng.normal(0.0, 1.0, 12)[test] + rng.normal(0.0, 1.0, test.size)
        totals.append(figures.sum())
        errors.append(standard_error(figures, test))
        wrong.append(standard_error(figures))
    assert np.mean(errors) == pytest.approx(np.std(totals), rel=0.1)
    assert np.std(totals) > 3.0 * np.mean(wrong)  # the control


def test_independent_cycles_have_the_error_of_independent_cycles():
    figures = np.random.default_rng(7).normal(size=400)
    test = np.repeat(np.arange(40), 10)
    alone = standard_error(figures)
    assert alone <= standard_error(figures, test) < 1.3 * alone
    assert standard_error(figures, np.zeros(400, dtype=int)) == alone
    balanced = np.tile([1.0, -1.0], 200)  # whose tests agree by chance
    assert standard_error(balanced, test) == standard_error(balanced)


def test_joined_tests_keep_their_cycles_together():
    rng = np.random.default_rng(8)
    parts = [CrossValidation(*([rng.normal(m, 1.0, 20)] * 4)) for m in (-3.0, 0.0, 3.0)]
    both = join(parts)
    np.testing.assert_array_equal(both.test, np.repeat([0, 1, 2], 20))
    assert standard_error(both.elpd, both.test) > standard_error(both.elpd)
    assert difference(both, join(parts[::-1]))[1] > 50.0  # −6, 0 and 6 times 20


def record_of(model, seed=5):
    """Four cycles of a model's force with some noise."""
    time = np.arange(0, 4, 1 / 40)
    motion = np.sin(2 * np.pi * time)
    trace = Trace.from_arrays(time, motion, 0.03, np.zeros(time.size))
    posterior = Posterior(trace, FILE, "ou", model)
    force = posterior.model.force(THETA[model], trace)[0]
    values = {"noise_sd": np.array([0.05]), "noise_time": np.array([0.03])}
    noise = posterior.noise.draw(np.random.default_rng(seed), time, values)[0]
    return Trace.from_arrays(time, motion, 0.03, force + noise)


@pytest.mark.slow
@pytest.mark.parametrize("truth", ["bouc_wen", "lugre"])
def test_the_model_that_a_record_is_from_predicts_its_cycles_best(truth):
    trace = record_of(truth)
    found = {}
    for model in ("bouc_wen", "lugre"):
        posterior = Posterior(trace, FILE, "ou", model)
        draws = sample(posterior, SHORT, 1)
        values = {name: column.reshape(-1) for name, column in draws.values.items()}
        walkers = draws.chains.walkers
        found[model] = cross_validate(
            posterior, values, len(draws.q), walkers, np.random.default_rng(0)
        )
        assert not np.any(found[model].bad)
        assert np.all(found[model].lppd >= found[model].elpd)
    (other,) = set(found) - {truth}
    apart, error = difference(found[truth], found[other])
    assert apart > 2 * error
    assert apart > 5.0
