"""Each fault is found in a record that has it, and nothing in one that has none."""

import numpy as np
import pytest

from mfd_bayes.records.data_quality import find_faults
from mfd_bayes.records.lag import estimate_lag
from mfd_bayes.records.record import read_record
from mfd_bayes.records.trace import Trace

GAP = 0.15  # in


def signals(rate=200.0, frequency=0.5, cycles=6, amplitude=1.0, seed=0):
    """Time, displacement and force, (T,) each, of a bristle that slips at 1 kip, with noise."""
    time = np.arange(int(rate * cycles / frequency) + 1) / rate
    displacement = amplitude * np.sin(2 * np.pi * frequency * time)
    fine = np.linspace(0.0, time[-1], 20 * time.size)
    steps = np.diff(amplitude * np.sin(2 * np.pi * frequency * fine), prepend=0.0)
    bristle = np.zeros(fine.size)
    for i in range(1, fine.size):
        bristle[i] = bristle[i - 1] + 40.0 * (steps[i] - abs(steps[i]) * bristle[i - 1])
    force = np.interp(time, fine, bristle)
    noise = np.random.default_rng(seed).standard_normal((2, time.size))
    return time, displacement + 1e-5 * noise[0], force + 0.01 * noise[1]


def names(time, displacement, force, gap=GAP):
    return [
        fault.name for fault in find_faults(Trace.from_arrays(time, displacement, None, force), gap)
    ]


def the_fault(name, time, displacement, force, gap=GAP):
    found = find_faults(Trace.from_arrays(time, displacement, None, force), gap)
    assert [fault.name for fault in found] == [name]
    return found[0]


@pytest.mark.parametrize(("rate", "frequency"), [(200.0, 0.5), (100.0, 0.05), (1024.0, 1.0)])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_sound_record_has_no_fault(rate, frequency, seed):
    assert names(*signals(rate, frequency, seed=seed)) == []


def test_a_motion_without_force_is_judged_too():
    time, displacement, _ = signals()
    assert names(time, displacement, None) == []
    assert names(time, 0.05 * displacement, None) == ["stroke"]


@pytest.mark.parametrize("side", ["force", "displacement"])
def test_a_swapped_sign_is_told(side):
    time, displacement, force = signals()
    swapped = (displacement, -force) if side == "force" else (-displacement, force)
    assert "sign" in str(the_fault("force sign", time, *swapped).message)


def test_both_signs_swapped_are_sound():
    time, displacement, force = signals()
    assert names(time, -displacement, -force) == []


def test_a_speed_that_no_damper_has_is_told():
    time, displacement, force = signals()
    assert "in/s" in str(the_fault("time unit", time / 1000, displacement, force).message)


def test_a_force_that_never_changes_is_told():
    time, displacement, force = signals()
    assert "0 kip" in str(the_fault("no force", time, displacement, 0 * force).message)


def test_a_clipped_force_is_told_with_its_samples():
    time, displacement, force = signals()
    fault = the_fault("clipping", time, displacement, np.minimum(force, 0.9))
    assert "0.9 kip" in str(fault.message)
    assert np.all(force[fault.samples] >= 0.9)
    assert fault.samples.size > 0.8 * np.count_nonzero(force >= 0.9)


def test_a_force_clipped_on_both_sides_is_told_of_both():
    time, displacement, force = signals()
    assert names(time, displacement, np.clip(force, -0.9, 0.9)) == ["clipping", "clipping"]


def ramped():
    """Eight cycles, of which the middle ones are at full stroke, and a force that follows them."""
    time = np.arange(0.0, 20.0, 1 / 200)
    size = np.clip(np.minimum(time, 20.0 - time) / 6.5, 0.0, 1.0)
    displacement = size * np.sin(np.pi * time)
    return time, displacement, size * np.tanh(8.0 * np.gradient(displacement, time))


