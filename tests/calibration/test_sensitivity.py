"""Whether parameters follow the prior or the data, and ArviZ's own word on the same draws."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import Prior, load_priors
from mfd_bayes.calibration.sampling import Draws, sample
from mfd_bayes.calibration.sensitivity import ALPHAS, Follows, power_scaling
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.records.trace import Trace

with warnings.catch_warnings():
    warnings.simplefilter("ignore", FutureWarning)
    import arviz as az

TRUTH = {
    "sigma0": 40.0, "sigma1": 0.02, "sigma2": 0.015, "Fc_fwd": 1.5, "Fc_bwd": 1.4,
    "static_excess_fwd": 0.1, "static_excess_bwd": 0.1, "k2": 0.6, "k3": 20.0, "d2": 0.1,
    "d3": 0.08, "ell": 0.02, "v_s": 0.4, "start": 0.5, "offset": 0.0,
}  # fmt: skip
NOISE = 0.05
FREE = ("Fc_fwd", "k3", "sigma1")  # sampled; all others are fixed at the truth
DECADES = 0.5  # prior sd of the logarithms
SLOW, FAST = 0.02, 5.0  # speeds over that of a test of 1 in and 0.25 Hz
EFFORT = Effort(ess=400, limit=1500)


def posterior_of(far: float, speed: float = 1.0) -> Posterior:
    """A test at a speed; the prior median of k3 is so many of its standard deviations too high."""
    time = np.linspace(0.0, 16.0, 600)
    motion = Trace.from_arrays(time / speed, np.sin(np.pi * time / 2.0), actuation=1.0)
    model = ThreeStage()
    values = {name: np.array([value]) for name, value in TRUTH.items()} | {"gamma1": np.ones(1)}
    force = model.force_unbounded(model.theta(values), motion, values["start"])[0]
    force = force + NOISE * np.random.default_rng(4).standard_normal(time.size)
    priors = load_priors("mfd")
    fixed = {name: Prior("fixed", {"value": value}) for name, value in TRUTH.items()}
    fixed["noise_sd"] = Prior("fixed", {"value": NOISE})
    # neighbours are correlated, by the same share at every speed
    fixed["noise_time"] = Prior("fixed", {"value": 0.02 / speed})
    width = 0.02 if far else DECADES  # a narrow one, so that the data do not outweigh it
    for name in FREE:
        sd, shift = (width, far) if name == "k3" else (DECADES, 0.0)
        figures = {"median": TRUTH[name] * np.exp(shift * sd), "sigma": sd}
        fixed[name] = Prior("lognormal", figures)
    file = replace(priors, parameters={**priors.parameters, **fixed})
    trace = Trace.from_arrays(motion.time, motion.displacement, 1.0, force)
    return Posterior(trace, file, "ou", model)


@pytest.fixture(scope="module")
def fitted() -> Draws:
    return sample(posterior_of(0.0, SLOW), EFFORT, seed=1)


def verdicts(draws: Draws) -> dict[str, Follows]:
    values = {name: draws.values[name] for name in draws.names}
    scaled = power_scaling(values, draws.log_prior, draws.log_likelihood)
    assert max(s.pareto_k for s in scaled.values()) < 0.7
    return {name: s.verdict for name, s in scaled.items()}


def test_what_the_motion_does_not_show_follows_the_prior(fitted) -> None:
    slow = verdicts(fitted)
    assert slow["sigma1"] == Follows.PRIOR
    assert slow["Fc_fwd"] == slow["k3"] == Follows.DATA
    fast = verdicts(sample(posterior_of(0.0, FAST), EFFORT, seed=1))
    assert fast["sigma1"] in (Follows.BOTH, Follows.DATA)


def test_a_prior_ten_sds_off_disagrees_with_the_data_and_one_in_place_does_not(fitted) -> None:
    assert verdicts(sample(posterior_of(10.0), EFFORT, seed=2))["k3"] == Follows.DISAGREE
    beside = verdicts(sample(posterior_of(1e-9), EFFORT, seed=3))
    assert beside["k3"] in (Follows.BOTH, Follows.DATA, Follows.PRIOR)


def test_the_figures_are_those_of_arviz_on_the_groups_that_it_is_given(fitted) -> None:
    data = fitted.to_inference_data()
    terms = data["log_likelihood"]
    joint = sum(terms[name].sum([d for d in terms[name].dims if d == "cycle"]) for name in terms)
    np.testing.assert_allclose(joint, fitted.log_likelihood, atol=1e-8)
    scaled = power_scaling(
        {name: fitted.values[name] for name in fitted.names},
        sum(data["log_prior"][name].to_numpy() for name in data["log_prior"]),
        fitted.log_likelihood,
    )
    for component in ("prior", "likelihood"):
        if hasattr(az, "psens"):
            delta, close = ALPHAS[1] - 1.0, 1e-5
            expected = az.psens(data, component=component, var_names=[*scaled], delta=delta)
        elif hasattr(az, "psense"):
            close = 1e-3  # it smooths both tails of the weights, and we the upper one
            expected = az.psense(data, group=component, var_names=[*scaled], alphas=ALPHAS)
        else:
            pytest.skip("this ArviZ has neither psens nor psense")
        for name, s in scaled.items():
            figure = s.prior if component == "prior" else s.data
            assert figure == pytest.approx(float(expected[name]), abs=close)
    # the control: the sum of the cycles given all others is not the joint log likelihood
    assert np.abs(terms["force"].sum("cycle").to_numpy() - fitted.log_likelihood).min() > 0.1
