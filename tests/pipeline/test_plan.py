"""What is said before anything is sampled, by inspect, prior-check and the dry run; any numbers."""

import json
import re
import shutil

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mfd_bayes as mb
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.campaign import synthetic
from mfd_bayes.errors import MfdError
from mfd_bayes.pipeline.init import prior_check
from mfd_bayes.pipeline.options import RunOptions
from mfd_bayes.pipeline.plan import plan_campaign
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.folder import hash_stored
from mfd_bayes.runs.manifest import read_begun
from mfd_bayes.runs.run import open_run
from mfd_bayes.store.files import json_text
from mfd_bayes.store.netcdf import save_trace
from tests.command_line import NAMES, here, refusal, write_csv

HEAD = '[campaign]\nmodel = "lugre"\nnoise = "iid"\nrate = "32 Hz"\n'
TIME = np.arange(640) / 64
SWAPPED = "t1: the force does negative work"


def write_campaign(folder, *test_keys, signs=(1, 1, 1, 1), extra=""):
    """Tests t0, t1, … with more keys each, of five cycles of Coulomb friction with some noise."""
    rng, text = np.random.default_rng(0), HEAD + extra
    for k, keys in enumerate(test_keys):
        motion = (1 + 0.02 * k) * np.sin(np.pi * TIME)
        smooth = (1 + 0.5 * k) * np.tanh(20 * np.gradient(motion, TIME))
        force = signs[k] * smooth + 0.02 * rng.normal(size=TIME.size)
        write_csv(folder / f"t{k}.csv", TIME, motion, force)
        text += f'[[test]]\nid = "t{k}"\nfile = "t{k}.csv"\n'
        text += f'actuation = "{500 * (k + 1)} psi"\n{keys}\n'
    path = folder / "campaign.toml"
    path.write_text(text)
    return path


def replace_in(path, *pairs):
    text = path.read_text()
    for target, replacement in pairs:
        assert target in text
        text = text.replace(target, replacement, 1)
    path.write_text(text)


def manifest_of(path):
    return plan_campaign(path, RunOptions(effort="quick")).manifest


def warnings_of(path):
    return {warning.name: warning for warning in manifest_of(path).warnings}


# --- warnings


def test_what_the_dry_run_says_is_what_the_plan_of_a_calibration_holds(tmp_path):
    path = write_campaign(tmp_path, *[""] * 4, signs=(1, -1, 1, 1))
    printed = here("calibrate", path, "-o", tmp_path / "out", "--dry-run").stdout
    assert f"warning: {SWAPPED}" in printed
    assert "warning: t1: the swapped sign is probably that of the force" in printed
    warnings = manifest_of(path).warnings
    for warning in warnings:
        assert f"warning: {warning.subject}: {warning.message!s}" in printed
    assert {warning.name for warning in warnings if warning.subject == "t1"} == {"force sign"}


def test_a_force_that_no_device_of_the_priors_has_is_named(tmp_path):
    time, displacement, force = (f'{{ name = "{name}" }}' for name in NAMES)
    columns = f"[columns]\ntime = {time}\ndisplacement = {displacement}\nforce = {force}\n"
    path = write_campaign(tmp_path, "", "", extra=columns)
    replace_in(path, ('"force_kip"', '"force_kip", unit = "MN"'))
    assert "probably in another unit" in str(warnings_of(path)["beyond the priors"].message)


def test_a_gap_is_beyond_the_priors_only_in_another_unit(tmp_path):
    matrix = synthetic.Matrix((500.0, 1000.0), (0.5,), (5,), (800.0, 0.5))
    synthetic.write_campaign(tmp_path, 1, matrix)
    path = tmp_path / "campaign.toml"
    assert "beyond the priors" not in warnings_of(path)
    replace_in(path, ('unit = "in"', 'unit = "ft"'))
    assert "the loop's gap of" in str(warnings_of(path)["beyond the priors"].message)


