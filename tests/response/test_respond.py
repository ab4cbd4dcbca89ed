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

import mfd_bayes as mb
from mfd_bayes.applications.buildings.building import read_building
from mfd_bayes.applications.buildings.dampers import plain_friction
from mfd_bayes.applications.buildings.ground import Ground, read_ground
from mfd_bayes.applications.buildings.response import sweep_of, variance_shares
from mfd_bayes.applications.buildings.time_integration import response_of
from mfd_bayes.applications.properties import design_factors
from mfd_bayes.errors import BuildingError
from mfd_bayes.evaluation.bounds import design_rows
from mfd_bayes.runs.run import rewrite_manifest
from mfd_bayes.units import GRAVITY
from tests.command_line import here, said, write_csv

PLACES = "".join(f'[[damper]]\nstorey = {i}\nactuation = "1000 psi"\n' for i in (1, 2))
STOREY = '[[storey]]\nweight = "20 kip"\nheight = "144 in"\nstiffness = "8 kip/in"\n'
BUILDING = f'{2 * STOREY}{PLACES}[limits]\ndrift = "0.5 %"\n'
HISTORY = 'actuation = { file = "valve.csv", column = "pressure_ksi", unit = "ksi" }'
WHITE = np.convolve(np.random.default_rng(5).standard_normal(100), np.hanning(9), mode="same")
GROUND = Ground("random", 0.02, 200.0 * WHITE / np.abs(WHITE).max())


@pytest.fixture(scope="module")
def run(finished_run):
    return mb.open_run(finished_run.out)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("building") / "building.toml"
    path.write_text(BUILDING)
    return path


@pytest.fixture(scope="module")
def device(run, path):
    """The response of a few draws of the mean device."""
    return mb.respond(run, path, GROUND, draws=12, seed=1, kind="mean")


@pytest.fixture(scope="module")
def response(run, path):
    return mb.respond(run, path, [GROUND, GROUND.scaled(2.0)], draws=40, seed=1)


@pytest.fixture(scope="module")
def quake(tmp_path_factory):
    names = ("time_s", "acceleration_in/s^2")
    path = tmp_path_factory.mktemp("quake") / "quake.csv"
    return write_csv(path, GROUND.time, GROUND.acceleration, names=names)


@pytest.fixture
def respond(finished_run, path, quake, tmp_path):
    """The command for a few rough draws, to the folder "r", with some more words."""

    def run_command(*words, out=finished_run.out):
        if "--ground" not in words:
            words = ("--ground", quake, *words)
        arguments = ["respond", out, "--building", path, "-o", tmp_path / "r", "--draws", "30"]
        return here(*arguments, "--jobs", "1", "--tolerance", "0.2", "--force", *words)

    return run_command


def test_the_call_of_the_contract(run, path, device):
    assert device.drift.shape == device.acceleration.shape == (12, 1, 2)
    assert device.force.shape == device.travel.shape == device.energy.shape == (12, 1, 2)
    assert np.all(device.energy > 0)
    assert device.imbalance.max() < 1e-3
    again = mb.respond(run, path, [GROUND], draws=12, seed=1, kind="mean")
    assert np.array_equal(again.drift, device.drift)
    rows = [row for row in device.rows() if row["quantity"] == "drift"]
    narrow, wide = (rows[0]["bands"][share] for share in ("50", "95"))
    assert wide[0] <= narrow[0] <= rows[0]["median"] <= narrow[1]
    assert rows[0]["bare"] > 0
    (limit,) = device.limits()
    worst = device.drift_ratio[:, 0].max(axis=1)
    passed = int(np.sum(worst > 0.005))
    assert (limit["passed"], limit["draws"]) == (passed, 12)
    assert limit["probability"] == passed / 12
    assert 0 <= limit["interval"][0] <= limit["probability"] <= limit["interval"][1] <= 1


