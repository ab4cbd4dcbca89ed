"""All commands on a small synthetic campaign, calibrated once by the command itself."""

import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import mfd_bayes as mb
from mfd_bayes.cli.commands import app
from mfd_bayes.pipeline.calibrate import calibrate
from mfd_bayes.pipeline.plan import Options, plan_campaign

TESTS = ("p500_f0.5", "p1000_f0.5", "p1500_f0.5")
HELD_OUT = "p1200_f0.5"
AREA = 1.5  # in²
TIME = np.arange(201) / 50.0
MOTION = np.sin(np.pi * TIME)


def environment():
    """Environment of a user who has set no thread counts."""
    plain = {name: v for name, v in os.environ.items() if not name.endswith("_NUM_THREADS")}
    return plain | {"PYTHONPATH": os.pathsep.join(sys.path)}


def mfd(command, *arguments):
    """Outcome of the command that some words start."""
    words = [*command, *map(str, arguments)]
    return subprocess.run(
        words, capture_output=True, text=True, env=environment(), timeout=300, check=False
    )


def here(*arguments):
    """Outcome of the command in this process, where warnings are errors."""
    return CliRunner().invoke(app, [str(a) for a in arguments])


def quick(campaign, out, *options):
    return "calibrate", campaign, "-o", out, "--effort", "quick", *options


def refused(outcome, *words):
    assert outcome.exit_code == 2, (outcome.output, outcome.exception)
    (sentence,) = outcome.stderr.splitlines()
    assert sentence.startswith("mfd-bayes: ")
    for word in words:
        assert word in sentence


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


def table_of(out, name, *keys):
    return pd.read_csv(out / name, comment="#").set_index([*keys])


# --- what is printed, and what was found


def test_calibrate_says_what_it_does_and_where_to_look(finished_run):
    assert (finished_run.code, finished_run.stderr) == (0, "")
    verdicts = json.loads((finished_run.out / "manifest.json").read_text())["verdicts"]
    lines = finished_run.stdout.splitlines()
    for test in TESTS:
        assert any(line.startswith(f"{test}: done") for line in lines)
    assert any(line.startswith(f"{verdicts['campaign'].upper()}: ") for line in lines)
    assert lines[-1].startswith(f"look next at {finished_run.out}/report.html")
    assert "\x1b" not in finished_run.stdout  # plain lines where there is no terminal


def test_the_posterior_finds_the_truth(campaign, run):
    for test in TESTS:
        known, draws = campaign[1]["tests"][test], run.tests[test].draws
        gap = (draws["d2"] + draws["d3"]).to_numpy(), known["d2"] + known["d3"]
        names = ("k3", "Fc_fwd", "Fc_bwd", "ell")
        for sample, truth in (gap, *((draws[name].to_numpy(), known[name]) for name in names)):
            assert np.median(sample) == pytest.approx(truth, abs=4 * np.std(sample))
            assert np.median(sample) == pytest.approx(truth, rel=0.15)
            assert np.std(sample) < 0.15 * truth


def test_the_laws_find_the_truth(campaign, out, run):
    for name in ("K_c_fwd", "K_c_bwd"):
        truth, slope = campaign[1]["population"][name], run.population.slopes[name]
        low, high = np.quantile(slope, [0.025, 0.975])
        assert low <= truth <= high or abs(slope.mean() - truth) < 3 * slope.std()
        assert np.median(slope) == pytest.approx(truth, rel=0.15)
        row = table_of(out, "laws.csv", "constant").loc[name]
        assert row["unit"] == "in^2"
        assert row["q50"] == pytest.approx(np.median(slope), rel=1e-4)


def test_the_population_holds_laws_and_scatter(campaign, run, out):
    population = run.population
    slopes = {"K_c_fwd", "K_c_bwd", "K_s_fwd", "K_s_bwd", "alpha_sigma0", "sigma0_0"}
    assert slopes <= set(population.slopes)
    assert {"Fc_fwd", "Fc_bwd", "d2", "offset"} <= set(population.scatters)
    assert {"k3", "d3"} <= set(population.scatters) | set(population.common)
    assert not set(population.scatters) & set(population.common)
    assert all(np.all(tau > 0) for tau in population.scatters.values())
    assert population.law_weights["Fc_fwd"] == {"proportional": 1.0}
    assert population.law_weights["sigma0"] == {"affine": 1.0}
    known = campaign[1]["population"]  # the truth of a scatter is that of its coordinate
    assert known["scatter_d3"] == pytest.approx(0.05 * np.sqrt(2))
    assert not {"scatter_Fc_fwd", "scatter_d2", "scatter_friction"} & set(known)
    scores = table_of(out, "law_scores.csv", "quantity", "law")
    assert scores.groupby("quantity")["weight"].sum().to_numpy() == pytest.approx(1.0)
    for name in ("Fc_fwd", "Fc_bwd"):
        assert scores.loc[(name, "proportional"), "chosen"] == "yes"
        assert scores.loc[(name, "constant"), "elpd_difference"] < -1


