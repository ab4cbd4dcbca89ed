"""Tables of a response are all in the units of one system."""

import csv
import io
import json

import numpy as np
import pytest

from mfd_bayes.reporting.response_tables import peaks_csv, response_json, sweep_csv
from mfd_bayes.response.result import Passing, Row
from mfd_bayes.response.sweep import Sweep
from mfd_bayes.runs.unit_system import SI, US
from mfd_bayes.units import GRAVITY

UNITS = ("1", "in", "in/s^2", "kip", "kip*in")
ROWS = [
    Row(
        f"of {unit}", "g.csv", "storey 1", unit, 2.0, 3.0, ((1.5, 2.5), (1.0, 3.0), (0.5, 4.0)), 5.0
    )
    for unit in UNITS
]
LIMITS = [
    Passing("travel", "g.csv", 2.0, "in", 0.3, 0.1),
    Passing("drift ratio", "g.csv", 0.01, "1", 0.2, 0.1),
]


@pytest.mark.parametrize("system", [US, SI])
def test_json_and_csv_of_peaks_say_the_same(system):
    told = json.loads(response_json(ROWS, LIMITS, {"title": "t"}, system))
    table = list(csv.DictReader(io.StringIO(peaks_csv(ROWS, system))))
    for row, one in zip(table, told["peaks"], strict=True):
        assert row["unit"] == one["unit"]
        assert float(row["median"]) == pytest.approx(one["median"], rel=1e-5)
        assert float(row["without_dampers"]) == pytest.approx(one["bare"], rel=1e-5)
        assert one["plain"] is None
        for share, (low, high) in one["bands"].items():
            assert float(row[f"lower_{share}"]) == pytest.approx(low, rel=1e-5)
            assert float(row[f"upper_{share}"]) == pytest.approx(high, rel=1e-5)


def test_json_is_in_the_units_of_its_system():
    told = json.loads(response_json(ROWS, LIMITS, {}, SI))
    assert [one["unit"] for one in told["peaks"]] == ["%", "mm", "g", "kN", "kN*mm"]
    middles = [one["median"] for one in told["peaks"]]
    assert middles == pytest.approx([200.0, 50.8, 2.0 / GRAVITY, 8.89644, 225.97], rel=1e-5)
    assert [(one["limit"], one["unit"]) for one in told["limits"]] == [(50.8, "mm"), (1.0, "%")]
    assert [one["probability"] for one in told["limits"]] == [0.3, 0.2]


@pytest.mark.parametrize(
    ("unit", "system", "name", "by"),
    [
        ("ksi", SI, "actuation_MPa", 6.894757),
        ("kip", SI, "actuation_kN", 4.448222),
        ("ksi", US, "actuation_ksi", 1.0),
        ("kip", US, "actuation_kip", 1.0),
    ],
)
def test_the_actuation_of_a_sweep_is_in_the_units_of_its_system(unit, system, name, by):
    levels = np.array([0.5, 1.0])
    values = dict.fromkeys(("drift", "acceleration"), np.ones((2, 3, 1)))
    sweep = Sweep(levels, unit, values, "drift", "mean", np.ones(2), 0.5, (0.5, 1.0))
    rows = list(csv.DictReader(io.StringIO(sweep_csv(sweep, system))))
    assert [float(row[name]) for row in rows] == pytest.approx(by * levels, rel=1e-5)
