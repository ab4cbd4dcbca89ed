"""A forecaster that follows a synthetic test of a known population."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.errors import FitError, RecordError
from mfd_bayes.friction.model import Model
from mfd_bayes.population import follow, given, tempering
from mfd_bayes.population.follow import Forecaster
from mfd_bayes.population.bands import Forecast
from mfd_bayes.population.given import predict_given
from mfd_bayes.population.incoming import AHEAD, Incoming
from mfd_bayes.population.bands import Predictor
from mfd_bayes.population.settings import planned_setting, setting_of
from mfd_bayes.records.trace import Trace


@pytest.fixture(scope="module")
def tools(benchmark_module):
    return benchmark_module("given.study")


@pytest.fixture(scope="module")
def study(tools):
    return tools.make_study()


@pytest.fixture(scope="module")
def truth(tools, study):
    return tools.draw_truth(study, np.random.default_rng(11))


@pytest.fixture
def make(study, monkeypatch):
    monkeypatch.setattr(follow, "TRIED", 500)
    monkeypatch.setattr(given, "TRIED", 500)
    monkeypatch.setattr(given, "POINTS", 600)
    monkeypatch.setattr(tempering, "MOST", 12)
    monkeypatch.setattr(tempering, "MOST_LAST", 40)

    def forecaster(**options):
        forecast = Forecast(options.pop("kind", "new_test"), draws=options.pop("draws", 300))
        setting = setting_of(study.motion)
        setting = replace(setting, actuation=options.pop("planned", setting.actuation))
        return Forecaster(study.predictor, setting, forecast, study.pace, **options)

    return forecaster


def feed(forecaster, trace, begin, end, size=16, actuation=1.0):
    """Give samples from `begin` up to `end` of a record, some at a time."""
    for at in range(begin, end, size):
        part = slice(at, min(at + size, end))
        columns = trace.time[part], trace.displacement[part], actuation, trace.force[part]
        forecaster.update(*columns)


def rest(trace, begin, actuation=None):
    return Trace.from_arrays(trace.time[begin:], trace.displacement[begin:], actuation)


def test_it_knows_what_a_given_part_says(make, study, truth):
    at = 64
    forecaster = make()
    feed(forecaster, truth.trace, 0, at)
    assert forecaster.time == truth.trace.time[at - 1]
    band = forecaster.band(rest(truth.trace, at))
    window = 0.0, float(truth.trace.time[at - 1])
    whole = predict_given(study.predictor, truth.trace, Forecast(draws=300), window, study.pace)
    width = np.mean((whole.upper - whole.lower)[at:])
    assert np.mean(band.upper - band.lower) == pytest.approx(width, rel=0.25)
    assert np.mean(np.abs(band.median - whole.median[at:])) < 0.25 * width
    inside = (band.lower <= truth.damper[at:]) & (truth.damper[at:] <= band.upper)
    assert np.mean(inside) > 0.8
    assert band.given.method == "sampling"
    assert band.given.window[1] == forecaster.time


def test_a_band_that_may_not_wait_says_so(make, truth):
    forecaster = make(refresh=False)
    feed(forecaster, truth.trace, 0, 64)
    assert forecaster.pareto_k > 0.7
    (remark,) = forecaster.band(rest(truth.trace, 64)).remarks
    assert "call refresh() in a pause of the test" in remark
    forecaster.refresh()
    assert not forecaster.pareto_k > 0.7
    assert not forecaster.band(rest(truth.trace, 64)).remarks


def test_blocks_do_not_matter(make, truth):
    found = []
    for size in (1, 5, 14):
        forecaster = make(refresh=False)
        feed(forecaster, truth.trace, 0, 14, size)
        found.append(forecaster.band(rest(truth.trace, 14)))
    width = np.mean(found[0].upper - found[0].lower)
    for other in found[1:]:
        assert np.max(np.abs(other.median - found[0].median)) < 0.1 * width


def test_before_the_first_motion_the_motion_that_follows_tells_the_side(make, truth):
    trace, still = truth.trace, np.arange(1, 20) / 32.0
    forecaster = make()
    forecaster.update(still, np.zeros(19), 1.0, np.full(19, 0.04) + truth.values["offset"])
    assert forecaster.pareto_k == -np.inf  # nothing is weighed yet
    sides = []
    for sign in (1.0, -1.0):
        motion = Trace.from_arrays(1.0 + trace.time, sign * trace.displacement)
        sides.append(forecaster.band(motion))
    for band in sides:
        np.testing.assert_allclose(band.median[0], 0.04, atol=0.08)
    assert sides[0].median[40] * sides[1].median[40] < 0


def test_another_actuation_moves_the_force(make, truth):
    forecaster = make(refresh=False)
    feed(forecaster, truth.trace, 0, 2)  # of which the weights of many draws can be trusted
    usual = forecaster.band(rest(truth.trace, 2))
    pressed = forecaster.band(rest(truth.trace, 2, actuation=2.0))
    assert usual.given.pareto_k < 0.7
    assert np.ptp(pressed.median) > 1.6 * np.ptp(usual.median)


def test_a_test_may_be_at_another_actuation_than_planned(make, study, truth):
    at = 64
    forecaster = make(planned=1.4)
    feed(forecaster, truth.trace, 0, at, actuation=1.0)
    band = forecaster.band(rest(truth.trace, at, actuation=1.0))
    assert band.given.method == "sampling"
    inside = (band.lower <= truth.damper[at:]) & (truth.damper[at:] <= band.upper)
    assert np.mean(inside) > 0.8
    # the control: the actuation is said to have been another, so that the force then is less
    forecaster = make(planned=1.4)
    feed(forecaster, truth.trace, 0, at, actuation=1.4)
    band = forecaster.band(rest(truth.trace, at, actuation=1.0))
    inside = (band.lower <= truth.damper[at:]) & (truth.damper[at:] <= band.upper)
    assert np.mean(inside) < 0.6


def test_a_band_of_observations_is_wider(make, truth):
    wide = []
    for kind in ("new_test", "observation"):
        forecaster = make(kind=kind, refresh=False)
        feed(forecaster, truth.trace, 0, 20)
        band = forecaster.band(rest(truth.trace, 20))
        wide.append(np.mean(band.upper - band.lower))
    assert wide[1] > wide[0]


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        (([0.1, 0.1], [0, 0], 1.0, [0, 0]), "time must increase; it does not at sample 1"),
        (([0.1, 0.2], [0], 1.0, [0, 0]), r"displacement of an update must have shape \(2,\)"),
        (([0.1, 0.2], [0, np.nan], 1.0, [0, 0]), "displacement of an update must be finite"),
        (([0.1, 0.2], [0, 0], -1.0, [0, 0]), "actuation of an update must not be negative"),
    ],
)
def test_samples_that_are_none_are_refused(make, columns, said):
    with pytest.raises(RecordError, match=said):
        make().update(*columns)


def test_what_comes_too_early_is_refused(make, study, truth):
    forecaster = make()
    with pytest.raises(FitError, match="a band needs some samples"):
        forecaster.band(study.motion)
    feed(forecaster, truth.trace, 0, 32)
    with pytest.raises(RecordError, match="time must increase"):
        feed(forecaster, truth.trace, 0, 32)
    with pytest.raises(FitError, match="must begin after the last sample"):
        forecaster.band(study.motion)


def test_a_model_without_steps_cannot_be_followed(study):
    class Rigid(Model):
        name = "rigid"
        quantities = ()

    predictor = Predictor(study.predictor.population, Rigid(), study.predictor.noise)
    with pytest.raises(FitError, match="rigid has no steps"):
        Forecaster(predictor, setting_of(study.motion), Forecast(), study.pace)


def test_samples_are_averaged_and_rest_is_one():
    incoming = Incoming(wanted=0.0625, stroke=1.0)  # sixteen samples of a quick record
    time = np.arange(64) / 256.0
    noise = 2e-4 * np.sin(1e4 * time)
    assert incoming.take(time, noise, 1.0, np.arange(64.0)).tolist() == [AHEAD]
    trace = incoming.trace()
    assert incoming.direction == 0
    assert trace.samples == AHEAD + 1
    assert trace.force[AHEAD] == pytest.approx(31.5)
    later = 0.25 + np.arange(40) / 256.0
    new = incoming.take(later, -0.1 * (later - 0.25), 1.0, np.full(40, 100.0))
    assert new.tolist() == [AHEAD + 1, AHEAD + 2]
    assert incoming.direction == -1
    np.testing.assert_allclose(incoming.trace().force[AHEAD:], [31.5, 100.0, 100.0])
    assert incoming.time == later[-1]


def test_the_velocity_is_that_at_the_sample_and_stays():
    incoming = Incoming(wanted=0.0625, stroke=1e-6)  # without play
    time = np.cumsum(np.tile([0.05, 0.08], 10))
    incoming.take(time[:12], time[:12] ** 2, 1.0, np.zeros(12))
    begun = incoming.trace().velocity
    incoming.take(time[12:], time[12:] ** 2, 1.0, np.zeros(8))
    velocity = incoming.trace().velocity
    np.testing.assert_allclose(velocity[AHEAD + 2 :], 2.0 * time[2:], rtol=1e-4)
    np.testing.assert_array_equal(velocity[: begun.size], begun)


def test_what_was_given_is_told_without_what_was_made_up(make, truth):
    forecaster = make(refresh=False)
    feed(forecaster, truth.trace, 0, 64)
    given = forecaster.band(rest(truth.trace, 64)).given
    assert given.method == "weights"
    assert given.window == (truth.trace.time[0], truth.trace.time[63])
    assert given.samples <= 64
    k = forecaster.pareto_k
    forecaster.refresh()
    sampled = forecaster.band(rest(truth.trace, 64)).given
    assert sampled.method == "sampling"
    assert sampled.pareto_k == k  # that of the weights which it replaces
    assert sampled.window == given.window


def test_a_test_without_actuation_can_be_followed(make, truth):
    forecaster = make(planned=0.0, refresh=False)
    feed(forecaster, truth.trace, 0, 64, actuation=0.0)
    band = forecaster.band(rest(truth.trace, 64))
    assert np.all(np.isfinite(band.draws))
    with pytest.raises(RecordError, match="planned without actuation, and now has one"):
        forecaster.band(rest(truth.trace, 64, actuation=0.5))
    with pytest.raises(RecordError, match="planned without actuation, and now has one"):
        feed(forecaster, truth.trace, 64, 80, actuation=0.5)


def test_a_covariate_that_is_no_number_is_refused(study):
    tested = study.predictor.population.layout.settings
    for value in ("3 in/s", -1.0, np.nan):
        with pytest.raises(FitError, match=f"planned velocity must be above zero.*{value}"):
            planned_setting(tested, 1.0, "", {"velocity": value})