def test_what_the_calibration_does_not_do_is_told(tmp_path):
    extra = '[laws]\nFc_fwd = "affine"\n[dependence]\ngap = ["velocity"]\n'
    path = write_campaign(tmp_path, "", "", extra=extra)
    columns = np.loadtxt(tmp_path / "t1.csv", delimiter=",", skiprows=1).T
    pressure = np.linspace(0.9, 1.1, TIME.size)
    write_csv(tmp_path / "t1.csv", *columns, pressure, names=(*NAMES, "pressure_ksi"))
    replace_in(path, ('"1000 psi"', '{ name = "pressure_ksi", unit = "ksi" }'))
    warnings = warnings_of(path)
    assert warnings["actuation history"].subject == "t1"
    assert "whatever the law of Fc_fwd" in str(warnings["actuation history"].message)
    words = "names gap, which the tests of the model lugre do not share"
    assert words in str(warnings["dependence"].message)
    assert "laws" not in warnings
    replace_in(path, ("lugre", "bouc_wen"), ('Fc_fwd = "affine"', 'sigma0 = "power"'))
    words = "names sigma0, which the model bouc_wen does not"
    assert words in str(warnings_of(path)["laws"].message)


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_a_run_with_a_swapped_sign_says_so_everywhere_and_is_not_usable(tmp_path):
    path, folder = write_campaign(tmp_path, *[""] * 3, signs=(1, -1, 1)), tmp_path / "out"
    replace_in(path, ('"500 psi"', '"0 psi"'))
    outcome = here("calibrate", path, "-o", folder, "--effort", "quick", "--jobs", "1", "--strict")
    assert outcome.exit_code == 1, outcome.output
    assert outcome.stdout.index(f"warning: {SWAPPED}") < outcome.stdout.index("finding modes")
    assert "NOT USABLE: Something is wrong with 1 of 3 tests. t1: " in outcome.stdout
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["warnings"][0]["subject"] == "t1"
    assert manifest["verdicts"]["t1"] == manifest["verdicts"]["campaign"] == "not usable"
    page = (folder / "report.html").read_text()
    assert SWAPPED in page[: page.index('<nav aria-label="Contents">')]
    checked = here("check", folder)
    assert checked.exit_code == 1
    assert f"warning: {SWAPPED}" in checked.stdout
    assert "The test to believe least is t1" in checked.stdout
    run = mb.open_run(folder)  # of a test at zero too
    assert run.population.design.laws["Fc_fwd"] == "proportional"
    assert np.all(np.isfinite(run.predict(run.tests["t2"].trace).median))


@pytest.mark.parametrize(
    ("levels", "unloaded", "mismatched"),
    [
        ({"a": (1.0, 500), "b": (0.05, 500), "z": (0.05, 0)}, ("z",), ("b",)),
        ({"z": (0.05, 0)}, (), ("z",)),  # no other test says what the priors are of
    ],
)
@pytest.mark.usefixtures("small_pictures")
def test_priors_are_not_wrong_for_a_test_without_actuation_where_others_have_one(
    tmp_path, levels, unloaded, mismatched
):
    text, time = '[campaign]\npriors = "mfd"\n', np.linspace(0.0, 6.0, 301)
    for name, (force, level) in levels.items():
        motion, signs = np.sin(np.pi * time), np.sign(np.cos(np.pi * time))
        write_csv(tmp_path / f"{name}.csv", time, motion, force * signs)
        text += f'[[test]]\nid = "{name}"\nfile = "{name}.csv"\nactuation = "{level} psi"\n'
    (tmp_path / "campaign.toml").write_text(text)
    check = prior_check(tmp_path / "campaign.toml", tmp_path)
    assert (check.unloaded, check.outlying) == (unloaded, mismatched)
    assert bool(check.wrong) == bool(mismatched)


# --- tests that follow each other


def test_the_order_is_in_the_plan_with_the_turns_outside_the_windows(tmp_path):
    follows = 'after = "t0"\nwindow = "0 s to 8.2 s"\nrole = "validate"'
    path = write_campaign(tmp_path, 'window = "1.1 s to 6.2 s"', follows, "")
    replace_in(path, ("lugre", "three_stage"))
    manifest = manifest_of(path)
    assert manifest.settings.order == {"t1": "t0"}
    head, tail = manifest.tests["t0"].before, manifest.tests["t0"].after
    assert head == pytest.approx((0.0, 1.0, np.sin(1.1 * np.pi)), abs=0.06)
    assert tail == pytest.approx((np.sin(6.2 * np.pi), 1.0, -1.0, 1.0, -1.0, 0.0), abs=0.06)
    assert manifest.tests["t1"].before == ()
    assert (manifest.tests["t2"].before, manifest.tests["t2"].after) == ((), ())
    replace_in(path, ("t1.csv", "t0.csv"), ("0 s to 8.2 s", "6.7 s to 9.9 s"))  # of one file
    middle = np.sin(np.pi * np.array([6.2, 6.5, 6.7]))
    assert manifest_of(path).tests["t1"].before == pytest.approx(middle, abs=0.06)


