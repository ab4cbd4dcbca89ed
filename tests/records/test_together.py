"""Tests compared with each other: duplicates, signs, units, actuations and other devices."""

from pathlib import Path

import numpy as np
import pytest

from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.records import duplicates
from mfd_bayes.records.cross_checks import Tested, compare_tests
from mfd_bayes.records.duplicates import Signature, find_twin
from mfd_bayes.records.outliers import deviation, find_odd
from mfd_bayes.records.record import Record
from mfd_bayes.records.trace import Trace

LEVELS = (20.0, 30.0, 35.0, 60.0, 80.0)
UNITS = {"displacement": ("x", "in"), "force": ("f", "kip")}


def motion(seed, cycles=6):
    """Six cycles at 0.5 Hz that ramp in, each test a little different."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 2.0 * cycles, 1 / 128)
    size = np.minimum(1.0, time / 2.0) * (1.0 + 0.01 * rng.normal())
    return time, size * np.sin(np.pi * time)


def trace_of(level, seed, *, length=1.0, force=1.0, actuation=1.0, cut=slice(None), noise=0):
    """A damper at a level in lbf; the record is wrong by the factors."""
    time, x = motion(seed)
    slip = 0.4 * level**0.5 * (1.0 + 0.05 * (-1) ** seed)
    theta = [[80, 0, 0, slip, slip, 1.1 * slip, 1.1 * slip, 0.3, 25, 0.1, 0.12, 1, 0.01, 0.5]]
    rng = np.random.default_rng(100 + seed + 1000 * noise)
    bent = 0.15 * slip * x**2  # both directions differ
    clean = ThreeStage().force(np.array(theta), Trace.from_arrays(time, x, 0.03))[0] + bent
    measured = clean + 0.03 * rng.normal(size=time.size)
    return Trace.from_arrays(
        time[cut] - time[cut][0],
        length * x[cut],
        actuation * level / 1000.0,
        force * measured[cut],
    )


def put(name, trace, actuation=None):
    record = replace_columns()
    level = f"{1000 * trace.reference_actuation:g} lbf" if actuation is None else actuation
    return Tested.of(name, record, trace, level)


def replace_columns():
    """A record of which only the columns are read."""
    record = object.__new__(Record)
    object.__setattr__(record, "columns", UNITS)
    object.__setattr__(record, "path", Path("a.csv"))
    return record


def campaign(k=None, **wrong):
    """Five tests; of test k the record is wrong."""
    return [
        put(f"t{level:g}", trace_of(level, n, **(wrong if n == k else {})))
        for n, level in enumerate(LEVELS)
    ]


def test_tests_of_one_device_are_not_named():
    assert compare_tests(campaign()) == []


WRONG = [
    ({"length": 25.4}, "unit of displacement", "displacement seems to be in mm, not in in"),
    ({"length": 4.0}, "displacement", "times too large: check its unit"),
    ({"force": 1000.0}, "unit of force", "force seems to be in lbf, not in kip"),
    ({"force": 4.448}, "unit of force", "force seems to be in kN, not in kip"),
    ({"force": -1.0}, "force sign", "probably that of the force"),
    ({"length": -1.0}, "force sign", "probably that of the displacement"),
    ({"length": -1.0, "force": -1.0}, "both signs", "probably both swapped"),
]


@pytest.mark.parametrize(("wrong", "name", "words"), WRONG)
@pytest.mark.parametrize("k", [0, 2, 4])
def test_the_test_that_is_wrong_is_named_with_its_cause(k, wrong, name, words):
    found = compare_tests(campaign(k, **wrong))
    assert [(test, fault.name) for test, fault in found] == [(f"t{LEVELS[k]:g}", name)]
    assert words in str(found[0][1].message)


@pytest.mark.parametrize(("wrong", "of"), [("force", "force"), ("length", "displacement")])
def test_two_other_tests_say_which_sign_is_swapped_where_the_work_is_negative(wrong, of):
    found = compare_tests(campaign(1, **{wrong: -1.0})[:3])
    assert [(test, fault.name) for test, fault in found] == [("t30", "force sign")]
    assert f"probably that of the {of}" in str(found[0][1].message)
    assert compare_tests(campaign(1, force=-1.0)[:2]) == []


@pytest.mark.parametrize(("k", "actuation"), [(2, 10.0), (4, 10.0), (2, 0.1)])
def test_an_actuation_that_is_wrong_by_ten_is_named(k, actuation):
    ((test, fault),) = compare_tests(campaign(k, actuation=actuation))
    assert (test, fault.name) == (f"t{LEVELS[k]:g}", "actuation")
    assert "probably wrong, by a factor of ten" in str(fault.message)


def forces(*sizes, level=(35.0,)):
    """Findings about tests at like actuation, or at levels, whose forces are scaled."""
    levels = (*level, *(level[-1:] * (len(sizes) - len(level))))
    return [
        (name, str(fault.message))
        for name, fault in compare_tests(
            [
                put(f"r{n}", trace_of(at, n, force=by))
                for n, (at, by) in enumerate(zip(levels, sizes, strict=True))
            ]
        )
    ]


def test_a_test_with_half_of_its_neighbours_force_is_named():
    ((name, sentence),) = forces(1.0, 1.0, 0.5)
    assert name == "r2"
    assert "times the one of about" in sentence
    ((name, _),) = forces(1.0, 0.5, 1.0, level=(30.0, 35.0, 40.0))
    assert name == "r1"
    ((name, _),) = forces(1.0, 1.0, 0.5, level=(20.0, 35.0, 35.0))
    assert name == "r2"
    both = forces(1.0, 0.5)
    assert [name for name, _ in both] == ["r0", "r1"]
    assert all("one of the two is wrong" in sentence for _, sentence in both)
    assert forces(1.0, 0.8, 1.2) == forces(1.0, 1.4, 2.0, level=(20.0, 35.0, 80.0)) == []


def test_a_tension_in_kn_is_named_with_the_unit_of_the_others():
    tests = campaign()
    trace = trace_of(35.0, 2, actuation=224.8089)
    tests[2] = put("t35", trace, "35 kN")
    ((test, fault),) = compare_tests(tests)
    assert test == "t35"
    assert "the actuation is probably 35 lbf, not 35 kN" in str(fault.message)


def test_another_device_is_named_as_such():
    time, x = motion(2)
    theta = [[300, 0, 0, 9, 9, 9.5, 9.5, 0.5, 300, 0.02, 0.03, 1, 0.002, 0.5]]
    force = ThreeStage().force(np.array(theta), Trace.from_arrays(time, x, 0.035))[0]
    tests = campaign()
    tests[2] = put("t35", Trace.from_arrays(time, x, 0.035, force))
    ((test, fault),) = compare_tests(tests)
    assert (test, fault.name) == ("t35", "another device")


def test_two_tests_cannot_tell_which_is_wrong():
    assert compare_tests(campaign(0, length=25.4)[:2]) == []


# --- duplicates


@pytest.mark.parametrize(
    ("rate", "begin", "end"), [(128, 0.0, 1.0), (100, 0.21, 0.9), (80, 0.0, 0.7), (64, 0.137, 0.8)]
)
def test_a_record_that_was_cut_or_sampled_anew_is_a_twin(rate, begin, end):
    trace = trace_of(35.0, 2)
    last = trace.time[-1]
    grid = np.arange(begin * last, end * last, 1.0 / rate)
    again = Trace.from_arrays(
        grid - grid[0],
        np.interp(grid, trace.time, trace.displacement),
        0.035,
        np.interp(grid, trace.time, trace.force),
    )
    twin = find_twin(Signature.of(again), Signature.of(trace))
    assert twin is not None
    assert twin.share > 0.97
    assert twin.lag == pytest.approx(grid[0], abs=2e-3)
    back = find_twin(Signature.of(trace), Signature.of(again))
    assert back is not None
    assert back.lag == pytest.approx(-grid[0], abs=2e-3)
    assert back.share == pytest.approx(twin.share * (end - begin), abs=0.02)


def test_a_twin_is_named_once_and_with_its_original():
    tests = campaign()
    tests.append(put("again", trace_of(35.0, 2)))
    tests.append(put("part", trace_of(35.0, 2, cut=slice(200, 1200))))
    found = compare_tests(tests)
    assert [(name, fault.name) for name, fault in found] == [
        ("again", "duplicate"),
        ("part", "duplicate"),
    ]
    assert str(found[0][1].message) == "same record as t35: it would count twice"
    assert "the same measurement as t35 in" in str(found[1][1].message)


def test_the_same_test_made_twice_is_no_twin():
    one, other = trace_of(35.0, 2), trace_of(35.0, 3)
    assert find_twin(Signature.of(one), Signature.of(other)) is None


def test_a_repeated_test_with_two_percent_more_friction_is_no_twin():
    """Its loop is as near as that of a copy, but a copy has the same noise."""
    one = Signature.of(trace_of(35.0, 2))
    other = Signature.of(trace_of(35.0, 2, noise=1, force=1.02))
    assert np.std(one.forces - other.forces) < duplicates.SAME * np.std(one.forces)
    assert find_twin(one, other) is None
    assert find_twin(one, one) is not None


def test_a_record_without_noise_is_its_own_twin():
    trace = trace_of(35.0, 2)
    smooth = np.sin(np.pi * trace.time) + 0.2 * np.sin(0.4 * np.pi * trace.time)
    finer = np.linspace(0.0, trace.time[-1], 3001)
    again = np.interp(finer, trace.time, smooth)
    one = Signature.of(Trace.from_arrays(trace.time, trace.displacement, 0.035, smooth))
    x = np.interp(finer, trace.time, trace.displacement)
    assert find_twin(Signature.of(Trace.from_arrays(finer, x, 0.035, again)), one) is not None


def test_a_record_with_another_force_is_no_twin():
    trace = trace_of(35.0, 2)
    for factor in (1.05, 1.3):
        other = Trace.from_arrays(
            trace.time, trace.displacement, 0.035, factor * np.asarray(trace.force)
        )
        assert find_twin(Signature.of(other), Signature.of(trace)) is None


def test_records_that_are_too_short_are_not_compared():
    short = trace_of(35.0, 2, cut=slice(0, 100))
    assert find_twin(Signature.of(short), Signature.of(short)) is None


# --- the law of the others


def logs(scatter, seed=0, count=8):
    rng = np.random.default_rng(seed)
    levels = np.linspace(0.02, 0.08, count)
    middle = np.log([0.3, 20.0, 2.0])[None] + np.log(levels / 0.05)[:, None] * [0.1, 0.3, 0.5]
    return middle + scatter * rng.normal(size=(count, 3)) * [0.08, 0.25, 0.15], levels


def test_scatter_of_one_device_seldom_makes_a_test_odd():
    odd = sum(bool(find_odd(*logs(1.0, seed))) for seed in range(300))
    assert odd <= 15


def test_two_odd_tests_do_not_hide_each_other():
    values, levels = logs(0.5)
    values[[1, 6], 0] += np.log(10.0)
    assert set(find_odd(values, levels)) == {1, 6}


def test_a_level_at_which_all_tests_deviate_is_no_tests_fault():
    values, levels = logs(0.3)
    levels[1] = levels[0]
    values[:2, 0] -= 0.6
    assert find_odd(values, levels) == {}
    values[1, 0] += 0.6
    assert set(find_odd(values, levels)) == {0}


def test_a_test_at_zero_actuation_is_not_compared():
    values, levels = logs(0.5)
    levels[0], values[0] = 0.0, values[0] + 3.0
    assert find_odd(values, levels) == {}


def test_a_deviation_far_from_the_other_levels_counts_for_less():
    values, levels = logs(0.0)
    place = np.log(levels)
    near = deviation(values, place, 3, [0, 1, 2, 4, 5, 6, 7])
    place[3] = np.log(2.0)
    far = deviation(values, place, 3, [0, 1, 2, 4, 5, 6, 7])
    assert far.sds[2] > 2 * near.sds[2]
