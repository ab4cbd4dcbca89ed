"""The population layer against brute force, closed forms, and data of a known truth."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.prior_files import load_priors
from mfd_bayes.errors import FitError, PriorError
from mfd_bayes.population.hierarchy import infer, pool
from mfd_bayes.population.laws import LAWS
from mfd_bayes.population.marginal import Marginal, Pooling, TestSummary, summarize

NAMES = ("Fc_fwd", "sigma0", "k3", "offset")
EFFORT = Effort(ess=200, limit=3000, length=2.0, kept=2000)


@pytest.fixture(scope="module")
def priors():
    return load_priors("mfd")


@pytest.fixture(scope="module")
def pooling(priors):
    laws = {"Fc_fwd": "power", "sigma0": "affine"}
    return pool(priors, NAMES, [0.5, 0.8, 1.2, 1.5], laws)


def random_tests(pooling, rng, actuations=(0.5, 0.8, 1.5)):
    d = len(pooling.names)
    tests = []
    for actuation in actuations:
        root = rng.normal(size=(d, d))
        spread = 0.01 * root @ root.T + 0.02 * np.eye(d)
        tests.append(TestSummary(actuation, 0.5 * rng.normal(size=d), spread))
    return tests


def random_points(pooling, rng, n=6):
    groups = len(pooling.groups)
    scatter = np.log(0.3) + 0.8 * rng.normal(size=(n, groups))
    return np.concatenate([scatter, rng.normal(1, 0.5, size=(n, len(pooling.shaped)))], axis=1)


def brute_force(pooling, tests, h):
    """Mean and covariance of all tests stacked, with N(0, 1) levels integrated out."""
    groups, d = len(pooling.groups), len(pooling.names)
    tau = np.exp(h[:groups])
    offset = []
    for test in tests:
        row = np.zeros(d)
        for name, law in pooling.laws.items():
            k = pooling.names.index(name)
            shape = h[groups + pooling.shaped.index(name)] if name in pooling.shaped else 0.0
            ratio = LAWS[law].ratio(np.array([test.actuation / pooling.reference]), np.array(shape))
            row[k] = np.log(ratio[0]) / pooling.spread[k]
        offset.append(row)
    own = np.diag((tau[pooling.member] / pooling.spread) ** 2)
    covariance = np.tile(np.eye(d), (len(tests), len(tests)))
    for j, test in enumerate(tests):
        block = slice(j * d, (j + 1) * d)
        covariance[block, block] += test.covariance + own
    return np.concatenate(offset), covariance


def brute_force_density(pooling, tests, h):
    mean, covariance = brute_force(pooling, tests, h)
    data = np.concatenate([test.mean for test in tests])
    density = stats.multivariate_normal(mean, covariance).logpdf(data)
    groups = len(pooling.groups)
    tau = np.exp(h[:groups])
    density += np.sum(stats.halfnorm(scale=pooling.scatter_sd).logpdf(tau) + h[:groups])
    for name, shape in zip(pooling.shaped, h[groups:], strict=True):
        if pooling.laws[name] == "power":
            density += stats.norm(1, 0.5).logpdf(shape)
        else:
            density += stats.logistic.logpdf(shape)
    return density


def test_the_marginal_is_the_joint_density_with_levels_integrated(pooling):
    rng = np.random.default_rng(1)
    tests, h = random_tests(pooling, rng), random_points(pooling, rng)
    found = Marginal(pooling, tests).log_prob(h)
    expected = np.array([brute_force_density(pooling, tests, row) for row in h])
    left = found - expected  # constants are left out
    np.testing.assert_allclose(left, left[0], atol=1e-8)
    assert np.ptp(expected) > 1


def test_the_marginal_is_not_that_of_another_actuation(pooling):
    rng = np.random.default_rng(1)
    tests, h = random_tests(pooling, rng), random_points(pooling, rng)
    moved = [replace(tests[0], actuation=0.6), *tests[1:]]
    left = Marginal(pooling, moved).log_prob(h)
    left -= [brute_force_density(pooling, tests, row) for row in h]
    assert np.ptp(left) > 1e-3


def test_a_batch_is_its_rows(pooling):
    rng = np.random.default_rng(2)
    marginal, h = Marginal(pooling, random_tests(pooling, rng)), random_points(pooling, rng)
    one_by_one = [marginal.log_prob(row[None])[0] for row in h]
    np.testing.assert_allclose(marginal.log_prob(h), one_by_one, rtol=1e-12)


def test_points_far_out_have_no_density_and_no_nan(pooling):
    rng = np.random.default_rng(3)
    marginal, h = Marginal(pooling, random_tests(pooling, rng)), random_points(pooling, rng, 3)
    h[0, 0], h[1, -1] = 40.0, -1e6
    found = marginal.log_prob(h)
    assert np.all(found[:2] == -np.inf)
    assert np.isfinite(found[2])


def test_levels_are_drawn_with_the_moments_of_their_closed_form(pooling):
    rng = np.random.default_rng(4)
    tests, h = random_tests(pooling, rng), random_points(pooling, rng, 1)[0]
    n, d = 40000, len(pooling.names)
    drawn = Marginal(pooling, tests).draw_levels(np.tile(h, (n, 1)), rng)
    # conditioning the stacked Gaussian: the covariance of a level with every test is that of itself
    mean, covariance = brute_force(pooling, tests, h)
    gain = np.linalg.solve(covariance, np.tile(np.eye(d), (len(tests), 1))).T
    expected = gain @ (np.concatenate([test.mean for test in tests]) - mean)
    spread = np.eye(d) - gain @ np.tile(np.eye(d), (len(tests), 1))
    standard = (drawn.mean(axis=0) - expected) / np.sqrt(np.diag(spread) / n)
    assert np.max(np.abs(standard)) < 4
    scale = np.sqrt(np.outer(np.diag(spread), np.diag(spread)))
    np.testing.assert_allclose(np.cov(drawn, rowvar=False) / scale, spread / scale, atol=0.03)
    assert np.any(np.abs(expected) > 10 * np.sqrt(np.diag(spread) / n))  # zero would be told apart


def exact_posterior(pooling, mean, covariance, rng, n):
    """Draws of a test's posterior under the N(0, 1) interim prior, in the priors' coordinates."""
    precision = np.linalg.inv(covariance)
    spread = np.linalg.inv(precision + np.eye(len(mean)))
    draws = rng.multivariate_normal(spread @ precision @ mean, spread, size=n)
    return pooling.centre + pooling.spread * draws


def test_a_summary_is_the_likelihood_without_the_interim_prior(pooling):
    rng = np.random.default_rng(5)
    mean = np.array([1.5, -2.0, 0.8, 0.3])
    root = rng.normal(size=(4, 4))
    covariance = 0.05 * root @ root.T + 0.05 * np.eye(4)
    found = summarize(pooling, 0.8, exact_posterior(pooling, mean, covariance, rng, 200_000))
    assert found.actuation == 0.8
    np.testing.assert_allclose(found.mean, mean, atol=0.03)
    np.testing.assert_allclose(found.covariance, covariance, rtol=0.05, atol=0.01)
    # the control: the posterior's own mean is pulled to the prior
    pulled = np.linalg.solve(np.eye(4) + covariance, mean)
    assert np.max(np.abs(found.mean - pulled)) > 0.1


def test_a_posterior_that_is_its_prior_says_next_to_nothing(pooling):
    rng = np.random.default_rng(6)
    draws = pooling.centre + pooling.spread * rng.normal(size=(50_000, 4))
    found = summarize(pooling, 1.0, draws)
    assert np.all(np.isfinite(found.mean))
    assert np.linalg.eigvalsh(np.linalg.inv(found.covariance)).max() < 0.05
    # it moves a level, whose own prior has precision 1, by next to nothing
    pull = np.linalg.solve(found.covariance, found.mean)
    assert np.max(np.abs(pull)) < 0.05


def test_a_posterior_wider_than_its_prior_still_has_a_covariance(pooling):
    draws = pooling.centre + 1.5 * pooling.spread * np.random.default_rng(7).normal(size=(5000, 4))
    found = summarize(pooling, 1.0, draws)
    assert np.all(np.linalg.eigvalsh(found.covariance) > 0)


FRICTION = 1.3  # kip per ksi
TRUE_SCATTER = 0.1


def friction_campaign(laws, rng, count=24):
    """Layout, and summaries of tests whose F_c is proportional to pressure with scatter."""
    priors = load_priors("mfd")
    actuations = np.tile([0.5, 0.8, 1.2, 1.5], count // 4)
    pooling = pool(priors, ("Fc_fwd", "offset"), actuations, laws)
    tests = []
    for actuation in actuations:
        log_friction = np.log(FRICTION * actuation) + TRUE_SCATTER * rng.normal()
        offset = 0.05 + 0.02 * rng.normal()
        error = np.array([0.02, 0.005])
        q = np.array([log_friction, offset]) + error * rng.normal(size=2)
        mean, sd = (q - pooling.centre) / pooling.spread, error / pooling.spread
        tests.append(TestSummary(float(actuation), mean, np.diag(sd**2)))
    parameters = {name: priors.parameters[name] for name in pooling.names}
    return infer(pooling, tests, parameters, "ksi", EFFORT, np.random.default_rng(8))


@pytest.fixture(scope="module")
def proportional():
    return friction_campaign({"Fc_fwd": "proportional"}, np.random.default_rng(9))


def test_inference_recovers_level_and_scatter(proportional):
    level = proportional.median("Fc_fwd", np.array([1.0]))
    assert level.shape == (*proportional.levels.shape[:2], 1)
    # 24 tests of 10 %: the level is known to 2 %, the scatter to 15 %
    assert np.median(level) == pytest.approx(FRICTION, rel=0.06)
    assert np.std(level) / FRICTION == pytest.approx(TRUE_SCATTER / np.sqrt(24), rel=0.5)
    scatter = proportional.scatters["friction"]
    assert np.median(scatter) == pytest.approx(TRUE_SCATTER, rel=0.4)
    low, high = np.quantile(scatter, [0.005, 0.995])
    assert low < TRUE_SCATTER < high
    assert np.median(proportional.scatters["offset"]) == pytest.approx(0.02, rel=0.5)
    assert proportional.convergence.reached(1.05, 100)


def test_the_wrong_law_misses_by_far():
    wrong = friction_campaign({"Fc_fwd": "constant"}, np.random.default_rng(9))
    # the laws' spread, the sd of the actuations' logarithms (0.42), goes into the scatter
    assert np.quantile(wrong.scatters["friction"], 0.005) > 2.5 * TRUE_SCATTER
    low_pressure = wrong.median("Fc_fwd", np.array([0.5]))
    assert np.quantile(low_pressure, 0.005) > 1.3 * FRICTION * 0.5


def test_the_exponent_of_a_power_law_is_found():
    found = friction_campaign({"Fc_fwd": "power"}, np.random.default_rng(9))
    exponent = found.shapes["Fc_fwd"]
    assert np.mean(exponent) == pytest.approx(1.0, abs=4 * 0.1 / (0.42 * np.sqrt(24)))
    assert np.std(exponent) < 0.15


def test_the_same_generator_gives_the_same_population(proportional):
    again = friction_campaign({"Fc_fwd": "proportional"}, np.random.default_rng(9))
    np.testing.assert_array_equal(again.levels, proportional.levels)
    np.testing.assert_array_equal(again.scatter, proportional.scatter)


def test_slopes_are_the_papers_constants(proportional):
    pooled = proportional.pooling
    assert isinstance(pooled, Pooling)
    one = proportional.median("Fc_fwd", np.array([0.5, 1.0, 2.0]))
    np.testing.assert_allclose(one[..., 0] * 4, one[..., 2], rtol=1e-12)
    assert proportional.law_weights == {"Fc_fwd": {"proportional": 1.0}}


def test_levels_belong_to_the_geometric_mean_of_the_actuations(pooling):
    assert pooling.reference == pytest.approx((0.5 * 0.8 * 1.2 * 1.5) ** 0.25)


def test_what_no_test_shares_is_not_pooled(priors):
    pooled = pool(priors, ("Fc_fwd", "start", "noise_dof"), [0.5, 1.0])
    assert pooled.names == ("Fc_fwd",)


def test_a_level_without_actuation_cannot_be_pooled(priors):
    with pytest.raises(FitError, match="actuation above zero"):
        pool(priors, ("Fc_fwd",), [0.0, 1.0])
    with pytest.raises(FitError, match="actuation above zero"):
        pool(priors, ("Fc_fwd",), [float("nan"), 1.0])


def test_a_law_needs_a_positive_quantity(priors):
    with pytest.raises(FitError, match="offset"):
        pool(priors, ("offset",), [1.0], {"offset": "proportional"})


def test_a_pooled_quantity_needs_a_scatter_prior(priors):
    bare = replace(priors, scatter={"friction": priors.scatter["friction"]})
    with pytest.raises(PriorError, match="k3"):
        pool(bare, ("Fc_fwd", "k3"), [1.0])