def test_a_drift_is_seen_although_most_cycles_ramp():
    time, displacement, force = ramped()
    noisy = force + 0.002 * np.random.default_rng(0).normal(size=time.size)
    assert "drift" not in names(time, displacement, noisy)
    assert "drift" in names(time, displacement, noisy + 0.8 * time / time[-1])
    uneven = noisy + 0.4 * np.sin(np.pi * time / 20.0)  # it comes back: no drift
    assert "drift" not in names(time, displacement, uneven)


def test_a_coarse_force_is_not_clipped():
    time, displacement, force = signals()
    assert names(time, displacement, np.round(force / 0.1) * 0.1) == []


@pytest.mark.parametrize("lag", [-0.04, -0.025, 0.02, 0.04])
def test_a_force_out_of_step_is_told_with_its_lag(lag):
    time, displacement, force = signals()
    late = np.interp(time - lag, time, force)
    fault = the_fault("lag", time, displacement, late)
    assert ("behind" if lag > 0 else "before") in str(fault.message)
    found = estimate_lag(Trace.from_arrays(time, displacement, None, late))
    assert found is not None
    assert found[0] == pytest.approx(lag, abs=0.008)


def test_a_lag_of_a_sample_is_not_told():
    time, displacement, force = signals()
    assert names(time, displacement, np.interp(time - 0.005, time, force)) == []


@pytest.mark.parametrize("viscous", [0.3, 1.0])
def test_viscous_friction_is_no_lag(viscous):
    time, displacement, force = signals()
    speed = np.cos(np.pi * time)
    assert names(time, displacement, force + viscous * speed) == []


def test_a_force_that_does_not_follow_the_motion_has_no_lag():
    time, displacement, _ = signals()
    noise = np.random.default_rng(1).standard_normal(time.size)
    assert estimate_lag(Trace.from_arrays(time, displacement, None, noise)) is None


@pytest.mark.parametrize("signal", ["displacement", "force"])
def test_spikes_are_told_with_their_places(signal):
    time, displacement, force = signals()
    at = [333, 1000, 1777]
    {"displacement": displacement, "force": force}[signal][at] += 1.0
    fault = next(
        f
        for f in find_faults(Trace.from_arrays(time, displacement, None, force), GAP)
        if f.name == "spikes"
    )
    assert fault.samples.tolist() == at
    assert f"3 isolated samples of the {signal}" in str(fault.message)


def test_a_ringing_force_has_no_spikes():
    time, displacement, force = signals()
    force += 0.3 * np.exp(-((time % 1.0) / 0.1)) * np.sin(2 * np.pi * 40 * time)
    assert "spikes" not in names(time, displacement, force)


def test_dropped_samples_are_told_with_their_place():
    time, displacement, force = signals()
    kept = np.setdiff1d(np.arange(time.size), [700, 701])
    fault = the_fault("dropped samples", time[kept], displacement[kept], force[kept])
    assert fault.samples.tolist() == [700]
    assert "1 step of time" in str(fault.message)


def test_a_clock_that_trembles_has_dropped_nothing():
    time, displacement, force = signals()
    shaken = time + 0.2 / 200.0 * np.random.default_rng(3).uniform(-1, 1, time.size)
    assert names(shaken, displacement, force) == []


@pytest.mark.parametrize("times", [2, 3])
def test_repeated_samples_are_told(times):
    time, displacement, force = signals()
    held = np.arange(time.size) // times * times
    found = find_faults(Trace.from_arrays(time, displacement[held], None, force[held]), GAP)
    assert "repeated samples" in [fault.name for fault in found]


def test_an_actuator_at_rest_repeats_nothing():
    time, displacement, force = signals()
    rest = np.clip(displacement, -0.5, 0.5)
    assert "repeated samples" not in names(time, rest, np.round(force, 1))


def test_a_coarse_displacement_is_told():
    time, displacement, force = signals()
    coarse = np.round(displacement / 0.02) * 0.02
    assert "0.02 in" in str(the_fault("resolution", time, coarse, force).message)


def test_a_displacement_of_fine_steps_is_sound():
    time, displacement, force = signals()
    assert names(time, np.round(displacement / 0.002) * 0.002, force) == []


