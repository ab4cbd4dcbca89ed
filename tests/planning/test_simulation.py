"""The loop of a candidate, and what is read from it."""

import numpy as np
import pytest

from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.planning.candidate import Candidate
from mfd_bayes.planning.study import Loop
from mfd_bayes.records.loops import loop_estimate
from mfd_bayes.records.trace import Harmonic, Trace

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


def test_summaries_are_what_is_read_off_a_record():
    fine = Harmonic(1.0, 0.5, 4).trace(1.0)
    force = ThreeStage().force(THETA, fine)[0]
    read = loop_estimate(Trace.from_arrays(fine.time, fine.displacement, 1.0, force))
    loop = Loop.of(Candidate(1.0, 0.5, 1.0), GAP)
    found = loop.summaries(ThreeStage().force(THETA, loop.trace), GAP)
    assert found["slip_fast_fwd"][0] == pytest.approx(read.plateau_fwd, rel=0.03)
    assert found["slip_fast_bwd"][0] == pytest.approx(read.plateau_bwd, rel=0.03)
    assert found["energy"][0] == pytest.approx(read.energy, rel=0.01)
    assert 0.7 * read.gap < found["gap_fwd"][0] < read.gap
