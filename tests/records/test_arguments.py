"""Arguments that do not fit are refused by records and traces, by one sentence each."""

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pint
import pytest

from mfd_bayes.errors import FitError, RecordError, UnitError
from mfd_bayes.records.channels import Source, Subtracted
from mfd_bayes.records.readers import read_table
from mfd_bayes.records.record import read_record
from mfd_bayes.records.regular import hash_file
from mfd_bayes.records.time_axis import checked_window
from mfd_bayes.records.trace import Trace
from mfd_bayes.units import actuation_factor, factor, parse_mass, parse_quantity

TIME = np.arange(0.0, 8.0, 1 / 64)
MOTION = np.sin(np.pi * TIME)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("arguments") / "a.csv"
    columns = {"time_s": TIME, "displacement_in": MOTION, "force_kip": np.cos(TIME)}
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


@pytest.fixture(scope="module")
def record(path):
    return read_record(path)


# --- traces


def test_a_force_that_is_not_known_is_zero():
    force = np.where(TIME < 2, 1.0, np.nan)
    with pytest.raises(RecordError, match=r"force must be finite; .* fill it with 0"):
        Trace.from_arrays(TIME, MOTION, 0.5, force)
    with pytest.raises(RecordError, match=r"velocity must be finite; sample 128 is nan$"):
        Trace.from_arrays(TIME, MOTION, 0.5, velocity=force)


def test_nothing_of_a_trace_can_be_changed():
    trace = Trace.from_arrays(TIME, MOTION, 0.5 + 0 * TIME, MOTION)
    arrays = [trace.velocity, trace.turning_points, *vars(trace).values()]
    arrays += vars(trace.path).values()
    arrays = [values for values in arrays if isinstance(values, np.ndarray)]
    assert len(arrays) > 14
    assert not any(values.flags.writeable for values in arrays)


@pytest.mark.parametrize("value", [True, False, np.True_, np.array(True)])
def test_true_is_no_number(value):
    with pytest.raises(RecordError, match="actuation must hold real numbers, got"):
        Trace.from_arrays(TIME, MOTION, value)
    with pytest.raises(RecordError, match="hysteresis, in inches, must be"):
        Trace.from_arrays(TIME, MOTION, hysteresis=value)


@pytest.mark.parametrize("value", ["0.1", [0.1], np.array([0.1]), np.nan, np.inf, -1.0])
def test_a_hysteresis_is_a_length(value):
    with pytest.raises(RecordError, match="hysteresis, in inches, must be a number from 0 to"):
        Trace.from_arrays(TIME, MOTION, hysteresis=value)
    assert type(Trace.from_arrays(TIME, MOTION, hysteresis=np.float32(0.5)).hysteresis) is float


@pytest.mark.filterwarnings("ignore::pint.UnitStrippedWarning")
def test_an_actuation_is_numbers_in_one_line():
    unit = pint.UnitRegistry()
    with pytest.raises(RecordError, match="actuation must hold real numbers"):
        Trace.from_arrays(TIME, MOTION, [[1.0], [1.0, 2.0]])
    for several in ([500 * unit.psi] * TIME.size, (500 * unit.psi,)):
        with pytest.raises(RecordError, match="actuation must be plain numbers without a unit"):
            Trace.from_arrays(TIME, MOTION, several)


# --- records


@pytest.mark.parametrize("value", [0, -1, np.nan, np.inf, True, "0.2", [0.2]])
def test_a_rate_and_a_gap_are_positive_numbers(record, value):
    with pytest.raises(RecordError, match="gap, in inches, must be a finite number above 0"):
        record.trace(gap=value)
    with pytest.raises(RecordError, match="rate, in Hz, must be a finite number above 0"):
        record.trace(value)


def test_a_rate_is_taken_in_every_form(record):
    expected = record.trace(32.0)
    for rate in (32, np.float32(32), np.int64(32), np.array(32.0)):
        np.testing.assert_array_equal(record.trace(rate).time, expected.time)
    assert record.trace(gap=np.float32(0.25)).samples == record.trace(gap=0.25).samples


@pytest.mark.parametrize("window", [[0, 4], np.array([0, 4]), (np.float32(0), 4), (-np.inf, 4)])
def test_a_window_is_taken_in_every_form(record, path, window):
    expected = record.trace(window=(0, 4))
    np.testing.assert_array_equal(record.trace(window=window).time, expected.time)
    np.testing.assert_array_equal(read_record(path, fit=window).trace().time, expected.time)


