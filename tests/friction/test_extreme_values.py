"""Models and posteriors under values that no device has: a number, or a refusal."""

import contextlib

import numpy as np
import pytest

import mfd_bayes as mb
from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.errors import FitError
from mfd_bayes.friction.models import MODELS

TIME = np.arange(0.0, 8.0, 1 / 64)
MOTION = np.sin(np.pi * TIME)


def some_theta(model):
    rng = np.random.default_rng(1)
    drawn = {name: prior.draw(rng, 3) for name, prior in load_priors("mfd").parameters.items()}
    return model.theta({"gamma1": np.ones(3), **drawn})


def test_a_force_is_a_number_or_refused():
    for name in MODELS:
        model, trace = MODELS[name], mb.Trace.from_arrays(TIME, MOTION, 0.5)
        rng, theta = np.random.default_rng(2), some_theta(model)
        powers = [0, 0, 0, -300, -38, -9, 9, 38, 300]
        finite = []
        for factors in [1e300, *(10.0 ** rng.choice(powers, size=(60, theta.shape[1])))]:
            with contextlib.suppress(FitError):
                finite.append(np.isfinite(model.force(factors * theta, trace)).all())
        assert len(finite) > 5, name
        assert all(finite), name


def test_batches_are_real_numbers_and_may_be_empty():
    trace = mb.Trace.from_arrays(TIME, MOTION, 0.5, np.tanh(4 * np.cos(np.pi * TIME)))
    model, posterior = mb.ThreeStage(), mb.Posterior(trace, priors="mfd", noise="ou")
    assert model.force(np.empty((0, len(model.parameters))), trace).shape == (0, TIME.size)
    assert posterior.log_prob(np.empty((0, posterior.dim))).shape == (0,)
    for make in (lambda x: np.ma.masked_greater(x, 0), lambda x: x + 1j, lambda x: x.astype(str)):
        with pytest.raises(FitError, match=r"masked|real numbers"):
            model.force(make(np.ones((2, len(model.parameters)))), trace)
        with pytest.raises(FitError, match=r"masked|real numbers"):
            posterior.log_prob(make(np.ones((2, posterior.dim))))
    for seed in (-1, 0.5, "x", [1, -2], None):
        with pytest.raises(FitError, match="seed"):
            mb.sample(posterior, "quick", seed)
