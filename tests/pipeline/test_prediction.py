"""The command predict on a small synthetic campaign, tested at 500, 1000 and 1500 psi."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import mfd_bayes as mb
from mfd_bayes.cli.commands import app

TIME = np.arange(401) / 100.0


@pytest.fixture(scope="module")
def out(finished_run) -> Path:
    """Run folder of the campaign."""
    assert finished_run.code == 0, finished_run.stderr
    return finished_run.out


@pytest.fixture(scope="module")
def tested(out):
    """Tested range of the run, by condition."""
    return {span.name: span for span in mb.open_run(out).tested}


@pytest.fixture
def ask(out, tmp_path):
    """Outcome of a prediction into bands.csv, by its further options."""

    def predict(*options):
        arguments = ("predict", out, "--actuation", "700 psi", "-o", tmp_path / "bands.csv")
        return CliRunner().invoke(app, [str(a) for a in (*arguments, *options)])

    return predict


def written(path, amplitude, frequency, force=None):
    """File of a harmonic motion, in in, with a force, kip, if it is given."""
    motion = amplitude * np.sin(2.0 * np.pi * frequency * TIME)
    columns, head = [TIME, motion], "time_s,displacement_in"
    if force is not None:
        columns, head = [*columns, force], f"{head},force_kip"
    np.savetxt(path, np.column_stack(columns), "%.9g", ",", header=head, comments="")
    return path


def test_far_outside_what_was_tested_it_refuses_without_extrapolate(ask, tested, tmp_path):
    stroke = tested["stroke"].highest
    motion = written(tmp_path / "fast.csv", 0.5 * stroke, 2.0)
    refused = ask("--motion", motion)
    assert refused.exit_code == 2
    (sentence,) = refused.stderr.splitlines()
    assert "the speed" in sentence
    assert "the frequency, 2 Hz, lies far outside the tested range" in sentence
    assert "give --extrapolate" in sentence
    assert not (tmp_path / "bands.csv").exists()
    allowed = ask("--motion", motion, "--extrapolate")
    assert allowed.exit_code == 0, allowed.output
    assert "warning: the speed" in allowed.stderr
    assert "# warning: the frequency, 2 Hz" in (tmp_path / "bands.csv").read_text()


def test_fifty_kip_are_not_three_hundred_pounds(ask, tmp_path, tested):
    motion = written(tmp_path / "slow.csv", 0.5 * tested["stroke"].highest, 0.5)
    refused = ask("--motion", motion, "--actuation", "50 MPa")
    assert refused.exit_code == 2
    assert "the actuation, 7252 psi, lies far outside" in refused.stderr


def test_inside_what_was_tested_nothing_is_said(ask, tested, tmp_path):
    inside = ask("--motion", written(tmp_path / "slow.csv", 0.5 * tested["stroke"].highest, 0.5))
    assert inside.exit_code == 0, inside.output
    assert "tested range" not in inside.stderr + (tmp_path / "bands.csv").read_text()


def test_the_tested_range_is_in_the_report_with_its_picture(out, tested):
    table = pd.read_csv(out / "tested_range.csv").set_index("condition")
    assert list(table.index) == ["stroke", "speed", "frequency", "actuation"]
    assert table.loc["actuation", ["smallest", "largest"]].tolist() == [0.5, 1.5]
    page = (out / "report.html").read_text()
    assert '<h2 id="tested">Tested range</h2>' in page
    assert (out / "figures/tested.png").read_bytes().startswith(b"\x89PNG")
    each = pd.read_csv(out / "figures/tested.csv").set_index("test")
    assert each.loc["p1200_f0.5", "role"] == "validate"
    fitted = each[each["role"] == "calibrate"]
    assert fitted["stroke_in"].max() == pytest.approx(tested["stroke"].highest, rel=1e-5)
