"""What a resumed run keeps where it is interrupted, and what it removes; nothing is sampled."""

from dataclasses import replace

import pytest

from mfd_bayes.pipeline import calibrate as calibration
from mfd_bayes.pipeline.calibrate import calibrate
from mfd_bayes.runs.manifest import read_manifest, with_keys
from mfd_bayes.runs.run import open_run
from tests.run_folders import PRIORS, plan_of, write_run

RESULTS = ("law_scores", "population_sampler", "crossvalidation", "comparison", "verdicts")
OPTIONAL = (
    *("tables.docx", "tables.xlsx", "report.pdf", "next.csv", "next.json", "next.png"),
    *("figures/next.png", "figures/next.csv"),
)
DRAWS = ("draws.csv", "draws.parquet")


class _StopError(Exception):
    """What ends a session, as a kill would."""


def stop(*_):
    raise _StopError


@pytest.fixture
def plan(tmp_path):
    """Plan of a run that is resumed."""
    plan = plan_of(small=False)
    home = tmp_path / "campaign"
    home.mkdir()
    (home / "campaign.toml").write_text("# read already\n")
    (home / "own.toml").write_text(PRIORS, encoding="utf-8")
    return replace(
        plan,
        campaign=replace(plan.campaign, path=home / "campaign.toml"),
        priors=replace(plan.priors, path=home / "own.toml"),
        options=replace(plan.options, resume=True, jobs=1),
    )


@pytest.fixture
def out(tmp_path):
    """Run folder of the plan, finished, with a report in every form."""
    folder = tmp_path / "out"
    write_run(folder)
    for name in (*OPTIONAL, *DRAWS):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("of these laws")
    return folder


def under_other_laws(plan):
    laws = {**plan.manifest.settings.laws, "sigma0": "constant"}
    settings = plan.manifest.settings.model_copy(update={"laws": laws})
    inputs = {**plan.manifest.inputs, "campaign.toml": "0" * 64}
    manifest = plan.manifest.changed(settings=settings, inputs=inputs)
    return replace(plan, manifest=with_keys(manifest, plan.priors))


def results_of(out):
    found = read_manifest(out)
    return {key: repr(getattr(found, key)) for key in RESULTS}


@pytest.mark.parametrize(
    "name", ["write_bytes", "save_trace", "run_jobs", "load_result", "hash_stored"]
)
def test_a_finished_run_that_is_resumed_and_killed_has_all_its_results(
    plan, out, monkeypatch, name
):
    before = results_of(out)
    monkeypatch.setattr(calibration, name, stop)
    for _ in range(2):
        with pytest.raises(_StopError):
            calibrate(plan, out, lambda _: None)
        assert results_of(out) == before
        assert open_run(out).population.size > 0


def test_a_finished_run_that_is_resumed_keeps_all_its_results(plan, out):
    before = results_of(out)
    calibrate(plan, out, lambda _: None)
    assert results_of(out) == before
    assert all((out / name).is_file() for name in (*OPTIONAL, *DRAWS))


def test_a_run_under_other_laws_is_not_finished_until_it_is(plan, out, monkeypatch):
    monkeypatch.setattr(calibration, "infer_population", stop)
    with pytest.raises(_StopError):
        calibrate(under_other_laws(plan), out, lambda _: None)
    with pytest.raises(calibration.StoreError, match="is not finished"):
        read_manifest(out)


def test_what_is_not_written_again_does_not_stay_beside_other_laws(plan, out, monkeypatch):
    monkeypatch.setattr(calibration, "infer_population", stop)
    with pytest.raises(_StopError):
        calibrate(under_other_laws(plan), out, lambda _: None)
    assert not [name for name in OPTIONAL if (out / name).exists()]
    assert all((out / name).is_file() for name in DRAWS)  # of the tests' posteriors, the same


def test_draws_of_other_posteriors_do_not_stay(plan, out, monkeypatch):
    (out / "tests/a/posterior.nc").unlink()
    monkeypatch.setattr(calibration, "run_jobs", lambda *_: (_ for _ in ()))
    monkeypatch.setattr(calibration, "infer_population", stop)
    with pytest.raises(_StopError):
        calibrate(plan, out, lambda _: None)
    assert not [name for name in (*OPTIONAL, *DRAWS) if (out / name).exists()]