def test_the_held_out_test_is_covered_and_was_not_fitted(out, run):
    held = table_of(out, "scores.csv", "test").loc[HELD_OUT]
    assert held["role"] == "validate"
    assert held["coverage_95"] > 0.8
    assert held["rrse"] < 0.25
    assert held["width_95_kip"] < 1.5  # of a force of 4 kip from peak to peak
    assert (set(run.tests), set(run.held_out)) == (set(TESTS), {HELD_OUT})
    assert not (out / "tests" / HELD_OUT / "posterior.nc").exists()


def test_what_derives_from_the_force_is_what_was_measured(campaign, out):
    table = table_of(out, "derived.csv", "test", "quantity")
    for test in (*TESTS, HELD_OUT):
        for name in ("energy_per_cycle", "c_eq"):
            row = table.loc[test].loc[name]
            spread = 3 * row["sd"] if test == HELD_OUT else 0
            assert row["q50"] == pytest.approx(row["measured"], rel=0.03, abs=spread)
            assert row["q2.5"] < row["q50"] < row["q97.5"]
            assert row["note"].startswith("over 1 full cycle")
    for test in TESTS:
        known, pressure = campaign[1]["tests"][test], float(test[1:].split("_")[0]) / 1000
        for side in ("fwd", "bwd"):
            row, value = table.loc[test].loc[f"C_{side}"], known[f"Fc_{side}"] / (pressure * AREA)
            assert row["q50"] == pytest.approx(value, abs=4 * row["sd"])


# --- the run folder


def test_every_file_of_the_contract_is_there(out, campaign):
    for name in (
        *("manifest.json", "population.nc", "parameters.csv", "laws.csv", "checks.csv"),
        *("parameters.json", "laws.json", "parameters.tex", "laws.tex", "derived.csv"),
        *("scores.csv", "law_scores.csv", "report.html"),
    ):
        assert (out / name).stat().st_size > 0
    assert (out / "campaign.toml").read_bytes() == campaign[0].read_bytes()
    assert list((out / "figures").glob("*.png"))
    for test in TESTS:
        assert (out / "tests" / test / "posterior.nc").is_file()
        pictures = {p.stem for p in (out / "tests" / test).glob("*.png")}
        assert {"loops", "history", "corner", "ranks"} <= pictures
    assert not list(out.rglob("*.part"))
    assert not list(out.rglob(".*"))
    page = re.sub(
        "<script.*?</script>", "", (out / "report.html").read_text(), flags=re.DOTALL
    )  # which a policy binds
    for call in ('src="http', "src='http", "@import", "stylesheet", "url(http"):
        assert call not in page


def test_parameters_csv_is_table_one_with_the_uncertainty_of_the_draws(out, run):
    table = table_of(out, "parameters.csv", "test", "parameter")
    names = mb.ThreeStage().parameters
    for test in TESTS:
        assert list(table.loc[test].index[: len(names)]) == list(names)  # in the paper's order
    assert (table["q2.5"] <= table["q50"]).all()
    assert (table["q50"] <= table["q97.5"]).all()
    assert (table["sd"] > 0).all()
    assert (table.dropna(subset=["r_hat"])["ess_bulk"] > 50).all()
    assert table.loc[(TESTS[0], "k3"), "unit"] == "kip/in"
    for name in ("Fs_bwd", "k3", "gamma2", "noise_sd"):
        draws, row = run.tests[TESTS[1]].draws[name].to_numpy(), table.loc[(TESTS[1], name)]
        assert row["mean"] == pytest.approx(draws.mean(), rel=1e-5)
        assert row["q97.5"] == pytest.approx(np.quantile(draws, 0.975), rel=1e-5)


