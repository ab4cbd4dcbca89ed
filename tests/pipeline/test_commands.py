"""All commands on a small synthetic campaign, calibrated once with the installed command."""

import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import mfd_bayes as mb
from mfd_bayes.cli.commands import app
from mfd_bayes.errors import FitError, StoreError
from mfd_bayes.pipeline import calibration as execution
from mfd_bayes.pipeline import commands as pipeline
from mfd_bayes.pipeline.plan import Options, plan_campaign
from mfd_bayes.population.bands import Predictor
from mfd_bayes.runs.folder import discard
from mfd_bayes.runs.unit_system import SI_SMALL

COMMAND = Path(sys.executable).parent / "mfd-bayes"
TESTS = ("p500_f0.5", "p1000_f0.5", "p1500_f0.5")
HELD_OUT = "p1200_f0.5"
AREA = 1.5  # in²
TIME = np.arange(201) / 50.0
MOTION = np.sin(np.pi * TIME)


def environment():
    """Environment of a user who has set no thread counts."""
    return {name: v for name, v in os.environ.items() if not name.endswith("_NUM_THREADS")}


def mfd(command, *arguments):
    """Outcome of the command that some words start."""
    words = [*command, *map(str, arguments)]
    return subprocess.run(
        words, capture_output=True, text=True, env=environment(), timeout=300, check=False
    )


def here(*arguments):
    """Outcome of the command in this process, where warnings are errors."""
    return CliRunner().invoke(app, [str(a) for a in arguments])


def calibrate(campaign, out, *options):
    return "calibrate", campaign, "-o", out, "--effort", "quick", *options


def refused(outcome, words):
    assert outcome.exit_code == 2
    (sentence,) = outcome.stderr.splitlines()
    assert sentence.startswith("mfd-bayes: ")
    assert words in sentence


@pytest.fixture(scope="module")
def campaign(finished_run):
    """Campaign file of three tests and one held out, and their true parameters."""
    return finished_run.campaign, finished_run.truth


@pytest.fixture(scope="module")
def out(finished_run):
    """Run folder of the campaign."""
    assert finished_run.code == 0, finished_run.stderr
    return finished_run.out


@pytest.fixture(scope="module")
def run(out):
    return mb.open_run(out)


@pytest.fixture
def copied(out, tmp_path):
    """Copy of the run that a test may spoil."""
    return Path(shutil.copytree(out, tmp_path / "copy"))


def parameters(out):
    return pd.read_csv(out / "parameters.csv").set_index(["test", "parameter"])


def draws_of(path):
    return mb.open_run(path.parents[2]).tests[path.parent.name].draws


# --- printed output


def test_calibrate_says_what_it_does_and_nothing_on_stderr(finished_run):
    folder, outcome = finished_run.out, finished_run
    assert outcome.code == 0
    assert outcome.stderr == ""
    for test in TESTS:
        assert f"{test}: done" in outcome.stdout
    assert f"look next at {folder / 'report.html'}" in outcome.stdout
    assert "\x1b" not in outcome.stdout  # plain lines where there is no terminal


@pytest.mark.parametrize("name", ["k3", "Fc_fwd", "Fc_bwd", "gap", "ell"])
@pytest.mark.parametrize("test", TESTS)
def test_the_posterior_finds_the_truth(campaign, run, test, name):
    known = campaign[1]["tests"][test]
    draws = run.tests[test].draws
    if name == "gap":
        sample, truth = (draws["d2"] + draws["d3"]).to_numpy(), known["d2"] + known["d3"]
    else:
        sample, truth = draws[name].to_numpy(), known[name]
    assert np.median(sample) == pytest.approx(truth, abs=4 * np.std(sample))
    assert np.median(sample) == pytest.approx(truth, rel=0.15)
    assert np.std(sample) < 0.15 * truth


def test_the_posteriors_tell_the_tests_apart(run):
    friction = [run.tests[test].draws["Fc_fwd"].to_numpy() for test in TESTS]
    assert friction[0].max() < friction[1].min()
    assert friction[1].max() < friction[2].min()


@pytest.mark.parametrize("name", ["K_c_fwd", "K_c_bwd"])
def test_the_laws_find_the_truth(campaign, out, run, name):
    truth = campaign[1]["population"][name]
    slope = run.population.slopes[name]
    low, high = np.quantile(slope, [0.025, 0.975])
    assert low <= truth <= high or abs(slope.mean() - truth) < 3 * slope.std()
    assert np.median(slope) == pytest.approx(truth, rel=0.15)
    row = pd.read_csv(out / "laws.csv").set_index("constant").loc[name]
    assert row["unit"] == "in^2"
    assert row["q50"] == pytest.approx(np.median(slope), rel=1e-4)


def test_the_sampling_converges(out):
    checks = pd.read_csv(out / "checks.csv")
    sampling = checks[checks["check"].isin(["R-hat", "bulk ESS", "tail ESS"])]
    assert {*TESTS, "population"} == set(sampling["subject"])
    assert (sampling["verdict"] == "pass").all()


def test_the_held_out_test_is_covered_and_was_not_fitted(out, run):
    scores = pd.read_csv(out / "scores.csv").set_index("test")
    held = scores.loc[HELD_OUT]
    assert held["role"] == "validate"
    assert held["coverage_95"] > 0.8
    assert held["rrse"] < 0.25
    assert held["width_95_kip"] < 1.5  # of a force of 4 kip from peak to peak
    assert set(run.tests) == set(TESTS)
    assert set(run.held_out) == {HELD_OUT}
    assert not (out / "tests" / HELD_OUT / "posterior.nc").exists()


