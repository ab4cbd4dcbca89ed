"""Posterior predictive checks pass the model that made the data and fail one that did not."""

import numpy as np
import pytest

from mfd_bayes.calibration.diagnostics import Effort, PredictiveCheck, check_predictive, replicate
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.sampling import sample
from mfd_bayes.records.trace import Trace

pytestmark = pytest.mark.slow

EFFORT = Effort(ess=100, limit=600, r_hat=1.05, length=1.0)
EXTREME = 0.005


def record() -> Trace:
    """A synthetic test with a gap, and noise that is correlated."""
    rng = np.random.default_rng(3)
    time = np.arange(0.0, 12.0, 0.04)
    plain = Trace.from_arrays(time, np.sin(2 * np.pi * 0.25 * time))
    blank = Trace.from_arrays(time, plain.displacement, force=np.zeros(time.size))
    source = Posterior(blank, "mfd")
    truth = {
        "sigma0": 30.0, "sigma1": 0.02, "sigma2": 0.01, "Fc_fwd": 1.1, "Fc_bwd": 1.4,
        "static_excess_fwd": 0.15, "static_excess_bwd": 0.15, "k2": 0.6, "k3": 20.0, "d2": 0.09,
        "d3": 0.07, "ell": 0.02, "gamma1": 1.0, "v_s": 0.5, "start": 0.4, "offset": 0.02,
        "noise_sd": 0.04, "noise_time": 0.1,
    }  # fmt: skip
    values = {name: np.array([value]) for name, value in truth.items()}
    force = source.force(values) + values["offset"] + source.noise.draw(rng, time, values)
    return Trace.from_arrays(time, plain.displacement, force=force[0])


def checks(model: str, noise: str) -> dict[str, PredictiveCheck]:
    posterior = Posterior(record(), "mfd", noise, model)
    draws = sample(posterior, EFFORT, seed=2)
    values = {name: value.reshape(-1) for name, value in draws.values.items()}
    replicas = replicate(posterior, values, np.random.default_rng(0))
    found = check_predictive(posterior, replicas, 0.16)
    return {check.name: check for check in found}


def extremes(found: dict[str, PredictiveCheck]) -> set[str]:
    return {n for n, c in found.items() if not EXTREME <= c.p_value <= 1.0 - EXTREME}


def test_the_model_that_made_the_record_passes() -> None:
    found = checks("three_stage", "ou")
    assert extremes(found) == set()
    names = " ".join(found)
    for statistic in ("residual rms", "lag-one", "mid-gap"):
        assert statistic in names


def test_a_model_without_the_gap_fails() -> None:
    assert "force at mid-gap, kip" in extremes(checks("lugre", "iid"))
