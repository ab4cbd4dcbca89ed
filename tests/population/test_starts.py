"""Where new tests begin is learned from where the calibrated ones began."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from mfd_bayes.calibration.priors import Prior
from mfd_bayes.friction.lugre import LuGre
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.population.settings import Setting
from mfd_bayes.population.starts import Standing, learned, left_by
from mfd_bayes.records.trace import Trace

LEFT = np.array([0.2, 0.7, 0.35, 0.6, 0.8, 0.3])
"""Places where the motions of six tests leave the device."""

THETA = np.array([[200.0, 0.02, 0.01, 3.0, 2.8, 3.2, 3.0, 2.0, 37.0, 0.2, 0.1, 1.0, 0.01, 0.5]])


def draws_of(begun, left, seed=0):
    """Places of new tests, whose motion leaves the device at 0.75."""
    rng = np.random.default_rng(seed)
    asked = None if left is None else (left, 0.75)
    return learned(np.tile(begun, (4000, 1)), asked, rng).draw(rng, lambda: None)


def motion(last):
    """Three strokes from 0 that end at a displacement after going forward."""
    corners = [0.0, 1.0, -1.0, last]
    displacement = np.concatenate([np.linspace(a, b, 40)[1:] for a, b in pairwise(corners)])
    return Trace.from_arrays(0.02 * np.arange(displacement.size), displacement, 1.0)


def test_tests_that_begin_where_they_end_say_where_a_new_one_begins():
    found = draws_of(LEFT + np.array([0.03, -0.02, 0.01, 0.0, -0.03, 0.02]), LEFT)
    assert found.mean() == pytest.approx(0.75, abs=0.03)
    assert found.std() < 0.12


def test_tests_that_begin_elsewhere_do_not():
    found = draws_of(1.0 - LEFT, LEFT)
    assert found.mean() == pytest.approx(0.5, abs=0.08)
    assert found.std() > 0.15


def test_one_test_says_little():
    one, six = (draws_of(LEFT[:n] + 0.05, LEFT[:n]) for n in (1, 6))
    assert 0.5 < one.mean() < 0.7
    assert one.std() > 1.3 * six.std()


def test_without_the_motion_tests_begin_about_the_middle():
    found = draws_of(np.full(6, 0.5), None)
    assert found.mean() == pytest.approx(0.5, abs=0.01)
    assert found.std() < 0.12


def test_a_motion_leaves_the_device_where_its_last_stroke_ends():
    # the gap is 0.3 in wide: after 0.1 in from the backward end it stands at a third of it
    place = left_by(ThreeStage(), THETA, motion(-0.9))
    back = left_by(ThreeStage(), THETA, motion(0.0))
    assert place == pytest.approx(1.0)  # the way back to 0 is longer than the gap
    assert back == pytest.approx(1.0)
    shifted = motion(-0.9)
    shifted = Trace.from_arrays(shifted.time, np.append(-0.9, shifted.displacement[1:]), 1.0)
    assert left_by(ThreeStage(), THETA, shifted) == pytest.approx(1.0 / 3.0, abs=0.02)


def test_the_start_counts_along_the_first_direction():
    one = motion(-0.9)
    x = np.append(-0.9, one.displacement[1:])
    forward = Trace.from_arrays(one.time, x, 1.0)
    backward = Trace.from_arrays(one.time, -x, 1.0)
    found = [left_by(ThreeStage(), THETA, trace) for trace in (forward, backward)]
    assert found[0] == pytest.approx(found[1])


def test_a_motion_ends_as_one_that_is_made_again():
    model, one = ThreeStage(), motion(0.05)
    x = np.concatenate([one.displacement, [0.0], one.displacement])
    twice = Trace.from_arrays(0.02 * np.arange(x.size), x, 1.0)
    start = np.array([left_by(model, THETA, one)])
    again = model.force(THETA, one, start)[0, 3:]  # once the bristles are bent as before
    second = model.force(THETA, twice)[0, 3 - one.samples :]
    assert np.max(np.abs(again - second)) < 0.05 * np.ptp(second)
    wrong = model.force(THETA, one, 1.0 - start)[0, 3:]
    assert np.max(np.abs(wrong - second)) > 0.3 * np.ptp(second)


def test_a_model_that_does_not_say_where_motions_end_has_no_place():
    class Silent(ThreeStage):
        end = Model.end

    assert left_by(Silent(), THETA, motion(0.0)) is None
    assert left_by(LuGre(), THETA[:, :8], motion(0.0)) is None


def test_only_motions_as_long_as_the_tests_begin_like_them(make_population):
    known = make_population()
    settings = [
        replace(s, covariates={"amplitude": 1.0, "velocity": 3.1}) for s in known.layout.settings
    ]
    begun = np.broadcast_to(0.3, (*known.h.shape[:2], len(settings)))
    population = replace(
        known,
        layout=replace(known.layout, settings=tuple(settings)),
        starts=begun,
        left=np.full(len(settings), 0.3),
    )
    rng = np.random.default_rng(0)
    like, shorter = (Setting(1.0, "", {"amplitude": a, "velocity": 3.0}) for a in (1.0, 0.5))
    near = population.draw_starts(rng, 4000, like, Standing(lambda: 0.7))
    assert near.mean() > population.draw_starts(rng, 4000, like, Standing(lambda: 0.3)).mean() + 0.2
    anywhere = population.draw_starts(rng, 4000, shorter, Standing(lambda: 0.7))
    assert anywhere.std() == pytest.approx(1.0 / np.sqrt(12.0), rel=0.05)


def test_a_start_that_is_fixed_is_kept(make_population):
    known = make_population()
    fixed = {**known.priors, "start": Prior("fixed", {"value": 0.9})}
    rng = np.random.default_rng(0)
    found = replace(known, priors=fixed).draw_starts(rng, 1000)
    np.testing.assert_allclose(found, 0.9, atol=2e-3)
    assert known.draw_starts(rng, 1000).std() > 0.25
