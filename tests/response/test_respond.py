"""From a finished run to the response of a building."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from itertools import chain

import numpy as np
import pytest
from typer.testing import CliRunner

import mfd_bayes as mb
from mfd_bayes.cli.commands import app
from mfd_bayes.errors import BuildingError
from mfd_bayes.evaluation.properties import design_rows
from mfd_bayes.population.population import LawDraws
from mfd_bayes.response.analysis import Accuracy, Analysis
from mfd_bayes.response.building import read_building
from mfd_bayes.response.device_draws import Choice, draw_dampers
from mfd_bayes.response.ground import Ground, read_ground
from mfd_bayes.response.result import variance_shares
from mfd_bayes.response.sweep import sweep_of
from mfd_bayes.units import GRAVITY

BUILDING = """
[building]
title = "Two storeys"
[[storey]]
weight = "20 kip"
height = "144 in"
stiffness = "8 kip/in"
[[storey]]
weight = "20 kip"
height = "144 in"
stiffness = "8 kip/in"
[[damper]]
storey = 1
actuation = "1000 psi"
[[damper]]
storey = 2
actuation = "1000 psi"
[limits]
drift = "0.5 %"
"""

ONCE = Accuracy(tolerance=0.03)


@pytest.fixture(scope="module")
def run(finished_run):
    return mb.open_run(finished_run.out)


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "building.toml"
    path.write_text(BUILDING)
    return path


@pytest.fixture
def ground():
    white = np.random.default_rng(5).standard_normal(100)
    values = np.convolve(white, np.hanning(9), mode="same")
    return Ground("random", 0.02, 200.0 * values / np.abs(values).max())


@pytest.fixture
def quake(tmp_path, ground):
    path = tmp_path / "quake.csv"
    rows = zip(ground.time, ground.acceleration, strict=True)
    path.write_text("time_s,acceleration_in/s^2\n" + "".join(f"{t:.2f},{a:.6f}\n" for t, a in rows))
    return path


def alone(population):
    """The population with its first draw alone, and nothing else unknown."""
    one = {name: values[:1, :1] for name, values in vars(population.draws).items()}
    none = {name: values[:0] for name, values in vars(population.alternatives).items()}
    certain = replace(population.residual, covariance=np.zeros_like(population.residual.covariance))
    return replace(
        population,
        draws=LawDraws(**one),
        choice=population.choice[:1, :1],
        alternatives=LawDraws(**none),
        alternative_weight=np.zeros(0),
        residual=certain,
    )


def dampers_of(run, path, scatter, draws=40):
    model = next(iter(run.tests.values())).posterior.model
    choice = Choice("new_test", draws, 3, scatter=scatter)
    found = draw_dampers(alone(run.population), model, read_building(path), choice)
    return replace(found, start=np.full(found.start.shape, 0.5))


def test_without_scatter_all_draws_are_one_and_more_scatter_widens(run, path, ground):
    building = read_building(path)

    def peaks(scatter):
        dampers = dampers_of(run, path, scatter)
        return Analysis(building, [ground], dampers, ONCE).respond().drift[:, 0, 0]

    none, some, more = peaks(0.0), peaks(1.0), peaks(2.0)
    assert np.ptp(none) < 1e-9 * none.mean()
    assert some.std() > 1e-3 * some.mean()
    assert more.std() > 1.4 * some.std()
    assert none[0] == pytest.approx(np.median(some), rel=0.2)


def test_each_damper_has_its_own_scatter_and_shares_the_law(run, path):
    dampers = dampers_of(run, path, 1.0)
    first, second = dampers.slip.T
    assert not np.allclose(first, second)
    assert np.allclose(*dampers.about["law and level"].T)
    assert np.allclose(dampers_of(run, path, 0.0).slip[:, 0], dampers_of(run, path, 0.0).slip[:, 1])


def test_the_call_of_the_contract(run, path, ground):
    response = run.respond(path, [ground], draws=12, seed=1, kind="device")
    assert response.drift.shape == (12, 1, 2)
    assert response.acceleration.shape == (12, 1, 2)
    assert response.force.shape == response.travel.shape == response.energy.shape == (12, 1, 2)
    assert np.all(response.energy > 0)
    assert response.imbalance.max() < 1e-3
    again = run.respond(path, ground, draws=12, seed=1, kind="device")
    assert np.array_equal(again.drift, response.drift)
    rows = [row for row in response.rows() if row.quantity == "drift"]
    assert rows[0].bands[2][0] <= rows[0].bands[0][0] <= rows[0].median <= rows[0].bands[0][1]
    assert rows[0].bare > 0
    (limit,) = response.limits()
    worst = response.drift_ratio[:, 0].max(axis=1)
    assert limit.probability == np.mean(worst > 0.005)
    assert 0 < limit.error < 0.2


def test_all_dampers_at_a_bound_stand_beside_the_band(run, path, ground):
    response = run.respond(path, [ground], draws=12, seed=1)
    lower, upper = (response.references[name] for name in ("lower", "upper"))
    for bound, sign in ((lower, -1.0), (upper, 1.0)):
        assert bound.draws == 1
        assert np.all(sign * (bound.dampers.slip - np.median(response.dampers.slip)) > 0)
        assert not np.allclose(bound.drift, np.median(response.drift, axis=0), rtol=1e-3)
    # as the data sheet has them
    trace = next(iter(run.tests.values())).trace
    model = next(iter(run.tests.values())).posterior.model
    trace = replace(trace, actuation=1.0)
    rows = {(row["name"], row["basis"]): row for row in design_rows(run, trace)}
    for name, parameter in (("slip_fwd", "Fc_fwd"), ("slip_bwd", "Fc_bwd")):
        column, design = model.parameters.index(parameter), rows[name, "new_test"]
        got = [float(bound.dampers.theta[0, 0, column]) for bound in (lower, upper)]
        assert got == pytest.approx([design["lower"], design["upper"]], rel=0.1)  # 4 se of tails
    static, kinetic = (model.parameters.index(f"F{x}_fwd") for x in "sc")
    ratios = [
        bound.dampers.theta[0, :, static] / bound.dampers.theta[0, :, kinetic]
        for bound in (lower, upper)
    ]
    assert np.allclose(*ratios)
    shown = next(row for row in response.rows() if row.quantity == "damper force")
    assert shown.lower < shown.upper
    assert np.isnan(shown.bare)


def test_shares_add_up_and_find_what_matters(run, path, ground):
    response = run.respond(path, [ground, ground.scaled(2.0)], draws=40)
    for ground_motion in (0, 1):
        shares = variance_shares(response, ground=ground_motion)
        assert sum(shares.values()) == pytest.approx(1.0)
        assert not any("record" in source for source in shares)
    first = response.dampers.about["gap"][:, 0]
    planted = replace(response, drift=np.broadcast_to(first[:, None, None], response.drift.shape))
    assert variance_shares(planted)["gap"] > 0.7


def test_draws_that_all_ran_away_have_no_shares(run, path, ground):
    response = run.respond(path, ground, draws=30, kind="device", tolerance=0.2)
    assert variance_shares(response)  # the control
    away = np.ones_like(response.unstable)
    assert variance_shares(replace(response, unstable=away)) == {}


def test_what_runs_away_is_told_in_one_sentence_and_nothing_is_written(
    finished_run, path, quake, tmp_path
):
    words = ["respond", str(finished_run.out), "--building", str(path), "--ground", str(quake)]
    words += ["-o", str(tmp_path / "r"), "--draws", "10", "--jobs", "1", "--scale", "1e9"]
    done = CliRunner().invoke(app, [*words, "--quiet"])
    assert done.exit_code == 2
    assert "every draw diverged under quake.csv" in done.output
    assert not (tmp_path / "r").exists()


def test_dampers_of_another_kind_of_actuation_are_refused(run, path, ground):
    path.write_text(BUILDING.replace("1000 psi", "40 lbf"))
    with pytest.raises(BuildingError, match="must be a pressure, as in the campaign"):
        run.respond(path, ground)


def test_a_history_that_ends_before_the_earthquake_is_told(run, path, ground, tmp_path):
    valve = tmp_path / "valve.csv"
    history = 'actuation = { file = "valve.csv", column = "pressure_ksi", unit = "ksi" }'
    path.write_text(BUILDING.replace('actuation = "1000 psi"', history))
    told = []
    for end in (0.5, 1000.0):
        valve.write_text(f"time_s,pressure_ksi\n0,1.0\n{end},1.0\n")
        response = run.respond(path, ground, draws=12, kind="device", tolerance=0.2)
        told.append([r for r in response.remarks if "valve" in r or "are taken to stay" in r])
    both, nothing = told
    assert len(both) == 2  # dampers
    assert all("is known from 0 s to 0.5 s, and the ground motion" in said for said in both)
    assert nothing == []


@pytest.mark.slow
def test_the_command_writes_a_page_and_tables(finished_run, path, quake, tmp_path):
    out = tmp_path / "response"
    words = ["respond", str(finished_run.out), "--building", str(path), "--ground", str(quake)]
    words += ["-o", str(out), "--draws", "10", "--jobs", "1", "--tolerance", "0.2"]
    sweep = ["--sweep", 'actuation="800 psi to 1200 psi in 2 steps"']
    done = CliRunner().invoke(app, [*words, *sweep])
    assert done.exit_code == 0, done.output
    assert "the largest storey drift is" in done.output
    assert "is smallest at" in done.output
    page = (out / "report.html").read_text()
    assert "Which actuation is best?" in page
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert json.loads((out / "response.json").read_text())["peaks"][0]["quantity"] == "drift ratio"
    head, *levels = (out / "sweep.csv").read_text().splitlines()
    assert head.startswith("actuation_ksi,drift_mean_in,drift_median_in,drift_lower_95_in,")
    assert len(levels) == 3
    assert r"\toprule" in (out / "peaks.tex").read_text()
    again = CliRunner().invoke(app, [*words, "--force"])
    assert again.exit_code == 0, again.output


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--sweep", "actuation=800 psi"], "expected actuation"),
        (["--sweep", "actuation=500 N to 1500 N"], "--sweep: the actuation must be a pressure"),
        (["--sweep", "actuation=1 psi to 2 psi in 300 steps"], "1 to 100 steps, got 300"),
        (["--peak", "3 in"], "--peak: expected an acceleration"),
        (["--ground", "nothing.AT2"], "cannot read nothing.AT2"),
        (["--building", "nothing.toml"], "cannot read nothing.toml"),
        (["--by", "q90"], "give --sweep too"),
        (
            [
                *("--sweep", "actuation=800 psi to 900 psi"),
                *("--by", "passing", "--minimise", "acceleration"),
            ],
            "needs limits.acceleration in the building file",
        ),
    ],
)
def test_a_mistake_is_one_sentence(
    finished_run, path, quake, tmp_path, monkeypatch, words, sentence
):
    monkeypatch.setattr(Analysis, "respond", None)  # it is told before anything is computed
    given = ["respond", str(finished_run.out), "--building", str(path), "--ground", str(quake)]
    done = CliRunner().invoke(app, [*given, "-o", str(tmp_path / "r"), *words])
    assert done.exit_code == 2
    assert sentence in done.output
    assert not (tmp_path / "r").exists()


def command(finished_run, path, out, *words):
    given = ["respond", str(finished_run), "--building", str(path), "-o", str(out)]
    few = ["--draws", "30", "--jobs", "1", "--tolerance", "0.2"]
    return CliRunner().invoke(app, [*given, *few, *map(str, words)])


def test_peak_and_duration_of_every_motion_are_printed_before_the_computation(
    finished_run, path, quake, tmp_path, monkeypatch
):
    def stop(*_):
        raise BuildingError("computing")

    monkeypatch.setattr(Analysis, "respond", stop)
    small = tmp_path / "small.txt"
    small.write_text("0.01 -0.1 0.02 0.05")
    words = "--ground", quake, "--ground", f"{small}:0.01s"
    done = command(finished_run.out, path, tmp_path / "r", *words)
    first, second, *_ = done.output.splitlines()
    assert first == "quake.csv: peak 0.518 g, 1.98 s in steps of 0.02 s"
    assert second == "small.txt: peak 0.1 g, 0.03 s in steps of 0.01 s"
    assert "computing" in done.output


def test_an_impossible_peak_is_computed_only_where_it_is_meant(
    finished_run, path, tmp_path, monkeypatch
):
    def stop(*_):
        raise BuildingError("computing")

    monkeypatch.setattr(Analysis, "respond", stop)
    quake = tmp_path / "quake.txt"
    quake.write_text("100 -281 30 12")
    ask = "--ground", f"{quake}:0.01s"
    done = command(finished_run.out, path, tmp_path / "r", *ask)
    assert done.exit_code == 2
    assert "quake.txt: its peak would be 281 g" in " ".join(done.output.split())
    for words in (["--scale", "0.001"], ["--scale", "1"], ["--peak", "0.3 g"], ["--unit", "gal"]):
        done = command(finished_run.out, path, tmp_path / "r", *ask, *words)
        assert "computing" in done.output, done.output
    done = command(finished_run.out, path, tmp_path / "r", "--ground", f"{quake}:0.01s:cm/s^2")
    assert "quake.txt: peak 0.287 g" in done.output
    assert "computing" in done.output


def test_an_answer_beyond_the_tests_says_so_beside_it(finished_run, path, quake, tmp_path):
    inside = command(finished_run.out, path, tmp_path / "r", "--ground", quake, "--scale", "0.4")
    assert inside.exit_code == 0, inside.output
    assert "beyond the tests" not in inside.output
    assert "✓ Answered" in (tmp_path / "r" / "report.html").read_text()
    words = "--ground", quake, "--ground", quake, "--scale", "6"
    far = command(finished_run.out, path, tmp_path / "f", *words, "--quiet")
    assert far.exit_code == 0, far.output
    answer, bounds, matters, beside, *_ = far.output.splitlines()
    assert "the largest storey drift is" in answer
    assert "with all dampers at their bound, lower " in bounds
    assert "% of the variance of the largest drift is " in matters
    assert "beyond the tests: the stroke, " in beside
    assert "times the largest" in beside
    head, *rows = (tmp_path / "f" / "peaks.csv").read_text().splitlines()
    assert head.endswith(",all_at_lower_bound,all_at_upper_bound")
    assert all(float(cell) > 0 for row in rows for cell in row.split(",")[-2:])
    page = (tmp_path / "f" / "report.html").read_text()
    assert "! Answered, but beyond the tests" in page
    assert "✓ Answered" not in page
    said = json.loads((tmp_path / "f" / "response.json").read_text())["verdict"]
    assert "beyond the tests: the stroke" in said[3]
    head, *rows = (tmp_path / "f" / "shares.csv").read_text().splitlines()
    assert head == "quantity,ground,source,share"
    assert not any("record to record" in row for row in rows)
    assert sum(",law and level," in row for row in rows) == 4  # of two quantities and two motions


@pytest.mark.parametrize("use", ["usable with care", "not usable", "usable"])
def test_an_answer_says_what_its_run_may_be_used_for(finished_run, path, quake, tmp_path, use):
    out = tmp_path / "out"
    shutil.copytree(finished_run.out, out)
    judged = {"campaign": use, "sentence": "In 1 of 3 tests the model misses the slip force."}
    mb.open_run(out).rewrite(verdicts=judged)
    done = command(out, path, tmp_path / "r", "--ground", quake, "--scale", "0.4", "--quiet")
    assert done.exit_code == 0, done.output
    page = (tmp_path / "r" / "report.html").read_text()
    said = f"the run of this device is {use}: In 1 of 3 tests the model misses the slip force."
    assert (said in done.output) == (said in page) == (use != "usable")
    head = {"usable with care": "! Answered, with care", "not usable": "✗ The run is not usable"}
    assert head.get(use, "✓ Answered") in page


@pytest.mark.parametrize("name", [b"qu\xffake.txt", b"=1+1.txt", b"a\x1b[31m\x07b.txt", b"@x.txt"])
def test_any_name_of_a_ground_motion_is_written_as_plain_text(finished_run, path, tmp_path, name):
    quake = tmp_path / os.fsdecode(name)
    quake.write_text("DT= .02 SEC\n0.1 -0.2 0.15 0.05 -0.1 0.02")
    done = command(finished_run.out, path, tmp_path / "r", "--ground", quake)
    assert done.exit_code == 0, done.output
    assert "\x1b" not in done.output
    for table in (tmp_path / "r").glob("*.csv"):
        for cell in chain.from_iterable(csv.reader(table.read_text(encoding="utf-8").splitlines())):
            assert cell.isprintable()
            assert not cell.startswith(("=", "@", "+"))
    for text in ("report.html", "response.json", "peaks.tex"):
        assert "\x1b" not in (tmp_path / "r" / text).read_text(encoding="utf-8")


def test_too_many_draws_are_refused_at_once(finished_run, run, path, ground, quake, tmp_path):
    for draws in (10**9, 10**30):
        with pytest.raises(BuildingError, match="draws must be a whole number of at most 100000"):
            run.respond(path, ground, draws=draws)
        done = command(finished_run.out, path, tmp_path / "r", "--ground", quake, "--draws", draws)
        assert done.exit_code == 2
        assert "Traceback" not in done.output
    trace = next(iter(run.tests.values())).trace
    for ask in (lambda n: run.predict(trace, draws=n), lambda n: run.next_test(draws=n)):
        with pytest.raises(mb.MfdError, match="draws must be a whole number of at most 100000"):
            ask(10**9)


def test_a_folder_of_others_is_left_alone(finished_run, path, quake, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("x")
    given = ["respond", str(finished_run.out), "--building", str(path), "--ground", str(quake)]
    for folder, words in (
        (tmp_path / "mine", "is not empty: give another name, or --force"),
        (finished_run.out, "is a run folder"),
    ):
        done = CliRunner().invoke(app, [*given, "-o", str(folder)])
        assert done.exit_code == 2
        assert words in " ".join(done.output.split())


def test_a_first_building_file_is_written_once(tmp_path):
    done = CliRunner().invoke(app, ["init", str(tmp_path), "--building"])
    assert done.exit_code == 0
    assert read_building(tmp_path / "building.toml").freedoms == 3
    assert read_ground(tmp_path / "ground.AT2").peak == pytest.approx(0.35 * GRAVITY)
    again = ["init", str(tmp_path), "--building"]
    assert CliRunner().invoke(app, again).exit_code == 2
    path = tmp_path / "building.toml"
    path.write_text(path.read_text().replace("Three storeys", "Mine"))
    assert CliRunner().invoke(app, [*again, "--force"]).exit_code == 0
    assert "Three storeys" in path.read_text()


@pytest.mark.parametrize("to", ["quofem", "csv", pytest.param("opensees", marks=pytest.mark.slow)])
def test_samples_go_to_other_programs(finished_run, tmp_path, to):
    out = tmp_path / "samples"
    words = ["export", str(finished_run.out), "--to", to, "-o", str(out), "--draws", "12"]
    done = CliRunner().invoke(app, [*words, "--actuation", "1000 psi"])
    assert done.exit_code == 0, done.output
    if to == "quofem":
        column = np.loadtxt(out / "Fc_fwd.txt")
        head, *rows = (out / "dakotaTab.out").read_text().splitlines()
        names = head.split()
        assert names[:2] == ["%eval_id", "interface"]
        at = names.index("Fc_fwd")
        assert np.allclose([float(row.split()[at]) for row in rows], column)
        group = json.loads((out / "randomVariables.json").read_text())["RVdataGroup"]
        assert group == ["{" + ",".join(names[2:]) + "}"]
    elif to == "csv":
        assert (out / "samples.csv").read_text().startswith("sigma0")
    else:
        assert (out / "BoucWen.tcl").read_text().count("uniaxialMaterial BoucWen") == 12
        misfit = json.loads((out / "about.json").read_text())["misfit"]["BoucWen"]
        assert 0 < np.median(misfit) < 0.6


@pytest.mark.slow
def test_the_same_bits_whatever_the_number_of_processes(run, path, ground, monkeypatch):
    monkeypatch.setattr("mfd_bayes.response.analysis.ROWS", 20)
    one = run.respond(path, [ground], draws=20, jobs=1)
    two = run.respond(path, [ground], draws=20, jobs=2)
    assert np.array_equal(one.drift, two.drift)
    assert np.array_equal(one.histories[0], two.histories[0])


@pytest.mark.slow
def test_ctrl_c_leaves_nothing(finished_run, path, quake, tmp_path):
    words = ["respond", str(finished_run.out), "--building", str(path), "--ground", str(quake)]
    words += ["-o", str(tmp_path / "r"), "--draws", "3000", "--jobs", "2"]
    begun = subprocess.Popen(
        [sys.executable, "-m", "mfd_bayes", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=os.environ | {"TMPDIR": str(tmp_path)},
    )
    assert begun.stdout is not None
    while "in the earthquake" not in begun.stdout.readline():
        assert begun.poll() is None
    begun.send_signal(signal.SIGINT)
    said = begun.communicate(timeout=60)[0]
    assert begun.returncode == 130
    assert "interrupted" in said
    assert not (tmp_path / "r").exists()
    assert not [place for place in tmp_path.glob("mfd_bayes-*") if any(place.glob("*.npz"))]


def test_a_draw_that_ran_away_at_a_level_does_not_count_in_a_sweep(run, path, ground):
    one = run.respond(path, ground, draws=12, kind="device", tolerance=0.2)
    away = np.zeros_like(one.unstable)
    away[3] = True
    drift = np.where(away[..., None], 1e5, one.drift)
    levels = np.array([0.8, 1.0]), "ksi"
    sweep = sweep_of(levels, [one, replace(one, drift=drift, unstable=away)], "drift", "mean")
    assert sweep.values["drift"].shape == (2, 11, 1)
    assert sweep.scores[1] == pytest.approx(sweep.scores[0])
    heeded = sweep_of(levels, [one, replace(one, drift=drift)], "drift", "mean")  # the control
    assert heeded.scores[1] > 1e3
    assert sweep.remarks == (
        "the sweep leaves out 1 of 12 draws, which diverged at one of its levels",
    )
    lost = replace(one, unstable=np.ones_like(away))
    sweep = sweep_of(levels, [one, lost], "drift", "mean")
    assert sweep.best == 0.8
    assert np.isinf(sweep.scores[1])
    assert "leaves out 1 of its levels" in sweep.remarks[0]
    with pytest.raises(BuildingError, match="many draws ran away at every level"):
        sweep_of(levels, [lost, lost], "drift", "mean")


def test_histories_beyond_what_was_tested_are_told(run, path, ground, tmp_path):
    history = 'actuation = { file = "valve.csv", column = "pressure_ksi", unit = "ksi" }'
    path.write_text(BUILDING.replace('actuation = "1000 psi"', history))
    told = []
    for most in (1.2, 15.0):
        (tmp_path / "valve.csv").write_text(f"time_s,pressure_ksi\n0,1.0\n1000,{most}\n")
        response = run.respond(path, ground, draws=12, kind="device", tolerance=0.2)
        told.append([r for r in response.remarks if "actuation" in r])
    inside, beyond = told
    assert inside == []
    assert len(beyond) == 1
