"""The density of a test's parameters: coordinates, prior, likelihood, and what is refused."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from mfd_bayes.calibration.diagnostics import derive_from_parameters
from mfd_bayes.calibration.noises import NOISES
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import Prior, load_priors
from mfd_bayes.errors import FitError, PriorError
from mfd_bayes.friction.three_stage import LuGre, ThreeStage
from mfd_bayes.records.trace import Trace

FILE = load_priors("brfd")
TIME = np.arange(0, 4, 1 / 64)
MOTION = np.sin(2 * np.pi * 0.5 * TIME)
FORCE = 2.0 * np.tanh(20 * np.cos(2 * np.pi * 0.5 * TIME))
TRACE = Trace.from_arrays(TIME, MOTION, actuation=0.03, force=FORCE)
CASES = pytest.mark.parametrize(
    ("model", "noise", "initial"),
    [
        ("three_stage", "ou", "sample"),
        ("three_stage", "student_t", "discard"),
        ("lugre", "iid", "sample"),
        ("bouc_wen", "ou", "sample"),
        ("backlash", "staged", "discard"),
    ],
)


def build(model="three_stage", noise="ou", initial="sample", *, trace=TRACE, priors=None):
    file = replace(FILE, parameters=FILE.parameters | (priors or {}))
    return Posterior(trace, file, noise, model, initial=initial)


def points(posterior, n=20, seed=0):
    return posterior.coordinates(posterior.sample_prior(n, seed))


def with_force(force):
    return Trace.from_arrays(TIME, MOTION, actuation=0.03, force=force)


@CASES
def test_the_density_is_prior_times_the_likelihood_computed_by_hand(model, noise, initial):
    posterior = build(model, noise, initial)
    draws, begin = posterior.sample_prior(20, 0), posterior.first
    q = posterior.coordinates(draws)
    values = posterior.values(q)
    for name in posterior.names:  # which invert each other
        np.testing.assert_allclose(values[name], draws[name], rtol=1e-9, atol=1e-12)
    position = values["start"] if posterior.model.has_gap else None
    force = posterior.model.force(posterior.model.theta(values), TRACE, position)
    residual = FORCE - values["offset"][:, None] - force
    np.testing.assert_allclose(posterior.residual(q), residual, rtol=1e-12, atol=1e-12)
    travel = posterior.travel(values)
    travel = None if travel is None else travel[:, begin:]
    expected = NOISES[noise].log_density(residual[:, begin:], TIME[begin:], values, travel)
    np.testing.assert_allclose(posterior.log_likelihood(q), expected, rtol=1e-12)
    total = posterior.log_prob(q)
    np.testing.assert_allclose(total, posterior.log_prior(q) + expected, rtol=1e-12)
    single = [posterior.log_prob(point[None])[0] for point in q[:5]]
    np.testing.assert_allclose(total[:5], single, rtol=1e-9)


@pytest.mark.parametrize("model", ["three_stage", "backlash"])
def test_the_prior_is_normalised(model):
    # E[exp(log r - log p)] = 1 with r a normalised density narrower than the prior p
    posterior = build(model, "iid")
    q = points(posterior, 20000, seed=3)
    narrower = stats.multivariate_normal(q.mean(axis=0), 0.5 * np.cov(q.T))
    ratio = np.exp(narrower.logpdf(q) - posterior.log_prior(q))
    error = ratio.std() / np.sqrt(ratio.size)
    assert ratio.mean() == pytest.approx(1.0, abs=4 * error)
    assert error < 0.08


def test_far_out_the_density_is_nothing():
    posterior = build()
    for far in (-1e5, 1e5, np.inf, -np.inf):
        q = np.repeat(points(posterior, 1), posterior.dim + 1, axis=0)
        q[np.arange(posterior.dim), np.arange(posterior.dim)] = far
        density = posterior.log_prob(q)
        assert np.isfinite(density[-1])
        # a logit or a plain coordinate is far out at 1e5, the logarithm of a value beyond range
        assert np.all(density[:-1] < -9e4)


def test_gamma1_is_not_sampled_but_keeps_its_prior():
    posterior = build()
    assert "gamma1" not in posterior.names
    np.testing.assert_array_equal(posterior.values(points(posterior, 3))["gamma1"], 1.0)
    draws = posterior.sample_prior(500, 0)
    assert np.std(np.log(draws["gamma1"])) == pytest.approx(0.5, rel=0.15)
    columns = dict(zip(ThreeStage().parameters, posterior.theta(draws).T, strict=True))
    np.testing.assert_allclose(columns["gamma2"] / columns["gamma1"], draws["ell"])
    assert np.all(columns["Fs_fwd"] >= columns["Fc_fwd"])


def test_a_fixed_prior_removes_a_dimension():
    for name in ("v_s", "static_excess_fwd", "start", "offset"):
        posterior = build(priors={name: Prior("fixed", {"value": 0.2})})
        assert set(build().names) - set(posterior.names) == {name}
        q = points(posterior)
        np.testing.assert_array_equal(posterior.values(q)[name], 0.2)
        np.testing.assert_allclose(posterior.coordinates(posterior.values(q)), q, atol=1e-9)
        assert np.all(np.isfinite(posterior.log_prob(q)))


def test_a_mask_drops_the_samples_before_the_first_slip():
    posterior = build(initial="discard")
    assert "start" not in posterior.names
    assert np.abs(MOTION[: posterior.first + 1] - MOTION[0]).max() > 2 * FILE.gap
    q = points(posterior)
    expected = posterior.log_likelihood(q)
    for sample, matters in ((posterior.first - 1, False), (posterior.first, True)):
        force = FORCE.copy()
        force[sample] += 5.0
        masked = build(initial="discard", trace=with_force(force))
        assert np.all((masked.log_likelihood(q) != expected) == matters)
    # where the device began does not matter afterwards
    values = posterior.sample_prior(10, 5)
    values |= {"d2": np.full(10, 0.1), "d3": np.full(10, 0.1), "ell": np.full(10, 0.005)}
    forces = [posterior.force(values | {"start": np.full(10, w)}) for w in (0.05, 0.95)]
    fitted = slice(posterior.first, None)
    np.testing.assert_allclose(forces[0][:, fitted], forces[1][:, fitted], atol=1e-5)


def test_points_and_values_are_taken_by_their_names():
    posterior = build()
    q = points(posterior, 3)
    table = pd.DataFrame(q, columns=list(posterior.names))
    np.testing.assert_array_equal(
        posterior.log_prob(table[sorted(table.columns)]), posterior.log_prob(q)
    )
    assert posterior.residual(np.empty((0, posterior.dim))).shape == (0, TIME.size)
    for function, bad, name in (
        (posterior.log_prob, pd.DataFrame(q), "lacks"),
        (posterior.log_prob, q[0], "q "),
        (posterior.log_prob, q[:, 1:], "q "),
        (posterior.log_prob, np.full_like(q, np.nan), "q "),
        (posterior.force, {}, "values"),
        (posterior.force, None, "values"),
        (posterior.coordinates, posterior.values(q) | {"k2": 1.0}, "k2"),
        (lambda seed: posterior.sample_prior(3, seed), "x", "seed"),
    ):
        with pytest.raises(FitError, match=name):
            function(bad)


SLOW = Trace.from_arrays(TIME, 0.01 * MOTION, actuation=0.03, force=FORCE)
LATE = Trace.from_arrays(
    TIME,
    0.05 * np.sin(4 * np.pi * TIME) + 20.0 * np.maximum(TIME - 0.9 * TIME[-1], 0.0),
    actuation=0.03,
    force=FORCE,
)


def test_what_makes_no_posterior_is_refused():
    for trace, options, name in (
        (None, {}, "trace"),
        (TIME, {}, "trace"),
        (Trace.from_arrays(TIME, MOTION), {}, "force"),
        (TRACE, {"model": "maxwell"}, "maxwell"),
        (TRACE, {"model": 3}, "model"),
        (TRACE, {"noise": "pink"}, "pink"),
        (TRACE, {"priors": "brdf"}, "brdf"),
        (TRACE, {"initial": "masked"}, "initial"),
        (SLOW, {"initial": "discard"}, "discard"),
        (LATE, {"initial": "discard"}, "discard"),
    ):
        with pytest.raises((FitError, PriorError), match=name):
            Posterior(trace, **{"priors": "brfd"} | options)


def test_a_prior_that_allows_what_no_damper_has_is_refused():
    for model, name, prior in (
        ("three_stage", "k3", Prior("normal", {"mean": 1.0, "sd": 1.0})),
        ("bouc_wen", "exponent", Prior("lognormal", {"median": 2.0, "sigma": 0.5})),
        ("bouc_wen", "exponent", Prior("fixed", {"value": 0.5})),
        ("bouc_wen", "alpha", Prior("half_normal", {"sd": 0.1})),
    ):
        with pytest.raises(PriorError, match=rf"{name} in brfd\.toml"):
            build(model, priors={name: prior})
        build("lugre", priors={name: prior})  # a model without this parameter
        fewer = {key: value for key, value in FILE.parameters.items() if key != name}
        with pytest.raises(PriorError, match=name):
            Posterior(TRACE, replace(FILE, parameters=fewer), model=model)


# --- what is computed of draws


def test_gap_and_self_energizing_factors_follow_from_the_parameters():
    columns = {"d2": [0.1, 0.2], "d3": [0.05, 0.1], "Fc_fwd": [2.0, 4.0], "Fc_bwd": [6.0, 8.0]}
    values = {name: np.array(column) for name, column in columns.items()}
    derived = derive_from_parameters(ThreeStage(), values, pressure=0.5, area=4.0)
    for name, expected in (("slip_to_slip", [0.15, 0.3]), ("C_fwd", [1, 2]), ("C_bwd", [3, 4])):
        np.testing.assert_allclose(derived[name], expected)
    assert set(derive_from_parameters(ThreeStage(), values)) == {"slip_to_slip"}
    unloaded = derive_from_parameters(ThreeStage(), values, pressure=0.0, area=2.0)
    assert set(unloaded) == {"slip_to_slip"}
    assert derive_from_parameters(LuGre(), values) == {}
