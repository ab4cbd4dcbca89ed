"""Tables and figures of two stored runs are those of tests/data/tables.json, to a thousandth.

Where MFD_BAYES_TABLES is set, that file is written anew: look at what differs.
"""

import csv
import json
import math
import os
import shutil
from pathlib import Path

import numpy as np

import mfd_bayes as mb
from mfd_bayes.reporting import figures
from tests.command_line import said, write_csv
from tests.run_folders import BUILDING

DATA = Path(__file__).parents[1] / "data"
LONG, ROWS = 320, 12  # of a longer table, and of those that figures show, so many rows are taken


def alike(cell, expected):
    try:
        return math.isclose(float(cell), float(expected), rel_tol=1e-3, abs_tol=1e-6)
    except ValueError:
        return cell == expected


def rows_of(figure):
    """What is in a figure: its size, and the words, limits and contents of its axes."""
    yield ["size", *map(str, figure.get_size_inches())]
    for axes in figure.axes:
        words = (axes.get_title(loc="left"), axes.get_xlabel(), axes.get_ylabel())
        curves = [np.asarray(line.get_xydata(), float) for line in axes.lines]
        curves += [path.vertices for item in axes.collections for path in item.get_paths()]
        sums = (len(axes.patches), len(curves), sum(np.nansum(np.abs(item)) for item in curves))
        limits = (*axes.get_xlim(), *axes.get_ylim())
        yield [
            *words,
            *(text.get_text() for text in axes.texts),
            *map("{:.6g}".format, limits + sums),
        ]


def test_tables_and_figures_of_stored_runs_are_those_that_were_looked_at(
    made_run, tmp_path, monkeypatch
):
    tables, dot = {}, figures.to_png(figures.new_figure(1, 1))

    def keep(figure):
        tables[f"figure {len(tables) + 1}"] = [*rows_of(figure)]
        return dot

    monkeypatch.setattr(figures, "to_png", keep)
    folder, synthetic = tmp_path / "out", tmp_path / "made"
    shutil.copytree(DATA / "run", folder)
    shutil.copytree(made_run, synthetic)
    said("report", folder, "--at", "700 psi, 0.9 in, 0.4 Hz")
    said("report", synthetic, "--units", "si")
    sine = ("--sine", "1 in, 0.4 Hz, 2 cycles", "--actuation", "700 psi")
    said("predict", folder, *sine, "--design", "--simultaneous", "-o", tmp_path / "bands.csv")
    said("next", folder, "--draws", 200, "-o", tmp_path / "next.csv")
    (tmp_path / "b.toml").write_text(BUILDING)
    time = np.arange(200) / 50
    names = ("time_s", "acceleration_in/s^2")
    ground = write_csv(tmp_path / "g.csv", time, 100.0 * np.sin(6.0 * time), names=names)
    building = ("--building", tmp_path / "b.toml", "--ground", ground)
    said("respond", folder, *building, "--draws", 10, "--jobs", 1, "-o", tmp_path / "response")
    trace = mb.open_run(folder).held_out["p800_f0.5"]
    record = write_csv(tmp_path / "held.csv", trace.time, trace.displacement, trace.force)
    level_args = ("--actuation", "800 psi", "-o")
    motion_args = (
        "--motion",
        record,
        "--condition-on",
        "0 s to 1 s",
        "--kind",
        "observation",
        "--compare",
    )
    said("predict", folder, *motion_args, "--units", "si", *level_args, tmp_path / "given.csv")
    said("accept", folder, record, *level_args, tmp_path / "accepted")
    for path in sorted(tmp_path.rglob("*.csv")):
        with path.open(encoding="utf-8") as file:
            rows = [*csv.reader(line for line in file if not line.startswith("#"))]
        thinned = len(rows) > LONG or path.name == "record.csv" or path.parent.name == "figures"
        step = max(len(rows) // ROWS, 1) if thinned else 1
        tables[path.relative_to(tmp_path).as_posix()] = [rows[0], *rows[1::step]]
    stored = DATA / "tables.json"
    if "MFD_BAYES_TABLES" in os.environ:
        text = json.dumps(tables, ensure_ascii=False).replace("], [", "],\n[")
        stored.write_text(text.replace("]], ", "]],\n\n") + "\n", encoding="utf-8")
    expected = json.loads(stored.read_text(encoding="utf-8"))
    assert tables.keys() == expected.keys()
    for name, table in tables.items():
        assert len(table) == len(expected[name]), name
        for row, reference in zip(table, expected[name], strict=True):
            assert all(map(alike, row, reference)), (name, row, reference)
