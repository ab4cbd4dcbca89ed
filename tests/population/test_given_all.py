"""With the whole record given, a prediction is the posterior of that test by itself."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.sampling import sample
from mfd_bayes.population.bands import Forecast
from mfd_bayes.population.given import predict_given
from mfd_bayes.population.design import lay_out
from mfd_bayes.population.population import Population
from mfd_bayes.population.bands import Predictor
from mfd_bayes.population.strokes import no_levels

PRIORS = 4000
"""Draws of the prior that stand for draws of a population without scatter."""


def of_prior(population: Population, posterior: Posterior, priors) -> Population:
    """A population whose tests have the prior of a test by itself."""
    layout = replace(
        lay_out(priors, population.layout.names, population.layout.settings), reference=1.0
    )
    drawn = posterior.draw_prior(np.random.default_rng(1), PRIORS)
    level = layout.coordinates.of({name: drawn[name] for name in layout.names})
    latent = np.zeros((4, PRIORS // 4, population.latent.shape[2], level.shape[1]))
    latent[:, :, 0] = ((level - layout.centre) / layout.spread).reshape(4, -1, level.shape[1])
    h = np.zeros((4, PRIORS // 4, population.h.shape[2]))
    h[..., : level.shape[1] + len(layout.effects)] = np.log(1e-6)
    return replace(
        population,
        layout=layout,
        latent=latent,
        h=h,
        choice=layout.draw_choice(PRIORS).reshape(4, PRIORS // 4, -1),
        together=np.broadcast_to(np.eye(level.shape[1]), (*h.shape[:2], *[level.shape[1]] * 2)),
        priors={n: posterior.priors[n] for n in (*layout.names, "start", "gamma1")},
    )


def compared(tools, priors, seed):
    """Quantities of one test: its own posterior draws, and those of a prediction given it all."""
    study = tools.make_study()
    residual = study.predictor.population.residual
    nothing = replace(
        residual,
        mean=np.zeros_like(residual.mean),
        covariance=1e-12 * np.eye(residual.mean.size),
        levels=no_levels(residual.mean.size),
    )
    even = replace(study.predictor.population, residual=nothing)
    study = replace(study, predictor=replace(study.predictor, population=even))
    truth = tools.draw_truth(study, np.random.default_rng(seed))
    posterior = Posterior(truth.trace, priors, "iid")
    own = sample(posterior, "quick", seed=1)
    values = posterior.values(own.q.reshape(-1, own.q.shape[-1]))
    predictor = Predictor(of_prior(even, posterior, priors), posterior.model, posterior.noise)
    window = 0.0, float(truth.trace.time[-1])
    band = predict_given(predictor, truth.trace, Forecast(draws=1000), window, study.pace)
    return values, band.values


@pytest.mark.slow
def test_with_everything_given_it_is_the_tests_own_posterior(benchmark_module):
    priors = benchmark_module("sbc.study").narrow_priors()
    values, found = compared(benchmark_module("given.study"), priors, 6)
    for name in ("Fc_fwd", "Fc_bwd", "k3", "d2", "ell", "offset", "noise_sd", "start"):
        middle, sd = values[name].mean(), values[name].std()
        assert abs(found[name].mean() - middle) < 0.3 * sd, name
        assert found[name].std() == pytest.approx(sd, rel=0.3), name