def test_all_dampers_at_a_bound_stand_beside_the_band(run, response):
    lower, upper = (response.references[name] for name in ("lower", "upper"))
    for bound, sign in ((lower, -1.0), (upper, 1.0)):
        assert bound.draws == 1
        assert np.all(sign * (bound.dampers.slip - np.median(response.dampers.slip)) > 0)
        assert not np.allclose(bound.drift, np.median(response.drift, axis=0), rtol=1e-3)
    # as the data sheet has them
    test = next(iter(run.tests.values()))
    parameters, trace = test.posterior.model.parameters, replace(test.trace, actuation=1.0)
    rows = {(row["name"], row["basis"]): row for row in design_rows(run, trace)}
    for name, parameter in (("slip_fwd", "Fc_fwd"), ("slip_bwd", "Fc_bwd")):
        column, design = parameters.index(parameter), rows[name, "new_test"]
        got = [float(bound.dampers.theta[0, 0, column]) for bound in (lower, upper)]
        assert got == pytest.approx([design["lower"], design["upper"]], rel=0.1)  # 4 se of tails
    static, kinetic = (parameters.index(f"F{x}_fwd") for x in "sc")
    ratios = [
        bound.dampers.theta[0, :, static] / bound.dampers.theta[0, :, kinetic]
        for bound in (lower, upper)
    ]
    assert np.allclose(*ratios)
    # all that a new test may differ in is on the same side: weak, or strong
    values = [
        dict(zip(parameters, bound.dampers.theta[0, 0], strict=True)) for bound in (lower, upper)
    ]
    for weak, strong in (values, [{"gap": -v["d2"] - v["d3"]} for v in values]):
        rising = [n for n in weak if n in {"gap", "sigma0", "k2", "k3", "Fc_fwd", "Fc_bwd"}]
        assert all(weak[name] < strong[name] for name in rising)
    weak, strong = (np.abs(bound.dampers.at_rest) for bound in (lower, upper))
    assert np.all(strong < 0.1 * weak)
    for g in (0, 1):
        ends = [bound.drift[0, g].max() for bound in (upper, lower)]
        assert ends[0] < np.median(response.drift[:, g].max(axis=1)) < ends[1]
    force_row = next(row for row in response.rows() if row["quantity"] == "damper force")
    assert force_row["lower"] < force_row["upper"]
    assert np.isnan(force_row["bare"])


def test_all_dampers_at_the_factors_of_a_standard_are_the_mean_property_times_these(run, response):
    parameters, factors = run.predictor.model.parameters, design_factors(run, 1.0)
    weak, strong = (
        dict(zip(parameters, response.references[name].dampers.theta[0, 0], strict=True))
        for name in ("lambda_min", "lambda_max")
    )
    for side in ("fwd", "bwd"):
        low, high = factors[f"slip_{side}"]
        assert low <= 0.85 < 1.2 <= high
        for parameter in (f"Fc_{side}", f"Fs_{side}"):
            assert strong[parameter] / weak[parameter] == pytest.approx(high / low, rel=1e-9)
    low, high = factors["effective_stiffness"]
    assert strong["k3"] / weak["k3"] == pytest.approx(high / low, rel=1e-9)
    assert (weak["d2"], weak["d3"]) == (strong["d2"], strong["d3"])
    plain = replace(run, manifest=run.manifest.changed(standard=None))
    assert design_factors(plain, 1.0) == {}
    assert "lambda_max" not in mb.respond(plain, response.building, GROUND, draws=20).references


def test_a_dampers_force_is_the_peak_that_design_says_of_the_same_motion(run, tmp_path):
    excess = {"rate": 0.15, "rate_variance": 0.01, "scatter": 0.3, "tests": 10.0}
    peaks = dict.fromkeys(("fwd", "bwd"), excess)
    run = replace(run, manifest=run.manifest.changed(peak_excess=peaks))
    building = tmp_path / "still.toml"  # a mass that stays where it is, over ground that moves
    building.write_text(
        '[building]\ndamping = { kind = "none" }\n[[storey]]\nweight = "1e7 kip"\n'
        'stiffness = "1 kip/in"\n[[damper]]\nstorey = 1\nactuation = "1000 psi"\n'
    )
    time, speed = np.arange(301) / 50, np.pi
    ground = Ground("sine", 0.02, speed**2 * np.cos(speed * time))
    response = mb.respond(run, building, ground, draws=400, seed=1)
    travel = response.travels[0][0, :, 0].astype(float)
    trace = mb.Trace.from_arrays(time, travel, actuation=1.0)
    rows = {(row["name"], row["basis"]): row for row in design_rows(run, trace)}
    for side in ("fwd", "bwd"):
        design, bounds = rows[f"peak_{side}", "new_test"], response.references
        got = [float(getattr(bounds[name], f"peak_{side}")[0, 0, 0]) for name in ("lower", "upper")]
        # a bound has slip forces and stiffness at theirs together: up to 10.5 % beyond
        assert got == pytest.approx([design["lower"], design["upper"]], rel=0.12)
        peaks_of_draws = getattr(response, f"peak_{side}")
        error = 1.25 * peaks_of_draws.std() / np.sqrt(peaks_of_draws.size)  # of a median, 2 to 3 %
        nominal = rows[f"peak_{side}", "mean"]["nominal"]
        assert abs(np.median(peaks_of_draws) - nominal) < 4.0 * error