@pytest.mark.parametrize("test", [*TESTS, HELD_OUT])
@pytest.mark.parametrize("name", ["energy_per_cycle", "c_eq"])
def test_what_is_dissipated_is_what_was_measured(out, test, name):
    row = derived(out).loc[(test, name)]
    spread = 3 * row["sd"] if test == HELD_OUT else 0
    assert row["q50"] == pytest.approx(row["measured"], rel=0.03, abs=spread)
    assert row["q2.5"] < row["q50"] < row["q97.5"]
    assert row["note"].startswith("over 1 full cycle")


@pytest.mark.parametrize("test", TESTS)
def test_gap_and_self_energizing_factors_find_the_truth(campaign, out, test):
    known, table = campaign[1]["tests"][test], derived(out)
    pressure = float(test[1:].split("_")[0]) / 1000
    truth = {"gap": known["d2"] + known["d3"]}
    truth |= {f"C_{side}": known[f"Fc_{side}"] / (pressure * AREA) for side in ("fwd", "bwd")}
    for name, value in truth.items():
        row = table.loc[(test, name)]
        assert row["q50"] == pytest.approx(value, abs=4 * row["sd"])
        if name == "gap":  # read off the loop, whose transitions are round
            assert row["measured"] == pytest.approx(value, rel=0.35)
        else:
            assert np.isnan(row["measured"])
    assert str(table.loc[(test, "C_fwd"), "unit"]) == "1"


def derived(out):
    return pd.read_csv(out / "derived.csv").set_index(["test", "quantity"])


# --- the run folder


def test_every_file_of_the_contract_is_there(out, campaign):
    names = ("manifest.json", "population.nc", "parameters.csv", "laws.csv", "checks.csv")
    exports = ("parameters.json", "laws.json", "parameters.tex", "laws.tex")
    for name in (*names, *exports, "derived.csv", "scores.csv", "law_scores.csv", "report.html"):
        assert (out / name).stat().st_size > 0
    assert (out / "campaign.toml").read_bytes() == campaign[0].read_bytes()
    assert list((out / "figures").glob("*.png"))
    for test in TESTS:
        assert (out / "tests" / test / "posterior.nc").is_file()
        pictures = {p.stem for p in (out / "tests" / test).glob("*.png")}
        assert {"loops", "history", "corner", "ranks"} <= pictures
    assert not list(out.rglob("*.part"))
    assert not list(out.rglob(".*"))


def test_the_report_is_one_file_without_network(out):
    text = (out / "report.html").read_text()
    page = re.sub("<script.*?</script>", "", text, flags=re.DOTALL)  # which a policy binds
    for name in (*TESTS, HELD_OUT, "K<sub>c,fwd</sub>", "k<sub>3</sub>", "How to repeat it"):
        assert name in page
    for call in ('src="http', "src='http", "@import", "stylesheet", "url(http"):
        assert call not in page


def test_parameters_csv_is_table_one_with_uncertainty(out):
    table = parameters(out)
    columns = {"unit", "mean", "sd", "q2.5", "q50", "q97.5", "ess_bulk", "ess_tail", "r_hat"}
    assert columns <= set(table.columns)
    assert set(table.index.get_level_values("test")) == set(TESTS)
    names = mb.ThreeStage().parameters
    for test in TESTS:
        assert set(names) <= set(table.loc[test].index)
        assert list(table.loc[test].index[: len(names)]) == list(names)  # in the paper's order
    assert (table["q2.5"] <= table["q50"]).all()
    assert (table["q50"] <= table["q97.5"]).all()
    assert (table["sd"] > 0).all()
    sampled = table.dropna(subset=["r_hat"])
    assert (sampled["ess_bulk"] > 50).all()
    assert table.loc[(TESTS[0], "k3"), "unit"] == "kip/in"


def test_the_table_is_that_of_the_draws(out, run):
    table = parameters(out)
    for name in ("Fs_bwd", "k3", "gamma2", "noise_sd"):
        draws = run.tests[TESTS[1]].draws[name].to_numpy()
        row = table.loc[(TESTS[1], name)]
        assert row["mean"] == pytest.approx(draws.mean(), rel=1e-5)
        assert row["q97.5"] == pytest.approx(np.quantile(draws, 0.975), rel=1e-5)


def test_the_manifest_says_how_it_came_about(out, campaign):
    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    manifest = json.loads((out / "manifest.json").read_text(), parse_constant=refuse)
    assert manifest["status"] == "finished"
    assert manifest["seed"] == 1
    assert manifest["effort"]["name"] == "quick"
    assert manifest["versions"]["mfd_bayes"] == mb.__version__
    assert {"python", "numpy", "scipy", "emcee", "arviz"} <= set(manifest["versions"])
    assert manifest["platform"]
    assert manifest["settings"]["rate"] == 50.0
    assert manifest["settings"]["model"] == "three_stage"
    folder = campaign[0].parent
    for file in ("campaign.toml", *(f"{test}.csv" for test in (*TESTS, HELD_OUT))):
        digest = hashlib.sha256((folder / file).read_bytes()).hexdigest()
        assert digest in manifest["inputs"].values()
    assert manifest["seconds"] > 0
    for test in TESTS:
        assert manifest["tests"][test]["status"] == "done"
        assert manifest["tests"][test]["seconds"] > 0
    assert manifest["command"].startswith("mfd-bayes calibrate")


# --- the run in Python


