"""Replicated records are finite, or they are refused."""

import numpy as np
import pytest

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.predictive import replicate
from mfd_bayes.errors import RecordError
from mfd_bayes.records.trace import Trace

TIME = np.arange(60) * 0.05
TRACE = Trace.from_arrays(TIME, np.sin(TIME), 0.5, np.cos(TIME))


def test_a_force_beyond_all_range_ends_in_a_sentence():
    posterior = Posterior(TRACE, "mfd", "iid", "lugre")
    drawn = posterior.draw_prior(np.random.default_rng(0), 20)
    assert np.all(np.isfinite(replicate(posterior, drawn, np.random.default_rng(0)).observed))
    drawn["sigma2"] = np.full(20, 1e14)
    with pytest.raises(RecordError, match="replicated force holds numbers too large"):
        replicate(posterior, drawn, np.random.default_rng(0))
