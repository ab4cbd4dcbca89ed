"""Results in a notebook: shown, drawn, handed to ArviZ and to tables."""

import csv
import shutil
import warnings
from importlib.util import find_spec

import numpy as np
import pandas as pd
import pytest

import mfd_bayes as mb
from mfd_bayes.errors import ReportError
from mfd_bayes.store.cards import card, grid
from tests.command_line import refusal, said

with warnings.catch_warnings():
    warnings.simplefilter("ignore", FutureWarning)
    import arviz as az


@pytest.fixture(scope="module")
def run(made_run):
    return mb.open_run(made_run)


@pytest.fixture(scope="module")
def band(run):
    return run.predict(run.tests["a"].trace, draws=20)


def test_what_a_notebook_shows_is_html_with_the_names_and_units(run, band):
    test = run.tests["a"]
    for item, words in (
        (run, "<td>a</td>"),
        (test, "Fc_fwd"),
        (band, "kip"),
        (test.posterior, "three_stage"),
    ):
        assert words in item._repr_html_()
    assert "<b>" not in card("<b>", [("<b>", "<b>")], "<b>")
    assert "<b>" not in grid("<b>", ["<b>"], [["<b>"]], "<b>")


def test_bands_and_loops_are_drawn(run, band):
    trace, factor = run.tests["a"].trace, run.system.factor("kip")
    axes = band.plot()
    assert axes.get_xlabel() == "time, s"
    np.testing.assert_allclose(axes.get_lines()[0].get_ydata(), band.median * factor)
    assert band.plot(axes) is axes
    loop_axes = band.plot(displacement=trace.displacement)
    assert loop_axes.get_xlabel() == f"displacement, {run.system.length}"
    forces = run.tests["a"].plot_loops().get_lines()[0].get_ydata()
    np.testing.assert_allclose(forces, trace.force * factor)


def test_what_cannot_be_drawn_is_named(run, band):
    x = run.tests["a"].trace.displacement
    for wrong in ("x", x[:5], np.nan * x):
        with pytest.raises(ReportError, match="displacement must"):
            band.plot(displacement=wrong)
    with pytest.raises(ReportError, match="axes must be axes of Matplotlib, got 'x'"):
        band.plot("x")


def test_arviz_takes_a_test_and_a_band_without_a_change(run, band):
    data = run.tests["a"].to_inference_data()
    if hasattr(az, "psislw"):  # ArviZ 1.x refuses the loo of these few draws
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # their weights are not to be trusted
            assert az.loo(data, var_name="force").n_data_points >= 3
    summary = az.summary(data, var_names=["Fc_fwd"])
    draws = run.tests["a"].draws["Fc_fwd"].to_numpy()
    assert float(summary["mean"].iloc[0]) == pytest.approx(draws.mean(), abs=2e-3)
    force = band.to_inference_data()["predictions"]["force"]
    np.testing.assert_array_equal(np.asarray(force)[0], band.draws)
    assert force.attrs["units"] == "kip"


def test_draws_are_written_with_their_units_or_refused_in_one_sentence(made_run, tmp_path):
    folder = tmp_path / "out"
    shutil.copytree(made_run, folder)
    assert "draws.csv written" in said("draws", folder, "--to", "csv", "--units", "si")
    table, run = pd.read_csv(folder / "draws.csv"), mb.open_run(folder)
    assert set(table["test"]) == set(run.tests)
    expected = run.tests["a"].draws["Fc_fwd"].to_numpy().reshape(-1) * 4.4482216152605
    values = table[table["test"] == "a"]["Fc_fwd [kN]"]
    np.testing.assert_allclose(values, expected, rtol=1e-6)
    assert np.all(np.isfinite(table["log_likelihood"]))
    if find_spec("pyarrow"):
        said("draws", folder, "--to", "parquet")
        columns = pd.read_parquet(folder / "draws.parquet")
        np.testing.assert_allclose(columns["log_likelihood"], table["log_likelihood"], rtol=1e-6)
    else:
        assert 'pip install "mfd_bayes[parquet]"' in refusal("draws", folder, "--to", "parquet")
        assert not (folder / "draws.parquet").exists()
    output = said("draws", folder, "--to", "csv", "--units", "us", "--most", "5")
    with (folder / "draws.csv").open() as file:
        assert "Fc_fwd [kip]" in next(csv.reader(file))
    assert f"{5 * len(run.tests)} draws" in output
