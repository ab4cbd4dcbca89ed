"""Parts that are left out, as jobs whose scores are stored, and what a report says of them."""

import json
import math
from dataclasses import asdict, replace

import pytest

from mfd_bayes.applications.comparison.crossvalidation import FOLDER, Fold, folds_of, parts_of
from mfd_bayes.errors import CampaignError
from mfd_bayes.evaluation.summary import left_out_view
from mfd_bayes.population.design import TestConditions
from mfd_bayes.runs.manifest import CampaignCrossValidation, Prediction, Score
from mfd_bayes.runs.resume import with_keys
from mfd_bayes.runs.run import open_run


def test_scores_of_another_fold_are_computed_anew(tmp_path):
    fold = Fold("a", "test_1.json", ("a",), ("b", "c"), effort="quick", seed=1)
    file = tmp_path / FOLDER / fold.file
    file.parent.mkdir()
    predictions = [asdict(Prediction("a", "a", score=scored(1.0, 0.2), fitted=scored(0.5, 0.1)))]
    file.write_text(json.dumps({"key": asdict(fold), "predictions": predictions}))
    assert fold.stored(tmp_path)
    assert not replace(fold, rests_on="other laws").stored(tmp_path)


def test_folds_of_a_run_rest_on_its_laws_and_posteriors(made_run):
    run = open_run(made_run)
    fold_a, fold_b = folds_of(run, "test", "quick")
    assert fold_a.rests_on == fold_b.rests_on != ""
    laws = {**run.manifest.settings.laws, "sigma0": "constant"}
    settings = run.manifest.settings.model_copy(update={"laws": laws})
    manifest = with_keys(run.manifest.changed(settings=settings), run.priors)
    variant = replace(run, manifest=manifest)
    assert folds_of(variant, "test", "quick")[0].rests_on != fold_a.rests_on


def test_a_part_is_left_out_only_where_another_has_an_actuation():
    def settings(*levels):
        return {f"t{i}": TestConditions(level) for i, level in enumerate(levels)}

    groups = parts_of(settings(0.0, 0.03, 0.0, 0.036), "level", "kip", "a.toml")
    assert groups == {"0 lbf": ("t0", "t2"), "30 lbf": ("t1",), "36 lbf": ("t3",)}
    for criterion, label in (("level", "30 lbf"), ("test", "t1")):
        with pytest.raises(CampaignError, match=f"cannot leave out {label}: no other calibrated"):
            parts_of(settings(0.0, 0.03), criterion, "kip", "a.toml")


def scored(width, crps):
    return Score((0.5, 0.8, 0.9), width, interval_score=1.5 * width, crps=crps, rrse=0.3)


def test_predictions_stand_beside_fitted_tests_and_are_averaged():
    pred_a, pred_b = (
        Prediction(label, test, score=scored(width, 0.2), fitted=scored(0.5, 0.1))
        for test, label, width in (("a", "500 psi", 1.0), ("b", "1000 psi", 2.0))
    )
    view = left_out_view(CampaignCrossValidation("level", (pred_a, pred_b)))
    row_a, row_b = view.rows
    assert (row_a["fitted_width"], row_a["width_ratio"], row_b["width_ratio"]) == (0.5, 2.0, 4.0)
    assert row_a["crps_ratio"] == pytest.approx(2.0)
    assert (view.mean["width_95"], view.mean["interval_score"]) == (1.5, 2.25)
    for words in ("Of 2 tests", "those of the other levels", "90.0 %", "50.0 %", "3.0 times"):
        assert words in view.sentence
    # whole histories that were held are counted, and no width has no ratio
    flat = replace(pred_a, simultaneous=True, fitted=scored(0.0, 0.0))
    view = left_out_view(
        CampaignCrossValidation("test", (flat, replace(pred_b, simultaneous=False)))
    )
    assert "from the others" in view.sentence
    assert [row["simultaneous_95"] for row in (*view.rows, view.mean)] == [1.0, 0.0, 0.5]
    assert "hold the whole force of 1 of 2 tests" in view.sentence
    assert math.isnan(view.rows[0]["width_ratio"])