@pytest.mark.parametrize("count", [2, 3])
def test_dampers_side_by_side_are_one_of_their_force(run, device, tmp_path, count):
    """A building of `count` times the mass and stiffness drifts as much with as many dampers."""
    path = tmp_path / "b.toml"
    storey = STOREY.replace("20 kip", f"{20 * count} kip").replace("8 kip", f"{8 * count} kip")
    places = PLACES.replace("storey =", f"count = {count}\nstorey =")
    path.write_text(f"{2 * storey}{places}")
    several = mb.respond(run, path, GROUND, draws=12, seed=1, kind="mean")
    assert not np.any(several.unstable | several.unsettled)
    assert several.imbalance.max() < 1e-3
    for name, reference in device.references.items():
        assert np.allclose(several.references[name].drift, reference.drift, rtol=1e-6), name
    # each begins at its own place in its gap
    assert np.allclose(np.median(several.drift, axis=0), np.median(device.drift, axis=0), rtol=0.2)


def test_bounds_that_do_not_bound_the_median_are_named(respond, tmp_path, small_pictures):
    time = 0.02 * np.arange(100)
    path, quake = tmp_path / "b.toml", tmp_path / "sine.csv"
    path.write_text(f'{2 * STOREY}[[damper]]\nstorey = 1\ncount = 3\nactuation = "1000 psi"\n')
    for period, peak, expected in ((0.6, 40.0, True), (1.1, 120.0, False)):
        sine = peak * np.sin(2.0 * np.pi * time / period)
        write_csv(quake, time, sine, names=("time_s", "acceleration_in/s^2"))
        words = ("--building", path, "--ground", quake, "--kind", "mean")
        printed = " ".join(respond(*words).output.split())
        assert ("the median of the draws and do not bound it" in printed) == expected, printed
        assert ("†</td>" in (tmp_path / "r" / "report.html").read_text()) >= expected


@pytest.mark.parametrize("limit", ["0.001 %", "30 %"])
def test_a_probability_of_a_limit_stays_within_0_and_100_percent(
    respond, path, tmp_path, small_pictures, limit
):
    always = limit == "0.001 %"
    building = tmp_path / "b.toml"
    building.write_text(BUILDING.replace("0.5 %", limit))
    printed = " ".join(respond("--building", building).output.split())
    lower, upper = (92, 100) if always else (0, 7.97)  # Jeffreys, of 30
    assert f"is exceeded in {30 * always} of 30 draws: a probability of {100 * always} %" in printed
    assert f"(95 % interval {lower} to {upper} %)" in printed
    with (tmp_path / "r" / "limits.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert [float(row[f"{end}_95"]) for end in ("lower", "upper")] == pytest.approx(
        [lower / 100, upper / 100], abs=1e-3
    )


def test_the_force_at_rest_is_said_where_the_drift_is(respond, tmp_path, small_pictures):
    printed = " ".join(respond().output.split())
    assert "the force that a damper holds there, in 95 % of the draws up to " in printed
    page = (tmp_path / "r" / "report.html").read_text()
    assert page.count("Drift is counted from the building at rest") == 2


def test_shares_add_up_and_find_what_matters(response):
    for ground_motion in (0, 1):
        shares = variance_shares(response, ground=ground_motion)
        assert sum(shares.values()) == pytest.approx(1.0)
        assert not any("record" in source for source in shares)
    gap = response.dampers.about["gap"][:, 0]
    planted = replace(response, drift=np.broadcast_to(gap[:, None, None], response.drift.shape))
    assert variance_shares(planted)["gap"] > 0.7
    unstable = np.ones_like(response.unstable)
    assert variance_shares(replace(response, unstable=unstable)) == {}


def test_a_history_that_ends_early_or_leaves_the_tests_is_told(run, tmp_path):
    path = tmp_path / "b.toml"
    path.write_text(BUILDING.replace('actuation = "1000 psi"', HISTORY))
    for final, words in (
        ("0.5,1.0", "is known from 0 s to 0.5 s, and the ground motion"),
        ("1000,15.0", "beyond the tests: the actuation"),
        ("1000,1.2", None),
    ):
        (tmp_path / "valve.csv").write_text(f"time_s,pressure_ksi\n0,1.0\n{final}\n")
        response = mb.respond(run, path, GROUND, draws=12, kind="mean", tolerance=0.2)
        remarks = [remark for remark in response.remarks if "actuation" in remark]
        assert bool(remarks) == (words is not None)
        assert all(words in remark for remark in remarks)


