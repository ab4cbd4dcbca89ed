"""A small synthetic campaign, calibrated once by the command itself: its files and its answers."""

import hashlib
import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import mfd_bayes as mb
from mfd_bayes.pipeline.calibrate import calibrate
from mfd_bayes.pipeline.options import RunOptions
from mfd_bayes.pipeline.plan import plan_campaign
from tests.command_line import here, refusal

TESTS = ("p500_f0.5", "p1000_f0.5", "p1500_f0.5")
HELD_OUT = "p1200_f0.5"
AREA = 1.5  # in²
TIME = np.arange(201) / 50.0
MOTION = np.sin(np.pi * TIME)


@pytest.fixture
def copied(out, tmp_path):
    return Path(shutil.copytree(out, tmp_path / "copy"))


def table_of(folder, name, *keys):
    return pd.read_csv(folder / name, comment="#").set_index([*keys])


# --- what is printed, and what is found


def test_calibrate_says_what_it_does_and_where_to_look(finished_run):
    assert finished_run.stderr == ""
    verdicts = json.loads((finished_run.out / "manifest.json").read_text())["verdicts"]
    lines = finished_run.stdout.splitlines()
    for test in TESTS:
        assert any(line.startswith(f"{test}: done") for line in lines)
    assert any(line.startswith(f"{verdicts['campaign'].upper()}: ") for line in lines)
    assert lines[-1].startswith(f"look next at {finished_run.out}/report.html")
    assert "\x1b" not in finished_run.stdout  # plain lines where there is no terminal


def test_the_posterior_finds_the_truth(finished_run, run):
    for test in TESTS:
        expected, draws = finished_run.truth["tests"][test], run.tests[test].draws
        gap = (draws["d2"] + draws["d3"]).to_numpy(), expected["d2"] + expected["d3"]
        names = ("k3", "Fc_fwd", "Fc_bwd", "ell")
        for sample, truth in (gap, *((draws[name].to_numpy(), expected[name]) for name in names)):
            assert np.median(sample) == pytest.approx(truth, abs=4 * np.std(sample))
            assert np.median(sample) == pytest.approx(truth, rel=0.15)
            assert np.std(sample) < 0.15 * truth


def test_laws_and_scatter_find_the_truth(finished_run, out, run):
    population, truth = run.population, finished_run.truth["population"]
    for name in ("K_c_fwd", "K_c_bwd"):
        slope = population.slopes[name]
        low, high = np.quantile(slope, [0.025, 0.975])
        assert low <= truth[name] <= high or abs(slope.mean() - truth[name]) < 3 * slope.std()
        assert np.median(slope) == pytest.approx(truth[name], rel=0.15)
        row = table_of(out, "laws.csv", "constant").loc[name]
        assert row["unit"] == "in^2"
        assert row["q50"] == pytest.approx(np.median(slope), rel=1e-4)
    assert {"K_s_fwd", "K_s_bwd", "alpha_sigma0", "sigma0_0"} <= set(population.slopes)
    assert {"Fc_fwd", "Fc_bwd", "d2", "offset"} <= set(population.scatters)
    assert {"k3", "d3"} <= set(population.scatters) ^ set(population.common)
    assert all(np.all(tau > 0) for tau in population.scatters.values())
    assert population.law_weights["sigma0"] == {"affine": 1.0}
    assert truth["scatter_d3"] == pytest.approx(0.05 * np.sqrt(2))  # that of its coordinate
    scores = table_of(out, "law_scores.csv", "quantity", "law")
    assert scores.groupby("quantity")["weight"].sum().to_numpy() == pytest.approx(1.0)
    for name in ("Fc_fwd", "Fc_bwd"):
        assert scores.loc[(name, "proportional"), "chosen"] == "yes"
        assert scores.loc[(name, "constant"), "elpd_difference"] < -1


def test_the_held_out_test_is_covered_and_was_not_fitted(out, run):
    scores = table_of(out, "scores.csv", "test").loc[HELD_OUT]
    assert scores["role"] == "validate"
    assert scores["coverage_95"] > 0.8
    assert scores["rrse"] < 0.25
    assert scores["width_95_kip"] < 1.5  # of a force of 4 kip from peak to peak
    assert (set(run.tests), set(run.held_out)) == (set(TESTS), {HELD_OUT})
    assert not (out / "tests" / HELD_OUT / "posterior.nc").exists()


def test_what_derives_from_the_force_is_what_was_measured(finished_run, out):
    table = table_of(out, "derived.csv", "test", "quantity")
    for test in (*TESTS, HELD_OUT):
        for name in ("energy_per_cycle", "c_eq"):
            row = table.loc[test].loc[name]
            spread = 3 * row["sd"] if test == HELD_OUT else 0
            assert row["q50"] == pytest.approx(row["measured"], rel=0.03, abs=spread)
            assert row["q2.5"] < row["q50"] < row["q97.5"]
            assert row["note"].startswith("over 1 full cycle")
    for test in TESTS:
        truth, pressure = finished_run.truth["tests"][test], float(test[1:].split("_")[0]) / 1000
        for side in ("fwd", "bwd"):
            row, value = table.loc[test].loc[f"C_{side}"], truth[f"Fc_{side}"] / (pressure * AREA)
            assert row["q50"] == pytest.approx(value, abs=4 * row["sd"])


