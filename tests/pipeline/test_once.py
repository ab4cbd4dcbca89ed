"""Each command reads a record once, and a report opens a posterior once for each use."""

import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from mfd_bayes.calibration import result
from mfd_bayes.campaign import campaign as campaigns
from mfd_bayes.cli.commands import app
from mfd_bayes.evaluation.summary import assess
from mfd_bayes.pipeline import commands, comparison, crossvalidation, report
from mfd_bayes.pipeline.plan import Options
from mfd_bayes.runs.run import open_run

TESTS = ("a", "b")


class _StopError(Exception):
    """What stands in place of the sampling."""


@pytest.fixture
def campaign(tmp_path):
    time = np.arange(400) / 50
    text = '[campaign]\nmodel = "lugre"\nnoise = "iid"\n'
    for k, name in enumerate(TESTS, start=1):
        columns = (time, np.sin(np.pi * time), k * np.tanh(5 * np.cos(np.pi * time)))
        np.savetxt(
            tmp_path / f"{name}.csv",
            np.column_stack(columns),
            delimiter=",",
            header="time_s,displacement_in,force_kip",
            comments="",
        )
        text += f'[[test]]\nid = "{name}"\nfile = "{name}.csv"\nactuation = "{500 * k} psi"\n'
    path = tmp_path / "campaign.toml"
    path.write_text(text)
    return path


@pytest.fixture
def reads(monkeypatch):
    """How often each record was read."""
    counts = Counter()
    read_record = campaigns.read_record

    def count(path, *args, **kwargs):
        counts[path.stem] += 1
        return read_record(path, *args, **kwargs)

    monkeypatch.setattr(campaigns, "read_record", count)
    return counts


@pytest.fixture
def plans(monkeypatch):
    """Plans that came to be sampled; the first ends the command."""
    found = []

    def stop(plan, out, observe):
        found.append(plan)
        raise _StopError

    for module in (crossvalidation, comparison):
        monkeypatch.setattr(module, "calibrate_locked", stop)
    return found


def test_a_dry_run_reads_each_record_once_and_still_warns(campaign, tmp_path, reads):
    shutil.copy(campaign.parent / "a.csv", campaign.parent / "b.csv")
    words = ["calibrate", str(campaign), "-o", str(tmp_path / "out"), "--dry-run"]
    outcome = CliRunner().invoke(app, words)
    assert outcome.exit_code == 0
    assert "same record as a" in outcome.stdout
    assert reads == dict.fromkeys(TESTS, 1)


def test_a_dry_run_refuses_what_the_run_would(campaign):
    for out, options, said in (
        (campaign.parent, (), "exists: give --resume to finish it or --force"),
        (campaign.parent / "out", ("--resume", "--force"), "give either --resume or --force"),
    ):
        words = ["calibrate", str(campaign), "-o", str(out), "--dry-run", *options]
        outcome = CliRunner().invoke(app, words)
        assert outcome.exit_code == 2, outcome.output
        assert said in outcome.stderr


def test_a_folder_that_is_no_run_is_not_said_to_be_replaced_by_force(campaign, tmp_path):
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis.tex").write_text("x")
    for options, said in ((["--resume"], "give another folder by -o"), (["--force"], "exists and")):
        outcome = CliRunner().invoke(app, ["calibrate", str(campaign), "-o", str(other), *options])
        assert outcome.exit_code == 2
        assert said in outcome.stderr
        assert "--force to start" not in outcome.stderr
    assert [path.name for path in other.iterdir()] == ["thesis.tex"]


def test_a_cross_validation_is_planned_once(campaign, tmp_path, reads, plans):
    options = Options(effort="quick", by="test")
    with pytest.raises(_StopError):
        crossvalidation.crossvalidate(campaign, tmp_path / "out", options, lambda _: None)
    assert len(plans) == 1
    assert reads == dict.fromkeys(TESTS, 1)


def test_a_comparison_is_planned_once_for_each_model(campaign, tmp_path, reads, plans):
    models, options = ("lugre", "three_stage"), Options(effort="quick")
    with pytest.raises(_StopError):
        comparison.compare(campaign, tmp_path / "out", models, options, lambda _: None)
    assert reads == dict.fromkeys(TESTS, len(models))


def test_a_comparison_of_noises_plans_the_campaigns_model_under_each(campaign, tmp_path, plans):
    options = Options(effort="quick", noises=("staged", "ou"))
    with pytest.raises(_StopError):
        comparison.compare(campaign, tmp_path / "out", (), options, lambda _: None)
    (first,) = plans
    assert (first.campaign.model, first.campaign.noise) == ("lugre", "ou")
    assert {task.noise for task in first.tasks} == {"ou"}


def test_a_run_that_was_just_calibrated_is_not_opened_again(campaign, tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(commands, "calibrate_locked", lambda plan, out, observe: "the run")
    monkeypatch.setattr(commands, "write_report", lambda run, *_, **__: seen.append(run))
    monkeypatch.setattr(report, "open_run", lambda _: pytest.fail("opened again"))
    commands.calibrate_campaign(campaign, tmp_path / "out", Options(), lambda _: None)
    assert seen == ["the run"]


def test_a_report_opens_each_posterior_once_for_each_use(tmp_path, monkeypatch):
    """To open the run, and to judge the test."""
    data = Path(__file__).parents[1] / "data" / "run"
    out = Path(shutil.copytree(data, tmp_path / "out"))
    counts = Counter()
    load_test = result.load_test

    def count(path):
        counts[path.parent.name] += 1
        return load_test(path)

    monkeypatch.setattr(result, "load_test", count)
    run = open_run(out)
    assess(run)
    assert counts == dict.fromkeys(run.tests, 2)
