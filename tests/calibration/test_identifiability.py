import warnings

import numpy as np
import pytest
from scipy import integrate, special, stats

from mfd_bayes.calibration.identifiability import (
    CONFLICT,
    PRIOR_LED,
    SENSITIVE,
    find_directions,
    find_pairs,
    identify,
    measure_sensitivity,
)
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.records.trace import Trace

PRIOR_SD = np.array([1.0, 0.5, 2.0])
DESIGN = np.array([[3.0, 1.0, 0.0], [0.5, -2.0, 0.0], [1.0, 1.0, 0.0], [2.0, 0.0, 0.0]])
NOISE = 0.4
NAMES = ("a", "b", "c")


def exact_draws(covariance, n=4000, seed=0):
    """Draws (n, dim) whose covariance is exactly the given one."""
    draws = np.random.default_rng(seed).normal(size=(n, len(covariance)))
    draws -= draws.mean(axis=0)
    root = np.linalg.cholesky(np.cov(draws, rowvar=False))
    return np.linalg.solve(root, draws.T).T @ np.linalg.cholesky(covariance).T


def linear_posterior(design=DESIGN):
    """Covariance of a linear model's posterior."""
    precision = np.diag(PRIOR_SD**-2.0) + design.T @ design / NOISE**2
    return np.linalg.inv(precision)


# --- directions


def test_directions_of_a_linear_model_are_those_of_its_curvature():
    curvature = (DESIGN * PRIOR_SD).T @ (DESIGN * PRIOR_SD) / NOISE**2
    values, vectors = np.linalg.eigh(curvature)
    found = find_directions(NAMES, PRIOR_SD, exact_draws(linear_posterior()))
    np.testing.assert_allclose(found.curvature, values[::-1], rtol=1e-6, atol=1e-9)
    alignment = np.abs(np.sum(found.axes * vectors[:, ::-1], axis=0))
    np.testing.assert_allclose(alignment, 1.0, atol=1e-9)
    assert found.informed == 2
    assert found.carriers(2) == ("c",)  # which the data do not see


@pytest.mark.parametrize(("draws", "dim"), [(100, 20), (60, 20), (100, 5)])
def test_few_draws_without_information_inform_no_direction(draws, dim):
    rng, names = np.random.default_rng(2), tuple("x" * dim)
    found = [
        find_directions(names, np.ones(dim), rng.normal(size=(draws, dim))).informed
        for _ in range(200)
    ]
    assert np.mean(found) < 0.05  # 3 without the limit, of 100 draws in 20 dimensions


def test_draws_that_follow_each_other_count_as_fewer():
    rng = np.random.default_rng(4)
    held = np.repeat(rng.normal(size=(100, 20)), 30, axis=0)
    names = tuple("x" * 20)
    assert find_directions(names, np.ones(20), held, 100.0).informed == 0
    assert find_directions(names, np.ones(20), held).informed > 0  # the control
    assert find_directions(names, np.ones(20), held, 15.0).informed == 0  # fewer than dimensions


# --- pairs


def test_pairs_that_trade_off_are_named():
    r = -0.85
    normal = exact_draws(np.array([[1.0, r, 0.0], [r, 1.0, 0.0], [0.0, 0.0, 1.0]]), 20000)
    (pair,) = find_pairs(NAMES, np.exp(3 * normal))  # ranks are the same on any scale
    assert (pair.first, pair.second) == ("a", "b")
    assert pair.correlation == pytest.approx(6 / np.pi * np.arcsin(r / 2), abs=0.01)


def test_independent_parameters_do_not_trade_off():
    assert find_pairs(NAMES, np.random.default_rng(2).normal(size=(4000, 3))) == ()
    assert find_pairs(("a",), np.random.default_rng(2).normal(size=(4000, 1))) == ()


# --- power-scaling


def normal_normal(prior_mean, prior_sd, data_mean, data_sd, alphas=(1.0, 1.0)):
    """Mean and sd of the posterior with prior and likelihood raised to two powers."""
    precision = np.array([alphas[0] / prior_sd**2, alphas[1] / data_sd**2])
    total = precision.sum()
    return precision @ [prior_mean, data_mean] / total, total**-0.5


def normal_distance(base, moved, low, high):
    """The distance of two normals, by quadrature of its formula."""
    p, q = stats.norm(*base), stats.norm(*moved)
    sides = []
    for name in ("cdf", "sf"):
        first, second = getattr(p, name), getattr(q, name)

        def divergence(x, first=first, second=second):
            a, b = first(x), second(x)
            m = 0.5 * (a + b)
            return special.xlogy(a, a / m) + special.xlogy(b, b / m)

        top = integrate.quad(divergence, low, high, epsabs=1e-14, limit=200)[0]
        size = integrate.quad(lambda x, f=first, s=second: f(x) + s(x), low, high)[0]
        sides.append(np.sqrt(top / np.log(2) / size))
    return max(sides)


