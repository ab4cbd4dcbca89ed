"""What a resumed run keeps where its campaign or its prior file has changed."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from mfd_bayes.errors import StoreError
from mfd_bayes.runs.resumption import Existing, prepare_folder


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
    given = priors or plan.priors
    home = plan.campaign.folder
    return prepare_folder(changed, home, out, Existing.RESUMED, given)


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


def test_another_noise_has_the_tests_sampled_again(plan, out):
    with pytest.raises(StoreError, match=r"settings \(noise\) changed"):
        resume(plan, out, noise="iid")
    assert (out / "crossvalidation").is_dir()


def test_another_window_has_the_tests_sampled_again(plan, out):
    tests = dict(plan.manifest.settings.tests)
    tests["a"] = tests["a"].model_copy(update={"fit": (0.0, 1.0)})
    with pytest.raises(StoreError, match=r"settings \(tests\) changed"):
        resume(plan, out, tests=tests)


def test_another_prior_of_a_parameter_has_the_tests_sampled_again(plan, out):
    parameters = dict(plan.priors.parameters)
    parameters["k3"] = replace(parameters["k3"], figures={"median": 1.0, "spread": 0.1})
    with pytest.raises(StoreError, match=r"inputs \(campaign.toml\) changed"):
        resume(plan, out, replace(plan.priors, parameters=parameters))


def test_another_role_is_not_resumed(plan, out):
    swapped = plan.manifest.with_test("a", role="validate")
    with pytest.raises(StoreError, match="inputs"):
        resume(replace(plan, manifest=swapped), out)


def test_another_record_is_not_resumed(plan, out):
    (file,) = {test.file for test in plan.manifest.settings.tests.values()}
    inputs = {**plan.manifest.inputs, file: "1" * 64}
    other = replace(plan, manifest=plan.manifest.changed(inputs=inputs))
    with pytest.raises(StoreError, match=file):
        resume(other, out)
