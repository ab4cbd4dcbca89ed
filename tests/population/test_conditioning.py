"""A first part of a test is given, or arrives sample by sample."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from mfd_bayes.errors import FitError, RecordError
from mfd_bayes.population import conditioning as given_part
from mfd_bayes.population.bands import FEWEST, PredictionOptions
from mfd_bayes.population.conditioning import OnlinePredictor, predict_given, stroke_likelihood
from mfd_bayes.population.design import setting_of
from mfd_bayes.records.trace import Trace
from tests.population.made import make_predictor, no_residual

RATE = 32.0
TIME = np.arange(160) / RATE
MODELS = ("three_stage", "backlash")
RESIDUAL = {"lag_one": 1e-3, "noise_time": 1.0 / RATE / np.log(1e3), "travel": 1e-6}
"""Independent noise, of which every sample counts."""


def motion(actuation=1.0):
    small = 0.04 * np.sin(4.0 * np.pi * TIME)
    later = np.maximum(TIME - 1.0, 0.0)
    x = np.where(TIME < 1.0, small, 0.5 * np.sin(1.4 * np.pi * later))
    return Trace.from_arrays(TIME, x, actuation, np.ones(TIME.size))


def predictor(name, **options):
    """A population of a model, with medians typical of the priors."""
    residual = no_residual(**RESIDUAL, **options.pop("residual", {}))
    options = {"scatter": 0.1, "level_sd": 0.01, "residual": residual} | options
    return make_predictor(name, [setting_of(motion(p)) for p in (0.5, 1.0, 2.0)], **options)


def truth_of(source, seed=1, actuation=1.0):
    """A test of the population: its record, its force without noise, and its quantities."""
    rng, trace = np.random.default_rng(seed), motion(actuation)
    draws = source.draw(trace, PredictionOptions(draws=FEWEST), rng)
    values = {name: value[0] for name, value in source.values(draws).items()}
    force = source.force(trace, draws)[0]
    noise = source.population.residual.draw_noise(rng, trace, np.array([values["noise_sd"]]))[0]
    record = replace(trace, force=force + values["offset"] + noise)
    return record, force, values


# --- likelihood


def test_the_likelihood_is_the_dense_density_with_an_intercept_of_each_stroke():
    rng = np.random.default_rng(1)
    strokes, residuals = np.repeat([0, 1, 2], [5, 9, 4]), rng.standard_normal((3, 18))
    sd, h = np.array([0.5, 1.0, 1.7]), 0.6
    density = stroke_likelihood(residuals, np.ones(18), strokes, sd, h)
    unit = (1.0 - h**2) * np.eye(18) + h**2 * (strokes[:, None] == strokes)
    expected = [
        stats.multivariate_normal(np.zeros(18), s**2 * unit).logpdf(row)
        for s, row in zip(sd, residuals, strict=True)
    ]
    np.testing.assert_allclose(density - 9.0 * np.log(2.0 * np.pi), expected, rtol=1e-10)
    independent = stroke_likelihood(residuals, np.ones(18), strokes, sd, 0.0)
    assert np.abs(independent - density).max() > 1.0  # the control


# --- a closed form


OFFSET = 0.06  # kip, scatter of the only unknown


def known_but_for_the_offset(share=0.0):
    residual = {"stroke_share": share}
    return predictor("lugre", scatter={"offset": OFFSET}, level_sd=0.0, residual=residual)


# by weights alone, and resampled and moved
@pytest.mark.parametrize(("share", "end"), [(0.0, 0.07), (0.5, 3.0)])
def test_an_offset_given_a_part_is_the_closed_form(share, end):
    source = known_but_for_the_offset(share)
    record, force, _ = truth_of(source, seed=4)
    band = predict_given(source, record, PredictionOptions(draws=4000, seed=1), (0.0, end))
    assert band.conditioning.method == "sampling" or end < 1.0
    window = end >= TIME
    n, turns = np.count_nonzero(window), record.turning_points
    strokes = np.searchsorted(turns, np.arange(n), side="right")
    same_stroke = (strokes[:, None] == strokes).astype(float)
    covariance = 0.05**2 * ((1.0 - share**2) * np.eye(n) + share**2 * same_stroke)
    residual = (record.force - force)[window]
    weight = np.linalg.solve(covariance, np.ones(n))
    precision = weight.sum() + OFFSET**-2
    mean, sd = weight @ residual / precision, precision**-0.5
    offsets = band.values["offset"]
    size = (
        min(band.conditioning.effective, 1500) if band.conditioning.method == "weights" else 300.0
    )
    assert abs(offsets.mean() - mean) < 4.0 * sd / np.sqrt(size)
    assert offsets.std() == pytest.approx(sd, rel=4.0 / np.sqrt(2.0 * size))
    assert sd < 0.7 * OFFSET  # the control


# --- all models


# a part that tells as much as 70 independent samples: weights alone would leave a few draws
@pytest.mark.parametrize(("name", "number"), [("three_stage", 6), ("backlash", 2)])
def test_a_given_part_makes_the_band_narrower_and_nearer(name, number, monkeypatch):
    monkeypatch.setattr(given_part, "PARTICLES", 800)
    source = predictor(name, scatter=0.2)
    errors, widths, coverages, unreliable = [], [], [], 0
    tail = TIME > 2.2
    for seed in range(number):
        record, force, _ = truth_of(source, seed)
        forecast = PredictionOptions(draws=300, seed=seed)
        prior = source.predict(record, forecast)
        band = predict_given(source, record, forecast, (0.0, 2.2))
        assert band.conditioning.window == (0.0, 2.2)
        unreliable += len(band.remarks)
        errors.append([np.abs(b.median - force)[tail].mean() for b in (prior, band)])
        widths.append([np.mean((b.upper - b.lower)[tail]) for b in (prior, band)])
        coverages.append(np.mean(((force >= band.lower) & (force <= band.upper))[tail]))
    prior_width, posterior_width = np.mean(widths, axis=0)
    assert posterior_width < 0.7 * prior_width
    prior, posterior = np.mean(errors, axis=0)
    assert posterior < 0.7 * prior
    assert unreliable <= 1
    assert np.mean(coverages) > 0.65  # 0.95 less four standard errors


@pytest.mark.parametrize("name", MODELS)
def test_a_test_that_is_followed_is_that_which_is_given(name):
    source = predictor(name, scatter=0.1)
    record, _, _ = truth_of(source, 2)
    forecast, index = PredictionOptions(draws=3000, seed=1), 30
    forecaster = OnlinePredictor(source, setting_of(record), forecast, refresh=False)
    for i in range(index):
        step = slice(i, i + 1)
        forecaster.update(record.time[step], record.displacement[step], None, record.force[step])
    later = Trace.from_arrays(record.time[index:], record.displacement[index:])
    followed = forecaster.band(later)
    conditional = predict_given(source, record, forecast, (0.0, float(record.time[index - 1])))
    prior = source.predict(record, forecast)
    draws = [followed.draws, conditional.draws[:, index:]]
    sd = draws[1].std(axis=0)
    size = min(followed.conditioning.effective, conditional.conditioning.effective)
    distance = np.abs(draws[0].mean(axis=0) - draws[1].mean(axis=0)) / sd
    # within the error of two weighted samples, and what blocks of samples leave
    assert np.mean(distance) < 4.0 / np.sqrt(size) + 0.1
    assert np.mean(draws[0].std(axis=0) / sd) == pytest.approx(1.0, abs=8.0 / np.sqrt(size) + 0.1)
    assert np.mean(prior.draws[:, index:].std(axis=0) / sd) > 1.02  # the control


def test_a_refreshed_forecaster_knows_what_is_given():
    source = known_but_for_the_offset()
    record, force, values = truth_of(source, 3)
    forecaster = OnlinePredictor(source, setting_of(record), PredictionOptions(draws=500))
    forecaster.update(record.time[:80], record.displacement[:80], None, record.force[:80])
    band = forecaster.band(Trace.from_arrays(TIME[80:], record.displacement[80:]))
    sd = 0.05 / np.sqrt(80)
    assert np.median(band.values["offset"]) == pytest.approx(values["offset"], abs=5.0 * sd)
    assert band.values["offset"].std() < 2.0 * sd
    assert np.mean(np.abs(band.median - force[80:])) < 0.02 * np.ptp(force)
    assert forecaster.time == record.time[79]


@pytest.mark.parametrize("actuation", [1.4, np.where(TIME < 2.5, 1.0, 2.0), 0.0])
def test_any_actuation_can_be_given_and_followed(actuation):
    laws = {"Fc_fwd": "affine", "Fc_bwd": "affine"}
    source = predictor("three_stage", laws=laws, effect={"level_friction": 0.1})
    record, force, _ = truth_of(source, 2, actuation)
    band = predict_given(source, record, PredictionOptions(draws=200), (0.0, 2.0))
    assert np.mean(np.abs(band.median - force)[TIME > 2.0]) < 0.3 * np.std(force)
    forecaster = OnlinePredictor(
        source, setting_of(record), PredictionOptions(draws=200), refresh=False
    )
    level = np.broadcast_to(actuation, TIME.shape)
    forecaster.update(TIME[:40], record.displacement[:40], level[:40], record.force[:40])
    later = Trace.from_arrays(TIME[40:], record.displacement[40:], level[40:])
    followed = forecaster.band(later)
    assert np.mean(np.abs(followed.median - force[40:])) < 0.4 * np.std(force)


# --- what is refused


def test_what_cannot_be_given_or_follow_is_one_sentence():
    source = predictor("lugre")
    record, _, _ = truth_of(source)
    for trace, kind, window, words in (
        (record, "mean", (0.0, 1.0), "condition_on is for the kinds"),
        (record, "new_test", (0.0, 60.0), "within the record"),
        (record, "new_test", (1.0, 1.03), "too few"),
        (replace(record, force=0.0 * TIME), "new_test", (0.0, 1.0), "force is zero"),
        (replace(record, force=None), "new_test", (0.0, 1.0), "no force"),
    ):
        with pytest.raises(FitError, match=words):
            predict_given(source, trace, PredictionOptions(kind), window)
    forecaster = OnlinePredictor(
        source, setting_of(record), PredictionOptions(draws=20), refresh=False
    )
    with pytest.raises(FitError, match="a band needs some samples"):
        forecaster.band(record)
    forecaster.update(TIME[:9], record.displacement[:9], None, record.force[:9])
    for arguments, words in (
        ((TIME[:2], [0.0, 0.0], None, [0.0, 0.0]), "time must increase"),
        (([9.0], [np.nan], None, [0.0]), "displacement of an update must be finite"),
        (([9.0], [0.0, 1.0], None, [0.0]), r"displacement of an update must have shape \(1,\)"),
        (([9.0], [0.0], -1.0, [0.0]), "actuation of an update must not be negative"),
    ):
        with pytest.raises(RecordError, match=words):
            forecaster.update(*arguments)
    with pytest.raises(FitError, match="must begin after the last sample"):
        forecaster.band(record)
    idle = OnlinePredictor(
        source, setting_of(motion(0.0)), PredictionOptions(draws=20), refresh=False
    )
    with pytest.raises(RecordError, match="planned without actuation, and now has one"):
        idle.update([0.0], [0.0], 1.0, [0.0])
