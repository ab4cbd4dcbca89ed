"""Log densities of a population's draws: the prior that weighs them, and the tests' likelihoods."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from mfd_bayes.calibration.priors import Prior
from mfd_bayes.population.design import design_of
from mfd_bayes.population.hyperprior import log_prior, natural_levels
from tests.population.test_exact import SD, Campaign, Y
from tests.population.test_inference import LAW, LEVELS, infer, made_tests


@pytest.fixture(scope="module")
def inference(priors):
    return infer(priors, made_tests(priors, "three_stage", LEVELS), LAW | {"sigma0": "power"})


def test_the_sampler_keeps_the_likelihood_of_levels_and_scatter(priors):
    """That of a measured value is normal, with the variances of scatter and error."""
    campaign = Campaign(priors, Y, SD)
    draws = campaign.sampler().run(0.0, np.inf, 40, 10**9, lambda *_: None)
    tau = campaign.mixed.tau(draws.h.reshape(-1, draws.h.shape[-1])).reshape(*draws.h.shape[:2], 1)
    expected = stats.norm.logpdf(Y, draws.z[..., :1], np.hypot(tau, SD))
    assert np.ptp(draws.log_likelihood - expected, axis=(0, 1)).max() < 1e-8  # but for constants
    without_scatter = stats.norm.logpdf(Y, draws.z[..., :1], SD)
    assert np.ptp(draws.log_likelihood - without_scatter, axis=(0, 1)).min() > 0.1


def parts(inference, design):
    """Log prior of each draw, term by term, by SciPy."""
    population = inference.population
    draws, layout = population.draws, population.design
    d = len(design.names)
    level = natural_levels(layout, draws.z)
    log = stats.norm.logpdf(level, design.coordinates.centre[:d], design.spread).sum(axis=-1)
    log += stats.norm.logpdf(draws.z[..., d : layout.z_sd.size], 0.0, layout.z_sd[d:]).sum(axis=-1)
    scale = [*design.scatter_sd[design.free], *(effect.scale for effect in design.effects)]
    log += stats.halfnorm.logpdf(np.exp(draws.h), scale=scale).sum(axis=-1)
    law = list(layout.laws).index("sigma0")  # the one whose exponent is inferred
    log += stats.norm.logpdf(draws.exponent[..., law], 1.0, 0.5)
    for j in range(len(layout.settings)):
        start = inference.values(j)["start"]
        prior = design.coordinates.priors["start"]
        log += prior.log_density(prior.coordinate(start))
    return log


def test_the_prior_is_that_of_levels_scatter_laws_and_what_a_test_has_to_itself(priors, inference):
    layout = inference.population.design
    pooled = [inference.values(j) for j in range(len(layout.settings))]
    other = dict(priors.parameters)
    other["Fc_fwd"] = Prior("lognormal", {"median": 0.5, "sigma": 0.3})
    other["start"] = Prior("beta", {"a": 3.0, "b": 3.0})
    scatter = {n: replace(s, sd=2.0 * s.sd) for n, s in priors.scatter.items()}
    changed = replace(priors, parameters=other, scatter=scatter)
    model = made_tests(priors, "three_stage", [1.0])["t0"].posterior.model
    names, arguments = layout.coordinates.names, (layout.settings, layout.laws)
    design = design_of(changed, names, *arguments, layout.dependence, model)
    log = [log_prior(inference.population, pooled, each) for each in (layout, design)]
    for computed, each in zip(log, (layout, design), strict=True):
        difference = computed - parts(inference, each)
        assert np.ptp(difference) < 1e-8  # but for a constant
    # of both priors the constants are the same, so that their ratio is right
    ratio = parts(inference, design) - parts(inference, layout)
    np.testing.assert_allclose(log[1] - log[0], ratio, atol=1e-8)
    assert np.std(ratio) > 0.5
