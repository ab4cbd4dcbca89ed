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


def faults(time, displacement, force, gap=GAP):
    return find_faults(Trace.from_arrays(time, displacement, None, force), gap)


def names(*arrays, **options):
    return [fault.name for fault in faults(*arrays, **options)]


NOISE = np.random.default_rng(1).standard_normal(2401)
SHAKE = np.random.default_rng(3).uniform(-1.0, 1.0, 2401)


def stepped(values, step):
    return np.round(values / step) * step


FAULTY = {
    "the sign of the force": (lambda t, x, f: (t, x, -f), "force sign", "sign = -1"),
    "the sign of the displacement": (lambda t, x, f: (t, -x, f), "force sign", "sign"),
    "time in ms": (lambda t, x, f: (t / 1000, x, f), "time unit", "in/s"),
    "no force": (lambda t, x, f: (t, x, 0 * f), "no force", "0 kip"),
    "a clipped force": (lambda t, x, f: (t, x, np.minimum(f, 0.9)), "clipping", "0.9 kip"),
    "coarse steps": (lambda t, x, f: (t, stepped(x, 0.02), f), "resolution", "0.02 in"),
    "noise": (
        lambda t, x, f: (t, x + 0.004 * NOISE, f),
        "noise",
        "noise of about 0.00394 in, 7% of the travel",
    ),
    "a drift": (lambda t, x, f: (t, x, f + 0.1 * t / t[-1]), "drift", "+0.101 kip"),
    "samples that were dropped": (
        lambda t, x, f: [np.delete(values, [700, 701]) for values in (t, x, f)],
        "dropped samples",
        "1 step of time",
    ),
}


@pytest.mark.parametrize(("change", "name", "words"), FAULTY.values(), ids=FAULTY)
def test_a_fault_is_named_alone_with_its_figures(change, name, words):
    (fault,) = faults(*change(*signals()))
    assert fault.name == name
    assert words in str(fault.message)


SOUND = {
    "both signs swapped": lambda t, x, f: (t, -x, -f),
    "no force at all": lambda t, x, f: (t, x, None),
    "a coarse force": lambda t, x, f: (t, x, stepped(f, 0.1)),
    "fine steps": lambda t, x, f: (t, stepped(x, 0.002), f),
    "little noise": lambda t, x, f: (t, x + 0.0004 * NOISE, f),
    "a little drift": lambda t, x, f: (t, x, f + 0.02 * t / t[-1]),
    "a lag of a sample": lambda t, x, f: (t, x, np.interp(t - 0.005, t, f)),
    "viscous friction": lambda t, x, f: (t, x, f + np.cos(np.pi * t)),
    "a clock that trembles": lambda t, x, f: (t + 1e-3 * SHAKE, x, f),
}


@pytest.mark.parametrize("change", SOUND.values(), ids=SOUND)
def test_what_is_no_fault_is_not_named(change):
    assert names(*change(*signals())) == []


def test_a_force_that_rings_has_no_spikes_and_an_actuator_at_rest_repeats_nothing():
    time, displacement, force = signals()
    ringing = 0.3 * np.exp(-((time % 1.0) / 0.1)) * np.sin(2 * np.pi * 40 * time)
    assert "spikes" not in names(time, displacement, force + ringing)
    rest = np.clip(displacement, -0.5, 0.5)
    assert "repeated samples" not in names(time, rest, stepped(force, 0.1))


@pytest.mark.parametrize(("rate", "frequency"), [(200.0, 0.5), (100.0, 0.05), (1024.0, 1.0)])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_sound_record_has_no_fault(rate, frequency, seed):
    assert names(*signals(rate, frequency, seed=seed)) == []


def test_the_samples_of_a_fault_are_given():
    time, displacement, force = signals()
    (fault,) = faults(time, displacement, np.minimum(force, 0.9))
    assert np.all(force[fault.samples] >= 0.9)
    assert fault.samples.size > 0.8 * np.count_nonzero(force >= 0.9)
    both = names(time, displacement, np.clip(force, -0.9, 0.9))
    assert both == ["clipping", "clipping"]
    kept = np.setdiff1d(np.arange(time.size), [700, 701])
    (fault,) = faults(time[kept], displacement[kept], force[kept])
    assert fault.samples.tolist() == [700]


