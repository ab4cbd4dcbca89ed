"""Measured values of the cycles of a loop: their definitions, and one number everywhere."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from mfd_bayes import Trace, read_record
from mfd_bayes.cli.commands import app
from mfd_bayes.records.measured import MeasuredCycles, measured_cycles

TIME = np.arange(0.0, 8.0, 1 / 500)
TITLES = {
    "peak force": ("peak_fwd", "peak_bwd"),
    "energy per cycle": ("energy",),
    "slip force": ("slip_fwd", "slip_bwd"),
    "effective stiffness": ("effective_stiffness",),
    "effective damping": ("effective_damping",),
    "equivalent damping": ("c_eq",),
    "gap": ("gap",),
    "build-up slope": ("build_up_slope",),
}
"""What inspect calls the values, by the titles of its lines."""


def records(folder):
    return sorted(path for path in folder.glob("*.csv") if path.name != "manifest.csv")


@given(
    amplitude=st.floats(0.1, 5.0),
    frequency=st.sampled_from([0.5, 1.0, 2.0]),
    stiffness=st.floats(0.0, 20.0),
    damping=st.floats(0.05, 2.0),
    zero=st.floats(-3.0, 3.0),
)
def test_a_spring_and_a_dashpot_have_their_textbook_values(
    amplitude, frequency, stiffness, damping, zero
):
    w = 2.0 * np.pi * frequency
    x, v = amplitude * np.sin(w * TIME), amplitude * w * np.cos(w * TIME)
    trace = Trace.from_arrays(TIME, x + zero, force=stiffness * x + damping * v, velocity=v)
    found = measured_cycles(trace)
    assert found.full_stroke.all()
    close = {"rel": 5e-3, "abs": 0.02 * damping * w}
    np.testing.assert_allclose(found.stroke, 2.0 * amplitude, rtol=1e-3)
    np.testing.assert_allclose(found.frequency, frequency, rtol=5e-3)
    own = found.of_test()
    assert own["energy"] == pytest.approx(np.pi * damping * w * amplitude**2, rel=1e-2)
    assert own["c_eq"] == pytest.approx(damping, rel=1e-2)
    assert own["slip_fwd"] == pytest.approx(damping * w * amplitude, rel=2e-2)
    assert own["slip_bwd"] == pytest.approx(damping * w * amplitude, rel=2e-2)
    assert own["effective_stiffness"] == pytest.approx(stiffness, **close)


def test_the_damping_of_a_rectangular_loop_is_two_over_pi():
    x = np.sin(np.pi * TIME)
    force = 2.0 * np.sign(np.cos(np.pi * (TIME + 1e-9)))
    own = measured_cycles(Trace.from_arrays(TIME, x, force=force)).of_test()
    stiffness = own["effective_stiffness"]
    assert own["effective_damping"] == pytest.approx(4.0 / np.pi / stiffness, rel=1e-2)


def test_a_record_without_force_or_without_cycles_has_no_values():
    x = np.sin(np.pi * TIME)
    assert measured_cycles(Trace.from_arrays(TIME, x)) is None
    found = measured_cycles(Trace.from_arrays(TIME[:300], x[:300], force=x[:300]))
    assert found.energy.size == 0
    assert np.isnan(found.of_test()["energy"])
    assert found.of_test()["peak_fwd"] == x[:300].max()


def test_no_peak_is_larger_than_the_largest_sample_and_numbers_survive_storing(data_folder):
    for path in records(data_folder):
        record = read_record(path)
        found = measured_cycles(record)
        assert np.nanmax(found.peak_fwd) <= found.largest_fwd == record.force.max(), path
        assert np.nanmax(found.peak_bwd) <= found.largest_bwd == -record.force.min(), path
        again = MeasuredCycles.from_content(found.to_content())
        for name, value in found.to_content().items():
            np.testing.assert_array_equal(again.to_content()[name], value, err_msg=name)


def test_inspect_shows_the_measured_values_of_every_shared_record(
    data_folder, tmp_path, small_pictures
):
    for path in records(data_folder):
        asked = ["inspect", str(path), "-o", str(tmp_path), "--units", "us"]
        shown = CliRunner().invoke(app, asked).stdout
        own = measured_cycles(read_record(path)).of_test()
        for title, names in TITLES.items():
            line = re.search(rf"^  {title} +(.*)$", shown, re.MULTILINE)
            if line is None:
                assert np.isnan(own[names[0]]), (path, title)
                continue
            figures = re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", line[1])[: len(names)]
            assert [float(f) for f in figures] == [float(f"{own[n]:.4g}") for n in names], path


@pytest.mark.slow
def test_predict_compares_with_the_measured_values(data_folder, tmp_path, small_pictures):
    """The run is of another device: only the measured column is looked at."""
    run = Path(__file__).parents[1] / "data" / "run"
    for path in records(data_folder)[:3]:
        bands = tmp_path / f"{path.stem}.csv"
        asked = ["--motion", path, "--actuation", "700 psi", "--extrapolate", "--compare"]
        asked += ["--rate", "32 Hz", "--units", "us", "-o", bands]
        CliRunner().invoke(app, ["predict", str(run), *map(str, asked)], catch_exceptions=False)
        own = measured_cycles(read_record(path)).of_test()
        text = bands.with_name(f"{bands.stem}_derived.csv").read_text().splitlines()
        rows = csv.DictReader(line for line in text if not line.startswith("#"))
        known = {row["quantity"]: row for row in rows}
        for name in ("peak_fwd", "peak_bwd", "slip_fwd", "effective_stiffness", "gap"):
            assert float(known[name]["measured"]) == pytest.approx(own[name], rel=1e-5), name
