"""The likelihood of a given part, against dense covariances."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from mfd_bayes.population.given_likelihood import GivenLikelihood, Sums
from mfd_bayes.population.pace import Counted
from mfd_bayes.population.discrepancy import Residual
from mfd_bayes.population.strokes import StrokeLevels
from mfd_bayes.population.discrepancy import TravelBasis

SAMPLES, STROKES, TESTS = 60, 5, 3


@pytest.fixture(scope="module")
def rng():
    return np.random.default_rng(3)


@pytest.fixture(scope="module")
def residual(rng):
    basis = TravelBasis(1.0, 2.0)
    root = 0.1 * rng.normal(size=(basis.size, basis.size)) / np.sqrt(basis.size)
    return Residual(
        basis=basis,
        mean=0.1 * rng.normal(size=basis.size),
        covariance=root @ root.T,
        log_shape=np.zeros(basis.size),
        slip_force=2.0,
        levels=StrokeLevels(np.zeros(basis.size), 0.6),
        noise_time=0.1,
        information=1.0,
    )


@pytest.fixture(scope="module")
def counted(rng, residual):
    return Counted(
        functions=0.1 * np.abs(rng.normal(size=(SAMPLES, residual.basis.size))),
        shape=np.exp(0.3 * rng.normal(size=SAMPLES)),
        share=np.ones(SAMPLES),
        common=rng.uniform(0.0, 0.8, SAMPLES),
        strokes=np.sort(rng.integers(0, STROKES, SAMPLES)),
    )


@pytest.fixture(scope="module")
def tests(rng):
    """Residuals, slip forces and noise sds of some tests."""
    return (
        rng.normal(size=(TESTS, SAMPLES)),
        rng.uniform(1.0, 3.0, TESTS),
        rng.uniform(0.2, 0.5, TESTS),
    )


def part(counted, inside):
    return Counted(*(getattr(counted, name)[inside] for name in vars(counted)))


def in_two_parts(left, counted, at=25):
    """Sums of two stretches, of which the second begins within a stroke."""
    first, second = slice(None, at), slice(at, None)
    return Sums.of(left[:, first], part(counted, first)) + Sums.of(
        left[:, second], part(counted, second)
    )


def of_strokes(counted, count=STROKES):
    """Level of each sample by level of each stroke, over the noise's sd, (T, strokes)."""
    found = np.zeros((counted.strokes.size, count))
    found[np.arange(counted.strokes.size), counted.strokes] = counted.common * counted.shape
    return found


def dense(residual, counted, slip, sd):
    """Covariance of a test's residuals, (T, T)."""
    levels, functions = of_strokes(counted), counted.functions
    rest = np.diag(counted.shape**2 * (1.0 - counted.common**2))
    noise = rest + levels @ residual.levels.correlation(STROKES) @ levels.T
    relative = slip / residual.slip_force
    return sd**2 * noise + relative**2 * functions @ residual.covariance @ functions.T


def test_it_is_that_of_the_dense_covariance(residual, counted, tests):
    left, slips, sds = tests
    expected = [
        multivariate_normal(np.zeros(SAMPLES), dense(residual, counted, slip, sd)).logpdf(r)
        for r, slip, sd in zip(left, slips, sds, strict=True)
    ]
    sums = in_two_parts(left, counted)
    np.testing.assert_allclose(GivenLikelihood(residual)(sums, slips, sds), expected, rtol=1e-9)
    # the negative control: levels that are independent from stroke to stroke
    other = replace(residual, levels=replace(residual.levels, memory=0.0))
    assert np.all(np.abs(GivenLikelihood(other)(sums, slips, sds) - expected) > 0.01)


def test_without_levels_samples_are_independent(residual, counted, tests):
    left, slips, sds = tests
    plain = replace(counted, common=np.zeros(SAMPLES))
    expected = [
        multivariate_normal(np.zeros(SAMPLES), dense(residual, plain, slip, sd)).logpdf(r)
        for r, slip, sd in zip(left, slips, sds, strict=True)
    ]
    found = GivenLikelihood(residual)(Sums.of(left, plain), slips, sds)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_draws_have_the_moments_of_the_dense_posterior(residual, counted, tests, rng):
    left, slips, sds = tests
    n, more = 4000, STROKES + 2  # two strokes are still to come
    many = np.repeat(left[:1], n, axis=0), np.full(n, slips[0]), np.full(n, sds[0])
    sums = Sums.of(many[0], counted)
    likelihood = GivenLikelihood(residual)
    coefficients = likelihood.draw_coefficients(sums, *many[1:], rng)
    levels = likelihood.draw_levels(sums, coefficients, many[1:], more, rng)
    functions = slips[0] / residual.slip_force * counted.functions
    loads = np.hstack([functions, sds[0] * of_strokes(counted, more)])
    prior = np.zeros((loads.shape[1],) * 2)
    prior[:-more, :-more] = residual.covariance
    prior[-more:, -more:] = residual.levels.correlation(more)
    rest = sds[0] ** 2 * np.diag(counted.shape**2 * (1.0 - counted.common**2))
    gain = prior @ loads.T @ np.linalg.inv(loads @ prior @ loads.T + rest)
    mean, sd = gain @ left[0], np.sqrt(np.diag(prior - gain @ loads @ prior))
    drawn = np.hstack([coefficients - residual.mean, levels])
    np.testing.assert_allclose(drawn.mean(axis=0), mean, atol=4.0 * sd.max() / np.sqrt(n))
    np.testing.assert_allclose(drawn.std(axis=0), sd, rtol=0.06)
    assert np.all(sd[-2:] > 1.2 * sd[-more:-2].max())


def test_tests_can_be_chosen_and_joined(counted, tests):
    left = tests[0]
    sums = Sums.of(left, counted)
    again = sums.of_tests(np.array([2])).beside([sums.of_tests(np.array([0, 1]))])
    expected = sums.of_tests(np.array([2, 0, 1]))
    np.testing.assert_array_equal(again.squares, expected.squares)
    np.testing.assert_array_equal(again.pulls, expected.pulls)
    np.testing.assert_array_equal(again.strokes.pulls, expected.strokes.pulls)