def test_inspect_and_the_dry_run_say_which_test_follows_which(tmp_path):
    path = write_campaign(tmp_path, "", 'after = "t0"')
    outcome = here("inspect", path, "-o", tmp_path)
    assert re.findall(r"follows +(.*)", outcome.stdout) == ["test t0, without a reset"]
    assert "without a reset: t1 after t0" in here("calibrate", path, "--dry-run").stdout
    replace_in(path, ('500 psi"', '500 psi"\nafter = "t1"'))
    assert "got a circle: t0 after t1 after t0" in refusal("calibrate", path, "--dry-run")


# --- numbers of any size

NUMBERS = st.floats(allow_nan=False, allow_infinity=False) | st.sampled_from(
    [1e300, 1e-300, 1e10, 1e-10, 1.5, 5e-324, 1e100]
)
TEXTS = st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"]), max_size=20)


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    folder = tmp_path_factory.mktemp("numbers")
    write_csv(folder / "a.csv", TIME, np.sin(np.pi * TIME), np.tanh(4 * np.cos(np.pi * TIME)))
    return folder


@settings(max_examples=25, deadline=None)
@given(
    area=st.sampled_from([1e10, 1e-10, 1.5]) | NUMBERS | st.none(),
    rate=NUMBERS | st.none(),
    title=TEXTS,
    session=TEXTS,
    level=NUMBERS,
    unit=st.sampled_from(["psi", "Pa", "ksi", "lbf", "GPa"]),
)
def test_what_a_dry_run_accepts_the_manifest_gives_back(
    home, area, rate, title, session, level, unit
):
    text = f"[campaign]\ntitle = {json.dumps(title, ensure_ascii=False)}\n"
    text += "" if area is None else f"area = {area!r}\n"
    text += "" if rate is None else f"rate = {rate!r}\n"
    text += f'[[test]]\nid = "a"\nfile = "a.csv"\nactuation = "{level!r} {unit}"\n'
    text += f"session = {json.dumps(session, ensure_ascii=False)}\n"
    (home / "campaign.toml").write_text(text, encoding="utf-8")
    try:
        manifest = manifest_of(home / "campaign.toml")
    except MfdError:
        return
    manifest.write(home)
    again = read_begun(home)
    assert json_text(again.content) == json_text(manifest.content)
    assert again.settings.area == manifest.settings.area
    assert again.settings.sessions == manifest.settings.sessions


@pytest.mark.parametrize("model", ["three_stage", "backlash"])
def test_a_force_of_any_size_that_is_taken_has_a_likelihood(tmp_path, model):
    for scale in (1e-12, 1e9):
        path = write_campaign(tmp_path, "")
        replace_in(path, ("lugre", model))
        motion, force = np.sin(np.pi * TIME), np.tanh(5 * np.cos(np.pi * TIME))
        write_csv(tmp_path / "t0.csv", TIME, motion, scale * force)
        (task,) = plan_campaign(path, RunOptions(effort="quick")).tasks
        posterior = Posterior(task.trace, task.priors, "iid", model)
        draws = posterior.sample_prior(50, 1)
        values = posterior.log_prob(posterior.coordinates(draws))
        assert not np.any(np.isnan(values))
        assert np.any(np.isfinite(values))


@pytest.mark.usefixtures("no_figures_of_tests")
def test_an_odd_test_is_named_and_left_out_of_the_report_which_is_finished(small_run, tmp_path):
    folder = shutil.copytree(small_run, tmp_path / "out")
    trace = open_run(folder).held_out["c"]
    moved = Trace.from_arrays(trace.time, trace.displacement, 1e-9, trace.force)  # 1 µpsi
    save_trace(folder / "tests/c/record.nc", moved, {})
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["files"] |= hash_stored(folder, ["tests/c/record.nc"])
    (folder / "manifest.json").write_text(json.dumps(manifest))
    outcome = here("report", folder)
    assert (outcome.exit_code, outcome.stderr) == (1, ""), outcome.output
    words = "Test c is left out of the report: a predicted parameter holds numbers"
    assert words in " ".join(outcome.stdout.split())
    assert "left out of the report" in (folder / "report.html").read_text()
    scores = (folder / "scores.csv").read_text().splitlines()[1:]
    assert [line.split(",")[0] for line in scores] == ["a"]