def test_arviz_reads_the_draws(run, out):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        import arviz as az
    draws = run.tests[TESTS[0]].draws
    summary = az.summary(draws)
    assert set(mb.ThreeStage().parameters) <= set(summary.index)
    assert draws["k3"].dims == ("chain", "draw")
    assert draws.sizes["chain"] >= 4
    assert (draws["k3"].attrs["units"], draws["v_s"].attrs["units"]) == ("kip/in", "in/s")
    data = az.from_netcdf(out / "tests" / TESTS[0] / "posterior.nc")
    # ArviZ 1 opens a DataTree, whose groups are paths
    groups = data.groups() if callable(data.groups) else [g.strip("/") for g in data.groups]
    for group in ("posterior", "sample_stats", "observed_data", "posterior_predictive"):
        assert group in groups
    assert {"lp", "log_prior", "log_likelihood"} <= set(data.sample_stats.data_vars)
    assert data.posterior_predictive["force"].dims == ("chain", "draw", "time")


def test_what_holds_by_construction_holds_in_the_draws(run):
    draws = run.tests[TESTS[2]].draws
    assert bool((draws["Fs_fwd"] >= draws["Fc_fwd"]).all())
    assert bool((draws["Fs_bwd"] >= draws["Fc_bwd"]).all())
    np.testing.assert_allclose(draws["gamma2"], draws["ell"] * draws["gamma1"], rtol=1e-12)


def test_the_population_holds_laws_and_scatter(run):
    population = run.population
    assert {"K_c_fwd", "K_c_bwd", "K_s_fwd", "K_s_bwd"} <= set(population.slopes)
    assert {"alpha_sigma0", "sigma0_0"} <= set(population.slopes)
    assert {"Fc_fwd", "Fc_bwd", "d2", "offset"} <= set(population.scatters)
    assert {"k3", "d3"} <= set(population.scatters) | set(population.common)
    assert not set(population.scatters) & set(population.common)
    assert all(np.all(tau > 0) for tau in population.scatters.values())
    assert population.law_weights["Fc_fwd"] == {"proportional": 1.0}
    assert population.law_weights["sigma0"] == {"affine": 1.0}


def predicted(run, actuation, **options):
    trace = mb.Trace.from_arrays(TIME, MOTION, actuation=actuation)
    return run.predict(trace, draws=300, **options)


@pytest.mark.parametrize("actuation", [1.0, 0.7], ids=["tested", "untested"])
def test_the_kinds_of_prediction_are_nested(run, actuation):
    kinds = ("device", "new_test", "observation")
    bands = [predicted(run, actuation, kind=kind) for kind in kinds]
    for kind, band in zip(kinds, bands, strict=True):
        assert isinstance(band, mb.Band)
        assert (band.kind, band.probability) == (kind, 0.95)
        assert band.draws.shape == (300, TIME.size)
        assert band.lower.shape == band.median.shape == band.upper.shape == TIME.shape
        assert np.all(np.isfinite(band.draws))
    device, new_test, observation = (np.mean(band.upper - band.lower) for band in bands)
    assert device < new_test < observation


def test_the_device_is_the_law_everywhere_and_this_very_test_a_kind_of_its_own(run):
    at, beside = (predicted(run, p, kind="device") for p in (1.0, 1.02))
    assert at.source == beside.source == "population laws"
    widths = [np.mean(band.upper - band.lower) for band in (at, beside)]
    assert widths[1] == pytest.approx(widths[0], rel=0.3)
    own = predicted(run, 1.0, kind="this_test", test=TESTS[1])
    draws = run.tests[TESTS[1]].draws["Fc_fwd"].to_numpy()
    assert np.median(own.values["Fc_fwd"]) == pytest.approx(np.median(draws), rel=0.02)
    assert np.all(np.isin(np.round(own.values["Fc_fwd"], 9), np.round(draws, 9)))
    later = TIME > 2.0
    scattered = predicted(run, 1.0, kind="new_test")
    assert np.mean((own.upper - own.lower)[later]) < 0.5 * np.mean(
        (scattered.upper - scattered.lower)[later]
    )


def test_a_test_that_is_repeated_belongs_to_its_own_session(run, monkeypatch):
    asked = []

    def repeat(self, trace, forecast, own):
        asked.append(forecast.session)
        return self.predict(trace, replace(forecast, kind="new_test"))

    monkeypatch.setattr(Predictor, "repeat", repeat)
    monkeypatch.setattr(mb.Run, "session", lambda self, name: f"session of {name}")
    predicted(run, 1.0, kind="this_test", test=TESTS[1])
    assert asked == [f"session of {TESTS[1]}"]


@pytest.mark.parametrize(
    ("kind", "test", "level", "words"),
    [
        ("this_test", "", 1.0, f"needs the id of a calibrated test: one of {TESTS[0]}"),
        ("this_test", "nope", 1.0, "no calibrated test 'nope': one of"),
        ("this_test", HELD_OUT, 1.2, "was held out"),
        ("this_test", TESTS[0], 1.0, "made at 500 psi, .* nothing of 1000 psi: take .* new_test"),
        ("new_test", TESTS[0], 0.5, "is for the kind this_test, not for new_test"),
    ],
)
def test_a_test_that_is_no_calibrated_one_is_refused(run, kind, test, level, words):
    with pytest.raises(FitError, match=words):
        predicted(run, level, kind=kind, test=test)


