"""Extreme numbers in a record give a verdict or a one-sentence error."""

import datetime

import numpy as np
import pytest

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.errors import MfdError
from mfd_bayes.pipeline.plan import Options, plan_campaign
from mfd_bayes.records.record import read_record
from mfd_bayes.records.trace import LARGEST, Trace

TIME = np.arange(200) / 50
MOTION = np.sin(np.pi * TIME)
FORCE = np.tanh(5 * np.cos(np.pi * TIME))
NAMES = ("time_s", "displacement_in", "force_kip", "pressure_psi")


def write(folder, **changed):
    """CSV file of a record whose columns are changed by name."""
    columns = dict(zip(NAMES, (TIME, MOTION, FORCE, np.full(200, 500.0)), strict=True)) | changed
    size = min(map(len, columns.values()))
    rows = np.column_stack([column[:size] for column in columns.values()])
    path = folder / "a.csv"
    np.savetxt(path, rows, "%.17g", ",", header=",".join(columns), comments="")
    return path


def plan(folder, actuation="500 psi", model="lugre"):
    path = folder / "campaign.toml"
    path.write_text(
        f'[campaign]\nmodel = "{model}"\nnoise = "iid"\n'
        f'[[test]]\nid = "a"\nfile = "a.csv"\nactuation = "{actuation}"\n'
    )
    return plan_campaign(path, Options(effort="quick"))


def with_value(column, at, value):
    changed = np.array(column, dtype=float)
    changed[at] = value
    return changed


REFUSED = {
    "ten samples": ({"time_s": TIME[:10]}, "10 samples"),
    "a time twice": ({"time_s": with_value(TIME, 9, TIME[8])}, "does not increase at line 11"),
    "steps too short": ({"time_s": TIME * 1e-12}, "expected 1e-09 s or more"),
    "constant displacement": ({"displacement_in": np.ones(200)}, "is constant"),
    "a stroke of nothing": ({"displacement_in": 1e-12 * MOTION}, "is constant"),
    "zero force": ({"force_kip": np.zeros(200)}, "zero throughout"),
    "force of 1e12 kip": ({"force_kip": 1e12 * FORCE}, "too large to use"),
    "force of 1e308 kip": ({"force_kip": 1e308 * FORCE}, "too large to use"),
    "displacement of 1e12 in": ({"displacement_in": 1e12 * MOTION}, "too large to use"),
    "a counter that overflowed": ({"time_s": with_value(TIME, -1, 2.0**64)}, "too large to use"),
    "a counter that began again": ({"time_s": np.arange(200) % 128}, "does not increase"),
    "no turn": ({"displacement_in": TIME}, "0 turning points"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_record_that_cannot_be_used_is_refused(tmp_path, case):
    changed, words = REFUSED[case]
    write(tmp_path, **changed)
    with pytest.raises(MfdError, match=words):
        plan(tmp_path)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("column", NAMES)
def test_what_is_not_finite_is_named_by_line_and_column(tmp_path, column, value):
    columns = dict(zip(NAMES, (TIME, MOTION, FORCE, np.full(200, 500.0)), strict=True))
    path = write(tmp_path, **{column: with_value(columns[column], 41, value)})
    roles = dict(zip(("time", "displacement", "force", "actuation"), NAMES, strict=True))
    with pytest.raises(MfdError, match=f"line 43 of .*{column}"):
        read_record(path, roles)


@pytest.mark.parametrize("scale", [1e-12, 1e-3, 1e3, 1e9])
@pytest.mark.parametrize("model", ["lugre", "three_stage", "bouc_wen", "backlash"])
def test_a_force_of_any_size_that_is_taken_has_a_likelihood(tmp_path, scale, model):
    write(tmp_path, force_kip=scale * FORCE)
    (task,) = plan(tmp_path, model=model).tasks
    posterior = Posterior(task.trace, task.priors, "iid", model)
    drawn = posterior.draw_prior(np.random.default_rng(1), 50)
    values = posterior.log_prob(posterior.coordinates(drawn))
    assert not np.any(np.isnan(values))
    assert np.any(np.isfinite(values))


@pytest.mark.parametrize("actuation", ["1e-9 psi", "1e6 psi"])
def test_any_actuation_above_zero_is_planned(tmp_path, actuation):
    write(tmp_path)
    assert plan(tmp_path, actuation).tasks


@pytest.mark.parametrize(
    ("actuation", "words"),
    [
        ("0 psi", "need an actuation above zero in at least one"),
        ("-1 psi", "must not be negative"),
        ("1e300 psi", "too large to use"),
        ("1e999 psi", "not finite"),
    ],
)
def test_no_actuation_and_an_endless_one_are_refused(tmp_path, actuation, words):
    write(tmp_path)
    with pytest.raises(MfdError, match=words):
        plan(tmp_path, actuation)


@pytest.mark.parametrize("stroke", [1e-6, 0.01, 1e3])
def test_a_stroke_within_the_gap_or_far_beyond_has_a_likelihood(tmp_path, stroke):
    write(tmp_path, displacement_in=stroke * MOTION)
    (task,) = plan(tmp_path, model="three_stage").tasks
    posterior = Posterior(task.trace, task.priors)
    drawn = posterior.draw_prior(np.random.default_rng(1), 50)
    assert np.any(np.isfinite(posterior.log_prob(posterior.coordinates(drawn))))


def test_one_slip_is_a_record(tmp_path):
    motion = np.interp(TIME, [0.0, 0.2, 3.8, TIME[-1]], [0.0, -0.01, 1.0, 0.99])
    write(tmp_path, displacement_in=motion)
    (task,) = plan(tmp_path, model="three_stage").tasks
    posterior = Posterior(task.trace, task.priors)
    drawn = posterior.draw_prior(np.random.default_rng(1), 50)
    assert np.any(np.isfinite(posterior.log_prob(posterior.coordinates(drawn))))


def test_a_million_samples_are_read_thinned_and_have_a_likelihood(tmp_path):
    time = np.arange(1_000_000) / 1000
    rows = np.column_stack([time, np.sin(0.2 * np.pi * time), np.cos(0.2 * np.pi * time)])
    path = tmp_path / "a.csv"
    lines = map("{:.3f},{:.5f},{:.5f}\n".format, *rows.T.tolist())
    path.write_text("time_s,displacement_in,force_kip\n" + "".join(lines))
    record = read_record(path, actuation="500 psi")
    assert record.time.size == 1_000_000
    trace = record.trace(gap=load_priors("mfd").gap)
    assert trace.samples < 1_000_000
    posterior = Posterior(trace)
    drawn = posterior.draw_prior(np.random.default_rng(1), 2)
    assert not np.any(np.isnan(posterior.log_prob(posterior.coordinates(drawn))))


def test_times_since_1970_and_no_further(tmp_path):
    now = datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC).timestamp()
    record = read_record(write(tmp_path, time_s=now + TIME))
    assert record.rate == pytest.approx(50.0, rel=1e-3)
    Trace.from_arrays(TIME, LARGEST * MOTION)
    with pytest.raises(MfdError, match="too large"):
        Trace.from_arrays(TIME, 2 * LARGEST * MOTION)