@pytest.mark.slow
def test_the_command_writes_a_page_and_tables(respond, tmp_path):
    root = tmp_path / "r"
    outcome = respond("--draws", 10, "--sweep", 'actuation="800 psi to 1200 psi in 2 steps"')
    assert outcome.exit_code == 0, outcome.output
    assert "the largest storey drift is" in outcome.output
    assert "is smallest at" in outcome.output
    page = (root / "report.html").read_text()
    assert "Which actuation is best?" in page
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert json.loads((root / "response.json").read_text())["peaks"][0]["quantity"] == "drift ratio"
    head, *levels = (root / "sweep.csv").read_text().splitlines()
    assert head.startswith("actuation_ksi,drift_mean_in,drift_median_in,drift_lower_95_in,")
    assert len(levels) == 3
    assert r"\toprule" in (root / "peaks.tex").read_text()
    assert respond("--draws", 10).exit_code == 0
    assert not (root / "sweep.csv").exists()


def test_a_mistake_is_one_sentence(run, respond, path, tmp_path):
    options = ["--statistic", "passing", "--minimise", "acceleration"]
    for words, named in (
        (["--sweep", "actuation=800 psi"], "expected actuation"),
        (["--sweep", "actuation=500 N to 1500 N"], "--sweep: the actuation"),
        (["--sweep", "actuation=1 psi to 2 psi in 300 steps"], "got 300"),
        (["--peak", "3 in"], "--peak: "),
        (["--ground", "nothing.AT2"], "nothing.AT2"),
        (["--building", "nothing.toml"], "nothing.toml"),
        (["--statistic", "q90"], "--sweep"),
        (["--sweep", "actuation=800 psi to 900 psi", *options], "limits.acceleration"),
        (["--draws", 10**30], "'--draws'"),
        (["--peak", "5e8 g", "--quiet"], "every draw diverged under quake.csv"),
    ):
        outcome = respond(*words)
        assert outcome.exit_code == 2
        assert named in outcome.output
        assert not (tmp_path / "r").exists()
    trace = next(iter(run.tests.values())).trace
    for ask in (
        lambda: mb.respond(run, path, GROUND, draws=10**9),
        lambda: run.predict(trace, draws=10**9),
        lambda: mb.next_test(run, draws=10**9),
    ):
        with pytest.raises(mb.MfdError, match="draws must be a whole number of at most 100000"):
            ask()
    (tmp_path / "b.toml").write_text(BUILDING.replace("1000 psi", "40 lbf"))
    with pytest.raises(BuildingError, match="must be a pressure, as in the campaign"):
        mb.respond(run, tmp_path / "b.toml", GROUND)


def test_peaks_are_printed_and_must_be_possible_or_meant(respond, quake, tmp_path, small_pictures):
    small, large = tmp_path / "small.txt", tmp_path / "large.txt"
    small.write_text("0.01 -0.1 0.02 0.05")
    line_a, line_b, *_ = respond(
        "--ground", quake, "--ground", f"{small}:0.01s"
    ).output.splitlines()
    assert line_a == "quake.csv: peak 0.518 g, 1.98 s in steps of 0.02 s"
    assert line_b == "small.txt: peak 0.1 g, 0.03 s in steps of 0.01 s"
    large.write_text("100 -281 30 12")
    outcome = respond("--ground", f"{large}:0.01s")
    assert outcome.exit_code == 2
    assert "large.txt: its peak would be 281 g" in " ".join(outcome.output.split())
    for words in (["--scale", "0.001"], ["--peak", "0.3 g"], ["--unit", "gal"]):
        assert respond("--ground", f"{large}:0.01s", *words).exit_code == 0
    outcome = respond("--ground", f"{large}:0.01s:cm/s^2")
    assert "large.txt: peak 0.287 g" in outcome.output