def test_a_band_of_the_whole_history_is_wider_than_that_of_single_samples(run):
    plain, whole = (predicted(run, 0.7, whole=asked) for asked in (False, True))
    assert plain.whole_lower is None
    np.testing.assert_array_equal(plain.lower, whole.lower)
    np.testing.assert_array_equal(plain.whole, (whole.whole_lower, whole.whole_upper))
    np.testing.assert_array_equal(whole.whole, plain.whole)
    assert np.all(whole.whole_lower <= whole.lower)
    assert np.all(whole.whole_upper >= whole.upper)
    inside = (whole.draws >= whole.whole_lower) & (whole.draws <= whole.whole_upper)
    assert 0.95 <= np.mean(np.all(inside, axis=1)) < 0.97


def test_predict_explains_what_makes_the_band_wide(out, motion, tmp_path):
    bands = tmp_path / "bands.csv"
    ask = ("predict", out, "--motion", motion, "--actuation", "1 ksi", "-o", bands)
    outcome = here(*ask, "--explain", "--whole")
    assert outcome.exit_code == 0, outcome.output
    for words in (
        "What makes the band wide",
        "scatter of backward slip force",
        "of the band's variance",
    ):
        assert words in outcome.stdout
    assert "start in the gap" in outcome.stdout
    table = pd.read_csv(bands, comment="#")
    assert (table["whole_lower_kip"] <= table["lower_kip"]).all()
    assert (table["whole_upper_kip"] >= table["upper_kip"]).all()
    assert bands.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    (sentence, _) = here(*ask, "--explain", "-q", "--force").stdout.splitlines()[::-1][:2]
    assert " of the band's variance come" in sentence


def test_the_report_says_what_makes_the_band_of_a_held_out_test_wide(out):
    page = (out / "report.html").read_text()
    section = page[page.index('id="held-out"') : page.index('id="unknown"')]
    assert " of the variance is " in section
    assert "test-to-test scatter of gap" in (out / "tests" / HELD_OUT / "page.html").read_text()


