"""How the sampler of a test spends its steps."""

import numpy as np
import pytest

from mfd_bayes.calibration import sampling
from mfd_bayes.calibration.diagnostics import Effort
from mfd_bayes.calibration.modes import climb
from mfd_bayes.calibration.sampling import sample_density


def funnel(q):
    """A funnel of Neal, in which no mixture that is learned fits."""
    wide = q[:, :1]
    return -0.5 * (wide[:, 0] / 2) ** 2 - 0.5 * np.sum(q[:, 1:] ** 2 * np.exp(-wide) + wide, axis=1)


@pytest.mark.slow
@pytest.mark.parametrize(("limit", "again"), [(1300, False), (2100, True)])
def test_the_proposal_is_learned_again_only_in_the_first_half(limit, again):
    effort = Effort(ess=1e6, limit=limit, ensembles=2, walkers=20)  # which is never reached
    modes = [climb(funnel, np.full(4, 0.1), np.eye(4), np.ones(4))]
    found = sample_density(lambda q, _: funnel(q), modes, effort, np.random.default_rng(1))
    assert found.steps == limit
    assert found.discarded <= limit // 2  # the steps of the second half are kept
    assert (found.discarded > 400) == again  # the warm-up takes 300


def test_proposals_that_are_surely_rejected_need_no_density(monkeypatch):
    def bounded(q, least):
        found = -0.5 * np.sum(q**2, axis=1) - 3.0 * np.sum(q**6, axis=1)
        spared.append(int(np.sum(found < least)))
        return np.where(found < least, -np.inf, found)

    def every(q, _):
        return bounded(q, -np.inf)

    def draws(density):
        effort = Effort(ess=50, limit=250, length=1.0, ensembles=2, walkers=20)
        modes = [climb(lambda q: every(q, 0.0), np.full(3, 0.1), np.eye(3), np.ones(3))]
        spared.clear()
        return sample_density(density, modes, effort, np.random.default_rng(1)).q

    spared = []
    expected, found = draws(every), draws(bounded)
    assert sum(spared) > 0
    np.testing.assert_array_equal(found, expected)
    monkeypatch.setattr(sampling, "NEVER", -1.0)  # the control: what may be accepted is left out
    assert not np.array_equal(draws(bounded), expected)


def test_convergence_is_measured_only_once_the_run_is_long_enough(monkeypatch):
    def bowl(q, _):
        return -0.5 * np.sum(q**2, axis=1)

    def measured(length, report=None):
        effort = Effort(ess=50, limit=2000, length=length, ensembles=2, walkers=20)
        modes = [climb(lambda q: bowl(q, 0.0), np.full(3, 0.1), np.eye(3), np.ones(3))]
        calls.clear()
        found = sample_density(bowl, modes, effort, np.random.default_rng(1), report=report)
        return found.q, len(calls)

    calls, told = [], []
    plain = sampling.measure
    monkeypatch.setattr(sampling, "measure", lambda kept: calls.append(1) or plain(kept))
    monkeypatch.setattr(sampling, "SILENT", np.inf)  # however slow the machine is
    draws, times = measured(20.0)
    assert times == 1
    heard, times = measured(20.0, told.append)
    assert times == 1
    assert [progress.measured for progress in told] == [False] * (len(told) - 1) + [True]
    assert len(told) > 3
    monkeypatch.setattr(sampling, "SILENT", -1.0)  # those who wait long are told
    told.clear()
    patient, times = measured(20.0, told.append)
    assert times == len(told)
    assert all(progress.measured for progress in told)
    np.testing.assert_array_equal(draws, heard)
    np.testing.assert_array_equal(draws, patient)