@pytest.mark.parametrize("signal", [1, 2])
def test_spikes_are_told_with_their_places(signal):
    arrays, at = signals(), [333, 1000, 1777]
    arrays[signal][at] += 1.0
    fault = next(fault for fault in faults(*arrays) if fault.name == "spikes")
    assert fault.samples.tolist() == at
    assert f"3 isolated samples of the {('displacement', 'force')[signal - 1]}" in str(
        fault.message
    )


@pytest.mark.parametrize("times", [2, 3])
def test_repeated_samples_are_told(times):
    arrays = signals()
    held = np.arange(arrays[0].size) // times * times
    assert "repeated samples" in names(arrays[0], arrays[1][held], arrays[2][held])


@pytest.mark.parametrize("lag", [-0.04, -0.025, 0.02, 0.04])
def test_a_force_out_of_step_is_told_with_its_lag(lag):
    time, displacement, force = signals()
    late = np.interp(time - lag, time, force)
    (fault,) = faults(time, displacement, late)
    assert ("behind" if lag > 0 else "before") in str(fault.message)
    estimate = estimate_lag(Trace.from_arrays(time, displacement, None, late))
    assert estimate is not None
    assert estimate[0] == pytest.approx(lag, abs=0.008)


def test_a_force_that_does_not_follow_the_motion_has_no_lag():
    time, displacement, _ = signals()
    assert estimate_lag(Trace.from_arrays(time, displacement, None, NOISE)) is None


def test_a_zero_that_steps_is_a_drift():
    time, displacement, force = signals(cycles=8)
    assert names(time, displacement, force + 0.1 * (time > 8.0)) == ["drift"]


def test_a_drift_is_seen_although_most_cycles_ramp():
    time = np.arange(0.0, 20.0, 1 / 200)
    size = np.clip(np.minimum(time, 20.0 - time) / 6.5, 0.0, 1.0)
    displacement = size * np.sin(np.pi * time)
    force = size * np.tanh(8.0 * np.gradient(displacement, time))
    force += 0.002 * np.random.default_rng(0).normal(size=time.size)
    assert "drift" not in names(time, displacement, force)
    assert "drift" in names(time, displacement, force + 0.8 * time / time[-1])
    uneven = force + 0.4 * np.sin(np.pi * time / 20.0)  # it comes back: no drift
    assert "drift" not in names(time, displacement, uneven)


def test_some_faults_depend_on_the_gap():
    long = signals(amplitude=10.0)
    long = (long[0], stepped(long[1], 0.05), long[2])
    slow, small = signals(rate=20.0), signals(amplitude=0.07)
    for name, arrays, other in (
        ("resolution", long, None),
        ("rate", slow, None),
        ("stroke", small, 0.1),
    ):
        assert name in names(*arrays)
        assert name not in names(*arrays, gap=other)
    (sentence,) = [str(fault.message) for fault in faults(*slow) if fault.name == "rate"]
    assert "in the first 0.15 in after a reversal, where the force builds up" in sentence
    assert names(small[0], small[1], None) == ["stroke"]


def test_a_short_record_is_told_and_the_gravest_fault_comes_first():
    assert "short record" in names(*signals(cycles=1.5))
    time, displacement, force = signals(rate=20.0, cycles=1.5)
    order = names(1000 * time, displacement, -force)
    assert order[0] == "force sign"
    assert order.index("short record") < order.index("rate")


def test_a_motion_without_a_turn_is_judged_too():
    time, displacement, force = (values[:90] for values in signals())
    assert "short record" in names(time, displacement, force)


def test_real_records_raise_no_false_alarm(data_folder):
    for path in sorted(data_folder.glob("20*.csv")):
        assert find_faults(read_record(path).trace(), 0.2) == (), path.name


# --- the velocity


def velocity_faults(change):
    """Faults of the velocity of a noisy displacement in coarse steps, its own changed."""
    time = np.arange(801) / 100.0
    noise = np.random.default_rng(3).normal(0.0, 2e-3, time.size)
    motion = stepped(np.sin(np.pi * time) + noise, 1 / 500)
    velocity = np.pi * np.cos(np.pi * time) + 0.05  # with a zero that is a little off
    trace = Trace.from_arrays(time, motion, 0.5, np.sign(velocity), change(velocity))
    return [str(fault.message) for fault in find_faults(trace) if fault.name == "velocity"]


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
    (sentence,) = velocity_faults(change)
    assert "not that of the displacement" in sentence


@pytest.mark.parametrize("change", [lambda v: v, lambda v: 1.1 * v, lambda v: None])
def test_a_velocity_that_agrees_or_is_not_there_is_none(change):
    assert velocity_faults(change) == []