def test_a_prediction_is_the_same_for_the_same_seed(run):
    first, again, other = (predicted(run, 0.7, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.draws, again.draws)
    assert np.any(first.draws != other.draws)
    half = predicted(run, 0.7, seed=1, probability=0.5)
    assert np.mean(half.upper - half.lower) < 0.6 * np.mean(first.upper - first.lower)


def test_a_prediction_follows_the_actuation(campaign, run):
    slope = campaign[1]["population"]["K_c_fwd"]
    forward = (TIME > 1.8) & (TIME < 2.2)
    for level in (0.6, 1.4):
        force = predicted(run, level).median[forward].mean()
        assert force == pytest.approx(slope * level, rel=0.2)


def test_a_history_of_actuation_is_followed(run):
    history = np.where(TIME < 2.0, 0.5, 1.5)
    band = predicted(run, history)
    early, late = (TIME > 1.9) & (TIME < 2.0), (TIME > 2.05) & (TIME < 2.2)
    assert band.median[late].mean() > 2 * band.median[early].mean()


def test_without_actuation_there_is_no_prediction(run):
    with pytest.raises(FitError, match="actuation"):
        run.predict(mb.Trace.from_arrays(TIME, MOTION))


# --- the other commands


def test_a_run_ends_with_its_verdict_and_where_to_look(finished_run):
    folder, outcome = finished_run.out, finished_run
    verdicts = json.loads((folder / "manifest.json").read_text())["verdicts"]
    *lines, look = outcome.stdout.splitlines()
    assert look.startswith(f"look next at {folder}/report.html")
    (whole,) = (
        n for n, text in enumerate(lines) if text.startswith(f"{verdicts['campaign'].upper()}: ")
    )
    assert len(lines) - whole < 10
    assert max(map(len, lines[whole:-1])) <= 100


@pytest.mark.usefixtures("no_figures_of_tests")
def test_report_remakes_the_report_without_sampling_and_quietly_says_the_verdict_alone(copied):
    sentence = json.loads((copied / "manifest.json").read_text())["verdicts"]["sentence"]
    stored = copied / "tests" / TESTS[0] / "posterior.nc"
    before = stored.stat().st_mtime_ns, hashlib.sha256(stored.read_bytes()).hexdigest()
    tables = {n: (copied / n).read_bytes() for n in ("parameters.csv", "laws.csv", "checks.csv")}
    (copied / "report.html").unlink()
    shutil.rmtree(copied / "figures")
    outcome = here("report", copied, "--quiet")
    assert outcome.exit_code == 0, outcome.output
    assert outcome.stderr == ""
    assert outcome.stdout.partition(": ")[2].split() == sentence.split()
    assert (copied / "report.html").stat().st_size > 10_000
    assert list((copied / "figures").glob("*.png"))
    for name, content in tables.items():
        assert (copied / name).read_bytes() == content
    after = stored.stat().st_mtime_ns, hashlib.sha256(stored.read_bytes()).hexdigest()
    assert after == before


@pytest.mark.usefixtures("no_figures_of_tests")
def test_conditions_are_added_to_the_data_sheet(copied):
    for text in ("700 psi", "700 lbf, 1 in, 0.5 Hz", "700 psi, one inch, 0.5 Hz"):
        refused(here("report", copied, "--at", text), "--at", text.split(",")[0])
    asked = ("--at", "700 psi, 1 in, 0.5 Hz", "--at", "1 ksi, 20 mm, 0.2 Hz")
    outcome = here("report", copied, *asked, "--quiet")
    assert outcome.exit_code == 0, outcome.output
    table = pd.read_csv(copied / "datasheet.csv")
    added = table[table["tested"] == "no"].drop_duplicates("condition")
    assert added["actuation"].tolist() == [700.0, 1000.0]
    assert added["stroke_in"].to_numpy() == pytest.approx([1.0, 20 / 25.4], rel=1e-5)
    assert added["measured"].isna().all()
    assert (table["lower"] <= table["upper"]).all()
    for name in ("datasheet.html", "report.html"):
        assert 'data-value="0.7" data-unit="actuation in ksi"' in (copied / name).read_text()
    assert "700 psi" in (copied / "datasheet.tex").read_text()


@pytest.fixture
def motion(tmp_path):
    path = tmp_path / "quake.csv"
    table = np.column_stack([TIME, MOTION])
    np.savetxt(path, table, delimiter=",", header="time_s,displacement_in", comments="")
    return path


def test_predict_writes_a_table_and_a_picture(out, motion, tmp_path):
    bands = tmp_path / "new" / "bands.csv"
    outcome = here("predict", out, "--motion", motion, "--actuation", "700 psi", "-o", bands)
    assert outcome.exit_code == 0, outcome.output
    assert "new_test" in outcome.stdout
    assert "95 %" in outcome.stdout
    table = pd.read_csv(bands, comment="#")
    columns = ["time_s", "displacement_in", "lower_kip", "median_kip", "upper_kip"]
    assert list(table.columns) == columns
    assert (table["lower_kip"] <= table["median_kip"]).all()
    assert (table["median_kip"] <= table["upper_kip"]).all()
    np.testing.assert_allclose(np.interp(table["time_s"], TIME, MOTION), table["displacement_in"])
    head = bands.read_text().splitlines()[0]
    assert head.startswith("#")
    assert "95 %" in head
    assert "new_test" in head
    assert bands.with_suffix(".png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.usefixtures("small_pictures")
def test_predict_tells_what_derives_from_the_force(out, tmp_path):
    motion = tmp_path / "motion.csv"
    table = np.column_stack([TIME, MOTION, np.sign(np.gradient(MOTION))])
    np.savetxt(motion, table, delimiter=",", header="time_s,displacement_in,force_kip", comments="")
    tables = {}
    for kind in ("new_test", "observation"):
        ask = ("--actuation", "700 psi", "-o", tmp_path / f"{kind}.csv", "--kind", kind)
        options = (*ask, "--probability", 0.5, "--compare")
        outcome = here("predict", out, "--motion", motion, *options)
        assert outcome.exit_code == 0, outcome.output
        assert "energy_per_cycle" in outcome.stdout
        assert "75 %" in outcome.stdout
        written = tmp_path / f"{kind}_derived.csv"
        head = written.read_text().splitlines()[0]
        assert "of kind new_test" in head
        assert "50 % intervals" in head
        tables[kind] = pd.read_csv(written, comment="#").set_index("quantity")
    pd.testing.assert_frame_equal(*tables.values())  # noise is no part of the damper
    rows = tables["new_test"]
    energies = ["energy_per_cycle", "energy_in_all"]
    derived = [*energies, "c_eq", "peak_fwd", "peak_bwd", "gap", "C_fwd", "C_bwd"]
    assert list(rows.index) == derived
    assert ((rows["lower"] < rows["median"]) & (rows["median"] < rows["upper"])).all()
    assert rows.loc["energy_per_cycle", "measured"] == pytest.approx(4.0, rel=0.02)
    energy, damping = rows.loc["energy_per_cycle", "median"], rows.loc["c_eq", "median"]
    assert damping == pytest.approx(energy / np.pi**2, rel=2e-3)  # ω = π 1/s, X = 1 in


@pytest.mark.usefixtures("small_pictures")
def test_the_force_in_a_motions_file_is_not_taken_for_the_prediction(out, tmp_path):
    motion = tmp_path / "motion.csv"
    table = np.column_stack([TIME, MOTION, np.sign(np.gradient(MOTION))])
    np.savetxt(motion, table, delimiter=",", header="time_s,displacement_in,force_kip", comments="")
    bands = tmp_path / "bands.csv"
    outcome = here("predict", out, "--motion", motion, "--actuation", "700 psi", "-o", bands)
    assert outcome.exit_code == 0, outcome.output
    rows = pd.read_csv(tmp_path / "bands_derived.csv", comment="#")
    assert rows["measured"].isna().all()


@pytest.mark.usefixtures("small_pictures")
def test_a_prediction_beyond_what_was_tested_is_told(out, run, motion, tmp_path):
    bands = tmp_path / "bands.csv"
    ask = ("predict", out, "--motion", motion, "-o", bands)
    inside = here(*ask, "--actuation", "700 psi")
    assert "lies outside" not in inside.stderr + bands.read_text()
    outside = here(*ask, "--actuation", "3000 psi", "--force")
    assert outside.exit_code == 0
    assert "3000 psi, lies outside the tested range" in outside.stderr
    assert "# warning: the actuation, 3000 psi" in bands.read_text()
    history = mb.Trace.from_arrays(TIME, MOTION, np.linspace(0.7, 9.0, TIME.size))
    assert "700 to 9000 psi" in run.predict(history, draws=20).remarks[0]


def test_a_prediction_of_a_run_that_failed_says_so(run):
    trace = mb.Trace.from_arrays(TIME, MOTION, 0.7)
    failed = run.manifest.changed(verdicts={"campaign": "not usable", "sentence": "It is bad."})
    remarks = replace(run, manifest=failed).predict(trace, draws=40).remarks
    assert remarks == ("the run is not usable as it is: It is bad.",)
    sentence = "energy per cycle 0.00198 kip·in where 0.000852 kip·in is expected"
    weak = replace(run, manifest=failed.changed(verdicts={**failed.verdicts, "sentence": sentence}))
    vars(weak)["system"] = SI_SMALL
    told = weak.predict(trace, draws=40).remarks[-1]
    assert told.endswith("energy per cycle 224 N·mm where 96.3 N·mm is expected")
    assert "224 N·mm" in weak._repr_html_()
    older = run.manifest.changed(verdicts={"campaign": "fail", "sentence": "It is bad."})
    assert replace(run, manifest=older).predict(trace, draws=40).remarks == remarks
    passed = run.manifest.changed(verdicts={"campaign": "usable", "sentence": "It is good."})
    assert replace(run, manifest=passed).predict(trace, draws=40).remarks == ()


def test_draws_that_are_too_few_for_a_probability_are_told(run):
    trace = next(iter(run.tests.values())).trace
    (remark,) = run.predict(trace, probability=0.9999, draws=100).remarks
    assert remark.startswith("100 draws are too few for a band of 99.99 %")
    assert run.predict(trace, probability=0.98, draws=100).remarks == ()  # the control


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--actuation", "5,5 MPa"), "of --actuation"),
        (("--actuation", "30 lbf"), "must be a pressure"),
        (("--actuation", "30 in"), "pressure"),
        (("--actuation", "1000"), "no unit"),
        (("--actuation", "-5 psi"), "negative"),
        (("--actuation", "1 ksi", "--probability", "1.5"), "between 0 and 1, got 1.5"),
        (("--actuation", "1 ksi", "--probability", "0"), "between 0 and 1"),
        (("--actuation", "1 ksi", "--probability", "nan"), "between 0 and 1"),
    ],
)
def test_a_prediction_that_makes_no_sense_is_refused(out, motion, tmp_path, options, words):
    bands = tmp_path / "bands.csv"
    refused(here("predict", out, "--motion", motion, "-o", bands, *options), words)
    assert not bands.exists()


