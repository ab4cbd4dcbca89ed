"""Readings off the loop beside the parameters of a fit."""

import numpy as np
import pytest

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.evaluation.read_off import reading_check, reading_rows
from mfd_bayes.records.trace import Trace
from mfd_bayes.calibration.predictive import _check
from mfd_bayes.runs.unit_system import SI
from mfd_bayes.runs.verdict import Verdict

TIME = np.arange(0.0, 10.0, 1 / 128)


def posterior_of(model="three_stage", offset=0.3):
    """A record of straight lines: slip 2 kip forward and 2.4 backward, gap 0.25 in."""
    x = np.sin(np.pi * TIME)
    force, travel, way = np.zeros(TIME.size), 0.0, 1.0
    for n in range(1, TIME.size):
        step = x[n] - x[n - 1]
        if step * way < 0:
            way, travel = -way, 0.0
        travel += abs(step)
        level = 2.0 if way > 0 else 2.4
        force[n] = way * np.clip(20.0 * (travel - 0.25) + level, 0.0, level)
    return Posterior(Trace.from_arrays(TIME, x, 0.03, force + offset), "brfd", "iid", model)


def draws(offset=0.3, **values):
    middle = {"Fc_fwd": 2.0, "Fc_bwd": 2.4, "Fs_fwd": 1.95, "Fs_bwd": 2.35, "k3": 20.0}
    middle |= {"d2": 0.15, "d3": 0.1, "offset": offset} | values
    rng = np.random.default_rng(0)
    return {name: value * (1 + 0.01 * rng.normal(size=400)) for name, value in middle.items()}


def test_parameters_that_agree_with_their_readings_are_not_named():
    rows = reading_rows("a", posterior_of(), draws())
    assert [row.name for row in rows] == ["Fc_fwd", "Fc_bwd", "k3", "gap", "Fs_fwd", "Fs_bwd"]
    assert not any(row.missed for row in rows)
    found = {row.name: row.value for row in rows}
    assert found["Fc_fwd"] == pytest.approx(2.0, abs=0.02)
    assert found["Fc_bwd"] == pytest.approx(2.4, abs=0.02)
    assert found["gap"] == pytest.approx(0.25, rel=0.05)
    assert {reading_check(row).verdict for row in rows} == {Verdict.PASS}


@pytest.mark.parametrize(
    ("name", "value"), [("Fc_fwd", 1.5), ("k3", 45.0), ("d2", 0.4), ("Fs_bwd", 2.7)]
)
def test_a_parameter_that_misses_its_reading_is_noted(name, value):
    rows = reading_rows("a", posterior_of(), draws(**{name: value}))
    (missed,) = [row for row in rows if row.missed]
    assert missed.name == {"d2": "gap"}.get(name, name)
    check = reading_check(missed)
    assert check.verdict == Verdict.NOTE
    assert ("largest force" if name == "Fs_bwd" else "read off") in check.target
    shown = _check(check, SI)
    assert f"{shown.value:.3g} {shown.unit}" in shown.target
    assert f"{check.value:.3g} {check.unit}" in check.target


@pytest.mark.parametrize(("value", "verdict"), [(0.9, "fail"), (1.1, "note"), (4.5, "fail")])
def test_a_slip_force_that_is_far_from_its_reading_fails(value, verdict):
    rows = reading_rows("a", posterior_of(), draws(Fc_fwd=value, k3=4.0))
    found = {row.name: reading_check(row).verdict for row in rows}
    assert found["Fc_fwd"] == verdict
    assert found["k3"] == "note"  # no slip force


def test_static_friction_at_the_largest_force_is_not_noted():
    found = {row.name: row for row in reading_rows("a", posterior_of(), draws())}
    largest = found["Fs_bwd"].value
    for factor, missed in ((1.005, False), (1.03, True)):
        values = draws()
        values["Fs_bwd"] *= factor * largest / np.median(values["Fs_bwd"])
        rows = reading_rows("a", posterior_of(), values)
        assert {r.name for r in rows if r.missed} == ({"Fs_bwd"} if missed else set())


def test_the_tolerance_is_the_campaigns():
    values = draws(Fc_fwd=1.5)
    assert not any(r.missed for r in reading_rows("a", posterior_of(), values, {"slip_force": 0.3}))


def test_another_model_is_read_by_its_own_parameters():
    values = {"Fy_fwd": 2.0, "Fy_bwd": 2.4, "offset": 0.3}
    rng = np.random.default_rng(0)
    drawn = {name: value + 0.01 * rng.normal(size=200) for name, value in values.items()}
    rows = reading_rows("a", posterior_of("bouc_wen"), drawn)
    assert [row.name for row in rows] == ["Fy_fwd", "Fy_bwd"]