def test_an_answer_beyond_the_tests_says_so_beside_it(respond, quake, tmp_path, small_pictures):
    folder = tmp_path / "r"
    near_tests = respond("--scale", "0.4")
    assert near_tests.exit_code == 0, near_tests.output
    assert "beyond the tests" not in near_tests.output
    assert "✓ Answered" in (folder / "report.html").read_text()
    far = respond("--ground", quake, "--ground", quake, "--scale", "6", "--quiet")
    assert far.exit_code == 0, far.output
    answer, bounds, standard, matters, caveat, *_ = far.output.splitlines()
    assert "the largest storey drift is" in answer
    assert "with all dampers at their bound, lower " in bounds
    assert "with all dampers at the standard's λ_min " in standard
    assert "% of the variance of the largest drift is " in matters
    assert "beyond the tests: the stroke, " in caveat
    assert "times the largest" in caveat
    with (folder / "peaks.csv").open() as file:
        for row in csv.DictReader(file):
            assert min(float(row[f"all_at_{end}_bound"]) for end in ("lower", "upper")) > 0
    page = (folder / "report.html").read_text()
    assert "! Answered, but beyond the tests" in page
    assert "✓ Answered" not in page
    verdict = json.loads((folder / "response.json").read_text())["verdict"]
    assert "beyond the tests: the stroke" in verdict[4]
    with (folder / "shares.csv").open() as file:
        sources = [row["source"] for row in csv.DictReader(file)]
    assert not any("record to record" in source for source in sources)
    assert sources.count("law and level") == 4  # of two quantities and two motions


def test_an_answer_says_what_its_run_may_be_used_for(
    finished_run, respond, tmp_path, small_pictures
):
    folder, sentence = tmp_path / "out", "In 1 of 3 tests the model misses the slip force."
    shutil.copytree(finished_run.out, folder)
    for use, head in (
        ("usable with care", "! Answered, with care"),
        ("not usable", "✗ The run is not usable"),
    ):
        rewrite_manifest(mb.open_run(folder), verdicts={"campaign": use, "sentence": sentence})
        printed = respond("--scale", "0.4", "--quiet", out=folder).output
        page = (tmp_path / "r" / "report.html").read_text()
        assert f"the run of this device is {use}: {sentence}" in printed
        assert f"the run of this device is {use}: {sentence}" in page
        assert head in page


def test_any_name_of_a_ground_motion_is_written_as_plain_text(respond, tmp_path, small_pictures):
    quake = tmp_path / os.fsdecode(b"=1+1\x1b[31m\x07\xff.txt")
    quake.write_text("DT= .02 SEC\n0.1 -0.2 0.15 0.05 -0.1 0.02")
    outcome = respond("--ground", quake)
    assert outcome.exit_code == 0, outcome.output
    assert "\x1b" not in outcome.output
    for table in (tmp_path / "r").glob("*.csv"):
        for cell in chain.from_iterable(csv.reader(table.read_text(encoding="utf-8").splitlines())):
            assert cell.isprintable()
            assert not cell.startswith(("=", "@", "+"))
    for text in ("report.html", "response.json", "peaks.tex"):
        assert "\x1b" not in (tmp_path / "r" / text).read_text(encoding="utf-8")