def test_an_unknown_kind_is_refused_with_those_there_are(out, motion, tmp_path):
    bands = tmp_path / "bands.csv"
    arguments = ("--motion", motion, "--actuation", "1 ksi", "-o", bands, "--kind", "maybe")
    outcome = here("predict", out, *arguments)
    assert outcome.exit_code == 2
    assert "observation" in outcome.stderr
    assert not bands.exists()


def test_a_motion_that_cannot_be_read_is_refused(out, tmp_path):
    bands = tmp_path / "bands.csv"
    ask = ("--actuation", "1 ksi", "-o", bands)
    refused(here("predict", out, "--motion", tmp_path / "no.csv", *ask), "no.csv")
    (tmp_path / "text.csv").write_text("time_s,displacement_in\n0,0\n0.1,a\n")
    refused(here("predict", out, "--motion", tmp_path / "text.csv", *ask), "line 3")
    assert not bands.exists()


def test_bands_are_not_lost_under_their_own_picture(out, motion, tmp_path):
    bands = tmp_path / "bands.png"
    outcome = here("predict", out, "--motion", motion, "--actuation", "1 ksi", "-o", bands)
    refused(outcome, "bands.png")


def test_bands_that_cannot_be_written_are_refused(out, motion, tmp_path):
    (tmp_path / "file").write_text("")
    ask = ("--motion", motion, "--actuation", "1 ksi", "-o", tmp_path / "file" / "bands.csv")
    refused(here("predict", out, *ask), "bands.csv")


def test_check_exits_by_the_verdicts(out, monkeypatch):
    sentence = json.loads((out / "manifest.json").read_text())["verdicts"]["sentence"]
    verdicts = json.loads((out / "manifest.json").read_text())["verdicts"]
    failed = verdicts["campaign"] == "not usable"
    monkeypatch.setattr(pipeline, "check", cache(pipeline.check))  # the same three times
    outcome = here("check", out)
    assert outcome.exit_code == (1 if failed else 0), outcome.output
    everything = here("check", out, "--all")
    assert "R-hat" in everything.stdout
    assert everything.exit_code == outcome.exit_code
    assert len(everything.stdout) > 5 * len(outcome.stdout)
    assert sentence in outcome.stdout
    assert here("check", out, "-q").stdout == f"{sentence}\n"


def test_check_fails_where_a_limit_is_not_kept(copied):
    manifest = json.loads((copied / "manifest.json").read_text())
    manifest["effort"]["ess"] = 1e9
    (copied / "manifest.json").write_text(json.dumps(manifest))
    outcome = here("check", copied, "-q")
    assert outcome.exit_code == 1
    (sentence,) = outcome.stdout.splitlines()  # --quiet: only the verdict
    assert "do not use these figures" in sentence


def test_every_law_is_scored_and_friction_is_not_called_constant(out):
    table = pd.read_csv(out / "law_scores.csv").set_index(["quantity", "law"])
    laws = ("proportional", "affine", "power", "constant", "residual_power")
    assert set(table.index) == {(n, law) for n in ("Fc_fwd", "Fc_bwd", "sigma0") for law in laws}
    assert table.groupby("quantity")["weight"].sum().to_numpy() == pytest.approx(1.0)
    for name in ("Fc_fwd", "Fc_bwd"):
        assert table.loc[(name, "proportional"), "chosen"] == "yes"
        assert table.loc[(name, "constant"), "elpd_difference"] < -1
    assert "Which law predicts best?" in (out / "report.html").read_text()


def test_the_truth_of_the_scatter_is_that_of_its_coordinate(campaign):
    known = campaign[1]["population"]
    assert known["scatter_d3"] == pytest.approx(0.05 * np.sqrt(2))
    assert known["scatter_offset"] == 0.02
    assert not {"scatter_Fc_fwd", "scatter_d2", "scatter_friction"} & set(known)


# --- cross-validation


