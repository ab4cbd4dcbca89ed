"""Arguments that do not fit are refused by one sentence, in this package's own error."""

import contextlib
import os
from fractions import Fraction
from pathlib import Path

import numpy as np
import pandas as pd
import pint
import pytest

import mfd_bayes as mb
from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.errors import FitError, MfdError, RecordError, UnitError
from mfd_bayes.friction.models import MODELS
from mfd_bayes.records.channels import Source, Subtracted
from mfd_bayes.records.numbers import real_number, real_numbers
from mfd_bayes.records.readers import read_table
from mfd_bayes.records.record import read_record
from mfd_bayes.records.regular import hash_file, path_of
from mfd_bayes.records.time_axis import checked_window
from mfd_bayes.records.trace import Trace, check_trace
from mfd_bayes.units import actuation_factor, factor, parse_mass, parse_quantity

TIME = np.arange(0.0, 8.0, 1 / 64)
MOTION = np.sin(np.pi * TIME)
UNIT = pint.UnitRegistry()


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

WRONG = {
    "masked": np.ma.masked_greater(MOTION, 0.5),
    "complex": MOTION + 1j,
    "text": MOTION.astype(str),
    "objects": np.array([*MOTION[:-1], "a"], dtype=object),
    "dates": np.full(MOTION.shape, np.datetime64("2020-01-01")),
    "a unit": MOTION * UNIT.mm,
    "units": [500 * UNIT.psi] * TIME.size,
    "nan": np.where(TIME < 2, 1.0, np.nan),
    "two lines": np.column_stack([MOTION, MOTION]),
    "ragged": [[1.0], [1.0, 2.0]],
}


@pytest.mark.filterwarnings("ignore::pint.UnitStrippedWarning")
@pytest.mark.parametrize("values", WRONG.values(), ids=WRONG)
@pytest.mark.parametrize("name", ["displacement", "actuation", "force", "velocity"])
def test_what_are_no_real_numbers_is_not_cast(name, values):
    arrays = {"displacement": MOTION, name: values}
    with pytest.raises(RecordError, match=name):
        Trace.from_arrays(TIME, **arrays)


@pytest.mark.parametrize("value", [True, np.array(True), "0.1", [0.1], np.nan, np.inf, -1.0])
def test_a_hysteresis_is_a_length(value):
    with pytest.raises(RecordError, match="hysteresis, in inches, must be a number from 0 to"):
        Trace.from_arrays(TIME, MOTION, hysteresis=value)


def test_an_actuation_is_a_number_without_a_unit():
    for value in (True, np.True_, 800 * UNIT.psi, (500 * UNIT.psi,), -1.0, np.inf):
        with pytest.raises(RecordError, match=r"actuation must (be|hold)"):
            Trace.from_arrays(TIME, MOTION, value)


def test_nothing_of_a_trace_can_be_changed():
    trace = Trace.from_arrays(TIME, MOTION, 0.5 + 0 * TIME, MOTION)
    arrays = [trace.velocity, trace.turning_points, *vars(trace).values()]
    arrays += vars(trace.path).values()
    arrays = [values for values in arrays if isinstance(values, np.ndarray)]
    assert len(arrays) > 14
    assert not any(values.flags.writeable for values in arrays)


def test_a_trace_is_a_trace():
    trace = Trace.from_arrays(TIME, MOTION, 0.5)
    assert check_trace("trace", trace, FitError) is trace
    with pytest.raises(FitError, match=r"trace must be a Trace, .* got ndarray"):
        check_trace("trace", MOTION, FitError)


# --- models and posteriors