def test_the_manifest_says_how_it_came_about(out, campaign):
    manifest = json.loads((out / "manifest.json").read_text(), parse_constant=pytest.fail)
    assert (manifest["status"], manifest["seed"]) == ("finished", 1)
    assert manifest["effort"]["name"] == "quick"
    assert manifest["versions"]["mfd_bayes"] == mb.__version__
    assert {"python", "numpy", "scipy", "emcee", "arviz"} <= set(manifest["versions"])
    assert manifest["command"].startswith("mfd-bayes calibrate")
    assert manifest["platform"]
    for file in ("campaign.toml", *(f"{test}.csv" for test in (*TESTS, HELD_OUT))):
        digest = hashlib.sha256((campaign[0].parent / file).read_bytes()).hexdigest()
        assert digest in manifest["inputs"].values()
    for test in TESTS:
        assert manifest["tests"][test]["status"] == "done"
        assert 0 < manifest["tests"][test]["seconds"] < manifest["seconds"] * 2


# --- predictions in Python


def predicted(run, actuation, **options):
    trace = mb.Trace.from_arrays(TIME, MOTION, actuation=actuation)
    return run.predict(trace, draws=300, **options)


def test_the_kinds_of_prediction_are_nested(run):
    for actuation in (1.0, 0.7):  # tested, and not
        widths = []
        for kind in ("device", "new_test", "observation"):
            band = predicted(run, actuation, kind=kind)
            assert (band.kind, band.probability) == (kind, 0.95)
            assert band.draws.shape == (300, TIME.size)
            assert band.lower.shape == band.median.shape == band.upper.shape == TIME.shape
            assert np.all(np.isfinite(band.draws))
            widths.append(np.mean(band.upper - band.lower))
        assert widths == sorted(widths)


def test_the_device_is_the_law_everywhere_and_this_very_test_a_kind_of_its_own(run):
    at, near = (predicted(run, p, kind="device") for p in (1.0, 1.02))
    assert at.source == near.source == "population laws"
    widths = [np.mean(band.upper - band.lower) for band in (at, near)]
    assert widths[1] == pytest.approx(widths[0], rel=0.3)
    own = predicted(run, 1.0, kind="this_test", test=TESTS[1])
    draws = run.tests[TESTS[1]].draws["Fc_fwd"].to_numpy()
    assert np.all(np.isin(np.round(own.values["Fc_fwd"], 9), np.round(draws, 9)))
    later, scattered = TIME > 2.0, predicted(run, 1.0, kind="new_test")
    assert np.mean((own.upper - own.lower)[later]) < 0.5 * np.mean(
        (scattered.upper - scattered.lower)[later]
    )


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
    band = predicted(run, np.where(TIME < 2.0, 0.5, 1.5))
    early, late = (TIME > 1.9) & (TIME < 2.0), (TIME > 2.05) & (TIME < 2.2)
    assert band.median[late].mean() > 2 * band.median[early].mean()


# --- the command predict


@pytest.mark.usefixtures("no_figures_of_tests")
def test_a_report_is_made_again_without_sampling_with_more_conditions(copied):
    for text, word in (
        ("700 psi", "700 psi"),
        ("700 lbf, 1 in, 0.5 Hz", "700 lbf"),
        ("700 psi, one inch, 0.5 Hz", "one inch"),
    ):
        refused(here("report", copied, "--at", text), "--at", word)
    stored = copied / "tests" / TESTS[0] / "posterior.nc"
    before = stored.stat().st_mtime_ns
    tables = {n: (copied / n).read_bytes() for n in ("parameters.csv", "laws.csv", "checks.csv")}
    (copied / "report.html").unlink()
    shutil.rmtree(copied / "figures")
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
    assert list((copied / "figures").glob("*.png"))
    for name, content in tables.items():
        assert (copied / name).read_bytes() == content
    assert stored.stat().st_mtime_ns == before


@pytest.fixture
def motion(tmp_path):
    """A motion with a force of ±1 kip."""
    table = np.column_stack([TIME, MOTION, np.sign(np.gradient(MOTION))])
    head = "time_s,displacement_in,force_kip"
    np.savetxt(tmp_path / "m.csv", table, delimiter=",", header=head, comments="")
    return tmp_path / "m.csv"