def drawn(case, n=40000):
    """Draws of a normal-normal posterior with their log densities, (4, n/4) each."""
    mean, sd = normal_normal(*case)
    grid = mean + sd * stats.norm.ppf((np.arange(n) + 0.5) / n)
    x = np.random.default_rng(5).permutation(grid).reshape(4, -1)
    return x, stats.norm(*case[:2]).logpdf(x), stats.norm(*case[2:]).logpdf(x)


def sensitivity(case):
    x, log_prior, log_likelihood = drawn(case)
    return measure_sensitivity(("x",), x[None], log_prior, log_likelihood)[0]


CASES = {
    "likelihood-dominated": (0.0, 10.0, 1.0, 0.1),
    "prior-dominated": (0.0, 0.1, 1.0, 10.0),
    "both": (0.0, 1.0, 0.3, 1.0),
    "conflict": (0.0, 0.5, 4.0, 0.5),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_sensitivity_of_a_normal_model_is_its_closed_form(case):
    found = sensitivity(case)
    x = drawn(case)[0]
    for at, value in enumerate((found.prior, found.likelihood)):
        expected = 0.0
        for power in (1.01, 1 / 1.01):
            alphas = (power, 1.0) if at == 0 else (1.0, power)
            moved = normal_normal(*case, alphas)
            expected += normal_distance(normal_normal(*case), moved, x.min(), x.max())
        assert value == pytest.approx(expected / 2 / np.log2(1.01), rel=0.02, abs=2e-3)
    diagnoses = {"prior-dominated": PRIOR_LED, "conflict": CONFLICT, "likelihood-dominated": ""}
    name = next(name for name in CASES if CASES[name] == case)
    assert found.diagnosis == diagnoses.get(name, found.diagnosis)


def walks(seed, phi=0.98, steps=500, walkers=8):
    """Slow AR(1) chains, (4, walkers · steps), ordered by walker: an ESS of about 160."""
    noise = np.random.default_rng(seed).normal(size=(steps, 4, walkers))
    walk = np.empty_like(noise)
    walk[0] = noise[0]
    for k in range(1, steps):
        walk[k] = phi * walk[k - 1] + np.sqrt(1 - phi**2) * noise[k]
    return walk.transpose(1, 2, 0).reshape(4, -1)


def test_few_draws_do_not_pass_for_sensitivity():
    found = [
        measure_sensitivity(("x",), walks(seed)[None], 8 * walks(seed + 100), walks(seed + 200))[0]
        for seed in range(20)
    ]
    raised = [s for s in found if s.prior_limit > SENSITIVE]
    assert len(raised) > 15  # with so few draws, chance alone exceeds the limit …
    assert sum(s.diagnosis != "" for s in found) <= 3  # … and is recognised as chance
    # the control: the same number of draws shows a real effect
    x = walks(7)
    seen = measure_sensitivity(("x",), x[None], 8 * x, walks(207))[0]
    assert seen.diagnosis == PRIOR_LED


def test_sensitivity_is_that_of_arviz():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # announcements of it and of its imports
        import arviz as az
    x, log_prior, log_likelihood = drawn(CASES["conflict"], 4000)
    if hasattr(az, "psens"):
        data = az.from_dict({"x": x})
        data.add_groups({"log_prior": {"x": log_prior}})
        theirs = az.psens(data, component="prior")
    else:
        data = az.from_dict({"posterior": {"x": x}, "log_prior": {"x": log_prior}})
        theirs = az.psense(data, group="prior")
    ours = measure_sensitivity(("x",), x[None], log_prior, log_likelihood)[0]
    assert ours.prior == pytest.approx(float(theirs["x"]), rel=0.02)


# --- a test of a damper


def test_draws_of_the_prior_say_that_the_data_tell_nothing():
    time = np.arange(0, 2, 1 / 32)
    motion = np.sin(np.pi * time)
    trace = Trace.from_arrays(time, motion, actuation=0.8, force=np.cos(np.pi * time))
    posterior = Posterior(trace, "mfd")
    rng = np.random.default_rng(8)
    flat = posterior.draw_prior(rng, 8000)
    log_prior = posterior.log_prior(posterior.coordinates(flat)).reshape(4, -1)
    values = {name: column.reshape(4, -1) for name, column in flat.items()}
    found = identify(
        posterior, values, posterior.draw_prior(rng, 8000), log_prior, rng.normal(size=(4, 2000))
    )
    assert found.directions.names == posterior.names
    assert found.directions.informed == 0
    assert found.pairs == ()
    assert [s.name for s in found.sensitivities] == list(posterior.names)
    assert all(s.diagnosis == PRIOR_LED for s in found.sensitivities)
    assert all(s.likelihood < 0.02 for s in found.sensitivities)