def test_a_folder_of_others_is_left_alone(finished_run, path, quake, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("x")
    for folder, words in (
        (tmp_path / "mine", "is not empty: give another name, or --force"),
        (finished_run.out, "is a run folder"),
    ):
        command = ["respond", finished_run.out, "--building", path, "--ground", quake, "-o", folder]
        assert words in said(*command, code=2)


def test_the_first_building_and_its_ground_motion_are_read(tmp_path):
    said("init", tmp_path, "--building")
    assert read_building(tmp_path / "building.toml").freedoms == 3
    assert read_ground(tmp_path / "ground.AT2").peak == pytest.approx(0.35 * GRAVITY)


@pytest.mark.parametrize("to", ["quofem", "csv", pytest.param("opensees", marks=pytest.mark.slow)])
def test_samples_go_to_other_programs(finished_run, tmp_path, to):
    folder = tmp_path / "samples"
    words = ["export", finished_run.out, "--to", to, "-o", folder, "--draws", "12"]
    said(*words, "--actuation", "1000 psi")
    if to == "quofem":
        column = np.loadtxt(folder / "Fc_fwd.txt")
        head, *rows = (folder / "dakotaTab.out").read_text().splitlines()
        names = head.split()
        assert names[:2] == ["%eval_id", "interface"]
        index = names.index("Fc_fwd")
        assert np.allclose([float(row.split()[index]) for row in rows], column)
        group = json.loads((folder / "randomVariables.json").read_text())["RVdataGroup"]
        assert group == ["{" + ",".join(names[2:]) + "}"]
    elif to == "csv":
        assert (folder / "samples.csv").read_text().startswith("sigma0")
    else:
        assert (folder / "BoucWen.tcl").read_text().count("uniaxialMaterial BoucWen") == 12
        misfit = json.loads((folder / "about.json").read_text())["misfit"]["BoucWen"]
        assert 0 < np.median(misfit) < 0.6


@pytest.mark.slow
def test_ctrl_c_leaves_nothing(finished_run, path, quake, tmp_path):
    words = ["respond", str(finished_run.out), "--building", str(path), "--ground", str(quake)]
    words += ["-o", str(tmp_path / "r"), "--draws", "3000", "--jobs", "2"]
    process = subprocess.Popen(
        [sys.executable, "-m", "mfd_bayes", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=os.environ | {"TMPDIR": str(tmp_path)},
    )
    assert process.stdout is not None
    while "in the earthquake" not in process.stdout.readline():
        assert process.poll() is None
    process.send_signal(signal.SIGINT)
    output = process.communicate(timeout=60)[0]
    assert process.returncode == 130
    assert "interrupted" in output
    assert not (tmp_path / "r").exists()
    assert not [folder for folder in tmp_path.glob("mfd_bayes-*") if any(folder.glob("*.npz"))]


def test_a_draw_that_ran_away_at_a_level_does_not_count_in_a_sweep(device):
    failed = np.zeros_like(device.unstable)
    failed[3] = True
    drift = np.where(failed[..., None], 1e5, device.drift)
    levels = np.array([0.8, 1.0]), "ksi"
    sweep = sweep_of(
        levels, [device, replace(device, drift=drift, unstable=failed)], "drift", "mean"
    )
    assert sweep.values["drift"].shape == (2, 11, 1)
    assert sweep.scores[1] == pytest.approx(sweep.scores[0])
    heeded = sweep_of(levels, [device, replace(device, drift=drift)], "drift", "mean")
    assert heeded.scores[1] > 1e3  # the control
    assert "leaves out 1 of 12 draws" in sweep.remarks[0]
    lost = replace(device, unstable=np.ones_like(failed))
    sweep = sweep_of(levels, [device, lost], "drift", "mean")
    assert sweep.best == 0.8
    assert np.isinf(sweep.scores[1])
    assert "leaves out 1 of its levels" in sweep.remarks[0]
    with pytest.raises(BuildingError, match="many draws ran away at every level"):
        sweep_of(levels, [lost, lost], "drift", "mean")


def test_levels_that_are_best_alike_are_an_interval_and_one_is_placed_by_its_neighbours(response):
    levels, rng = np.array([3.0, 4.0, 5.0, 6.0]), np.random.default_rng(1)

    def swept(goal, *ratios):
        """The sweep of responses whose draws have these largest drifts, as shares of the height."""
        drifts = [144.0 * np.tile(ratio[:, None, None], (1, 2, 2)) for ratio in ratios]
        responses = [replace(response, drift=drift) for drift in drifts]
        return sweep_of((levels, "ksi"), responses, "drift", goal)

    exceeding, passing = np.where(np.arange(40) < 16, 0.02, 0.001), np.full(40, 0.001)
    for ratios, best in (
        ([rng.permutation(exceeding) for _ in levels], (3.0, 6.0)),
        ([passing] * 4, (3.0, 6.0)),
        ([exceeding, passing, passing, exceeding], (4.0, 5.0)),
    ):
        sweep = swept("passing", *ratios)
        assert np.isnan(sweep.best)
        assert sweep.interval == best
        assert (sweep.lowest[0], sweep.lowest[-1]) == best
    shape = rng.normal(1.0, 0.01, 40)
    sweep = swept("mean", *(shape * (0.01 + 0.001 * (level - 4.3) ** 2) for level in levels))
    assert sweep.best == pytest.approx(4.3, abs=1e-6)
    assert sweep.interval == pytest.approx((4.3, 4.3), abs=1e-6)
    assert sweep.lowest.tolist() == [4.0]


def test_the_name_of_a_ground_motion_may_be_long_and_hold_anything(path):
    building, shaken = read_building(path), 100.0 * np.sin(np.arange(50) / 5.0)
    grounds = [Ground(name, 0.02, shaken) for name in ("g" * 250, "a/b", "a b", "a_b")]
    short, long = (
        response_of(building, grounds, plain_friction(np.ones(2)), 0.05, jobs=jobs)
        for jobs in (1, 2)
    )
    np.testing.assert_array_equal(long.drift, short.drift)