def test_predict_writes_a_table_and_pictures(out, motion, tmp_path):
    bands = tmp_path / "new" / "bands.csv"
    ask = ("predict", out, "--motion", motion, "--actuation", "700 psi", "-o", bands)
    outcome = here(*ask, "--explain", "--whole")
    assert outcome.exit_code == 0, outcome.output
    for words in (
        *("new_test", "95 %", "What makes the band wide", "scatter of backward slip force"),
        *("start in the gap", "energy_per_cycle"),
    ):
        assert words in outcome.stdout
    table = pd.read_csv(bands, comment="#")
    columns = ["whole_lower_kip", "lower_kip", "median_kip", "upper_kip", "whole_upper_kip"]
    assert (np.diff(table[columns].to_numpy(), axis=1) >= 0).all()
    np.testing.assert_allclose(np.interp(table["time_s"], TIME, MOTION), table["displacement_in"])
    head = bands.read_text().splitlines()[0]
    assert head.startswith("#")
    assert "95 %" in head
    assert "new_test" in head
    for picture in ("bands.png", "bands_history.png"):
        assert (bands.parent / picture).read_bytes().startswith(b"\x89PNG")
    derived = table_of(bands.parent, "bands_derived.csv", "quantity")
    assert derived["measured"].isna().all()  # the file's force is not taken for the prediction


@pytest.mark.usefixtures("small_pictures")
def test_predict_says_what_derives_from_the_force(out, motion, tmp_path):
    tables = []
    for kind in ("new_test", "observation"):
        ask = ("--actuation", "700 psi", "-o", tmp_path / f"{kind}.csv", "--kind", kind)
        outcome = here("predict", out, "--motion", motion, *ask, "--probability", 0.5, "--compare")
        assert outcome.exit_code == 0, outcome.output
        assert "75 %" in outcome.stdout
        head = (tmp_path / f"{kind}_derived.csv").read_text().splitlines()[0]
        assert f"of kind {kind}" in head
        assert "50 % intervals" in head
        tables.append(table_of(tmp_path, f"{kind}_derived.csv", "quantity"))
    rows = tables[0]
    assert list(rows.index) == list(tables[1].index)
    names = {"energy_per_cycle", "energy_in_all", "c_eq", "peak_fwd", "peak_bwd"}
    assert names <= set(rows.index)
    assert ((rows["lower"] <= rows["median"]) & (rows["median"] <= rows["upper"])).all()
    assert rows.loc["energy_per_cycle", "measured"] == pytest.approx(4.0, rel=0.02)
    energy, damping = rows.loc["energy_per_cycle", "median"], rows.loc["c_eq", "median"]
    assert damping == pytest.approx(energy / np.pi**2, rel=2e-3)  # ω = π 1/s, X = 1 in


def test_a_prediction_that_makes_no_sense_is_refused(out, motion, tmp_path, monkeypatch):
    for options, words in [
        (("--actuation", "5,5 MPa"), "of --actuation"),
        (("--actuation", "30 lbf"), "must be a pressure"),
        (("--actuation", "1000"), "no unit"),
        (("--actuation", "1 ksi", "--probability", "1.5"), "between 0 and 1, got 1.5"),
        (("--actuation", "1 ksi", "--motion", "text.csv"), "line 3"),
        (("--actuation", "1 ksi", "-o", "bands.png"), "bands.png"),
        (("--actuation", "1 ksi", "-o", "text.csv/bands.csv"), "bands.csv"),
    ]:
        monkeypatch.chdir(tmp_path)
        (tmp_path / "text.csv").write_text("time_s,displacement_in\n0,0\n0.1,a\n")
        refused(here("predict", out, "--motion", motion, "-o", "bands.csv", *options), words)
        assert not (tmp_path / "bands.csv").exists()


# --- report and check


def test_check_exits_by_the_verdict(out, copied):
    verdicts = json.loads((out / "manifest.json").read_text())["verdicts"]
    everything = here("check", out, "--all")
    assert everything.exit_code == int(verdicts["campaign"] == "not usable"), everything.output
    assert "R-hat" in everything.stdout
    manifest = json.loads((copied / "manifest.json").read_text())
    manifest["effort"]["ess"] = 1e9
    (copied / "manifest.json").write_text(json.dumps(manifest))
    outcome = here("check", copied, "-q")
    assert outcome.exit_code == 1
    assert "do not use these figures" in outcome.stdout
    assert len(everything.stdout) > 5 * len(outcome.stdout)


# --- cross-validation


