"""Mean and bounding properties, from draws whose quantiles are known."""

from types import SimpleNamespace

import numpy as np
import pytest

from mfd_bayes.evaluation.properties import ANOTHER, BASES, NOT_KNOWN, bounds_of, design_warnings
from mfd_bayes.population.bands import KIND_NAMES, KINDS
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.symbols import BAND_NAMES, BANDS
from mfd_bayes.reporting.tables import convert_rows, design_csv
from mfd_bayes.runs.unit_system import SI

UNIT = (np.arange(2000) + 0.5) / 2000.0
DRAWN = {
    "device": {"slip_fwd": 2.0 + 0.2 * (UNIT - 0.5), "energy_per_cycle": np.full(2000, 4.0)},
    "new_test": {"slip_fwd": 2.0 + 2.0 * (UNIT - 0.5), "energy_per_cycle": 3.0 + 2.0 * UNIT},
    "observation": {"energy_per_cycle": 2.0 + 4.0 * UNIT},
}


def bounds(probability=0.9, drawn=DRAWN):
    return {(r["name"], r["basis"]): r for r in bounds_of(drawn, probability)}


def test_bounds_are_quantiles_and_factors_relative_to_the_mean_property():
    row = bounds(0.9)["slip_fwd", "new_test"]
    figures = [row[key] for key in ("lower", "nominal", "upper", "lambda_min", "lambda_max")]
    assert figures == pytest.approx([1.1, 2.0, 2.9, 0.55, 1.45], abs=1e-3)
    narrow = bounds(0.5)["slip_fwd", "new_test"]
    assert (narrow["lower"], narrow["upper"]) == pytest.approx((1.5, 2.5), abs=1e-3)
    (metric,) = convert_rows((row,), SI)
    assert (metric["unit"], metric["lambda_max"]) == ("kN", row["lambda_max"])
    assert metric["upper"] == pytest.approx(row["upper"] * 4.4482216)


def test_another_device_is_not_known_from_tests_of_one():
    row = bounds()["slip_fwd", ANOTHER]
    assert np.isnan(row["upper"])
    assert row["note"] == NOT_KNOWN
    known = bounds(drawn={**DRAWN, ANOTHER: DRAWN["new_test"]})["slip_fwd", ANOTHER]
    assert known["upper"] > known["nominal"]
    assert known["note"] == ""


def test_what_a_basis_or_a_motion_does_not_have_is_left_out():
    assert ("slip_fwd", "observation") not in bounds()
    assert ("energy_per_cycle", "observation") in bounds()
    none = {basis: {"energy_per_cycle": np.full(9, np.nan)} for basis in ("device", "new_test")}
    assert bounds_of(none, 0.9) == ()


def test_the_table_says_its_probability_and_names():
    text = design_csv(bounds_of(DRAWN, 0.9), "1000 psi", 0.9)
    assert "exceeded with a probability of 5 %" in text
    for name in BASES.values():
        assert name in text


def test_every_kind_has_one_name():
    assert set(KIND_NAMES) == set(KINDS)
    assert set(BAND_NAMES) == set(BANDS) == {*KINDS, "prior"}
    assert all(BAND_NAMES[kind] == name for kind, name in KIND_NAMES.items())
    assert all(BASES[kind] == KIND_NAMES[kind] for kind in BASES if kind in KIND_NAMES)


def test_bounds_from_two_levels_come_with_a_warning():
    time = np.linspace(0.0, 4.0, 401)
    traces = [Trace.from_arrays(time, np.sin(np.pi * time), p) for p in (0.5, 0.5, 1.0, 1.5)]
    tests = {str(i): SimpleNamespace(trace=trace) for i, trace in enumerate(traces)}
    few = dict(list(tests.items())[:3])
    (warning,) = design_warnings(SimpleNamespace(tests=few))
    assert "have 2 levels" in warning
    assert "too narrow" in warning
    assert design_warnings(SimpleNamespace(tests=tests)) == ()