# --- the run folder


def test_every_file_of_the_contract_is_there(finished_run, out):
    names = "manifest.json population.nc parameters.csv laws.csv checks.csv parameters.json "
    names += "laws.json parameters.tex laws.tex derived.csv scores.csv law_scores.csv report.html"
    assert all((out / name).stat().st_size > 0 for name in names.split())
    assert (out / "campaign.toml").read_bytes() == finished_run.campaign.read_bytes()
    assert list((out / "figures").glob("*.png"))
    for test in TESTS:
        assert (out / "tests" / test / "posterior.nc").is_file()
        pictures = {p.stem for p in (out / "tests" / test).glob("*.png")}
        assert {"loops", "history", "corner", "ranks"} <= pictures
    page = (out / "report.html").read_text()
    head = page[: page.index('<nav aria-label="Contents">')]  # which says the tested range
    assert 'data-value="1.5" data-unit="actuation in ksi"' in head
    assert not list(out.rglob("*.part"))
    assert not list(out.rglob(".*"))


def test_the_manifest_says_how_it_came_about(finished_run, out):
    manifest = json.loads((out / "manifest.json").read_text(), parse_constant=pytest.fail)
    assert (manifest["status"], manifest["seed"]) == ("finished", 1)
    assert manifest["effort"]["name"] == "quick"
    assert manifest["versions"]["mfd_bayes"] == mb.__version__
    assert manifest["command"].startswith("mfd-bayes calibrate")
    for file in ("campaign.toml", *(f"{test}.csv" for test in (*TESTS, HELD_OUT))):
        content = (finished_run.campaign.parent / file).read_bytes()
        assert hashlib.sha256(content).hexdigest() in manifest["inputs"].values()
    stored = {path.relative_to(out).as_posix() for path in out.rglob("*.nc")}
    assert set(manifest["files"]) == {*stored, "priors.toml"}  # each with its hash
    for test in TESTS:
        assert manifest["tests"][test]["status"] == "done"
        assert 0 < manifest["tests"][test]["seconds"] < manifest["seconds"] * 2


# --- predictions in Python


def predicted(run, actuation, **options):
    trace = mb.Trace.from_arrays(TIME, MOTION, actuation=actuation)
    return run.predict(trace, draws=300, **options)


def width(band):
    return np.mean(band.upper - band.lower)


def test_the_kinds_of_prediction_are_nested_and_the_device_is_the_law_everywhere(run):
    for actuation in (1.0, 0.7):  # tested, and not
        bands = [predicted(run, actuation, kind=k) for k in ("mean", "new_test", "observation")]
        for band in bands:
            assert band.probability == 0.95
            assert band.draws.shape == (300, TIME.size)
            assert band.lower.shape == band.median.shape == band.upper.shape == TIME.shape
            assert np.all(np.isfinite(band.draws))
        assert [band.kind for band in bands] == ["mean", "new_test", "observation"]
        assert [*map(width, bands)] == sorted(map(width, bands))
    tested, neighbour = (predicted(run, p, kind="mean") for p in (1.0, 1.02))
    assert tested.source == neighbour.source == "population laws"
    assert width(neighbour) == pytest.approx(width(tested), rel=0.3)


def test_a_prediction_of_this_very_test_has_its_draws_and_is_narrower(run):
    conditional, scattered = (
        predicted(run, 1.0, kind="this_test", test=TESTS[1]),
        predicted(run, 1.0, kind="new_test"),
    )
    draws = run.tests[TESTS[1]].draws["Fc_fwd"].to_numpy()
    assert np.all(np.isin(np.round(conditional.values["Fc_fwd"], 9), np.round(draws, 9)))
    assert width(conditional) < 0.6 * width(scattered)


# --- report and check


@pytest.mark.usefixtures("no_figures_of_tests")
def test_a_report_is_made_again_without_sampling_with_more_conditions(copied):
    assert "--at: " in refusal("report", copied, "--at", "700 lbf, 1 in, 0.5 Hz")
    stored = copied / "tests" / TESTS[0] / "posterior.nc"
    mtime = stored.stat().st_mtime_ns
    tables = {n: (copied / n).read_bytes() for n in ("parameters.csv", "laws.csv", "checks.csv")}
    (copied / "report.html").unlink()
    shutil.rmtree(copied / "figures")
    conditions = ("--at", "700 psi, 1 in, 0.5 Hz", "--at", "1 ksi, 20 mm, 0.2 Hz")
    outcome = here("report", copied, *conditions, "--quiet")
    assert outcome.exit_code == 0, outcome.output
    table = pd.read_csv(copied / "datasheet.csv")
    added = table[table["tested"] == "no"].drop_duplicates("condition")
    assert added["actuation"].tolist() == [700.0, 1000.0]
    assert added["stroke_in"].to_numpy() == pytest.approx([1.0, 20 / 25.4], rel=1e-5)
    assert added["measured"].isna().all()
    assert (table["lower"] <= table["upper"]).all()
    for name in ("datasheet.html", "report.html"):
        assert 'data-value="0.7" data-unit="actuation in ksi"' in (copied / name).read_text()
    assert list((copied / "figures").glob("*.png"))
    assert {name: (copied / name).read_bytes() for name in tables} == tables
    assert stored.stat().st_mtime_ns == mtime


