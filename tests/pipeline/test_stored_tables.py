"""Tables that two stored runs give are those of tests/data/tables.json, to a thousandth.

Where MFD_BAYES_TABLES is set, that file is written anew: look at what differs.
"""

import csv
import json
import math
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.command_line import said, write_csv

DATA = Path(__file__).parents[1] / "data"
LONG, ROWS = 260, 12  # of a longer table, and of those that figures show, so many rows are taken
BUILDING = """
[building]
[[storey]]
weight = "20 kip"
stiffness = "8 kip/in"
[[damper]]
storey = 1
actuation = "800 psi"
"""


def alike(cell, other):
    try:
        return math.isclose(float(cell), float(other), rel_tol=1e-3, abs_tol=1e-6)
    except ValueError:
        return cell == other


@pytest.mark.usefixtures("no_figures", "small_pictures")
def test_tables_of_stored_runs_are_those_that_were_looked_at(made_run, tmp_path):
    out, made = tmp_path / "out", tmp_path / "made"
    shutil.copytree(DATA / "run", out)
    shutil.copytree(made_run, made)
    said("report", out, "--at", "700 psi, 0.9 in, 0.4 Hz")
    said("report", made, "--units", "si")
    sine = ("--sine", "1 in, 0.4 Hz, 2 cycles", "--actuation", "700 psi", "--no-figures")
    said("predict", out, *sine, "--design", "--whole", "-o", tmp_path / "bands.csv")
    said("next", out, "--draws", 200, "-o", tmp_path / "next.csv")
    (tmp_path / "b.toml").write_text(BUILDING)
    time = np.arange(200) / 50
    names = ("time_s", "acceleration_in/s^2")
    ground = write_csv(tmp_path / "g.csv", time, 100.0 * np.sin(6.0 * time), names=names)
    building = ("--building", tmp_path / "b.toml", "--ground", ground)
    said("respond", out, *building, "--draws", 10, "--jobs", 1, "-o", tmp_path / "response")
    tables = {}
    for path in sorted(tmp_path.rglob("*.csv")):
        with path.open(encoding="utf-8") as file:
            rows = [*csv.reader(line for line in file if not line.startswith("#"))]
        shown = len(rows) > LONG or path.name == "record.csv" or path.parent.name == "figures"
        step = max(len(rows) // ROWS, 1) if shown else 1
        tables[path.relative_to(tmp_path).as_posix()] = [rows[0], *rows[1::step]]
    stored = DATA / "tables.json"
    if "MFD_BAYES_TABLES" in os.environ:
        text = json.dumps(tables, ensure_ascii=False).replace("], [", "],\n[")
        stored.write_text(text.replace("]], ", "]],\n\n") + "\n", encoding="utf-8")
    expected = json.loads(stored.read_text(encoding="utf-8"))
    assert tables.keys() == expected.keys()
    for name, table in tables.items():
        assert len(table) == len(expected[name]), name
        for row, other in zip(table, expected[name], strict=True):
            assert all(map(alike, row, other)), (name, row, other)
