"""Parts that are left out: which there are, and as jobs whose scores are stored."""

import json
from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pytest

from mfd_bayes.errors import CampaignError, StoreError
from mfd_bayes.evaluation import crossvalidate as folds
from mfd_bayes.evaluation.crossvalidate import FOLDER, Fold, _pooled, leave_out, parts_of
from mfd_bayes.population.bands import Predictor
from mfd_bayes.population.inference import Inference
from mfd_bayes.population.population import LawDraws
from mfd_bayes.population.settings import Setting
from mfd_bayes.population.storage import save_test_draws
from mfd_bayes.runs.folder import hash_stored
from mfd_bayes.runs.manifest import with_keys
from mfd_bayes.runs.paths import pooled_of
from mfd_bayes.runs.run import open_run
from mfd_bayes.runs.test_sequence import StoredPooled
from tests.run_folders import write_run


def test_scores_of_another_fold_are_computed_anew(tmp_path):
    fold = Fold("a", "test_1.json", ("a",), ("b", "c"), effort="quick", seed=1)
    file = tmp_path / FOLDER / fold.file
    file.parent.mkdir()
    key = asdict(fold)
    file.write_text(json.dumps({"key": key, "predictions": []}))
    assert fold.stored(tmp_path)
    other = replace(fold, rests_on="other laws")
    assert not other.stored(tmp_path)


def test_folds_of_a_run_rest_on_its_laws_and_posteriors(tmp_path):
    write_run(tmp_path / "out")
    run = open_run(tmp_path / "out")
    first, second = folds.folds_of(run, "test", "quick")
    assert first.rests_on == second.rests_on != ""
    laws = {**run.manifest.settings.laws, "sigma0": "constant"}
    settings = run.manifest.settings.model_copy(update={"laws": laws})
    manifest = with_keys(run.manifest.changed(settings=settings), run.priors)
    other = replace(run, manifest=manifest)
    assert folds.folds_of(other, "test", "quick")[0].rests_on != first.rests_on


def settings(*levels):
    return {f"t{i}": Setting(level) for i, level in enumerate(levels)}


def test_the_level_without_actuation_is_a_part():
    found = parts_of(settings(0.0, 0.03, 0.0, 0.036), "level", "kip", "a.toml")
    assert found == {"0 lbf": ("t0", "t2"), "30 lbf": ("t1",), "36 lbf": ("t3",)}


@pytest.mark.parametrize(("by", "part"), [("level", "30 lbf"), ("test", "t1")])
def test_all_tests_with_an_actuation_cannot_be_left_out(by, part):
    with pytest.raises(CampaignError, match=f"cannot leave out {part}: no other calibrated test"):
        parts_of(settings(0.0, 0.03), by, "kip", "a.toml")


def drawn_of(run):
    """An inference of the tests a and b, with draws that no sampler has seen."""
    rng, population = np.random.default_rng(0), run.population
    names = population.design.coordinates.names
    x = 0.1 * rng.normal(size=(*population.shape, 2, len(names)))
    return Inference(population, x, (), {}, (), 1, (0.5, 0.5))


def test_what_is_pooled_without_a_part_is_what_a_run_of_the_others_would_store(tmp_path):
    write_run(tmp_path / "out")
    run = open_run(tmp_path / "out")
    inference = drawn_of(run)
    population, names = inference.population, run.population.design.coordinates.names
    path = tmp_path / "out" / pooled_of("b")
    save_test_draws(path, inference.values(1), {}, "b")
    files = {k: v for k, v in run.manifest.files.items() if k != pooled_of("b")}
    files |= hash_stored(run.folder, [pooled_of("b")])
    manifest = run.manifest.changed(files=files)
    stored = StoredPooled(run.folder, manifest, population)("b")
    found = _pooled(inference, run.tests, "b")
    assert set(found) >= set(names)
    for name in stored:
        np.testing.assert_allclose(found[name], stored[name], rtol=1e-6)
    draws = {name: values[:, 1:] for name, values in vars(population.draws).items()}
    fewer = replace(population, draws=LawDraws(**draws))
    with pytest.raises(StoreError, match="does not hold the draws of its population"):
        StoredPooled(run.folder, manifest, fewer)("b")


@pytest.fixture
def left_out(tmp_path, monkeypatch):
    """Function that leaves out some of the tests a and b, b after a; the forecasts of each."""
    write_run(tmp_path / "out")
    run = open_run(tmp_path / "out")
    settings = run.manifest.settings.with_test("b", after="a")
    run = replace(run, manifest=run.manifest.changed(settings=settings))
    drawn = drawn_of(run)
    monkeypatch.setattr(folds, "infer_population", lambda *_: drawn)
    monkeypatch.setattr(folds, "DRAWS", 20)
    asked = []

    def predict(predictor, trace, forecast):
        asked.append(forecast)
        return SimpleNamespace(draws=np.zeros((20, trace.samples)))

    monkeypatch.setattr(Predictor, "predict", predict)

    def leave(*names):
        kept = tuple(name for name in run.tests if name not in names)
        leave_out(run, Fold("part", "test_1.json", names, kept, effort="quick", seed=1))
        return asked

    return leave


def test_a_test_that_is_left_out_begins_where_a_calibrated_one_ended(left_out):
    (forecast,) = left_out("b")
    assert (forecast.before.test, forecast.before.predicted) == ("a", False)


def test_the_end_of_a_test_that_is_left_out_too_is_predicted_without_its_force(left_out):
    first, second = left_out("a", "b")
    assert first.before is None
    assert (second.before.test, second.before.predicted) == ("a", True)
