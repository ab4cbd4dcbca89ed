"""Verdicts of `accept` are wrong as often as they say, on devices whose levels are known."""

from types import SimpleNamespace

import numpy as np
import pytest

from mfd_bayes.applications.acceptance.judgement import (
    ComparedRecord,
    Expected,
    Level,
    complete_limits,
    judge,
)
from mfd_bayes.evaluation.measurement import Gains, normal_scores

DEVICES, DRAWS = 1000, 500
LIMIT, SCATTER, GAIN = 0.15, 0.02, 0.04  # of levels, of tests, and of the load cell's gain
RECORD = SimpleNamespace(columns={"force": ("", "kip"), "displacement": ("", "in")})


def simulate(stated_gain, seed=1):
    """Stated risks of acceptance and rejection, and whether each verdict was wrong.

    Levels are uniform over three limits in either direction, as the flat prior of a level has them.
    The load cell of a device is another than that of the tests.
    """
    rng, limits = np.random.default_rng(seed), complete_limits({"slip": LIMIT})
    risks = {"p_wrong_acceptance": [], "p_wrong_rejection": []}
    gains = Gains(np.exp(stated_gain * normal_scores(rng, DRAWS)))
    for _ in range(DEVICES):
        level = rng.uniform(-3.0, 3.0) * np.log1p(LIMIT)
        measured = np.exp(level + np.hypot(SCATTER, GAIN) * rng.standard_normal())
        tests = {"slip_fwd": np.exp(SCATTER * rng.standard_normal(DRAWS))}
        nominal, device = (gains.applied(x) for x in ({"slip_fwd": np.ones(DRAWS)}, tests))
        device["loop"] = np.ones(DRAWS)
        expected = Expected(nominal, device, device, None, ())
        group = (ComparedRecord(RECORD, None, {"slip_fwd": measured}, expected),)
        of_device = Level.of(group, independent=True)
        row = judge("", group, of_device, of_device.p_value, limits).rows.loc["slip_fwd"]
        beyond = abs(np.expm1(level)) > LIMIT
        for key, wrong in (("p_wrong_acceptance", beyond), ("p_wrong_rejection", not beyond)):
            if np.isfinite(row[key]):
                risks[key].append((row[key], wrong))
    return {key: np.array(pairs).T for key, pairs in risks.items()}


def standard_errors(stated, wrong):
    """By how many standard errors the observed share of wrong verdicts lies above the stated."""
    return np.sum(wrong - stated) / np.sqrt(np.sum(stated * (1.0 - stated)))


@pytest.mark.parametrize("stated_gain", [GAIN, 0.0])
def test_stated_risks_are_the_shares_of_wrong_verdicts(stated_gain):
    """The control: with a gain that is not stated verdicts are wrong more often than they say."""
    for key, (stated, wrong) in simulate(stated_gain).items():
        assert stated.size > 150
        if stated_gain:
            assert abs(standard_errors(stated, wrong)) < 4.0, key
        else:
            assert standard_errors(stated, wrong) > 4.0, key