@pytest.mark.slow
def test_every_level_is_predicted_from_the_others_and_nothing_sampled_twice(
    campaign, out, copied, without_figures
):
    copy = copied
    arguments = ("crossvalidate", campaign[0], "-o", copy, "--by", "level", "--effort", "quick")
    outcome = mfd(without_figures, *arguments, "--jobs", 2, "--resume")
    assert outcome.returncode == 0, outcome.stderr
    for level in ("500 psi", "1000 psi", "1500 psi"):
        assert f"without {level}: done" in outcome.stdout
    assert "finding modes" not in outcome.stdout
    assert "population: " not in outcome.stdout
    assert "Of 3 tests, each predicted from those of the other levels" in outcome.stdout
    for test in TESTS:
        name = Path("tests") / test / "posterior.nc"
        assert (copy / name).read_bytes() == (out / name).read_bytes()
    table = table_of(copy, "crossvalidation.csv", "test")
    assert list(table.index) == [*TESTS, "mean"]
    assert list(table["part"][:3]) == ["500 psi", "1000 psi", "1500 psi"]
    assert table.loc["mean", "coverage_95"] > 0.85
    assert (table[["width_ratio", "crps_ratio"]] > 1).all(axis=None)
    assert (table["interval_score_95_kip"] >= table["width_95_kip"] * 0.999).all()
    assert (table["rrse"] < 0.6).all()
    before = (copy / "manifest.json").read_bytes()
    refused(here(*arguments), "--resume")
    assert (copy / "manifest.json").read_bytes() == before


# --- interrupting and resuming


def test_resuming_a_finished_run_keeps_its_draws(campaign, copied):
    files = [copied / "tests" / test / "posterior.nc" for test in TESTS]
    before = [file.stat().st_mtime_ns for file in files]
    steps = []
    plan = plan_campaign(campaign[0], Options(effort="quick", resume=True))
    assert calibrate(plan, copied, steps.append).manifest.status == "finished"
    assert [(step.id, step.stage) for step in steps] == [(test, "kept") for test in TESTS]
    assert [file.stat().st_mtime_ns for file in files] == before
    assert set(mb.open_run(copied).tests) == set(TESTS)
    before = (copied / "manifest.json").read_bytes()
    refused(here(*quick(campaign[0], copied)), "--resume", "--force")
    refused(here(*quick(campaign[0], copied, "--resume", "--seed", 2)), "seed")
    assert (copied / "manifest.json").read_bytes() == before


def start(*arguments):
    """Start the command as a terminal does, in a process group of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "mfd_bayes", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment() | {"PYTHONUNBUFFERED": "1"},
        start_new_session=True,
    )


@pytest.mark.slow
def test_an_interrupt_while_processes_start_is_one_sentence_too(campaign, tmp_path):
    out = tmp_path / "out"
    process = start(*quick(campaign[0], out, "--jobs", 2))
    last = out / "tests" / HELD_OUT / "record.nc"  # is written just before
    while process.poll() is None and not last.exists():
        time.sleep(0.01)
    time.sleep(0.05)  # Python starts in the new processes, and until then Ctrl-C is ignored
    for _ in range(40):  # as a person does, until it stops
        os.killpg(process.pid, signal.SIGINT)
        try:
            _, complaint = process.communicate(timeout=0.5)
            break
        except subprocess.TimeoutExpired:
            continue
    assert process.returncode == 130
    (sentence,) = complaint.splitlines()
    assert sentence.startswith("mfd-bayes: interrupted")


# --- the plan


def test_a_tests_seed_does_not_depend_on_its_neighbours(campaign, tmp_path):
    folder = shutil.copytree(campaign[0].parent, tmp_path / "campaign")
    head, *entries = (folder / "campaign.toml").read_text().split("[[test]]")
    (folder / "less.toml").write_text(f"{head}[[test]]{entries[2]}")
    whole = plan_campaign(folder / "campaign.toml", Options()).tasks
    (alone,) = plan_campaign(folder / "less.toml", Options()).tasks
    assert (alone.id, alone.seed) == (whole[2].id, whole[2].seed)
    assert len({task.seed for task in whole}) == 3
    for place, test in (("a", TESTS[0]), ("b", TESTS[1])):  # every input has its hash
        (folder / place).mkdir()
        shutil.copy(folder / f"{test}.csv", folder / place / "test.csv")
    entry = '[[test]]\nid = "{0}"\nfile = "{0}/test.csv"\nactuation = "500 psi"\n'
    (folder / "same.toml").write_text(head + entry.format("a") + entry.format("b"))
    plan = plan_campaign(folder / "same.toml", Options(effort="quick"))
    for place in ("a", "b"):
        digest = hashlib.sha256((folder / place / "test.csv").read_bytes()).hexdigest()
        assert digest in plan.manifest.inputs.values()
