"""What tests cover, and where a motion leaves it."""

import numpy as np
import pytest

from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.tested_range import (
    conditions_of,
    extrapolation_messages,
    extrapolations,
    kind_sentence,
    range_of,
    reach_of,
)
from mfd_bayes.runs.unit_system import SI, US
from tests.command_line import said, write_csv

SINE = "1 in, 1 Hz, 3 cycles"


def sine(amplitude=1.0, frequency=0.5, actuation=1.0, cycles=4):
    time = np.linspace(0.0, cycles / frequency, 400 * cycles + 1)
    motion = amplitude * np.sin(2.0 * np.pi * frequency * time)
    return Trace.from_arrays(time, motion, actuation)


RANGE = range_of(map(conditions_of, (sine(0.5, 0.25, 0.5), sine(1.0, 0.5, 1.5))), "ksi")


def left(*motion):
    return {d.reached.name: d for d in extrapolations(RANGE, reach_of(sine(*motion), "ksi"))}


def test_the_range_holds_all_tests():
    spans = {span.name: (span.lowest, span.highest) for span in RANGE}
    assert spans["stroke"] == pytest.approx((1.0, 2.0))
    assert spans["speed"] == pytest.approx((0.25 * np.pi, np.pi), rel=0.01)
    assert spans["frequency"] == pytest.approx((0.25, 0.5), rel=0.01)
    assert spans["actuation"] == (0.5, 1.5)
    assert [span.words(US) for span in RANGE[::3]] == ["1 to 2 in", "500 to 1500 psi"]
    assert RANGE[0].words(SI) == "25.4 to 50.8 mm"


def test_what_lies_outside_is_said():
    for motion, name, far in (
        ((1.5, 0.3, 1.0), "stroke", False),
        ((2.5, 0.25, 1.0), "stroke", True),
        ((0.1, 0.5, 1.0), "stroke", False),
        ((1.0, 0.8, 1.0), "speed", False),
        ((2.0, 1.0, 1.0), "speed", True),
        ((0.5, 1.5, 1.0), "frequency", True),
        ((1.0, 0.5, 3.0), "actuation", False),
        ((1.0, 0.5, 3.1), "actuation", True),
        ((1.0, 0.5, 0.2), "actuation", True),
    ):
        exceeded = left(*motion)
        assert exceeded[name].far is far
        words = f"lies {'far outside' if far else 'outside'} the tested range"
        assert words in exceeded[name].sentence(US)
        assert (name in extrapolation_messages(exceeded.values(), US)) == far


def test_what_lies_inside_is_not_said_and_how_many_times_is():
    assert left(1.0, 0.5, 1.0) == {}
    assert left(0.5, 0.2, 1.0).keys() == {"frequency"}  # every test is slow near its turns
    faster = left(2.0, 1.0, 1.0)["speed"]
    for words in ("12.6 in/s", "4 times the largest"):
        assert words in faster.sentence(US)
    assert "319 mm/s" in faster.sentence(SI)


def test_a_history_reaches_from_its_least_to_its_largest_actuation():
    time = np.linspace(0.0, 8.0, 801)
    for ends, words, times in (
        ((0.7, 9.0), "700 to 9000 psi", 6.0),
        ((0.1, 1.505), "100 to 1505 psi", 0.2),  # 1.505 counts as tested
    ):
        history = Trace.from_arrays(time, np.sin(np.pi * time), np.linspace(*ends, 801))
        (departure,) = extrapolations(RANGE, reach_of(history, "ksi"))
        assert departure.reached.words(US) == words
        assert departure.times == pytest.approx(times)
        assert departure.far


def quake(seconds=20.0):
    """A motion within the tested range that turns back before a full cycle at most turns, in."""
    time = np.arange(0.0, seconds, 0.02)
    pulse = 0.8 * np.exp(-(((time - 8.0) / 0.7) ** 2))
    return time, 0.15 * np.sin(2 * np.pi * 0.9 * time) * np.sin(0.5 * time) + pulse


def test_a_motion_of_another_kind_is_said_and_has_no_properties_of_cycles(made_run, tmp_path):
    write_csv(tmp_path / "quake.csv", *quake())
    for motion, uneven in ((("--motion", tmp_path / "quake.csv"), True), (("--sine", SINE), False)):
        bands = tmp_path / f"{uneven}.csv"
        how = ("--actuation", "700 psi", "--no-figures", "--extrapolate")
        words = said("predict", made_run, *motion, *how, "-o", bands)
        assert ("most strokes of this motion are partial" in words) == uneven
        derived = (tmp_path / f"{uneven}_derived.csv").read_text()
        for name in ("slip_fwd", "effective_stiffness", "energy_per_cycle"):
            assert (name not in derived) == uneven
        assert "total_energy" in derived
        assert "peak_fwd" in derived


@pytest.mark.parametrize(
    "amplitudes", [[1.0] * 4, [0.3, 0.6, 1.0, 1.0, 0.6], [0.25, 0.25, 0.5, 0.5, 0.75, 1.0, 1.0]]
)
def test_full_cycles_are_of_the_tests_kind(amplitudes):
    time = np.linspace(0.0, 2.0 * len(amplitudes), 200 * len(amplitudes), endpoint=False)
    motion = np.repeat(amplitudes, 200) * np.sin(np.pi * time)
    tests = [conditions_of(sine())]
    assert kind_sentence(tests, Trace.from_arrays(time, motion, 1.0)) == ""
    trace = Trace.from_arrays(*quake(), 1.0)
    assert "another kind" in kind_sentence(tests, trace)  # the control
    assert kind_sentence([conditions_of(trace)], trace) == ""
