"""Figures read off a loop by a plain rule."""

import numpy as np
import pytest

from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.records.loop_features import asymmetry, loop_estimate
from mfd_bayes.records.loops import find_loops
from mfd_bayes.records.trace import Trace

FORWARD, BACKWARD, SLOPE, GAP = 2.0, 2.5, 25.0, 0.3


def drawn_loop(cycles=5, ramp=0):
    """A loop of straight lines: no force in the gap, a build-up, then slip."""
    time = np.arange(0.0, cycles / 0.5, 1 / 256)
    size = np.minimum(1.0, time / max(ramp / 0.5, 1e-9)) if ramp else 1.0
    x = size * np.sin(np.pi * time)
    force, travel, way = np.zeros(time.size), 0.0, 1.0
    for n in range(1, time.size):
        step = x[n] - x[n - 1]
        if step * way < 0:
            way, travel = -way, 0.0
        travel += abs(step)
        level = FORWARD if way > 0 else BACKWARD
        start = GAP - level / SLOPE
        force[n] = way * np.clip(SLOPE * (travel - start), 0.0, level)
    return Trace.from_arrays(time, x, 0.03, force)


def test_a_loop_of_straight_lines_is_read_as_it_was_drawn():
    read = loop_estimate(drawn_loop())
    assert read.plateau_fwd == pytest.approx(FORWARD)
    assert read.plateau_bwd == pytest.approx(BACKWARD)
    assert read.plateau == pytest.approx(0.5 * (FORWARD + BACKWARD))
    assert read.slope == pytest.approx(SLOPE, rel=0.02)
    assert read.gap == pytest.approx(GAP, rel=0.02)


def test_the_offset_of_the_load_cell_is_taken_off():
    trace = drawn_loop()
    shifted = Trace.from_arrays(trace.time, trace.displacement, 0.03, trace.force + 0.4)
    assert loop_estimate(shifted).plateau_fwd == pytest.approx(FORWARD + 0.4)
    assert loop_estimate(shifted, 0.4).plateau_fwd == pytest.approx(FORWARD)
    assert loop_estimate(shifted, 0.4).gap == pytest.approx(GAP, rel=0.02)


def test_ramps_are_not_read():
    read, loops = loop_estimate(trace := drawn_loop(8, ramp=3)), find_loops(drawn_loop(8, ramp=3))
    assert read.energy == pytest.approx(loops.energy[loops.strong].mean())
    assert loops.energy.mean() < 0.95 * read.energy
    assert read.plateau_fwd == pytest.approx(loop_estimate(drawn_loop()).plateau_fwd)
    assert np.count_nonzero(find_loops(trace).strong) < loops.energy.size


def test_the_model_reads_as_its_parameters():
    trace = drawn_loop()
    theta = np.array([[200, 0, 0, 2.0, 2.0, 2.4, 2.4, 0.1, 20, 0.15, 0.1, 1, 0.001, 0.5]])
    force = ThreeStage().force(theta, trace)[0]
    read = loop_estimate(Trace.from_arrays(trace.time, trace.displacement, 0.03, force))
    assert read.plateau_fwd == pytest.approx(2.0, rel=0.02)
    assert read.plateau_bwd == pytest.approx(2.4, rel=0.02)
    assert read.gap == pytest.approx(0.25, rel=0.1)


def test_without_a_stroke_or_a_force_nothing_is_read():
    time = np.arange(100) / 50
    for force in (None, np.ones(100)):
        read = loop_estimate(Trace.from_arrays(time, time, 0.03, force))
        assert np.isnan([read.plateau_fwd, read.slope, read.gap, read.energy]).all()


def test_a_record_with_both_signs_swapped_has_the_opposite_asymmetry():
    trace = drawn_loop()
    bent = trace.force + 0.1 * trace.displacement**2
    plain, turned = (
        asymmetry(Trace.from_arrays(trace.time, s * trace.displacement, 0.03, s * bent))
        for s in (1, -1)
    )
    assert np.corrcoef(plain, turned)[0, 1] < -0.9
