"""What measured peaks have above computed ones: learned, and given to new tests."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mfd_bayes import open_run
from mfd_bayes.evaluation.properties import predicted_rows, properties_of
from mfd_bayes.population.peaks import (
    NO_EXCESS,
    PRIOR_SCATTER,
    PeakExcess,
    certain,
    of_mean,
)
from mfd_bayes.records.trace import Harmonic
from mfd_bayes.runs.run import sequence_of
from mfd_bayes.store.netcdf import StoredTest

DATA = Path(__file__).parents[1] / "data" / "run"
CAMPAIGNS, TESTS = 400, 8
PEAK = 3.0  # kip


def coverage(of, scatter, new):
    """Share of new tests, or of their mean, inside the 80 % interval of what others show."""
    rng, hits = np.random.default_rng(1), []
    for _ in range(CAMPAIGNS):
        speed, peak = rng.uniform(0.5, 7.0, TESTS + 1), np.full(TESTS + 1, PEAK)
        excess = 0.15 * speed + scatter * rng.standard_normal(TESTS + 1)
        learned = of({"fwd": PeakExcess.of(excess[1:], speed[1:], peak[1:])})["fwd"]
        scores = learned.scores(rng, (500,))
        predicted = learned.seen(peak[0], speed[0], np.array(2.5), scores)
        low, high = np.quantile(predicted - peak[0], [0.1, 0.9])
        hits.append(low <= (excess[0] if new else 0.15 * speed[0]) <= high)
    return np.mean(hits)


def test_intervals_of_a_new_test_and_of_the_mean_hold_its_peak_as_often_as_stated():
    error = 4.0 * np.sqrt(0.8 * 0.2 / CAMPAIGNS)
    # twice the scatter that the prior expects, and for the mean as much as it expects
    for of, scatter, new in ((dict, 0.3, True), (of_mean, PRIOR_SCATTER * PEAK, False)):
        assert abs(coverage(of, scatter, new) - 0.8) < error
        assert abs(coverage(certain, scatter, new) - 0.8) > error  # one that is certain is seen


def test_an_excess_is_one_of_force_that_grows_with_the_speed():
    speed = np.array([1.0, 2.0, 4.0])
    learned = PeakExcess.of(0.2 * speed, speed, np.full(3, 3.0))
    assert learned.rate == pytest.approx(0.2)
    low, high = (learned.seen(5.0, v, np.array(4.0), np.zeros(1)) for v in (1.0, 6.0))
    assert (low, high) == (pytest.approx(5.2), pytest.approx(6.2))
    assert PeakExcess.of(speed, np.zeros(3), speed) == PeakExcess()


def test_a_damper_that_does_not_slip_has_less_of_it():
    excess, slip = PeakExcess(rate=0.5), np.array(2.0)
    largest = np.array([0.0, 1.0, 2.0, 3.0])
    assert excess.seen(largest, 1.0, slip, np.zeros(4)) == pytest.approx([0.0, 1.25, 2.5, 3.5])
    peaks = replace(excess, rate=-9.0).seen(largest, 1.0, slip, np.zeros(4))
    assert peaks == pytest.approx([0.0, 1.0, 2.0, 2.0])


def test_the_bound_of_a_sum_adds_the_scatter_of_both_by_squares():
    excess, rng = PeakExcess(0.2, 0.01, 0.3, 200.0), np.random.default_rng(2)
    slip = 3.0 + 0.4 * rng.standard_normal(200_000)
    sums = np.quantile(
        excess.seen(slip, 5.0, np.array(np.nan), excess.scores(rng, slip.shape)), [0.025, 0.975]
    )
    for total, sign, probability in zip(sums, (-1.0, 1.0), (0.025, 0.975), strict=True):
        at_bound = np.array(3.0 + sign * 1.96 * 0.4)
        spread = np.abs(at_bound - 3.0)
        score = excess.bound(probability, spread, np.array(5.0))
        assert excess.seen(at_bound, 5.0, np.array(np.nan), score) == pytest.approx(total, abs=0.02)


@pytest.mark.parametrize("rate", [-5.0, 0.0, 0.3])
def test_no_predicted_peak_is_below_the_slip_force_of_its_draw(rate):
    run = open_run(DATA)
    peaks = dict.fromkeys(NO_EXCESS, PeakExcess(rate, 0.1, 0.5, 3.0))
    trace = Harmonic(1.0, 0.5, 2).trace(0.7)
    properties = properties_of(trace, run.predict(trace, draws=200).draws, peaks)
    for side in ("fwd", "bwd"):
        assert np.all(properties[f"peak_{side}"] >= properties[f"slip_{side}"])
        assert np.all(properties[f"peak_{side}"] == properties[f"slip_{side}"]) == (rate < 0.0)
    run = replace(
        run, manifest=run.manifest.changed(peak_excess={k: vars(e) for k, e in peaks.items()})
    )
    rows = {row["name"]: row for row in predicted_rows(run, trace, run.predict(trace, draws=200))}
    assert rows["peak_fwd"]["median"] >= rows["slip_fwd"]["median"]


def test_the_excess_is_learned_on_the_forces_to_which_it_is_applied(monkeypatch):
    run = open_run(DATA)
    learned, values = run.with_peaks().peaks, StoredTest.values
    assert all(excess.tests == len(run.tests) for excess in learned.values())

    def with_static_friction(stored):
        return {**values(stored), "static_excess_fwd": np.full_like(values(stored)["offset"], 0.6)}

    monkeypatch.setattr(StoredTest, "values", with_static_friction)
    assert open_run(DATA).with_peaks().peaks == learned
    isolated = open_run(DATA)
    vars(isolated)["_sequence"] = replace(sequence_of(isolated), pooled=lambda _: {})
    assert isolated.with_peaks().peaks != learned  # a test's own posterior would be seen
