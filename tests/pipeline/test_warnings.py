"""Every warning about a record is heard: by inspect, the dry run, the run, its report and check."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import mfd_bayes as mb
from mfd_bayes.cli.commands import app
from mfd_bayes.pipeline.plan import Options, plan_campaign

HEAD = '[campaign]\nmodel = "lugre"\nnoise = "iid"\nrate = "32 Hz"\n'


def here(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def write_campaign(folder, signs, extra=""):
    """Tests of five cycles of Coulomb friction with some noise; the signs of their forces."""
    rng = np.random.default_rng(0)
    time = np.arange(640) / 64
    text = HEAD + extra
    for k, sign in enumerate(signs):
        motion = (1 + 0.02 * k) * np.sin(np.pi * time)
        smooth = (1 + 0.5 * k) * np.tanh(20 * np.gradient(motion, time))
        table = np.column_stack([time, motion, sign * smooth + 0.02 * rng.normal(size=time.size)])
        head = "time_s,displacement_in,force_kip"
        np.savetxt(folder / f"t{k}.csv", table, delimiter=",", header=head, comments="")
        text += f'[[test]]\nid = "t{k}"\nfile = "t{k}.csv"\nactuation = "{500 * (k + 1)} psi"\n'
    path = folder / "campaign.toml"
    path.write_text(text)
    return path


WORDS = "t1: the force does negative work"


def test_what_the_dry_run_says_is_what_the_plan_of_a_calibration_holds(tmp_path):
    path = write_campaign(tmp_path, (1, -1, 1, 1))
    outcome = here("calibrate", path, "-o", tmp_path / "out", "--dry-run")
    assert f"warning: {WORDS}" in outcome.stdout
    assert "warning: t1: the swapped sign is probably that of the force" in outcome.stdout
    warnings = plan_campaign(path, Options(effort="quick")).manifest.warnings
    for found in warnings:
        assert f"warning: {found.subject}: {found.message!s}" in outcome.stdout
    assert {found.name for found in warnings if found.subject == "t1"} == {"force sign"}


def test_a_gap_or_force_that_no_device_of_the_priors_has_is_named(tmp_path):
    path = write_campaign(tmp_path, (1, 1))
    text = path.read_text()
    path.write_text(
        text.replace(
            "[[test]]",
            '[columns]\nforce = { name = "force_kip", unit = "MN" }\n'
            'time = { name = "time_s" }\ndisplacement = { name = "displacement_in" }\n[[test]]',
            1,
        )
    )
    warnings = plan_campaign(path, Options(effort="quick")).manifest.warnings
    assert {found.name for found in warnings} >= {"beyond the priors"}
    assert "probably in another unit" in " ".join(str(found.message) for found in warnings)


def test_tolerances_of_a_campaign_are_kept_and_checked(tmp_path):
    extra = '[tolerances]\nenergy = 0.02\npeak = "20 %"\n'
    path = write_campaign(tmp_path, (1, 1), extra)
    plan = plan_campaign(path, Options(effort="quick"))
    assert plan.manifest.settings.tolerances == {"energy": 0.02, "peak": 0.2}
    path.write_text(path.read_text().replace("energy", "enrgy"))
    outcome = here("calibrate", path, "-o", tmp_path / "out", "--dry-run")
    assert outcome.exit_code == 2
    assert "did you mean 'energy'?" in outcome.stderr
    path.write_text(path.read_text().replace("enrgy = 0.02", "energy = 0"))
    assert here("calibrate", path, "-o", tmp_path / "out", "--dry-run").exit_code == 2


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_a_run_with_a_swapped_sign_says_so_everywhere_and_is_not_usable(tmp_path):
    path, out = write_campaign(tmp_path, (1, -1, 1)), tmp_path / "out"
    path.write_text(path.read_text().replace('"500 psi"', '"0 psi"'))
    outcome = here("calibrate", path, "-o", out, "--effort", "quick", "--jobs", "1", "--strict")
    assert outcome.exit_code == 1, outcome.output
    assert outcome.stdout.index(f"warning: {WORDS}") < outcome.stdout.index("finding modes")
    assert "NOT USABLE: Something is wrong with 1 of 3 tests. t1: " in outcome.stdout
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["warnings"][0]["subject"] == "t1"
    assert manifest["verdicts"]["t1"] == manifest["verdicts"]["campaign"] == "not usable"
    page = (out / "report.html").read_text()
    assert WORDS in page[: page.index('<nav aria-label="Contents">')]
    checked = here("check", out)
    assert checked.exit_code == 1
    assert f"warning: {WORDS}" in checked.stdout
    assert "The test to believe least is t1" in checked.stdout
    run = mb.open_run(out)  # of a test at zero too
    assert run.population.design.laws["Fc_fwd"] == "proportional"
    assert np.all(np.isfinite(run.predict(run.tests["t2"].trace).median))


def test_what_the_calibration_does_not_do_is_told(tmp_path):
    extra = '[laws]\nFc_fwd = "affine"\n[dependence]\ngap = ["velocity"]\n'
    path = write_campaign(tmp_path, (1, 1), extra)
    table = np.genfromtxt(tmp_path / "t1.csv", delimiter=",", names=True)
    columns = [*(table[name] for name in table.dtype.names), np.linspace(0.9, 1.1, table.size)]
    head = "time_s,displacement_in,force_kip,pressure_ksi"
    np.savetxt(tmp_path / "t1.csv", np.transpose(columns), delimiter=",", header=head, comments="")
    text = path.read_text().replace(
        'actuation = "1000 psi"', 'actuation = { name = "pressure_ksi", unit = "ksi" }'
    )
    path.write_text(text)
    told = {f.name: f for f in plan_campaign(path, Options(effort="quick")).manifest.warnings}
    assert told["actuation history"].subject == "t1"
    assert "whatever the law of Fc_fwd" in str(told["actuation history"].message)
    assert "names gap, which the tests of the model lugre do not share" in str(
        told["dependence"].message
    )
    assert "laws" not in told


def test_a_law_that_the_model_lacks_is_told(tmp_path):
    for laws, lacking in [
        ('sigma0 = "power"', "names sigma0, which the model bouc_wen does not"),
        ('Fy_fwd = "affine"', ""),
    ]:
        path = write_campaign(tmp_path, (1, 1), f"[laws]\n{laws}\n")
        path.write_text(path.read_text().replace('"lugre"', '"bouc_wen"'))
        printed = here("calibrate", path, "--dry-run").stdout
        assert lacking in printed
        assert ("warning: laws: [laws] names" in printed) == bool(lacking)
