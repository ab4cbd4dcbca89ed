"""Bounding properties from draws whose quantiles are known, and the data sheet of a run."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from mfd_bayes import open_run
from mfd_bayes.applications.properties.datasheet import datasheet
from mfd_bayes.applications.properties.harmonic import parse_condition
from mfd_bayes.errors import MfdError
from mfd_bayes.evaluation.bounds import ANOTHER, NOT_KNOWN, bounds_of, design_warnings
from mfd_bayes.evaluation.properties import is_missed
from mfd_bayes.records.trace import Trace
from tests.run_folders import FORCE, MOTION

UNIT = (np.arange(2000) + 0.5) / 2000.0
DRAWN = {
    "mean": {"slip_fwd": 2.0 + 0.2 * (UNIT - 0.5), "energy_per_cycle": np.full(2000, 4.0)},
    "new_test": {"slip_fwd": 2.0 + 2.0 * (UNIT - 0.5), "energy_per_cycle": 3.0 + 2.0 * UNIT},
    "observation": {"energy_per_cycle": 2.0 + 4.0 * UNIT},
}


def bounds(probability=0.9, draws=DRAWN):
    return {(r["name"], r["basis"]): r for r in bounds_of(draws, probability)}


def test_bounds_are_quantiles_and_factors_relative_to_the_mean_property():
    row = bounds(0.9)["slip_fwd", "new_test"]
    figures = [row[key] for key in ("lower", "nominal", "upper", "lower_ratio", "upper_ratio")]
    assert figures == pytest.approx([1.1, 2.0, 2.9, 0.55, 1.45], abs=1e-3)
    narrow = bounds(0.5)["slip_fwd", "new_test"]
    assert (narrow["lower"], narrow["upper"]) == pytest.approx((1.5, 2.5), abs=1e-3)


@pytest.mark.parametrize("name", ["slip_fwd", "energy_per_cycle"])
def test_a_property_is_missed_that_is_both_extreme_and_beyond_its_tolerance(name):
    wide, narrow = 2.0 + 2.0 * (UNIT - 0.5), 2.0 + 1e-3 * (UNIT - 0.5)
    assert not any(is_missed(wide, measured, name) for measured in (1.2, 2.0, 2.8, np.nan))
    assert all(is_missed(wide, measured, name) for measured in (0.9, 3.1))
    assert not is_missed(narrow, 2.01, name)  # extreme, and within the tolerance


def test_what_a_basis_or_a_motion_does_not_have_is_left_out_or_not_known():
    assert ("slip_fwd", "observation") not in bounds()
    assert ("energy_per_cycle", "observation") in bounds()
    empty = {basis: {"energy_per_cycle": np.full(9, np.nan)} for basis in ("mean", "new_test")}
    assert bounds_of(empty, 0.9) == ()
    row = bounds()["slip_fwd", ANOTHER]
    assert np.isnan(row["upper"])
    assert row["note"] == NOT_KNOWN
    bound = bounds(draws={**DRAWN, ANOTHER: DRAWN["new_test"]})["slip_fwd", ANOTHER]
    assert bound["upper"] > bound["nominal"]
    assert bound["note"] == ""


def test_bounds_from_two_levels_come_with_a_warning():
    time = np.linspace(0.0, 4.0, 401)
    traces = [Trace.from_arrays(time, np.sin(np.pi * time), p) for p in (0.5, 0.5, 1.0, 1.5)]
    tests = {str(i): SimpleNamespace(trace=trace) for i, trace in enumerate(traces)}
    (warning,) = design_warnings(SimpleNamespace(tests=dict(list(tests.items())[:3])))
    assert re.search("have 2 levels.*too narrow", warning)
    assert design_warnings(SimpleNamespace(tests=tests)) == ()


# --- the data sheet


def test_measured_cycles_of_harmonic_tests_stand_beside_their_bounds(made_run):
    sheet = datasheet(open_run(made_run))
    rows = sheet.rows
    levels = ["500 psi", "700 psi", "1000 psi"]  # of tests a, c, which is held out, and b
    assert list(dict.fromkeys(rows["condition"])) == [f"{level}, 1 in, 1 Hz" for level in levels]
    assert rows["tested"].all()
    area = np.sum(0.5 * (FORCE[1:41] + FORCE[:40]) * np.diff(MOTION[:41])) / 2  # two periods
    expected = {"slip_force": 2.0, "peak_force": 2.0, "effective_stiffness": 2.0, "energy": area}
    expected["effective_damping"] = area / (2 * np.pi * 2.0)
    for condition, group in rows.groupby("condition"):
        for quantity, value in expected.items():
            subset = group[group["quantity"] == quantity]
            for column in ("measured_low", "measured", "measured_high"):
                np.testing.assert_allclose(subset[column], value, rtol=0.02, err_msg=quantity)
            misses = (subset["measured"] < subset["lower"]) | (subset["measured"] > subset["upper"])
            assert (subset["n_outside"] == misses).all(), (condition, quantity)
            assert (subset["n_tests"] == 1).all()
        energy = group[group["quantity"] == "energy"]
        assert energy["cycle"].tolist() == [0, 1, 2]
        assert energy["n_cycles"].tolist() == [2, 1, 1]
    totals = rows[rows["cycle"] == 0]
    misses, tests = totals["n_outside"].sum(), totals["n_tests"].sum()
    assert 0 < misses < tests
    assert str(sheet.verdict[1]).startswith(f"{misses} of {tests} measured values")


def test_a_condition_that_is_none_is_refused():
    for text in ("500 psi, 1 in", "35 lbf, 1 in, 1 Hz"):
        with pytest.raises(MfdError, match=text.split(",")[0]):
            parse_condition(text, "ksi")