def test_batches_of_models_and_posteriors_are_real_numbers_and_may_be_empty():
    trace = Trace.from_arrays(TIME, MOTION, 0.5, np.tanh(4 * np.cos(np.pi * TIME)))
    model, posterior = mb.ThreeStage(), mb.Posterior(trace, priors="mfd", noise="ou")
    theta = posterior.draw_prior(np.random.default_rng(0), 0)
    assert {values.shape for values in theta.values()} == {(0,)}
    assert model.force(np.empty((0, len(model.parameters))), trace).shape == (0, TIME.size)
    assert posterior.log_prob(np.empty((0, posterior.dim))).shape == (0,)
    wrong = (lambda x: np.ma.masked_greater(x, 0), lambda x: x + 1j, lambda x: x.astype(str))
    for make in wrong:
        with pytest.raises(FitError, match=r"masked|real numbers"):
            model.force(make(np.ones((2, len(model.parameters)))), trace)
        with pytest.raises(FitError, match=r"masked|real numbers"):
            posterior.log_prob(make(np.ones((2, posterior.dim))))
    for n in (-1, 1.5, "2", None, True):
        with pytest.raises(FitError, match="must be a whole number, 0 or more"):
            posterior.draw_prior(np.random.default_rng(0), n)
    for seed in (-1, 0.5, "x", [1, -2], None):
        with pytest.raises(FitError, match="seed must be a whole number"):
            mb.sample(posterior, "quick", seed)


def some_theta(model):
    rng = np.random.default_rng(1)
    drawn = {name: prior.draw(rng, 3) for name, prior in load_priors("mfd").parameters.items()}
    return model.theta({"gamma1": np.ones(3), **drawn})


@pytest.mark.parametrize("name", MODELS)
def test_a_force_is_a_number_or_refused(name):
    model, trace = MODELS[name], Trace.from_arrays(TIME, MOTION, 0.5)
    rng, theta = np.random.default_rng(2), some_theta(model)
    powers = [0, 0, 0, -300, -38, -9, 9, 38, 300]
    finite = []
    for factors in [1e300, *(10.0 ** rng.choice(powers, size=(120, theta.shape[1])))]:
        with contextlib.suppress(FitError):
            finite.append(np.isfinite(model.force(factors * theta, trace)).all())
    assert len(finite) > 5
    assert all(finite)


@pytest.mark.parametrize("dt", [-0.1, np.nan, np.inf])
def test_a_step_of_no_time_is_refused_from_the_first_sample_on(dt):
    model = mb.ThreeStage()
    state = model.start(some_theta(model))
    with pytest.raises(FitError, match="dt of a step"):
        model.step(state, 0.0, 1.0, dt)
    _, state = model.step(state, 0.0, 1.0, 0.0)
    with pytest.raises(FitError, match="dt of a step"):
        model.step(state, 0.1, 1.0, dt)


# --- numbers, windows and paths


@pytest.mark.parametrize("value", [2, np.float32(2), np.int64(2), np.array(2.0), Fraction(4, 2)])
def test_a_number_is_taken_in_every_form(record, value):
    assert real_number("x", value, FitError, (0.0, np.inf)) == 2.0
    np.testing.assert_array_equal(real_numbers("x", [value, 1]), [2.0, 1.0])
    if not isinstance(value, Fraction):
        assert record.trace(16 * value).samples == record.trace(32.0).samples


@pytest.mark.parametrize(
    "value", [True, np.True_, "2", None, [2.0], np.array([2.0]), np.nan, np.inf, 10**400, 2j, -1.0]
)
def test_what_is_no_number_is_none(record, value):
    with pytest.raises(FitError, match="x must be a finite number of at least 0, got"):
        real_number("x", value, FitError, (0.0, np.inf))
    if value is not None:
        with pytest.raises(RecordError, match="gap, in inches, must be a finite number above 0"):
            record.trace(gap=value)


@pytest.mark.parametrize(
    ("bounds", "words"),
    [
        ({}, "a finite number"),
        ({"bounds": (0.0, np.inf), "inside": True}, "a finite number above 0"),
        ({"bounds": (-np.inf, 1.0)}, "a finite number of at most 1"),
        ({"bounds": (0.0, 1.0), "inside": True}, "a number between 0 and 1"),
        ({"bounds": (0.0, 1.0)}, "a number from 0 to 1"),
    ],
)
def test_the_sentence_says_which_numbers_there_may_be(bounds, words):
    with pytest.raises(FitError, match=f"p must be {words}, got 'x'"):
        real_number("p", "x", FitError, **bounds)