def test_steps_as_wide_as_the_gap_are_coarse_however_long_the_stroke():
    time, displacement, force = signals(amplitude=10.0)
    coarse = np.round(displacement / 0.05) * 0.05
    assert "resolution" in names(time, coarse, force)
    assert "resolution" not in names(time, coarse, force, gap=None)


def test_a_rate_too_low_for_the_gap_is_told():
    time, displacement, force = signals(rate=20.0)
    found = find_faults(Trace.from_arrays(time, displacement, None, force), GAP)
    (sentence,) = [str(fault.message) for fault in found if fault.name == "rate"]
    assert "in the first 0.15 in after a reversal, where the force builds up" in sentence
    assert "rate" not in names(time, displacement, force, gap=None)


def test_a_stroke_within_the_gap_is_told():
    time, displacement, force = signals(amplitude=0.07)
    assert "stroke" in names(time, displacement, force)
    assert "stroke" not in names(time, displacement, force, gap=0.1)


def test_a_short_record_is_told():
    time, displacement, force = signals(cycles=1.5)
    assert "short record" in names(time, displacement, force)
    time, displacement, force = signals(rate=20.0, cycles=2)
    assert "short record" in names(time, displacement, force, gap=None)


def test_a_force_that_loses_its_zero_is_told():
    time, displacement, force = signals(cycles=8)
    assert "drift" in names(time, displacement, force + 0.6 * time / time[-1])
    assert names(time, displacement, force + 0.1 * time / time[-1]) == ["drift"]
    assert names(time, displacement, force + 0.1 * (time > 8.0)) == ["drift"]
    assert names(time, displacement, force + 0.03 * time / time[-1]) == []


def test_faults_come_the_gravest_first():
    time, displacement, force = signals(rate=20.0, cycles=1.5)
    found = names(1000 * time, displacement, -force)
    assert len(found) > 2
    assert found[0] == "force sign"
    assert found.index("short record") < found.index("rate")


def test_real_records_raise_no_false_alarm(data_folder):
    for path in sorted(data_folder.glob("20*.csv")):
        assert find_faults(read_record(path).trace(), 0.2) == (), path.name


# --- the velocity


def velocity_trace(change):
    """A trace with a noisy displacement in coarse steps, and its own velocity, changed."""
    time = np.arange(801) / 100.0
    noise = np.random.default_rng(3).normal(0.0, 2e-3, time.size)
    motion = np.round((np.sin(np.pi * time) + noise) * 500) / 500
    velocity = np.pi * np.cos(np.pi * time) + 0.05  # with a zero that is a little off
    return Trace.from_arrays(time, motion, 0.5, np.sign(velocity), change(velocity))


@pytest.mark.parametrize(
    "change",
    [
        lambda v: -100 * v,
        lambda v: -v,
        lambda v: 25.4 * v,
        lambda v: v / 2,
        np.zeros_like,
        lambda v: v[::-1].copy() ** 2,
    ],
    ids=["-100 times", "sign", "mm/s as in/s", "half", "zero", "another channel"],
)
def test_a_velocity_that_contradicts_the_displacement_is_a_fault(change):
    faults = [f for f in find_faults(velocity_trace(change)) if f.name == "velocity"]
    assert len(faults) == 1
    assert "not that of the displacement" in str(faults[0].message)


@pytest.mark.parametrize("change", [lambda v: v, lambda v: 1.1 * v, lambda v: None])
def test_a_velocity_that_agrees_or_is_not_there_is_none(change):
    assert "velocity" not in {f.name for f in find_faults(velocity_trace(change))}


def test_noise_of_the_displacement_beside_the_build_up_is_told():
    time, displacement, force = signals()
    noise = 0.004 * np.random.default_rng(1).standard_normal(time.size)
    sentence = str(the_fault("noise", time, displacement + noise, force).message)
    assert "noise of about 0.0039 in, 7% of the travel" in sentence
    assert names(time, displacement + 0.1 * noise, force) == []