def test_check_exits_by_the_verdict(out, copied):
    verdicts = json.loads((out / "manifest.json").read_text())["verdicts"]
    everything = here("check", out, "--all")
    assert everything.exit_code == int(verdicts["campaign"] == "not usable"), everything.output
    assert "R-hat" in everything.stdout
    stored = copied / "assessment.json"
    stored.write_text(stored.read_text().replace('"R-hat"', '"Q-hat"'))
    assert "Q-hat" in here("check", copied, "--all").stdout  # it is read, not computed
    stored.unlink()
    computed = here("check", copied, "--all")
    assert computed.stdout == everything.stdout
    manifest = json.loads((copied / "manifest.json").read_text())
    manifest["effort"]["ess"] = 1e9
    (copied / "manifest.json").write_text(json.dumps(manifest))
    outcome = here("check", copied, "-q")
    assert outcome.exit_code == 1
    assert "do not use these figures" in outcome.stdout
    assert len(everything.stdout) > 5 * len(outcome.stdout)


# --- cross-validation, resuming, the plan


@pytest.mark.slow
def test_every_level_is_predicted_from_the_others_and_nothing_sampled_twice(
    finished_run, out, copied, without_figures
):
    words = ("crossvalidate", finished_run.campaign, "-o", copied, "--by", "level")
    words = [*map(str, words), "--effort", "quick", "--resume"]
    command = [*without_figures, *words, "--jobs", "2"]
    outcome = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)
    for level in ("500 psi", "1000 psi", "1500 psi"):
        assert f"without {level}: done" in outcome.stdout
    assert "finding modes" not in outcome.stdout
    assert "population: " not in outcome.stdout
    assert "Of 3 tests, each predicted from those of the other levels" in outcome.stdout
    for test in TESTS:
        name = Path("tests") / test / "posterior.nc"
        assert (copied / name).read_bytes() == (out / name).read_bytes()
    table = table_of(copied, "crossvalidation.csv", "test")
    assert list(table.index) == [*TESTS, "mean"]
    assert list(table["part"][:3]) == ["500 psi", "1000 psi", "1500 psi"]
    assert table.loc["mean", "coverage_95"] > 0.85
    assert (table[["width_ratio", "crps_ratio"]] > 1).all(axis=None)
    assert (table["interval_score_95_kip"] >= table["width_95_kip"] * 0.999).all()
    assert (table["rrse"] < 0.6).all()
    content = (copied / "manifest.json").read_bytes()
    assert "--resume" in refusal(*words[:-1])
    assert (copied / "manifest.json").read_bytes() == content


def test_resuming_a_finished_run_keeps_its_draws(finished_run, copied):
    files = [copied / "tests" / test / "posterior.nc" for test in TESTS]
    state = [file.stat().st_mtime_ns for file in files]
    steps = []
    plan = plan_campaign(finished_run.campaign, RunOptions(effort="quick", resume=True))
    assert calibrate(plan, copied, steps.append).manifest.status == "finished"
    assert [(step.id, step.stage) for step in steps] == [(test, "kept") for test in TESTS]
    assert [file.stat().st_mtime_ns for file in files] == state
    assert set(mb.open_run(copied).tests) == set(TESTS)
    state = (copied / "manifest.json").read_bytes()
    again = ("calibrate", finished_run.campaign, "-o", copied, "--effort", "quick")
    assert re.search("--resume.*--force", refusal(*again))
    assert "seed" in refusal(*again, "--resume", "--seed", 2)
    assert (copied / "manifest.json").read_bytes() == state


def test_a_tests_seed_does_not_depend_on_its_neighbours(finished_run, tmp_path):
    folder = shutil.copytree(finished_run.campaign.parent, tmp_path / "campaign")
    head, *entries = (folder / "campaign.toml").read_text().split("[[test]]")
    (folder / "less.toml").write_text(f"{head}[[test]]{entries[2]}")
    tasks = plan_campaign(folder / "campaign.toml", RunOptions()).tasks
    (single,) = plan_campaign(folder / "less.toml", RunOptions()).tasks
    assert (single.id, single.seed) == (tasks[2].id, tasks[2].seed)
    assert len({task.seed for task in tasks}) == 3
