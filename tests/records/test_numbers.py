"""Wrong input in Python raises an error of this package; empty batches give empty results."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pint
import pytest

import mfd_bayes as mb
from mfd_bayes.calibration.prior_files import load_priors
from mfd_bayes.errors import FitError, RecordError
from mfd_bayes.friction.models import MODELS
from mfd_bayes.population.bands import Forecast
from mfd_bayes.records.numbers import real_number, real_numbers
from mfd_bayes.records.regular import path_of
from mfd_bayes.records.trace import check_trace

TIME = np.arange(101) / 25.0
MOTION = np.sin(np.pi * TIME)


@pytest.fixture(params=MODELS)
def model(request):
    return MODELS[request.param]


@pytest.fixture
def posterior():
    trace = mb.Trace.from_arrays(TIME, MOTION, 0.5, np.tanh(4 * np.cos(np.pi * TIME)))
    return mb.Posterior(trace, priors="mfd", noise="ou")


def some_theta(model, n=3):
    priors = load_priors("mfd").parameters
    rng = np.random.default_rng(1)
    drawn = {name: p.draw(rng, n) for name, p in priors.items()}
    return model.theta({"gamma1": np.ones(n), **drawn})


def test_an_empty_batch_gives_an_empty_result(model):
    trace = mb.Trace.from_arrays(TIME, MOTION, 0.5)
    assert model.force(some_theta(model)[:0], trace).shape == (0, TIME.size)
    assert model.travel(some_theta(model)[:0], trace).shape == (0, TIME.size)
    varying = mb.Trace.from_arrays(TIME, MOTION, np.linspace(0.4, 0.6, TIME.size))
    assert model.force(some_theta(model)[:0], varying).shape == (0, TIME.size)


def test_a_posterior_takes_and_gives_empty_batches(posterior):
    drawn = posterior.draw_prior(np.random.default_rng(0), 0)
    assert {values.shape for values in drawn.values()} == {(0,)}
    q = np.empty((0, posterior.dim))
    for density in (posterior.log_prob, posterior.log_prior, posterior.log_likelihood):
        assert density(q).shape == (0,)


@pytest.mark.parametrize("n", [-1, 1.5, "2", None, True])
def test_a_number_of_draws_that_is_none_is_refused(posterior, n):
    with pytest.raises(FitError, match="must be a whole number, 0 or more"):
        posterior.draw_prior(np.random.default_rng(0), n)


@pytest.mark.parametrize("seed", [-1, 0.5, "x", [1, -2], None])
def test_a_seed_that_is_none_is_refused(posterior, seed):
    with pytest.raises(FitError, match="seed must be a whole number"):
        mb.sample(posterior, "quick", seed)
    if not isinstance(seed, list):
        with pytest.raises(FitError, match="seed must be a whole number"):
            Forecast(seed=seed)


@pytest.mark.parametrize("dt", [-0.1, np.nan, np.inf])
def test_a_step_of_no_time_is_refused_from_the_first_sample_on(dt):
    theta = some_theta(mb.ThreeStage())
    state = mb.ThreeStage().start(theta)
    with pytest.raises(FitError, match="dt of a step"):
        mb.ThreeStage().step(state, 0.0, 1.0, dt)
    _, state = mb.ThreeStage().step(state, 0.0, 1.0, 0.0)
    with pytest.raises(FitError, match="dt of a step"):
        mb.ThreeStage().step(state, 0.1, 1.0, dt)


@pytest.mark.parametrize("hysteresis", [np.nan, np.inf, -1e-3])
def test_a_hysteresis_that_is_no_length_is_refused(hysteresis):
    with pytest.raises(RecordError, match="hysteresis"):
        mb.Trace.from_arrays(TIME, MOTION, hysteresis=hysteresis)


WRONG = {
    "masked": lambda x: np.ma.masked_greater(x, np.median(x)),
    "complex": lambda x: x + 1j,
    "text": lambda x: x.astype(str),
    "objects": lambda x: np.array([*x.ravel()[:-1], "a"], dtype=object).reshape(x.shape),
    "dates": lambda x: np.full(x.shape, np.datetime64("2020-01-01")),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_are_no_real_numbers_is_not_cast(model, posterior, name):
    wrong, words = WRONG[name], "masked" if name == "masked" else "real numbers"
    with pytest.raises(RecordError, match=words):
        mb.Trace.from_arrays(TIME, wrong(MOTION))
    with pytest.raises(RecordError, match=words):
        mb.Trace.from_arrays(TIME, MOTION, wrong(1.0 + MOTION**2))
    with pytest.raises(FitError, match=words):
        model.force(wrong(some_theta(model)), mb.Trace.from_arrays(TIME, MOTION, 0.5))
    with pytest.raises(FitError, match=words):
        posterior.log_prob(wrong(np.zeros((2, posterior.dim)) + np.arange(2)[:, None]))


@pytest.mark.parametrize("values", [[1, 2], (1.0, True), np.ma.array([1.0, 2.0]), np.float32([1])])
def test_real_numbers_of_every_kind_are_taken(values):
    np.testing.assert_array_equal(real_numbers("x", values), np.asarray(values, dtype=float))


def test_a_force_is_a_number_or_refused(model):
    trace = mb.Trace.from_arrays(TIME, MOTION, 0.5)
    theta = some_theta(model)
    rng = np.random.default_rng(2)
    powers = [0, 0, 0, -300, -38, -9, 9, 38, 300]
    factors = [1e300, *(10.0 ** rng.choice(powers, size=(120, theta.shape[1])))]
    taken = 0
    for factor in factors:
        odd = factor * theta
        try:
            force = model.force(odd, trace)
        except FitError:
            continue
        taken += 1
        assert np.all(np.isfinite(force)), odd
    assert taken > 5


# --- what one place checks for all


@pytest.mark.parametrize(
    "value", [2, 2.0, np.float32(2), np.int64(2), np.array(2.0), Fraction(4, 2)]
)
def test_a_number_is_taken_in_every_form(value):
    assert real_number("x", value, FitError, (0.0, np.inf)) == 2.0


@pytest.mark.parametrize(
    "value",
    [True, np.True_, "2", None, [2.0], np.array([2.0]), np.nan, np.inf, 10**400, 2 + 0j, -1.0],
)
def test_what_is_no_number_is_none(value):
    with pytest.raises(FitError, match="x must be a finite number of at least 0, got"):
        real_number("x", value, FitError, (0.0, np.inf))


@pytest.mark.parametrize(
    ("bounds", "words"),
    [
        ({}, "a finite number"),
        ({"bounds": (0.0, np.inf), "inside": True}, "a finite number above 0"),
        ({"bounds": (-np.inf, 1.0)}, "a finite number of at most 1"),
        ({"bounds": (0.0, 1.0), "inside": True}, "a number between 0 and 1"),
        ({"bounds": (0.0, 1.0)}, "a number from 0 to 1"),
    ],
)
def test_the_sentence_says_which_numbers_there_may_be(bounds, words):
    with pytest.raises(FitError, match=f"p must be {words}, got 'x'"):
        real_number("p", "x", FitError, **bounds)


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_a_number_inside_is_at_neither_end(value):
    assert real_number("p", value, FitError, (0.0, 1.0)) == value
    with pytest.raises(FitError):
        real_number("p", value, FitError, (0.0, 1.0), inside=True)


def test_a_unit_is_not_lost():
    """A pressure of 800 psi was taken for 800 ksi."""
    unit = pint.UnitRegistry()
    with pytest.raises(RecordError, match="actuation must be plain numbers without a unit"):
        mb.Trace.from_arrays(TIME, MOTION, 800 * unit.psi)
    with pytest.raises(RecordError, match="displacement must be plain numbers without a unit"):
        mb.Trace.from_arrays(TIME, MOTION * unit.mm, 0.8)
    with pytest.raises(FitError, match="got one in millimeter"):
        real_number("x", 3 * unit.mm, FitError)


@pytest.mark.parametrize("value", ["a/b", Path("a/b")])
def test_a_path_is_text_or_a_path(value):
    assert path_of("out", value, FitError) == Path("a/b")


@pytest.mark.parametrize("value", [None, 5, b"a", ["a"], "a\0b"])
def test_what_is_no_path_is_none(value):
    with pytest.raises(FitError, match="out must be a path"):
        path_of("out", value, FitError)


def test_a_trace_is_a_trace():
    trace = mb.Trace.from_arrays(TIME, MOTION, 0.5)
    assert check_trace("trace", trace, FitError) is trace
    with pytest.raises(FitError, match=r"trace must be a Trace, .* got ndarray"):
        check_trace("trace", MOTION, FitError)
