"""The whole way from posterior to draws, on a posterior that is known in closed form."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import Prior, PriorFile
from mfd_bayes.calibration.sampling import Draws, sample
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.quantities import Quantity
from mfd_bayes.records.trace import Trace

NOISE = 0.2


class Linear(Model):
    name = "linear"
    quantities = (
        Quantity("sigma2", "damping", "c", "dashpot", lower=-np.inf),
        Quantity("k2", "stiffness", "k", "spring", lower=-np.inf),
    )

    def force(self, theta, trace, start=None, *, scales=None):
        return theta @ np.stack([trace.velocity, trace.displacement])


PRIORS = PriorFile(
    path=Path("linear.toml"),
    title="linear",
    parameters={
        "sigma2": Prior("normal", {"mean": 0.0, "sd": 1.0}),
        "k2": Prior("normal", {"mean": 1.0, "sd": 0.5}),
        "offset": Prior("normal", {"mean": 0.0, "sd": 0.3}),
        "noise_sd": Prior("fixed", {"value": NOISE}),
    },
    scatter={},
)


def make_posterior() -> Posterior:
    rng = np.random.default_rng(5)
    time = np.linspace(0.0, 4.0, 60)
    x = np.sin(2.0 * time) + 0.3 * np.sin(5.0 * time)
    motion = Trace.from_arrays(time, x)
    force = 0.3 * motion.velocity + 1.4 * x + 0.1 + NOISE * rng.standard_normal(time.size)
    return Posterior(Trace.from_arrays(time, x, force=force), PRIORS, "iid", Linear())


def design_of(posterior: Posterior) -> np.ndarray:
    """Force for a unit of each quantity, (T, 3), kip."""
    trace = posterior.trace
    return np.stack([trace.velocity, trace.displacement, np.ones(trace.samples)], axis=1)


def closed_form(posterior: Posterior, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of (sigma2, k2, offset), for a noise level."""
    design, force = design_of(posterior), np.asarray(posterior.trace.force)
    means, sds = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.5, 0.3])
    covariance = np.linalg.inv(design.T @ design / noise**2 + np.diag(sds**-2.0))
    return covariance @ (design.T @ force / noise**2 + means / sds**2), covariance


def agrees(draws: Draws, mean: np.ndarray, covariance: np.ndarray) -> bool:
    """Whether means lie within 4 Monte Carlo errors and sds within 10 %."""
    flat = draws.q.reshape(-1, 3)
    sd = np.sqrt(np.diag(covariance))
    error = sd / np.sqrt(draws.convergence.ess_bulk[:3])
    close = np.all(np.abs(flat.mean(axis=0) - mean) < 4.0 * error)
    return bool(close and np.all(np.abs(flat.std(axis=0) / sd - 1.0) < 0.10))


@pytest.fixture(scope="module")
def fitted() -> tuple[Posterior, Draws]:
    posterior = make_posterior()
    return posterior, sample(posterior, Effort(ess=800, limit=3000), seed=3)


def test_log_evidence_agrees_with_the_closed_form(fitted) -> None:
    posterior, draws = fitted
    trace = posterior.trace
    design = design_of(posterior)
    covariance = NOISE**2 * np.eye(trace.samples) + design @ np.diag([1.0, 0.25, 0.09]) @ design.T
    force = np.asarray(trace.force) - design @ [0.0, 1.0, 0.0]
    exact = multivariate_normal(cov=covariance).logpdf(force)
    evidence = draws.log_evidence()
    assert evidence.trusted
    assert abs(evidence.value - exact) < min(0.02, 5.0 * evidence.error + 0.002)
    # the control: a prior of the spring that is five times as wide lowers it by nearly log 5
    wide = {**PRIORS.parameters, "k2": Prior("normal", {"mean": 1.0, "sd": 2.5})}
    vague = Posterior(trace, replace(PRIORS, parameters=wide), "iid", Linear())
    lower = sample(vague, Effort(ess=800, limit=3000), seed=4).log_evidence()
    assert exact - lower.value > 0.5
    # and draws of another density are not a bridge to this one
    assert not replace(draws, q=draws.q + 5.0).log_evidence().trusted


def test_draws_agree_with_the_closed_form_and_with_no_other(fitted) -> None:
    posterior, draws = fitted
    assert posterior.names == ("sigma2", "k2", "offset")
    mean, covariance = closed_form(posterior, NOISE)
    assert agrees(draws, mean, covariance)
    assert not agrees(draws, *closed_form(posterior, 1.3 * NOISE))
    assert not agrees(draws, mean + 0.5 * np.sqrt(np.diag(covariance)), covariance)


def test_draws_are_summed_up_and_handed_to_arviz(fitted) -> None:
    posterior, draws = fitted
    assert len(repr(draws)) < 300
    summary = draws.summary()
    assert [*summary.index] == ["sigma2", "k2", "offset"]
    mean, covariance = closed_form(posterior, NOISE)
    assert summary.loc["k2", "mean"] == pytest.approx(mean[1], abs=0.2 * covariance[1, 1] ** 0.5)
    data = draws.to_inference_data()
    for group in ("posterior", "sample_stats", "prior", "log_prior", "log_likelihood"):
        assert data[group].sizes["chain"] == (1 if group == "prior" else len(draws.q))
    np.testing.assert_array_equal(data["observed_data"]["force"], posterior.trace.force)