@pytest.fixture(scope="module")
def crossed(campaign, out, without_figures, tmp_path_factory):
    """Copy of the run, cross-validated by level, and what was printed."""
    copy = Path(shutil.copytree(out, tmp_path_factory.mktemp("crossed") / "out"))
    arguments = ("crossvalidate", campaign[0], "-o", copy, "--by", "level", "--effort", "quick")
    return copy, mfd(without_figures, *arguments, "--jobs", 2, "--resume"), arguments


@pytest.mark.slow
def test_every_level_is_predicted_from_the_others_and_nothing_sampled_twice(out, crossed):
    copy, outcome, _ = crossed
    assert outcome.returncode == 0, outcome.stderr
    assert list((out / "tests").rglob("*.png"))
    assert not list((copy / "tests").rglob("*.png"))  # `without_figures` keeps what it promises
    for level in ("500 psi", "1000 psi", "1500 psi"):
        assert f"without {level}: done" in outcome.stdout
    assert "finding modes" not in outcome.stdout
    assert "population: " not in outcome.stdout
    assert "Of 3 tests, each predicted from those of the other levels" in outcome.stdout
    for test in TESTS:
        name = Path("tests") / test / "posterior.nc"
        assert (copy / name).read_bytes() == (out / name).read_bytes()


@pytest.mark.slow
def test_predictions_of_levels_left_out_cover_the_force(crossed):
    table = pd.read_csv(crossed[0] / "crossvalidation.csv").set_index("test")
    assert list(table.index) == [*TESTS, "mean"]
    assert list(table["part"][:3]) == ["500 psi", "1000 psi", "1500 psi"]
    assert table.loc["mean", "coverage_95"] > 0.85
    assert table.loc["mean", "crps_kip"] == pytest.approx(table["crps_kip"][:3].mean(), rel=1e-4)
    for column in ("width", "crps"):
        assert (table[f"{column}_ratio"] > 1).all()
    assert (table["interval_score_95_kip"] >= table["width_95_kip"] * 0.999).all()
    assert (table["rrse"] < 0.6).all()


@pytest.mark.slow
def test_the_report_shows_what_was_left_out_beside_the_test_held_out(crossed):
    page = (crossed[0] / "report.html").read_text()
    section = page[page.index('id="held-out"') : page.index('id="unknown"')]
    for words in ("Every level held out in turn", "coverage of the 95 % band"):
        assert words in section
    assert HELD_OUT not in pd.read_csv(crossed[0] / "crossvalidation.csv")["test"].to_numpy()


@pytest.mark.slow
def test_parts_that_were_predicted_are_not_predicted_again(crossed, without_figures, tmp_path):
    folder, _, arguments = crossed
    copy = Path(shutil.copytree(folder, tmp_path / "copy"))
    (copy / "crossvalidation" / "level_2.json").unlink()
    again = [str(copy) if a == folder else a for a in arguments]
    outcome = mfd(without_figures, *again, "--jobs", 2, "--resume")
    assert outcome.returncode == 0, outcome.stderr
    assert "without 1000 psi: done" in outcome.stdout
    assert "without 500 psi: done before" in outcome.stdout
    assert "without 500 psi: sampling" not in outcome.stdout
    name = "crossvalidation.csv"
    assert (copy / name).read_bytes() == (folder / name).read_bytes()


@pytest.mark.slow
def test_resuming_keeps_the_cross_validation_and_replacing_removes_it(campaign, crossed, tmp_path):
    copy = Path(shutil.copytree(crossed[0], tmp_path / "copy"))
    options = Options(effort="quick", resume=True)
    execution.calibrate(plan_campaign(campaign[0], options), copy, lambda _: None)
    assert mb.open_run(copy).manifest.crossvalidation.by == "level"
    (copy / "crossvalidation" / ".level_1.json.abc.part").write_text("")
    discard(copy)
    assert not (copy / "crossvalidation").exists()
    assert not (copy / "crossvalidation.csv").exists()
    assert not (copy / "law_scores.csv").exists()


@pytest.mark.slow
def test_an_existing_run_is_not_cross_validated_unasked(crossed):
    before = (crossed[0] / "manifest.json").read_bytes()
    refused(here(*crossed[2]), "--resume")
    assert (crossed[0] / "manifest.json").read_bytes() == before


# --- interrupting and resuming


def test_resuming_a_finished_run_keeps_its_draws(campaign, copied):
    files = [copied / "tests" / test / "posterior.nc" for test in TESTS]
    before = [file.stat().st_mtime_ns for file in files]
    steps = []
    plan = plan_campaign(campaign[0], Options(effort="quick", resume=True))
    run = execution.calibrate(plan, copied, steps.append)
    assert [(step.id, step.stage) for step in steps] == [(test, "kept") for test in TESTS]
    assert [file.stat().st_mtime_ns for file in files] == before
    assert run.manifest.status == "finished"
    assert set(mb.open_run(copied).tests) == set(TESTS)


def test_an_existing_run_is_refused_and_kept(campaign, copied):
    before = (copied / "manifest.json").read_bytes()
    outcome = here(*calibrate(campaign[0], copied))
    refused(outcome, "--resume")
    assert "--force" in outcome.stderr
    assert (copied / "manifest.json").read_bytes() == before


def test_another_seed_cannot_resume(campaign, copied):
    before = (copied / "manifest.json").read_bytes()
    refused(here(*calibrate(campaign[0], copied, "--resume", "--seed", 2)), "seed")
    assert (copied / "manifest.json").read_bytes() == before