@pytest.mark.parametrize(
    "window",
    [
        *(True, 5, (True, 4), (0, True), ("0", "4"), {0, 4}, {0: 1, 4: 1}, [[0, 1], [2, 3]]),
        *(([0], 4), (4, 0), (np.nan, 4), (0, 1, 2), np.array(3.0), np.zeros((2, 2)), b"04"),
    ],
)
def test_what_is_no_window_is_none(record, path, window):
    words = "a window must be two times in s, the earlier one first"
    with pytest.raises(RecordError, match=words):
        record.trace(window=window)
    with pytest.raises(RecordError, match=words):
        read_record(path, fit=window)
    with pytest.raises(FitError, match="given must be two times"):
        checked_window(window, "given", FitError)


def test_what_is_left_out_is_asked_of_a_trace(record):
    with pytest.raises(RecordError, match="trace must be a Trace"):
        record.around(None)
    for since in ("a", None, [0.0], np.nan):
        with pytest.raises(RecordError, match="since, in s, must be"):
            record.around(record.trace(), since)


@pytest.mark.parametrize("given", [None, 5, b"a.csv", ["a.csv"], "a\0.csv"])
def test_a_path_is_text_or_a_path(given):
    with pytest.raises(RecordError, match="path must be a path"):
        read_record(given)


def test_a_name_that_no_file_can_have_is_refused(tmp_path):
    with pytest.raises(RecordError, match=r"cannot read|too long"):
        read_record(tmp_path / f"{5000 * 'a'}.csv")
    with pytest.raises(RecordError, match="NUL"):
        read_table(Path("a\0.csv"))
    with pytest.raises(OSError, match="NUL"):
        hash_file(Path("a\0.csv"))
    with pytest.raises(RecordError, match="is a folder"):
        read_table(tmp_path)
    os.mkfifo(tmp_path / "a.csv")
    with pytest.raises(RecordError, match="is a pipe"):
        read_table(tmp_path / "a.csv")


@pytest.mark.parametrize("given", ["time_s", ["time_s"], 5, pd.Series({"time": "time_s"}), "", []])
@pytest.mark.parametrize("name", ["columns", "units"])
def test_columns_and_units_are_given_by_role(path, name, given):
    with pytest.raises(RecordError, match=f"{name} must be a mapping such as"):
        read_record(path, **{name: given})
    assert read_record(path, **{name: {}}).force is not None


# --- quantities in words


@pytest.mark.parametrize("given", [0.5, 500, True, b"500 psi", ["500 psi"], ("1", "2")])
def test_a_quantity_is_text(path, given):
    for parse in (lambda q: parse_quantity(q, "force"), parse_mass):
        with pytest.raises(UnitError, match="expected a number and a unit such as"):
            parse(given)
    with pytest.raises(UnitError, match="expected a number and a unit such as"):
        read_record(path, actuation=given)


@pytest.mark.parametrize("unit", [5, None, b"mm", ["mm"]])
def test_a_unit_is_text(unit):
    with pytest.raises(UnitError, match="unknown"):
        factor(unit, "displacement")
    with pytest.raises(UnitError, match="unknown"):
        actuation_factor(unit)


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"arm": 4}, "arm of the force of .* must be text such as '4 in', got 4"),
        ({"minus_mass": 3}, "minus_mass of the force .* must be text such as '3 kg', got 3"),
        ({"tare": (0, 2)}, "tare of the force .* must be text"),
        ({"tare": 5}, "tare of the force .* must be text"),
        ({"arm": "4 in", "measured_at": 3}, "measured_at of the force .* must be text"),
        ({"minus": Subtracted("displacement_in", times=1)}, "times of the force .* must be text"),
    ],
)
def test_parts_of_a_source_are_text(path, parts, words):
    columns = {"time": "time_s", "displacement": "displacement_in"}
    with pytest.raises(UnitError, match=words):
        read_record(path, columns | {"force": Source("force_kip", **parts)})


@pytest.mark.parametrize("minus", ["force_kip", 3, Source("force_kip")])
def test_what_is_taken_off_is_a_column_of_its_own_kind(path, minus):
    columns = {"time": "time_s", "displacement": "displacement_in"}
    with pytest.raises(RecordError, match=r"minus of the force of .* must be a Subtracted"):
        read_record(path, columns | {"force": Source("force_kip", minus=minus)})
