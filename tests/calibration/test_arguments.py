"""Arguments that do not fit are refused by the posterior and its sampling, by one sentence each."""

import numpy as np
import pandas as pd
import pytest

from mfd_bayes.calibration.diagnostics import Effort, find_effort
from mfd_bayes.calibration.noise import find_noise
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.sampling import generator_of, sample
from mfd_bayes.errors import FitError
from mfd_bayes.records.trace import Trace

TIME = np.arange(101) / 25.0
TRACE = Trace.from_arrays(
    TIME, np.sin(np.pi * TIME), 0.5, np.tanh(4 * np.cos(np.pi * TIME)), hysteresis=0.0
)


@pytest.fixture(scope="module")
def posterior():
    return Posterior(TRACE, "mfd", "ou")


@pytest.fixture(scope="module")
def values(posterior):
    return posterior.draw_prior(np.random.default_rng(1), 3)


# --- posterior


@pytest.mark.parametrize("trace", [None, TIME, "a"])
def test_a_posterior_needs_a_trace(posterior, values, trace):
    with pytest.raises(FitError, match="trace must be a Trace"):
        Posterior(trace, "mfd")
    if trace is not None:
        with pytest.raises(FitError, match="trace must be a Trace"):
            posterior.force(values, trace)


def test_a_posterior_can_be_a_key(posterior):
    other = Posterior(TRACE, "mfd", "ou")
    assert {posterior: 1}[posterior] == 1
    assert posterior != other


def test_a_table_of_points_is_read_by_its_names(posterior, values):
    q = posterior.coordinates(values)
    table = pd.DataFrame(q, columns=list(posterior.names))
    shuffled = table[sorted(table.columns)]
    assert list(shuffled.columns) != list(table.columns)
    for density in (posterior.log_prob, posterior.log_prior, posterior.log_likelihood):
        np.testing.assert_array_equal(density(shuffled), density(q))
    with pytest.raises(FitError, match=r"q is a table, .* it lacks"):
        posterior.log_prob(pd.DataFrame(q))


def test_far_out_the_likelihood_is_nothing(posterior, values):
    q = posterior.coordinates(values)
    near = posterior.log_likelihood(q)
    assert np.all(np.isfinite(near))
    far = np.repeat(q[:1], 3, axis=0)
    far[1, posterior.names.index("sigma0")] = -1000.0
    far[2, posterior.names.index("Fc_fwd")] = 1000.0
    found = posterior.log_likelihood(far)
    np.testing.assert_array_equal(found[1:], [-np.inf, -np.inf])
    np.testing.assert_allclose(found[0], near[0], rtol=1e-9)
    assert np.all(posterior.log_prob(far)[1:] == -np.inf)


@pytest.mark.parametrize("given", [{}, None, [1.0], "a"])
def test_values_are_given_by_name(posterior, given):
    for result in (posterior.coordinates, posterior.force, posterior.theta):
        with pytest.raises(FitError, match=r"values (by name lack|must be a mapping)"):
            result(given)


def test_values_have_one_shape(posterior, values):
    with pytest.raises(FitError, match=r"values of k2 must have shape \(3,\), got \(\)"):
        posterior.coordinates(values | {"k2": 1.0})
    with pytest.raises(FitError, match="values by name lack start"):
        posterior.force({name: value for name, value in values.items() if name != "start"})


@pytest.mark.parametrize("rng", [0, None, "a", np.random.default_rng])
def test_draws_need_a_generator(posterior, rng):
    with pytest.raises(FitError, match="rng must be a generator"):
        posterior.draw_prior(rng, 3)


# --- sampling


@pytest.mark.parametrize("given", [None, TRACE, Posterior, "a"])
def test_only_a_posterior_is_sampled(given):
    with pytest.raises(FitError, match="posterior must be a Posterior, got"):
        sample(given, "quick")


def test_a_report_is_a_function(posterior):
    with pytest.raises(FitError, match="report must be a function"):
        sample(posterior, "quick", report=5)


@pytest.mark.parametrize("name", [["ou"], None, {}, 5, "pink"])
def test_a_noise_or_an_effort_that_is_none_is_refused(name):
    with pytest.raises(FitError, match="unknown noise"):
        find_noise(name)
    with pytest.raises(FitError, match="unknown effort"):
        find_effort(name)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("ess", ("many", np.nan, 0, -1, None, True)),
        ("r_hat", ("1", np.nan, 0.0)),
        ("length", ("1", np.nan, -1.0)),
        *[(n, (0, -5, 1.5, np.nan, "1", None, True)) for n in ("limit", "starts", "kept")],
        *[(n, (0, -5, 1.5, "1", None)) for n in ("ensembles", "walkers")],
    ],
)
def test_an_effort_has_numbers_that_can_be(name, values):
    good = {"ess": 100, "limit": 200}
    assert Effort(**good).starts == 24
    for value in values:
        with pytest.raises(FitError, match=f"{name} of an effort must be a"):
            Effort(**good | {name: value})


def first(seed):
    """First random numbers of a seed."""
    return tuple(generator_of(seed).integers(2**62, size=2))


def test_seeds_of_another_length_give_other_numbers():
    seeds = (1, 0, 2**32 + 1, [1, 0], [1, 0, 0], (1, 2), [0, 0], [0, 1], [1, 2, 0], [1, 0, 0, 0, 0])
    assert len({first(seed) for seed in seeds}) == len(seeds)
    numpys = {tuple(np.random.default_rng(s).integers(2**62, size=2)) for s in (1, [1, 0])}
    assert len(numpys) == 1  # it is NumPy that takes one for the other


@pytest.mark.parametrize("seed", [0, 1, 12345, 2**40, [7], (3, 4), [1, 0, 5], [2, 2**63]])
def test_other_seeds_are_those_of_numpy(seed):
    expected = tuple(np.random.default_rng(seed).integers(2**62, size=2))
    assert first(seed) == expected
    assert first(np.array(seed, dtype=np.uint64)) == expected


@pytest.mark.parametrize("seed", [[], (), np.array([], dtype=int), "", b"ab", [[1]], [True], "12"])
def test_a_seed_that_is_none_is_refused(seed):
    with pytest.raises(FitError, match="seed must be a whole number"):
        generator_of(seed)
