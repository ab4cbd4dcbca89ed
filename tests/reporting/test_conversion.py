from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from mfd_bayes.errors import UnitError
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.conversion import convert_law, convert_rows, convert_test, to_units
from mfd_bayes.runs.unit_system import SI, SI_SMALL, US, both_systems, named_system, system_of
from mfd_bayes.units import convert


@pytest.mark.parametrize(
    ("internal", "metric", "factor"),
    [
        ("kip", "kN", 4.4482216152605),
        ("kip/in", "kN/mm", 0.17512683524648),
        ("kip*s/in", "kN*s/mm", 0.17512683524648),
        ("in^2", "mm^2", 645.16),
        ("in**2", "mm**2", 645.16),
        ("1/in", "1/mm", 1 / 25.4),
        ("kip*in", "kN*mm", 112.98482902762),
        ("ksi", "MPa", 6.8947572931684),
        ("1", "1", 1.0),
        ("s", "s", 1.0),
    ],
)
def test_units_of_either_system(internal, metric, factor):
    assert SI.unit(internal) == metric
    assert SI.factor(internal) == pytest.approx(factor, rel=1e-12)
    assert (US.unit(internal), US.factor(internal)) == (internal, 1.0)


def test_units_of_different_kinds_are_not_converted():
    with pytest.raises(UnitError, match="'kip' cannot be given in 'mm'"):
        convert("kip", "mm")


@pytest.mark.parametrize(
    ("units", "expected"),
    [
        (("mm", "mm", "in"), SI),
        (("in", "ft"), US),
        (("cm",), SI),
        (("m",), SI),
        (("mm", "in"), US),  # a tie keeps the internal units
        ((), US),
        (("parsec?",), US),
    ],
)
def test_most_records_decide_the_system(units, expected):
    assert system_of(units) is expected


@pytest.mark.parametrize(
    ("actuations", "pressure"),
    [
        (("bar", "bar"), "bar"),
        (("kPa", "kPa"), "kPa"),
        (("bar", "kPa"), "MPa"),
        (("psi",), "MPa"),
        (("MPa", ""), "MPa"),
        (("N",), "MPa"),
        (("three bar",), "MPa"),
        ((), "MPa"),
    ],
)
def test_a_metric_pressure_is_in_the_unit_of_the_campaign(actuations, pressure):
    system = system_of(["mm"], [2.0], actuations)
    assert system == replace(SI, pressure=pressure)
    assert system_of(["in"], [2.0], actuations) == US
    assert both_systems(system) == (US, system)
    assert named_system("si", system) == system
    assert named_system("us", system) == US


def test_a_report_in_bar_has_stiffness_per_bar():
    system = system_of(["mm"], [0.01], ["bar"])
    assert system == replace(SI_SMALL, pressure="bar")
    trace = Trace.from_arrays(np.arange(30.0), np.arange(30.0), 0.3 / 6.894757)
    assert system.actuation(trace, "ksi") == "3 bar"
    assert system.unit("kip/in/ksi") == "N/mm/bar"
    assert system.factor("kip/in/ksi") == pytest.approx(SI_SMALL.factor("kip/in/ksi") / 10.0)


def test_actuations_in_words():
    quiet = Trace.from_arrays(np.arange(30.0), np.arange(30.0), 0.8)
    assert US.actuation(quiet, "ksi") == "800 psi"
    assert US.actuation(quiet, "kip") == "800 lbf"
    assert SI.actuation(quiet, "ksi") == "5.516 MPa"
    assert SI.actuation(quiet, "kip") == "3.559 kN"
    varying = Trace.from_arrays(np.arange(30.0), np.arange(30.0), np.linspace(0.5, 1.5, 30))
    assert "mean of a history" in SI.actuation(varying, "ksi")


def test_what_figures_show_keeps_its_meaning_in_the_other_system(campaign):
    ours, theirs = campaign.tests[0], convert_test(campaign.tests[0], SI, "ksi")
    kip, inch = SI.factor("kip"), SI.factor("in")
    np.testing.assert_allclose(theirs.trace.force, ours.trace.force * kip)
    np.testing.assert_allclose(theirs.trace.displacement, ours.trace.displacement * inch)
    np.testing.assert_allclose(theirs.observation.median, ours.observation.median * kip)
    assert theirs.actuation == "5.516 MPa"
    assert convert_test(ours, US, "ksi") is ours
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
    assert to_units(frame, US) is frame
