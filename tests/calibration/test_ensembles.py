"""How the sampler of a test spends its steps."""

import numpy as np
import pytest

from mfd_bayes.calibration import ensembles
from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.ensembles import sample_density
from mfd_bayes.calibration.map_fit import climb


def funnel(q):
    """A funnel of Neal, in which no mixture that is learned fits."""
    wide = q[:, :1]
    return -0.5 * (wide[:, 0] / 2) ** 2 - 0.5 * np.sum(q[:, 1:] ** 2 * np.exp(-wide) + wide, axis=1)


@pytest.mark.slow
@pytest.mark.parametrize(("limit", "again"), [(1300, False), (2100, True)])
def test_the_proposal_is_learned_again_only_in_the_first_half(limit, again):
    effort = Effort(ess=1e6, limit=limit, ensembles=2, walkers=20)  # which is never reached
    modes = [climb(funnel, np.full(4, 0.1), np.ones(4))]
    chains = sample_density(lambda q, _: funnel(q), modes, effort, np.random.default_rng(1))
    assert chains.steps == limit
    assert chains.discarded <= limit // 2  # the steps of the second half are kept
    assert (chains.discarded > 400) == again  # the warm-up takes 300


def test_proposals_that_are_surely_rejected_need_no_density(monkeypatch):
    def bounded(q, least):
        found = -0.5 * np.sum(q**2, axis=1) - 3.0 * np.sum(q**6, axis=1)
        spared.append(int(np.sum(found < least)))
        return np.where(found < least, -np.inf, found)

    def every(q, _):
        return bounded(q, -np.inf)

    def draws(density):
        effort = Effort(ess=50, limit=250, length=1.0, ensembles=2, walkers=20)
        modes = [climb(lambda q: every(q, 0.0), np.full(3, 0.1), np.ones(3))]
        spared.clear()
        return sample_density(density, modes, effort, np.random.default_rng(1)).q

    spared = []
    expected, found = draws(every), draws(bounded)
    assert sum(spared) > 0
    np.testing.assert_array_equal(found, expected)
    monkeypatch.setattr(ensembles, "NEVER", -1.0)  # the control: what may be accepted is left out
    assert not np.array_equal(draws(bounded), expected)
