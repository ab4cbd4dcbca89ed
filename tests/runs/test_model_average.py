"""One prediction by several models."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

import mfd_bayes as mb
from mfd_bayes.population.bands import Band, Forecast
from mfd_bayes.population.given import Conditioned

TIME = np.arange(200) / 100.0


def fake(model, middle, sd=1.0, tests=("a", "b"), force=0.0, remarks=(), given=None, noise="ou"):
    """A run whose band is normal, independent at each sample."""

    def predict(trace, kind, probability, *, draws, seed, **_):
        rng = np.random.default_rng([seed, len(model)])
        force = middle + sd * rng.standard_normal((draws, trace.time.size))
        band = Band.of(trace.time, force, Forecast(kind, probability, draws), "laws")
        return replace(band, remarks=remarks, given=given)

    record = SimpleNamespace(trace=SimpleNamespace(force=np.full(3, force)))
    return SimpleNamespace(
        folder=f"out/{model}",
        tests=dict.fromkeys(tests, record),
        manifest=SimpleNamespace(settings=SimpleNamespace(model=model, noise=noise)),
        extras=None,
        predict=predict,
    )


@pytest.fixture
def trace():
    return mb.Trace.from_arrays(TIME, np.sin(TIME), 1.0)


def test_the_band_is_that_of_the_mixture(trace):
    """Its quantiles are those of two normals in equal parts, by the closed form."""
    band = mb.ModelAverage([fake("lugre", 0.0), fake("backlash", 3.0)]).predict(trace, draws=20_000)
    mixture = 0.5 * (stats.norm.cdf(band.upper) + stats.norm.cdf(band.upper - 3.0))
    assert np.abs(mixture - 0.975).mean() < 0.002
    assert np.abs(band.median - 1.5).mean() < 0.05
    assert np.abs(band.lower + band.upper - 3.0).mean() < 0.1  # symmetrical
    # negative control: the mean of the two bands is not it
    assert band.upper.mean() > 0.5 * (1.96 + 3.0 + 1.96) + 0.3


def test_every_model_gives_as_many_draws(trace):
    runs = [fake("lugre", 0.0, 1e-9), fake("backlash", 3.0, 1e-9), fake("bouc_wen", 9.0, 1e-9)]
    draws = mb.ModelAverage(runs).predict(trace, draws=101).draws
    assert np.unique(np.round(draws[:, 0]), return_counts=True)[1].tolist() == [34, 34, 33]


def test_a_remark_says_where_the_models_disagree(trace):
    apart = mb.ModelAverage([fake("lugre", 0.0), fake("backlash", 3.0)]).predict(trace)
    alike = mb.ModelAverage([fake("lugre", 0.0), fake("backlash", 0.3)]).predict(trace)
    assert any("the models disagree" in remark for remark in apart.remarks)
    assert alike.remarks == ()


def test_remarks_are_said_once_and_the_worst_given_part_counts(trace):
    first = Conditioned((0.0, 1.0), 50, 0.1, "weights", 200.0)
    second = Conditioned((0.0, 1.0), 50, 0.9, "sampling", 250.0, 4, 0.3)
    runs = [
        fake("lugre", 0.0, remarks=("far",), given=first),
        fake("backlash", 0.0, remarks=("far", "odd"), given=second),
    ]
    band = mb.ModelAverage(runs).predict(trace, given=(0.0, 1.0))
    assert band.remarks == ("far", "odd")
    assert (band.given.method, band.given.pareto_k, band.given.effective) == ("sampling", 0.9, 450)
    assert band.given.accepted == 0.3


def test_runs_of_the_same_model_are_told_apart_by_their_noise():
    runs = [fake("lugre", 0.0), fake("lugre", 0.0, noise="iid")]
    assert mb.ModelAverage(runs).models == ("lugre (ou)", "lugre (iid)")


@pytest.mark.parametrize(
    ("others", "words"),
    [
        ([], "needs at least two runs, got 1"),
        ([fake("lugre", 1.0)], r"two of the runs have the model lugre \(ou\)"),
        ([fake("backlash", 0.0, tests=("a",))], "'b' is calibrated in out/lugre but not in out/b"),
        ([fake("backlash", 0.0, force=1.0)], "record of test 'a' is another"),
    ],
)
def test_runs_that_do_not_belong_together_are_refused(others, words):
    with pytest.raises(mb.MfdError, match=words):
        mb.ModelAverage([fake("lugre", 0.0), *others])


def test_one_calibrated_test_is_not_predicted_by_several_models(trace):
    with pytest.raises(mb.MfdError, match="not the kind this_test"):
        mb.ModelAverage([fake("lugre", 0.0), fake("backlash", 0.0)]).predict(trace, "this_test")
