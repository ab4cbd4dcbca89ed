"""What a resumed run keeps where its campaign or its prior file has changed."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from mfd_bayes.errors import StoreError
from mfd_bayes.runs.folder import discard
from mfd_bayes.runs.manifest import read_manifest
from mfd_bayes.runs.resumption import Existing, population_digest, prepare_folder, with_keys


@pytest.fixture(scope="module")
def runs(benchmark_module):
    """The benchmark's maker of run folders."""
    return benchmark_module("fuzz.runs")


@pytest.fixture(scope="module")
def made(runs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("made") / "out"
    runs.write_run(folder)
    return folder


@pytest.fixture
def out(made, tmp_path):
    return Path(shutil.copytree(made, tmp_path / "out"))


@pytest.fixture
def plan(runs):
    return runs.plan_of(small=False)


def resume(plan, out, priors=None, **settings):
    """Resume with changed settings, or another prior file, as a campaign file with them has it."""
    manifest = plan.manifest
    inputs = {**manifest.inputs, "campaign.toml": "0" * 64}
    changed = manifest.changed(
        settings=manifest.settings.model_copy(update=settings), inputs=inputs
    )
    changed = with_keys(changed, priors or plan.priors)
    resumed = prepare_folder(changed, plan.campaign.folder, out, Existing.RESUMED)
    return resumed.manifest, resumed.before


def test_other_laws_keep_the_tests_and_infer_the_population_again(plan, out):
    laws = {**plan.manifest.settings.laws, "sigma0": "constant"}
    manifest, before = resume(plan, out, laws=laws)
    assert before is None  # what it has of the population is not taken over
    assert manifest.tests["a"].status == "done"
    assert "tests/a/posterior.nc" in manifest.files
    assert (out / "tests/a/posterior.nc").is_file()
    assert not (out / "crossvalidation").exists()  # of the population before


def test_a_dependence_concerns_the_population_alone(plan, out):
    assert resume(plan, out, dependence={"Fc_fwd": ("velocity",)})[1] is None


def test_sessions_concern_the_population_alone(plan, out):
    tests = dict(plan.manifest.settings.tests)
    tests["a"] = tests["a"].model_copy(update={"session": "Monday"})
    manifest, before = resume(plan, out, tests=tests)
    assert before is None
    assert manifest.tests["a"].status == "done"


def test_an_order_of_the_tests_concerns_predictions_of_what_was_left_out_alone(plan, out):
    tests = dict(plan.manifest.settings.tests)
    last, first, *_ = tests
    tests[last] = tests[last].model_copy(update={"after": first})
    manifest, before = resume(plan, out, tests=tests)
    assert manifest.tests[last].status == "done"
    assert before.status == "finished"  # its population is taken over
    assert before.crossvalidation is None
    assert not (out / "crossvalidation").exists()


def test_priors_of_scatter_concern_the_population_alone(plan, out):
    scatter = dict(plan.priors.scatter)
    name = next(iter(scatter))
    scatter[name] = replace(scatter[name], sd=2.0 * scatter[name].sd)
    assert resume(plan, out, replace(plan.priors, scatter=scatter))[1] is None


def test_a_comment_in_the_campaign_changes_nothing(plan, out):
    manifest, before = resume(plan, out)
    assert before.status == "finished"
    assert manifest.tests["a"].status == "done"
    assert (out / "crossvalidation").is_dir()


def kept_of(out, plan, priors=None, **settings):
    """Calibrated tests that are kept, after a resumption that does not keep the population."""
    manifest, before = resume(plan, out, priors, **settings)
    assert before is None
    assert json.loads((out / "manifest.json").read_text())["status"] == "running"
    kept = [name for name, entry in manifest.tests.items() if entry.status == "done"]
    assert [name for name in "ab" if (out / f"tests/{name}/posterior.nc").is_file()] == kept
    assert not (out / "crossvalidation").exists()
    return kept


def test_another_noise_has_the_tests_sampled_again(plan, out):
    assert kept_of(out, plan, noise="iid") == []


def test_another_window_has_its_test_sampled_again(plan, out):
    tests = dict(plan.manifest.settings.tests)
    tests["a"] = tests["a"].model_copy(update={"fit": (0.0, 1.0)})
    assert kept_of(out, plan, tests=tests) == ["b"]


def test_another_prior_of_a_parameter_has_the_tests_sampled_again(plan, out):
    parameters = dict(plan.priors.parameters)
    parameters["k3"] = replace(parameters["k3"], figures={"median": 1.0, "spread": 0.1})
    assert kept_of(out, plan, replace(plan.priors, parameters=parameters)) == []


def test_what_is_stored_of_a_test_in_another_role_is_removed(plan, out):
    swapped = plan.manifest.with_test("a", role="validate")
    assert kept_of(out, replace(plan, manifest=swapped)) == ["b"]


def test_another_record_has_its_tests_sampled_again(plan, out):
    (file,) = {test.file for test in plan.manifest.settings.tests.values()}
    inputs = {**plan.manifest.inputs, file: "1" * 64}
    other = replace(plan, manifest=plan.manifest.changed(inputs=inputs))
    assert kept_of(out, other) == []


def test_a_tolerance_changes_nothing_that_is_stored(plan, out):
    manifest, before = resume(plan, out, tolerances={"energy": 0.2})
    assert before.status == "finished"
    assert manifest.tests["a"].status == "done"


def test_a_run_of_other_tests_is_refused_and_stays(plan, out):
    manifest = json.loads((out / "manifest.json").read_text())
    for part in (manifest["tests"], manifest["settings"]["tests"]):
        for name in tuple(part):
            part[f"other_{name}"] = part.pop(name)
    del manifest["truth"]
    (out / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(StoreError, match=r"a run of other tests \(other_a, .*another folder"):
        resume(plan, out)
    assert (out / "tests/a/posterior.nc").is_file()


def test_a_run_that_was_begun_without_keys_is_refused_and_stays(plan, out):
    manifest = json.loads((out / "manifest.json").read_text())
    del manifest["population_key"]
    (out / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(StoreError, match=r"an earlier version began it.*--force"):
        resume(plan, out)
    assert (out / "tests/a/posterior.nc").is_file()


# --- what was left out, and what was compared


def test_predictions_that_cannot_be_removed_are_no_longer_taken(plan, out, monkeypatch):
    def fail(path):
        raise OSError(16, "Device or resource busy")

    monkeypatch.setattr(shutil, "rmtree", fail)
    before = (out / "manifest.json").read_bytes()
    with pytest.raises(StoreError, match=r"cannot remove .*crossvalidation: Device or resource"):
        resume(plan, out, laws={**plan.manifest.settings.laws, "sigma0": "constant"})
    assert (out / "manifest.json").read_bytes() == before


def test_a_link_in_place_of_a_folder_is_removed_and_not_what_it_leads_to(out):
    (out / "kept").mkdir()
    (out / "kept" / "notes.txt").write_text("mine")
    shutil.rmtree(out / "crossvalidation")
    (out / "crossvalidation").symlink_to("kept")
    discard(out)
    assert [path.name for path in out.iterdir()] == ["kept"]
    assert (out / "kept" / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("laws", [{}, {"sigma0": "constant"}])
def test_a_comparison_rests_on_the_tests_alone(plan, out, laws):
    stored = read_manifest(out).comparison
    assert stored is not None
    given = {**plan.manifest.settings.laws, **laws}
    assert resume(plan, out, laws=given)[0].comparison == stored
    (out / "tests/a/posterior.nc").unlink()  # which is sampled again
    assert resume(plan, out, laws=given)[0].comparison is None


@pytest.mark.parametrize(
    "change",
    [
        lambda content, priors: content["settings"].update(laws={"sigma0": "constant"}),
        lambda content, priors: content["settings"].update(dependence={"Fc_fwd": ["velocity"]}),
        lambda content, priors: content["settings"]["tests"]["a"].update(session="Monday"),
        lambda content, priors: content["settings"]["tests"]["b"].update(after="a"),
        lambda content, priors: content["files"].update({"tests/a/posterior.nc": "0" * 64}),
        lambda content, priors: priors.scatter.clear(),
        lambda content, priors: priors.parameters.popitem(),
    ],
)
def test_what_the_population_rests_on_has_a_digest(plan, out, change):
    content = json.loads((out / "manifest.json").read_text())
    priors = replace(
        plan.priors, scatter={**plan.priors.scatter}, parameters={**plan.priors.parameters}
    )
    before = population_digest(content, priors)
    content["title"] = "Another"
    assert population_digest(content, priors) == before
    assert population_digest(read_manifest(out).content, priors) == before
    change(content, priors)
    assert population_digest(content, priors) != before
