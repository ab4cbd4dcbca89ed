"""Results in a notebook: shown, drawn, handed to ArviZ and to tables."""

import csv
import shutil
import subprocess
import sys
import warnings

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import mfd_bayes as mb
from mfd_bayes.cli.commands import app
from mfd_bayes.errors import FitError, ReportError
from mfd_bayes.runs.run import open_run as open_plain
from mfd_bayes.store.cards import card, grid
from tests.run_folders import write_run

with warnings.catch_warnings():
    warnings.simplefilter("ignore", FutureWarning)
    import arviz as az


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "out"
    write_run(out)
    return out


@pytest.fixture(scope="module")
def run(folder):
    return mb.open_run(folder)


@pytest.fixture(scope="module")
def band(run):
    return run.predict(run.tests["a"].trace, draws=20)


def test_what_a_notebook_shows_is_html_with_the_names_and_units(run, band):
    test = run.tests["a"]
    for shown, words in (
        (run, "<table"),
        (run, "<td>a</td>"),
        (test, "Fc_fwd"),
        (band, "kip"),
        (test.posterior, "three_stage"),
    ):
        assert words in shown._repr_html_()
    assert "<b>" not in card("<b>", [("<b>", "<b>")], "<b>")
    assert "<b>" not in grid("<b>", ["<b>"], [["<b>"]], "<b>")


def test_a_band_is_drawn_over_time_and_over_displacement(run, band):
    trace = run.tests["a"].trace
    axes = band.plot()
    line = axes.get_lines()[0]
    assert axes.get_xlabel() == "time, s"
    np.testing.assert_allclose(line.get_ydata(), band.median * run.system.factor("kip"))
    again = band.plot(axes)
    assert again is axes
    along = band.plot(displacement=trace.displacement)
    assert along.get_xlabel() == f"displacement, {run.system.length}"


def test_what_cannot_be_drawn_is_named(run, band):
    x = run.tests["a"].trace.displacement
    for wrong, said in (
        ("x", "displacement must hold real numbers"),
        (5, "displacement must have shape"),
        (x[:5], "displacement must have shape"),
        (x[:, None], "displacement must have shape"),
        (np.nan * x, "displacement must be finite"),
    ):
        with pytest.raises(ReportError, match=said):
            band.plot(displacement=wrong)
    for draw in (band.plot, run.tests["a"].plot_loops):
        with pytest.raises(ReportError, match="axes must be axes of Matplotlib, got 'x'"):
            draw("x")


def test_the_loops_of_a_test_are_drawn_with_its_force(run, folder):
    test = run.tests["a"]
    drawn = test.plot_loops().get_lines()[0].get_ydata()
    np.testing.assert_allclose(drawn, test.trace.force * run.system.factor("kip"))
    with pytest.raises(FitError, match=r"mfd_bayes\.open_run"):
        open_plain(folder).tests["a"].plot_loops()


def test_arviz_takes_a_test_and_a_band_without_a_change(run, band):
    data = run.tests["a"].inference_data()
    if hasattr(az, "psislw"):  # ArviZ 1.x refuses the loo of these few draws
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # their weights are not to be trusted
            assert az.loo(data).n_data_points >= 3
    summary = az.summary(data, var_names=["Fc_fwd"])
    drawn = run.tests["a"].draws["Fc_fwd"].to_numpy()
    assert float(summary["mean"].iloc[0]) == pytest.approx(drawn.mean(), abs=2e-3)
    force = band.inference_data()["predictions"]["force"]
    np.testing.assert_array_equal(np.asarray(force)[0], band.draws)
    assert force.attrs["units"] == "kip"


def test_opening_a_run_imports_no_matplotlib(folder):
    code = (
        "import sys, mfd_bayes as mb; run = mb.open_run(sys.argv[1]); run._repr_html_(); "
        "assert 'matplotlib' not in sys.modules and 'arviz' not in sys.modules"
    )
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code, str(folder)],
        capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


# --- tables of draws


def drawn(folder, *words):
    outcome = CliRunner().invoke(app, ["draws", str(folder), *words])
    assert outcome.exit_code == 0, outcome.output
    return outcome.output


def test_draws_are_written_as_csv_with_units_in_the_head(folder, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(folder, out)
    assert "draws.csv written" in drawn(out, "--to", "csv", "--units", "si")
    table = pd.read_csv(out / "draws.csv")
    run = mb.open_run(out)
    assert set(table["test"]) == set(run.tests)
    one = table[table["test"] == "a"]
    expected = run.tests["a"].draws["Fc_fwd"].to_numpy().reshape(-1) * 4.4482216152605
    np.testing.assert_allclose(one["Fc_fwd [kN]"], expected, rtol=1e-6)
    assert np.all(np.isfinite(one["log_likelihood"]))
    us = drawn(out, "--to", "csv", "--units", "us", "--most", "5")
    with (out / "draws.csv").open() as file:
        head = next(csv.reader(file))
    assert "Fc_fwd [kip]" in head
    assert f"{5 * len(run.tests)} draws" in us


def test_draws_are_written_as_parquet_or_refused_in_one_sentence(folder, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(folder, out)
    outcome = CliRunner().invoke(app, ["draws", str(out), "--to", "parquet"])
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        assert outcome.exit_code == 2
        assert 'pip install "mfd_bayes[parquet]"' in outcome.output
        assert not (out / "draws.parquet").exists()
        return
    assert outcome.exit_code == 0, outcome.output
    table = pd.read_parquet(out / "draws.parquet")
    drawn(out, "--to", "csv")
    np.testing.assert_allclose(
        table["log_likelihood"], pd.read_csv(out / "draws.csv")["log_likelihood"], rtol=1e-6
    )
