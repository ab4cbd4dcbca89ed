"""The data sheet over models: each as the run has it, their mixture, and what is marked."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize, stats

import mfd_bayes as mb
from mfd_bayes.applications.comparison.crossvalidation import parts_of
from mfd_bayes.applications.comparison.datasheets import MIXTURE, sheet_weights, values_of
from mfd_bayes.applications.properties.datasheet import datasheet
from mfd_bayes.errors import CampaignError
from mfd_bayes.evaluation.scores import log_score
from mfd_bayes.population.design import TestConditions
from mfd_bayes.runs.manifest import CampaignCrossValidation, Prediction, Score

SCORE = Score((0.5, 0.9, 0.95), 1.0, interval_score=1.0, crps=0.1, rrse=0.1)
EQUAL = np.array([0.5, 0.5])


@pytest.fixture(scope="module")
def run(finished_run):
    return mb.open_run(finished_run.out)


@pytest.fixture(scope="module")
def other(finished_run, tmp_path_factory):
    """A copy under another noise, with the same draws."""
    folder = tmp_path_factory.mktemp("other") / "out"
    shutil.copytree(finished_run.out, folder)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["settings"]["campaign"]["noise"] = "student_t"
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return mb.open_run(folder)


def draws_of(*means, n=20000):
    rng = np.random.default_rng(0)
    return [mean + rng.standard_normal(n) for mean in means]


@pytest.mark.parametrize(("shift", "weights", "marked"), [(5, EQUAL, True), (1, EQUAL, False)])
def test_the_mixture_holds_both_models_and_is_marked_where_they_are_apart(shift, weights, marked):
    draws = draws_of(0.0, shift)
    values, difference = values_of(("a", "b"), weights, draws, draws)

    def tail(x):
        return weights @ stats.norm.sf(x, [0.0, shift]) - 0.025

    upper = optimize.brentq(tail, 0.0, 10.0)
    density = weights @ stats.norm.pdf(upper, [0.0, shift])
    error = np.sqrt(0.025 / 40000) / density
    assert values[MIXTURE][2] == pytest.approx(upper, abs=4 * error)
    assert values[MIXTURE][0] == pytest.approx(shift / 2, abs=4 * 0.5**0.5 * 20000**-0.5)
    assert difference == pytest.approx(shift / (upper - shift / 2), rel=0.05)
    assert (difference > 1) == marked


def test_a_model_without_weight_does_not_count_and_draws_of_any_number_do():
    few, many = draws_of(0.0, n=5000) + draws_of(5.0)
    values, difference = values_of(("a", "b"), np.array([1.0, 0.0]), [few, many], [few, many])
    assert difference == 0
    np.testing.assert_allclose(values[MIXTURE], values["a"], atol=0.02)
    # the control: with equal weights half of the mixture is from the model of few draws
    values, difference = values_of(("a", "b"), EQUAL, [few, many], [few, many])
    assert difference > 1
    assert values[MIXTURE][0] == pytest.approx(2.5, abs=0.05)


def test_each_model_has_the_values_of_its_own_data_sheet_and_a_planted_difference_is_seen(
    run, other
):
    table = mb.sheet_over_models(mb.ModelAverage([run, other]))
    names = ["three_stage (ou)", "three_stage (student_t)", MIXTURE]
    assert table["model"].unique().tolist() == names
    own = datasheet(run).rows
    own = own[(own["cycle"] == 0) & own["tested"]].set_index(["condition", "quantity", "direction"])
    for name in names[:2]:
        rows = table[table["model"] == name].set_index(own.index.names)
        for key in ("nominal", "lower", "upper"):
            np.testing.assert_array_equal(rows[key], own.loc[rows.index, key])
    assert len(rows) == len(own.dropna(subset="upper"))
    assert not table["depends_on_model"].any()  # the control: both have the same draws

    population = other.population
    z = population.draws.z.copy()
    strong = [population.design.names.index(name) for name in ("Fc_fwd", "Fc_bwd")]
    z[..., strong] += 1.0  # of the logarithm of the slip force
    shifted = other.with_population(replace(population, draws=replace(population.draws, z=z)))
    table = mb.sheet_over_models(mb.ModelAverage([run, shifted]))
    marked = table.groupby(["quantity"])["depends_on_model"].all()
    assert marked["slip_force"]
    assert not marked["gap"]  # which does not follow it
    assert not marked["forward_over_backward"]
    assert (table["weight"][table["model"] != MIXTURE] == 0.5).all()


def predicted(run, scores, kind="motion"):
    """The run with stored scores of its tests."""
    tests = zip(run.tests, scores, strict=True)
    predictions = [Prediction("p", name, SCORE, SCORE, log_score=s) for name, s in tests]
    stored = CampaignCrossValidation(kind, tuple(predictions))
    return replace(run, manifest=run.manifest.changed(crossvalidation=stored))


def test_weights_are_those_of_the_mixture_that_predicts_motions_left_out_best(run, other):
    def weights(*runs):
        return sheet_weights(mb.ModelAverage(runs))

    a, b = np.array([1.0, 0.5, 0.4]), np.array([-1.0, 0.2, 0.5])
    w, sentence = weights(predicted(run, a), predicted(other, b))
    grid = np.linspace(0.001, 0.999, 999)
    gain = np.log(grid * np.exp(a[:, None]) + (1 - grid) * np.exp(b[:, None])).sum(axis=0)
    gain += 0.5 * (np.log(grid) + np.log(1 - grid))  # a prior that is worth one test
    assert w[0] == pytest.approx(grid[gain.argmax()], abs=2e-3)
    assert w[0] > 0.6
    assert f"three_stage (ou) {w[0]:.2f}" in sentence
    swapped, _ = weights(predicted(run, b), predicted(other, a))
    np.testing.assert_allclose(swapped, w[::-1], atol=1e-3)
    for pair in (  # no scores of motions left out under every model
        (predicted(run, a), other),
        (predicted(run, a, "level"), predicted(other, b, "level")),
        (predicted(run, a), predicted(other, [None, 0.2, 0.5])),
    ):
        w, sentence = weights(*pair)
        np.testing.assert_array_equal(w, EQUAL)
        assert "the same weight" in sentence


def test_the_log_score_is_that_of_the_density_and_is_best_for_the_right_width():
    rng = np.random.default_rng(1)
    observed = rng.standard_normal(400)
    scores = [log_score(sd * rng.standard_normal((4000, 400)), observed) for sd in (0.5, 1.0, 2.0)]
    exact = stats.norm.logpdf(observed).mean()
    assert scores[1] == pytest.approx(exact, abs=0.01)
    assert max(scores) == scores[1]


def test_tests_of_one_kind_of_motion_are_left_out_together():
    def settings(*motions):
        keys = ("velocity", "amplitude", "full_strokes")
        return {
            f"t{i}": TestConditions(0.5 + i, "", dict(zip(keys, motion, strict=True)))
            for i, motion in enumerate(motions)
        }

    slow, fast, quake = (0.31, 1.0, 1.0), (3.1, 1.0, 1.0), (3.1, 1.0, 0.2)
    near = (3.2, 1.02, 0.98)
    groups = parts_of(settings(slow, fast, quake, near), "motion", "kip", "a.toml")
    assert [*groups.values()] == [("t0",), ("t1", "t3"), ("t2",)]
    assert [*groups] == ["the motion of t0", "the motion of t1", "the motion of t2"]
    with pytest.raises(CampaignError, match="by motion needs at least two motions"):
        parts_of(settings(fast, near), "motion", "kip", "a.toml")
