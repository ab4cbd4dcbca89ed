"""Tests that follow each other, from the campaign file to the prediction."""

import re

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from mfd_bayes.cli.commands import app
from mfd_bayes.pipeline.plan import Options, plan_campaign

HEAD = '[campaign]\nnoise = "iid"\nrate = "32 Hz"\n'


def here(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def write_campaign(folder, *more):
    """Tests t0, t1, … with more keys each, of five cycles of a loop with a gap."""
    rng = np.random.default_rng(0)
    time, text = np.arange(640) / 64, HEAD
    for k, keys in enumerate(more):
        motion = (1 + 0.02 * k) * np.sin(np.pi * time)
        force = np.tanh(20 * np.gradient(motion, time)) + 0.02 * rng.normal(size=time.size)
        head = "time_s,displacement_in,force_kip"
        table = np.column_stack([time, motion, force])
        np.savetxt(folder / f"t{k}.csv", table, delimiter=",", header=head, comments="")
        text += f'[[test]]\nid = "t{k}"\nfile = "t{k}.csv"\nactuation = "{500 + k} psi"\n{keys}\n'
    path = folder / "campaign.toml"
    path.write_text(text)
    return path


def test_the_order_is_in_the_plan_with_the_turns_outside_the_windows(tmp_path):
    follows = 'after = "t0"\nfit = "0 s to 8.2 s"\nrole = "validate"'
    path = write_campaign(tmp_path, 'fit = "1.1 s to 6.2 s"', follows, "")
    manifest = plan_campaign(path, Options(effort="quick")).manifest
    assert manifest.settings.order == {"t1": "t0"}
    before, after = manifest.tests["t0"].before, manifest.tests["t0"].after
    assert before == pytest.approx((0.0, 1.0, np.sin(1.1 * np.pi)), abs=0.06)
    assert after == pytest.approx((np.sin(6.2 * np.pi), 1.0, -1.0, 1.0, -1.0, 0.0), abs=0.06)
    assert manifest.tests["t1"].before == ()
    text = path.read_text().replace("t1.csv", "t0.csv").replace("0 s to 8.2 s", "6.7 s to 9.9 s")
    path.write_text(text)
    of_one = plan_campaign(path, Options(effort="quick")).manifest.tests["t1"]
    assert of_one.before == pytest.approx(np.sin(np.pi * np.array([6.2, 6.5, 6.7])), abs=0.06)
    assert (manifest.tests["t2"].before, manifest.tests["t2"].after) == ((), ())


def test_inspect_and_the_dry_run_say_which_test_follows_which(tmp_path):
    path = write_campaign(tmp_path, "", 'after = "t0"')
    shown = here("inspect", path, "-o", tmp_path)
    assert re.findall(r"follows +(.*)", shown.stdout) == ["test t0, without a reset"]
    tried = here("calibrate", path, "-o", tmp_path / "out", "--dry-run")
    assert tried.exit_code == 0
    assert "without a reset: t1 after t0" in tried.stdout


def test_the_dry_run_refuses_an_order_that_cannot_be(tmp_path):
    path = write_campaign(tmp_path, 'after = "t1"', 'after = "t0"')
    tried = here("calibrate", path, "-o", tmp_path / "out", "--dry-run")
    assert tried.exit_code == 2
    assert "got a circle: t0 after t1 after t0" in tried.stderr
    assert not (tmp_path / "out").exists()


@pytest.fixture
def ask(finished_run, tmp_path):
    assert finished_run.code == 0, finished_run.stderr
    arguments = "predict", finished_run.out, "--actuation", "700 psi", "-o", tmp_path / "bands.csv"
    return lambda *options: here(*arguments, *options)


@pytest.fixture
def motion(tmp_path):
    """A small motion, which stays inside the gap."""
    time = np.arange(400) / 100
    table = np.column_stack([time, 0.03 * np.sin(np.pi * time)])
    head = "time_s,displacement_in"
    np.savetxt(tmp_path / "m.csv", table, delimiter=",", header=head, comments="")
    return tmp_path / "m.csv"


def test_a_motion_after_a_test_has_a_narrower_band_that_says_so(
    ask, motion, finished_run, tmp_path
):
    test = next(path.parent.name for path in sorted(finished_run.out.glob("tests/*/posterior.nc")))
    widths = []
    for options in ((), ("--after", test)):
        found = ask("--motion", motion, *options, "--kind", "observation", "--force")
        assert found.exit_code == 0, found.output
        table = pd.read_csv(tmp_path / "bands.csv", comment="#")
        widths.append(np.mean(table.upper_kip - table.lower_kip))
    assert widths[1] < 0.8 * widths[0]
    said = f"begun where in its gap test {test} ended"
    assert said in " ".join(found.stdout.split())
    assert said in (tmp_path / "bands.csv").read_text()


def test_what_cannot_be_followed_is_refused(ask, motion, tmp_path):
    for options, said in [
        (("--after", "p5"), "after must be the id of a test of the run, one of"),
        (("--after", "p5", "--design"), "--design cannot be combined with --after"),
    ]:
        found = ask("--motion", motion, *options)
        assert found.exit_code == 2
        assert said in " ".join(found.stderr.split())
        assert not (tmp_path / "bands.csv").exists()
