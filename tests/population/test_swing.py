"""Tests whose actuation changes: the slip force at its mean, whatever the law on the way."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.prior_files import load_priors
from mfd_bayes.friction.models import find_model
from mfd_bayes.population.design import lay_out
from mfd_bayes.population.pilot import fit_pilot
from mfd_bayes.population.settings import setting_of
from mfd_bayes.population.swing import swing_of
from mfd_bayes.population.working import working_likelihood
from mfd_bayes.records.trace import Trace

INTERCEPT, SLOPE, NOISE = 0.5, 2.0, 0.05
PRIORS = load_priors("mfd")
_FRICTION = {
    "sigma0": 40.0,
    "sigma1": 0.01,
    "sigma2": 0.01,
    "static_excess_fwd": 0.1,
    "static_excess_bwd": 0.1,
    "v_s": 0.5,
}
TRUTHS = {
    "backlash": {
        "k_fwd": 40.0,
        "k_bwd": 45.0,
        "gap": 0.15,
        "ell": 0.01,
        "k_0": 0.3,
        "n": 2.5,
        "sigma2": 0.01,
        "static_excess_fwd": 0.1,
        "static_excess_bwd": 0.1,
        "v_s": 0.5,
    },
    "lugre": _FRICTION,
    "three_stage": _FRICTION
    | {"k2": 1.0, "k3": 30.0, "d2": 0.1, "d3": 0.07, "gamma1": 1.0, "ell": 0.01},
}


def friction(p):
    return INTERCEPT + SLOPE * p


def record(p, seed, model="backlash"):
    """A record under an actuation and an affine law, and its quantities."""
    t, found = np.arange(0.0, 12.0, 1.0 / 64.0), find_model(model)
    bare = Trace.from_arrays(t, np.sin(np.pi * t), p)
    level = bare.reference_actuation
    values = {"start": 0.5, "offset": 0.0, "noise_sd": NOISE} | TRUTHS[model]
    values |= {"Fc_fwd": friction(level), "Fc_bwd": friction(level)}
    arrays = {name: np.array([value]) for name, value in values.items()}
    factor = np.broadcast_to(friction(p) / friction(level), t.shape)[None]
    follows = {*found.laws, *found.tied_laws}
    scales = dict.fromkeys(follows, factor)
    force = found.force(found.theta(arrays), bare, arrays["start"], scales=scales)[0]
    force = force + NOISE * np.random.default_rng(seed).standard_normal(t.size)
    return Trace.from_arrays(t, bare.displacement, p, force), arrays


def swinging(share):
    t = np.arange(0.0, 12.0, 1.0 / 64.0)
    return 0.8 * (1.0 + share * np.sin(0.8 * t))


def fitted(law, model="backlash", *, swings=True):
    """Slip force of a swinging test over the truth less one, its sd, and the noise over truth."""
    made = [record(p, seed, model) for seed, p in enumerate((0.4, 0.8, 1.2, swinging(0.6)))]
    posteriors = [Posterior(trace, PRIORS, "iid", find_model(model)) for trace, _ in made]
    settings = [setting_of(trace) for trace, _ in made]
    laws = dict(find_model(model).laws) | {"Fc_fwd": law, "Fc_bwd": law}
    layout = lay_out(PRIORS, posteriors[0].names, settings, laws)
    working = [working_likelihood(layout, posterior, PRIORS) for posterior in posteriors]
    if not swings:
        d = len(working[-1].order)
        cut = {"middle": working[-1].middle[:d], "scale": working[-1].scale[:d], "swing": None}
        working[-1] = replace(working[-1], **cut)
    starts = [start_of(one, values) for one, (_, values) in zip(working, made, strict=True)]
    test, k = fit_pilot(working, starts).tests[-1], layout.names.index("Fc_fwd")
    covariance = np.linalg.inv(test.precision + np.eye(test.mean.size))
    mean = covariance @ (test.precision @ test.mean)
    at = layout.names.index("noise_sd")
    noise = np.exp(layout.spread[at] * (mean[at] - starts[-1][at]))
    size = layout.spread[k]
    return size * (mean[k] - starts[-1][k]), size * np.sqrt(covariance[k, k]), noise


def start_of(working, values):
    """The truth in the coordinates of a test."""
    x, priors = np.zeros(working.middle.size), working.posterior.priors
    own = [priors[name].coordinate(values[name]) for name in working.own]
    q = np.concatenate([working.layout.coordinates.of(values)[0], *own])
    x[: q.size] = (q - working.middle[: q.size]) / working.scale[: q.size]
    return x


@pytest.mark.parametrize("law", ["affine", "residual_power", "compare"])
def test_the_slip_force_at_the_mean_actuation_is_found(law):
    away, sd, noise = fitted(law)
    assert abs(away) < 3.0 * sd
    assert sd < 0.02
    assert noise == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("model", ["three_stage", "lugre"])
def test_it_is_found_by_other_models(model):
    away, sd, noise = fitted("affine", model)
    assert abs(away) < 3.0 * sd
    assert sd < 0.02
    assert noise == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("model", TRUTHS)
def test_in_proportion_it_is_not_found(model):
    """The negative control: without shapes of its own the same fit is wrong, and knows it not."""
    away, sd, noise = fitted("affine", model, swings=False)
    assert away < -4.0 * sd
    assert noise > 1.5


def test_nothing_changes_where_the_law_is_proportional_or_the_actuation_steady():
    model = find_model("backlash")
    names = Posterior(record(0.8, 0)[0], PRIORS, "iid", model).names
    steady, swung = record(swinging(0.02), 0)[0], record(swinging(0.3), 0)[0]
    for law, trace, expected in (
        ("proportional", swung, False),
        ("affine", steady, False),
        ("affine", record(0.8, 0)[0], False),
        ("affine", swung, True),
        ("constant", swung, True),
    ):
        layout = lay_out(PRIORS, names, [setting_of(trace)], {"Fc_fwd": law, "Fc_bwd": law})
        assert (swing_of(layout, model, trace) is not None) == expected


def test_factors_are_those_of_the_shapes():
    model, trace = find_model("three_stage"), record(swinging(0.3), 0)[0]
    names = Posterior(trace, PRIORS, "iid", model).names
    laws = {"Fc_fwd": "affine", "Fc_bwd": "constant", "sigma0": "proportional"}
    swing = swing_of(lay_out(PRIORS, names, [setting_of(trace)], laws), model, trace)
    level = trace.reference_actuation
    share = SLOPE * level / friction(level)
    of = dict.fromkeys(swing.shapes, 0.0)
    of |= {("Fc_fwd", "share"): np.log(share / (1.0 - share)), ("Fc_fwd", "exponent"): 1.0}
    scales = swing.scales(np.array([list(of.values())]))
    expected = friction(trace.actuation) / friction(level)
    np.testing.assert_allclose(scales["Fc_fwd"][0], expected)
    np.testing.assert_allclose(scales["Fs_fwd"][0], expected)
    np.testing.assert_allclose(scales["Fc_bwd"][0], 1.0)
    np.testing.assert_allclose(scales["sigma0"][0], trace.actuation / level)
    assert set(swing.shapes) == {("Fc_fwd", "share"), ("Fc_fwd", "exponent")}
