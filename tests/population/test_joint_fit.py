"""The joint fit of records that friction models have made."""

import numpy as np
import pytest

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.friction.models import find_model
from mfd_bayes.population.design import design_of, setting_of
from mfd_bayes.population.inference import TestLikelihood, fit_jointly
from mfd_bayes.records.trace import Trace

TIME = np.arange(160) / 32.0
LEVELS = (0.6, 1.0, 1.4)
NOISE = 0.02
TRUTH = {
    "lugre": {"sigma0": 30.0, "Fc_fwd": 1.0, "Fc_bwd": 1.2, "offset": 0.05},
    "three_stage": {
        "sigma0": 30.0, "Fc_fwd": 1.0, "Fc_bwd": 1.2, "k2": 0.8, "k3": 20.0, "d2": 0.1, "d3": 0.08,
        "offset": 0.05,
    },
    "backlash": {"Fc_fwd": 1.0, "Fc_bwd": 1.2, "k_fwd": 20.0, "k_bwd": 25.0, "gap": 0.15},
    "bouc_wen": {"Fy_fwd": 1.0, "Fy_bwd": 1.2},
}  # fmt: skip


class Made:
    """Synthetic tests of a model at three levels, and the coordinates that they are made with."""

    def __init__(self, priors, name, seed=0):
        rng, model = np.random.default_rng(seed), find_model(name)
        motion = 0.8 * np.sin(1.2 * np.pi * TIME)
        traces = [Trace.from_arrays(TIME, motion, p, np.sin(TIME)) for p in LEVELS]
        names = Posterior(traces[0], priors, "iid", model, start="sample").names
        self.design = design_of(priors, names, [setting_of(t) for t in traces])
        coordinates = self.design.coordinates
        typical = {n: priors.parameters[n].typical for n in coordinates.names}
        self.likelihoods, rows = [], []
        for trace, p in zip(traces, LEVELS, strict=True):
            values = {n: np.array([v]) for n, v in {**typical, **TRUTH[name]}.items()}
            for slip in ("Fc_fwd", "Fc_bwd", "Fy_fwd", "Fy_bwd"):
                if slip in values:
                    values[slip] = values[slip] * p * np.exp(0.05 * rng.standard_normal(1))
            values = {n: v for n, v in values.items() if n in coordinates.names}
            values["noise_sd"] = np.array([NOISE])
            rows.append(coordinates.of(values)[0])
            blank = TestLikelihood(
                Posterior(trace, priors, "iid", model, start="sample"), coordinates
            )
            left = blank.residuals(rows[-1][None])[0]
            force = np.asarray(trace.force) - left + NOISE * rng.standard_normal(TIME.size)
            record = Trace.from_arrays(TIME, motion, p, force)
            posterior = Posterior(record, priors, "iid", model, start="sample")
            self.likelihoods.append(TestLikelihood(posterior, coordinates))
        self.x = np.array(rows)
        self.common = np.zeros(self.x.shape[1], dtype=bool)
        self.common[: len(self.design.names)] = self.design.common

    def columns(self, *names):
        return [self.design.coordinates.names.index(n) for n in names if n in self.design.names]


@pytest.mark.parametrize("name", TRUTH)
def test_planted_coordinates_are_found(priors, name):
    made = Made(priors, name)
    start = made.x + 0.15 * np.random.default_rng(1).standard_normal(made.x.shape)
    fit = fit_jointly(made.likelihoods, start, made.common)
    slips = made.columns("Fc_fwd", "Fc_bwd", "Fy_fwd", "Fy_bwd")
    sd = np.sqrt(np.diagonal(np.linalg.inv(fit.precision), axis1=1, axis2=2))
    away = (fit.mean - made.x)[:, slips]
    # the discrepancy is learned from the same records, and takes something of the slip force
    allowed = 4.0 * sd[:, slips] + 0.03 / made.design.coordinates.spread[slips]
    assert np.all(np.abs(away) < allowed), np.abs(away) / allowed
    assert np.any(np.abs((start - made.x)[:, slips]) > allowed)  # the control: where it began
    noise = [made.design.coordinates.values(m[None])["noise_sd"][0] for m in fit.mean]
    np.testing.assert_allclose(noise, NOISE, rtol=0.35)
    assert fit.residual.information > 0.5  # the noise is independent
