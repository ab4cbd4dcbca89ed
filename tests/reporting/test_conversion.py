from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from mfd_bayes.errors import UnitError
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.tables import convert_law, convert_rows, convert_test, to_units
from mfd_bayes.runs.unit_system import SI, SI_SMALL, US, both_systems, named_system, system_of
from mfd_bayes.units import convert


def test_units_of_either_system():
    for internal, metric, factor in (
        ("kip", "kN", 4.4482216152605),
        ("kip/in", "kN/mm", 0.17512683524648),
        ("kip*s/in", "kN*s/mm", 0.17512683524648),
        ("in^2", "mm^2", 645.16),
        ("in**2", "mm**2", 645.16),
        ("1/in", "1/mm", 1 / 25.4),
        ("kip*in", "kN*mm", 112.98482902762),
        ("ksi", "MPa", 6.8947572931684),
        ("1", "1", 1.0),
    ):
        assert SI.unit(internal) == metric
        assert SI.factor(internal) == pytest.approx(factor, rel=1e-12), internal
        assert (US.unit(internal), US.factor(internal)) == (internal, 1.0)
    with pytest.raises(UnitError, match="'kip' cannot be given in 'mm'"):
        convert("kip", "mm")


def test_most_records_decide_the_system_and_the_pressure():
    for units, expected in (
        (("mm", "mm", "in"), SI),
        (("in", "ft"), US),
        (("m",), SI),
        (("mm", "in"), US),  # a tie keeps the internal units
        (("parsec?",), US),
    ):
        assert system_of(units) is expected
    for actuations, pressure in (
        (("bar", "bar"), "bar"),
        (("kPa", "kPa"), "kPa"),
        (("bar", "kPa"), "MPa"),
        (("psi",), "MPa"),
        (("N",), "MPa"),
        (("three bar",), "MPa"),
    ):
        system = system_of(["mm"], [2.0], actuations)
        assert system == replace(SI, pressure=pressure), actuations
        assert system_of(["in"], [2.0], actuations) == US
        assert both_systems(system) == (US, system)
        assert (named_system("si", system), named_system("us", system)) == (system, US)


def test_actuations_and_stiffness_per_actuation():
    system = system_of(["mm"], [0.01], ["bar"])
    assert system == replace(SI_SMALL, pressure="bar")
    assert system.unit("kip/in/ksi") == "N/mm/bar"
    assert system.factor("kip/in/ksi") == pytest.approx(SI_SMALL.factor("kip/in/ksi") / 10.0)
    quiet = Trace.from_arrays(np.arange(30.0), np.arange(30.0), 0.8)
    texts = [s.actuation(quiet, unit) for s in (US, SI) for unit in ("ksi", "kip")]
    assert texts == ["800 psi", "800 lbf", "5.516 MPa", "3.559 kN"]
    assert system.actuation(replace(quiet, actuation=0.3 / 6.894757), "ksi") == "3 bar"
    varying = Trace.from_arrays(np.arange(30.0), np.arange(30.0), np.linspace(0.5, 1.5, 30))
    assert "mean of a history" in SI.actuation(varying, "ksi")


def test_what_figures_show_keeps_its_meaning_in_the_other_system(campaign):
    ours, theirs = campaign.tests[0], convert_test(campaign.tests[0], SI, "ksi")
    kip, inch = SI.factor("kip"), SI.factor("in")
    np.testing.assert_allclose(theirs.trace.force, ours.trace.force * kip)
    np.testing.assert_allclose(theirs.trace.displacement, ours.trace.displacement * inch)
    np.testing.assert_allclose(theirs.observation.median, ours.observation.median * kip)
    assert theirs.actuation == "5.516 MPa"
    k3 = next(row for row in ours.rows if row["name"] == "k3")
    (metric,) = convert_rows((k3,), SI)
    assert metric["unit"] == "kN/mm"
    assert metric["upper"] == pytest.approx(k3["upper"] * SI.factor("kip/in"))
    assert (metric["r_hat"], metric["contraction"]) == (k3["r_hat"], k3["contraction"])
    law, before = convert_law(campaign.laws[0], SI, "ksi"), campaign.laws[0]
    slope = law.device.median[-1] / law.actuation[-1]  # kN/MPa, of kip/ksi
    expected = before.device.median[-1] / before.actuation[-1] * SI.factor("in^2")
    assert slope * 1e3 == pytest.approx(expected)


def test_a_table_is_converted_by_row_and_by_column():
    frame = pd.DataFrame({"unit": ["kip", "1"], "mean": [1.0, 2.0], "crps_kip": 1.0, "n": 3})
    metric = to_units(frame, SI)
    assert list(metric) == ["unit", "mean", "crps_kN", "n"]
    assert metric["unit"].tolist() == ["kN", "1"]
    assert metric["mean"].tolist() == pytest.approx([SI.factor("kip"), 2.0])
    assert metric["crps_kN"][0] == pytest.approx(SI.factor("kip"))
    assert metric["n"].tolist() == [3, 3]
