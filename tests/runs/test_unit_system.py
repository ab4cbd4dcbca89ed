"""The units in which a run is reported: those of most of its records."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.messages import Measure, Message
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.unit_system import SI, SI_SMALL, US, both_systems, named_system, system_of


def test_most_records_decide_the_system_and_the_pressure():
    for units, expected in (
        (("mm", "mm", "in"), SI),
        (("in", "ft"), US),
        (("mm", "in"), US),  # a tie keeps the internal units
    ):
        assert system_of(units) is expected
    for actuations, pressure in (
        (("bar", "bar"), "bar"),
        (("bar", "kPa"), "MPa"),
        (("psi",), "MPa"),
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


def test_quantities_of_a_sentence_are_written_in_the_units_of_the_reader_and_text_stays():
    gap = Measure.of(0.2, 0.3, unit="in")
    message = Message("the gap of {test} is {gap}, {{sic}}", {"test": "2 in", "gap": gap})
    assert str(message) == message.to_text(US) == "the gap of 2 in is 0.2 to 0.3 in, {sic}"
    assert message.to_text(SI) == "the gap of 2 in is 5.08 to 7.62 mm, {sic}"
