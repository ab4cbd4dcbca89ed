import numpy as np
import pytest

from mfd_bayes.calibration.cycles import cycle_energies
from mfd_bayes.records.loops import find_loops
from mfd_bayes.records.trace import Trace


def harmonic(cycles=6, force=True, grow=0.0):
    """Trace of amplitude 1 in at 0.5 Hz whose force is a circle about 0.2 kip, with a drift."""
    time = np.arange(int(200 * cycles) + 1) / 100.0
    angle = np.pi * time
    sign = 1 + grow * time / time[-1]
    return Trace.from_arrays(
        time,
        np.sin(angle),
        force=0.2 + sign * np.cos(angle) + grow * time / time[-1] if force else None,
    )


def test_a_loop_has_its_amplitude_its_period_and_the_energy_of_its_ellipse():
    loops = find_loops(harmonic())
    assert loops.bounds.size == loops.period.size + 1 == 6
    np.testing.assert_allclose(loops.period, 2.0)
    np.testing.assert_allclose(loops.amplitude, 1.0)
    np.testing.assert_allclose(loops.energy, np.pi, rtol=1e-3)
    np.testing.assert_allclose(loops.offset, 0.2, atol=1e-3)


def test_energies_are_those_that_derived_quantities_are_compared_with():
    trace = harmonic(grow=0.3)
    np.testing.assert_allclose(
        find_loops(trace).energy, cycle_energies(trace.force[None], trace)[0]
    )


def test_drifts_compare_the_first_loops_with_the_last():
    steady, growing = find_loops(harmonic()), find_loops(harmonic(grow=0.5))
    assert steady.energy_drift == pytest.approx(0.0, abs=1e-9)
    assert steady.offset_drift == pytest.approx(0.0, abs=1e-9)
    assert growing.energy_drift == pytest.approx(0.30, abs=0.05)
    assert growing.offset_drift == pytest.approx(0.33, abs=0.05)


def test_ramps_are_not_strong_and_tell_no_drift():
    time = np.arange(1001) / 100.0
    ramped = np.minimum(time / 6, 1) * np.sin(np.pi * time)
    loops = find_loops(Trace.from_arrays(time, ramped, force=np.cos(np.pi * time)))
    assert 0 < np.count_nonzero(loops.strong) < loops.strong.size
    assert loops.energy_drift is None


def test_a_motion_without_force_has_loops_without_energy():
    loops = find_loops(harmonic(force=False))
    assert loops.period.size == 5
    assert loops.energy is None
    assert loops.energy_drift is loops.offset_drift is None


def test_a_motion_that_turns_twice_has_no_full_loop():
    loops = find_loops(harmonic(cycles=1))
    assert loops.bounds.size == loops.period.size == loops.energy.size == 0
    assert not loops.strong.size
