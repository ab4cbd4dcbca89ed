"""The loop of a candidate, which forgets where the test began."""

import numpy as np
import pytest

from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.planning.candidate import Candidate
from mfd_bayes.planning.study import Loop

GAP = 0.16
THETA = np.array([[80, 0.02, 0.015, 1.5, 1.3, 1.9, 1.65, 0.6, 20, 0.09, 0.07, 1, 0.02, 0.4]])


@pytest.mark.parametrize("waveform", ["sine", "triangle"])
def test_a_loop_is_a_full_stroke_and_then_a_full_loop(waveform):
    loop = Loop.of(Candidate(1.0, 0.5, 1.0, waveform=waveform), GAP)
    x, t = loop.trace.displacement, loop.trace.time
    assert x[0] == pytest.approx(-1.0)
    assert x[loop.first] == pytest.approx(1.0)
    assert x[-1] == pytest.approx(1.0)
    assert x.min() == pytest.approx(-1.0)
    assert t[-1] - t[loop.first] == pytest.approx(2.0)
    assert np.all(np.diff(t) > 0)
    assert x.size < 70
    fastest = np.abs(loop.trace.velocity).max()
    assert fastest == pytest.approx(Candidate(1.0, 0.5, 1.0, waveform=waveform).speed, rel=0.02)


def test_where_the_test_began_does_not_matter():
    loop = Loop.of(Candidate(1.0, 0.5, 1.0), GAP)
    one, other = (ThreeStage().force(THETA, loop.trace, [w]) for w in (0.05, 0.95))
    np.testing.assert_allclose(one[:, loop.first :], other[:, loop.first :], atol=1e-6)
    assert np.abs(one - other).max() > 0.1  # but it did before the loop