@pytest.mark.parametrize("window", [[0, 4], np.array([0, 4]), (np.float32(0), 4), (-np.inf, 4)])
def test_a_window_is_taken_in_every_form(record, path, window):
    expected = record.trace(window=(0, 4))
    np.testing.assert_array_equal(record.trace(window=window).time, expected.time)
    np.testing.assert_array_equal(read_record(path, fit=window).trace().time, expected.time)


@pytest.mark.parametrize(
    "window",
    [
        True,
        5,
        (0, True),
        ("0", "4"),
        {0, 4},
        {0: 1, 4: 1},
        ([0], 4),
        (4, 0),
        (np.nan, 4),
        b"04",
        (),
    ],
)
def test_what_is_no_window_is_none(record, path, window):
    for read in (lambda: record.trace(window=window), lambda: read_record(path, fit=window)):
        with pytest.raises(RecordError, match="two times in s, the earlier one first"):
            read()
    with pytest.raises(FitError, match="given must be two times"):
        checked_window(window, "given", FitError)


def test_what_is_left_out_is_asked_of_a_trace(record):
    with pytest.raises(RecordError, match="trace must be a Trace"):
        record.around(None)
    for since in ("a", None, [0.0], np.nan):
        with pytest.raises(RecordError, match="since, in s, must be"):
            record.around(record.trace(), since)


def test_a_path_is_text_or_a_path_of_a_file(tmp_path):
    assert path_of("out", "a/b", FitError) == path_of("out", Path("a/b"), FitError) == Path("a/b")
    for given in (None, 5, b"a", ["a"], "a\0b"):
        with pytest.raises(RecordError, match="path must be a path"):
            read_record(given)
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


# --- columns and quantities in words


@pytest.mark.parametrize("given", [["time_s"], 5, pd.Series({"time": "time_s"}), "", []])
@pytest.mark.parametrize("name", ["columns", "units"])
def test_columns_and_units_are_given_by_role(path, name, given):
    with pytest.raises(RecordError, match=f"{name} must be a mapping such as"):
        read_record(path, **{name: given})
    assert read_record(path, **{name: {}}).force is not None


@pytest.mark.parametrize("given", [0.5, True, b"500 psi", ["500 psi"], ("1", "2")])
def test_quantities_and_units_are_text(path, given):
    for parse in (lambda q: parse_quantity(q, "force"), parse_mass):
        with pytest.raises(UnitError, match="expected a number and a unit such as"):
            parse(given)
    with pytest.raises(UnitError, match="expected a number and a unit such as"):
        read_record(path, actuation=given)
    for convert in (lambda unit: factor(unit, "displacement"), actuation_factor):
        with pytest.raises(UnitError, match="unknown"):
            convert(given)


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"arm": 4}, "arm of the force of .* must be text such as '4 in', got 4"),
        ({"minus_mass": 3}, "minus_mass of the force .* must be text such as '3 kg', got 3"),
        ({"tare": (0, 2)}, "tare of the force .* must be text"),
        ({"arm": "4 in", "measured_at": 3}, "measured_at of the force .* must be text"),
        ({"minus": Subtracted("displacement_in", times=1)}, "times of the force .* must be text"),
        ({"minus": "force_kip"}, "minus of the force of .* must be a Subtracted"),
        ({"minus": Source("force_kip")}, "minus of the force of .* must be a Subtracted"),
    ],
)
def test_parts_of_a_source_are_of_their_own_kind(path, parts, words):
    columns = {"time": "time_s", "displacement": "displacement_in"}
    with pytest.raises(MfdError, match=words):
        read_record(path, columns | {"force": Source("force_kip", **parts)})
