"""Tests that follow each other: where each of them begins, of a run that no sampler has seen."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.population.bands import PredictionOptions, Predictor
from mfd_bayes.runs.run import open_run, sequence_of
from mfd_bayes.runs.test_sequence import TestSequence

FORECAST = PredictionOptions(draws=20)


@pytest.fixture(scope="module")
def run(made_run):
    return open_run(made_run)


def ordered(run, turns=None, **predecessors):
    settings = run.manifest.settings
    for name, predecessor in predecessors.items():
        settings = settings.with_test(name, after=predecessor, file=f"{name}.csv")
    manifest = run.manifest.changed(settings=settings)
    for name, ends in (turns or {}).items():
        manifest = manifest.with_test(name, **ends)
    return replace(run, manifest=manifest)


def test_a_test_begins_where_the_posterior_of_the_one_before_ends(run):
    chained = ordered(run, c="b")
    trace = run.held_out["c"]
    ending = sequence_of(chained).before("c", trace, FORECAST)
    model, test = run.tests["b"].posterior.model, run.tests["b"]
    values = test.stored.values()
    pick = np.linspace(0, len(values["start"]) - 1, 20).astype(int)
    sample = {name: column[pick] for name, column in values.items()}
    ended = model.end(model.theta(sample), test.trace, sample["start"])
    gap = model.gap(sample)
    moved = ended + (trace.displacement[0] - test.trace.displacement[-1]) / gap
    np.testing.assert_allclose(ending.place, np.clip(moved, 0.0, 1.0))
    assert (ending.test, ending.predicted) == ("b", False)
    assert sequence_of(chained).before("b", trace, FORECAST) is None


def test_what_the_windows_leave_out_moves_the_device_in_between(run):
    trace = run.held_out["c"]
    for turns, expected in (
        ({"b": {"after": (90.0, 80.0)}}, 0.0),
        ({"b": {"after": (90.0, -90.0)}}, 1.0),
        ({"c": {"before": (90.0, -90.0)}}, 1.0),
        ({"b": {"after": (-90.0,)}, "c": {"before": (90.0,)}}, 0.0),
    ):
        ending = sequence_of(ordered(run, turns, c="b")).before("c", trace, FORECAST)
        np.testing.assert_allclose(ending.place, expected, atol=1e-9)


def test_a_prediction_says_which_test_it_follows(run):
    motion = replace(run.held_out["c"], force=None)
    band = run.predict(motion, draws=20, after="b")
    assert band.source.endswith("begun where in its gap test b ended")
    model, ending = run.tests["b"].posterior.model, sequence_of(run).ending("b", motion, FORECAST)
    assert set(band.values["start"]) <= set(model.start_at(ending.place, motion))
    explicit = run.predict(motion, draws=20, after=ending)
    np.testing.assert_array_equal(explicit.draws, band.draws)
    unordered = run.predict(motion, draws=20)
    assert not np.array_equal(unordered.values["start"], band.values["start"])


def test_a_test_that_is_predicted_itself_is_followed_as_it_is_predicted(run):
    chained = ordered(run, b="a", c="b")
    posterior = run.tests["a"].posterior
    predictor = Predictor(run.population, posterior.model, posterior.noise)
    left_out = {"b": run.tests["b"].trace, **run.held_out}
    sequence = TestSequence(chained.manifest, {"a": run.tests["a"]}, left_out, predictor)
    ending = sequence.before("c", run.held_out["c"], FORECAST)
    assert (ending.test, ending.predicted) == ("b", True)
    assert "test b, which is predicted itself, ended" in ending.words
    assert sequence.before("b", left_out["b"], FORECAST).predicted is False
    # without the posterior of a it begins anywhere, and a slow way forward makes that forgotten
    isolated = replace(sequence, tests={}, motions=left_out)
    assert isolated.before("b", left_out["b"], FORECAST) is None  # a is lost: nothing is known
    assert isolated.before("c", run.held_out["c"], FORECAST).predicted