def start(*arguments):
    """Start the installed command as a terminal does, in a process group of its own."""
    return subprocess.Popen(
        [COMMAND, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment() | {"PYTHONUNBUFFERED": "1"},
        start_new_session=True,
    )


def press_until_it_stops(process):
    """Error output after pressing Ctrl-C twice a second, as a person does, until it stops."""
    for _ in range(40):
        os.killpg(process.pid, signal.SIGINT)
        try:
            return process.communicate(timeout=0.5)[1]
        except subprocess.TimeoutExpired:
            if process.poll() is not None:
                break
    return process.communicate(timeout=10)[1]


@pytest.mark.slow
@pytest.mark.parametrize("wait", [0.05, 0.12])
def test_an_interrupt_while_processes_start_is_one_sentence_too(campaign, tmp_path, wait):
    out = tmp_path / "out"
    process = start(*calibrate(campaign[0], out, "--jobs", 2))
    last = out / "tests" / HELD_OUT / "record.nc"  # is written just before
    while process.poll() is None and not last.exists():
        time.sleep(0.01)
    time.sleep(wait)  # Python starts in the new processes, and until then Ctrl-C is ignored
    complaint = press_until_it_stops(process)
    assert process.returncode == 130
    (sentence,) = complaint.splitlines()
    assert sentence.startswith("mfd-bayes: interrupted")


@pytest.mark.slow
def test_an_interrupted_run_is_resumed_to_the_same_bits(campaign, out, copied, without_figures):
    """Replace a run, interrupt that, give back what could be finished by then, and go on."""
    (copied / "mine.txt").write_text("keep me")
    process = start(*calibrate(campaign[0], copied, "--force", "--jobs", 2))
    assert process.stdout is not None
    seen = []
    for line in process.stdout:
        seen.append(line)
        if "finding modes" in line and len(seen) == 2:
            break
    time.sleep(0.5)
    os.killpg(process.pid, signal.SIGINT)
    began = time.monotonic()
    printed, complaint = process.communicate(timeout=30)
    assert process.returncode == 130, (seen, printed, complaint)
    assert time.monotonic() - began < 20
    (sentence,) = complaint.splitlines()
    assert sentence.startswith("mfd-bayes: interrupted")
    assert "--resume" in sentence
    # --force has removed what the run had written, and only that
    assert not (copied / "report.html").exists()
    assert not list(copied.glob("parameters.*"))
    assert not list(copied.glob("laws.*"))
    assert not list(copied.rglob("posterior.nc"))
    assert (copied / "mine.txt").read_text() == "keep me"
    assert json.loads((copied / "manifest.json").read_text())["status"] == "running"
    refused(here("report", copied), "not finished")
    with pytest.raises(StoreError, match="--resume"):
        mb.open_run(copied)

    for test in TESTS[:2]:
        home = copied / "tests" / test
        home.mkdir(parents=True, exist_ok=True)
        shutil.copy(out / "tests" / test / "posterior.nc", home)
    outcome = mfd(without_figures, *calibrate(campaign[0], copied, "--resume", "--jobs", 1))
    assert outcome.returncode == 0, outcome.stderr
    assert f"{TESTS[2]}: done" in outcome.stdout
    assert f"{TESTS[0]}: done before" in outcome.stdout
    assert f"{TESTS[0]}: sampling" not in outcome.stdout
    # one process here, two there; the draws are the same to the bit, and so is what follows
    first, again = (draws_of(f / "tests" / TESTS[2] / "posterior.nc") for f in (out, copied))
    assert first.data_vars.keys() == again.data_vars.keys()
    for name in first.data_vars:
        np.testing.assert_array_equal(first[name], again[name], err_msg=str(name))
    for table in ("parameters.csv", "laws.csv", "checks.csv"):
        assert (copied / table).read_bytes() == (out / table).read_bytes()


def test_a_damaged_posterior_is_named(copied):
    damaged = copied / "tests" / TESTS[1] / "posterior.nc"
    damaged.write_bytes(damaged.read_bytes()[:5000])
    refused(here("check", copied), str(damaged))
    damaged.unlink()
    refused(here("check", copied), str(damaged))


# --- the plan


def test_every_input_has_its_hash_even_if_names_repeat(campaign, tmp_path):
    folder = campaign[0].parent
    for place, test in (("a", TESTS[0]), ("b", TESTS[1])):
        (tmp_path / place).mkdir()
        shutil.copy(folder / f"{test}.csv", tmp_path / place / "test.csv")
    head = campaign[0].read_text().split("[[test]]")[0]
    entry = '[[test]]\nid = "{0}"\nfile = "{0}/test.csv"\nactuation = "500 psi"\n'
    path = tmp_path / "campaign.toml"
    path.write_text(head + entry.format("a") + entry.format("b"))
    plan = plan_campaign(path, Options(effort="quick"))
    for place in ("a", "b"):
        digest = hashlib.sha256((tmp_path / place / "test.csv").read_bytes()).hexdigest()
        assert digest in plan.manifest.inputs.values()


def test_a_tests_seed_does_not_depend_on_its_neighbours(campaign, tmp_path):
    folder = shutil.copytree(campaign[0].parent, tmp_path / "campaign")
    head, *entries = (folder / "campaign.toml").read_text().split("[[test]]")
    (folder / "less.toml").write_text(f"{head}[[test]]{entries[2]}")
    whole = plan_campaign(folder / "campaign.toml", Options()).tasks
    (alone,) = plan_campaign(folder / "less.toml", Options()).tasks
    assert (alone.id, alone.seed) == (whole[2].id, whole[2].seed)
    assert len({task.seed for task in whole}) == 3
