"""Advice on populations of given values, whose best next tests have closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.applications.next_test.study import (
    Goals,
    Loop,
    SimulatedDevices,
    advise,
    directions_of,
    fit_left_out,
    gain_of,
)
from mfd_bayes.calibration.noises import find_noise
from mfd_bayes.campaign.candidate import NEW_DEVICE, Candidate, Goal, Limits, parse_goal
from mfd_bayes.errors import CampaignError, NotThereError
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.population.bands import PredictionOptions, Predictor
from mfd_bayes.population.design import TestConditions, setting_of
from tests.population.made import THREE_STAGE, make_population, no_residual

MEDIANS = THREE_STAGE | {"offset": 0.0, "noise_sd": 0.01}
"""At 1 ksi."""

DRAWS = 1600


def make_situation(
    *,
    level=0.05,
    scatter=0.05,
    exponent=0.0,
    effect=1e-9,
    levels=(0.9, 1.0),
    sessions=(),
    devices=(),
    noise=0.01,
) -> tuple[Predictor, tuple[Candidate, ...]]:
    """Slip forces known to `level` at 1 ksi, with a scatter, and an exponent known so well.

    Tests were made at `levels`, in `sessions`, of `devices`; an effect of this size on slip forces
    is known to be 0 for them, and unknown for others. Everything else is known, and the same in all
    tests.
    """
    session_names = [*sessions, *[""] * len(levels)][: len(levels)]
    owned = [*devices, *[""] * len(levels)][: len(levels)]
    settings = [
        TestConditions(p, s, {}, d) for p, s, d in zip(levels, session_names, owned, strict=True)
    ]
    slip = ("Fc_fwd", "Fc_bwd")
    population = make_population(
        settings,
        {"Fc_fwd": "power", "Fc_bwd": "power", "sigma0": "proportional"},
        medians=MEDIANS | {"noise_sd": noise},
        level_sd=dict.fromkeys(slip, level),
        scatter=dict.fromkeys(slip, scatter),
        effect=dict.fromkeys(("level_friction", "session_friction", "device_friction"), effect),
        exponent_sd=exponent,
        shape=(4, DRAWS // 4),
        residual=no_residual(noise_time=0.1),
    )
    design = population.design  # no more is unknown of levels than is said here
    design = replace(design, scatter_sd=np.zeros_like(design.scatter_sd))
    population = replace(population, design=design)
    tests = tuple(Candidate(p, 0.5, 1.0) for p in levels)
    return Predictor(population, ThreeStage(), find_noise("ou")), tests


SLIP = parse_goal("slip at 1000 psi, 0.5 Hz, 1 in", "ksi")
AT_ONE = Candidate(1.0, 0.5, 1.0)
GAP = 0.16
FEW = 200


def ask(situation, goal, *candidates, limits=None, draws=1600):
    return advise(*situation, goal, candidates or (AT_ONE,), limits or Limits(), draws=draws)


@pytest.mark.parametrize(("level", "scatter"), [(0.03, 0.09), (0.08, 0.04)])
def test_one_more_test_of_known_scatter_has_its_closed_form(level, scatter):
    """A test tells the slip force less its scatter: 1/v' = 1/level² + 1/scatter²."""
    (row,) = ask(make_situation(level=level, scatter=scatter), SLIP)
    closed = 1.0 - scatter / np.hypot(level, scatter)
    assert abs(row.reduction - closed) < 2.0 * row.error + 0.01
    assert row.information == pytest.approx(-np.log(1.0 - closed), abs=0.05 + 0.1 * closed)


@pytest.mark.parametrize(
    ("effect", "sessions"), [(1e-9, ()), (0.1, ("a", "a", "b"))], ids=["copies", "a session"]
)
def test_copies_average_their_scatter_but_not_the_effect_of_their_session(effect, sessions):
    situation = make_situation(effect=effect, levels=(1.0, 1.0, 1.0), sessions=sessions)
    advice = ask(situation, SLIP)
    law, shared = 0.05**2, effect**2 if sessions else 0.0
    closed = [1.0 - np.sqrt(1.0 - law / (law * (1 + 1 / n) + shared)) for n in (1, 2, 3)]
    np.testing.assert_allclose([t.reduction for t in advice.together], closed, atol=0.04)
    assert [len(t.candidates) for t in advice.together] == [1, 2, 3]
    np.testing.assert_allclose(advice.curve[0], advice.width)
    assert np.all(np.diff(advice.curve) < 0.01 * advice.width)  # but for the draws' chance
    assert advice.curve[-1] < advice.curve[0]


def test_a_test_of_another_device_has_its_effect_and_one_of_a_known_device_has_not():
    situation = make_situation(effect=0.1, levels=(1.0, 1.0, 1.0), devices=("a", "a", "b"))
    unseen, tested = (Candidate(1.0, 0.5, 1.0, device=d) for d in (NEW_DEVICE, "b"))
    rows = {row.candidate: row for row in ask(situation, SLIP, unseen, tested)}
    for candidate, effect in ((unseen, 0.1), (tested, 0.0)):
        closed = 1.0 - np.sqrt(1.0 - 0.05**2 / (0.05**2 * 2 + effect**2))
        row = rows[candidate]
        assert abs(row.reduction - closed) < 2.0 * row.error + 0.01
        assert row.repeat == (candidate is tested)
    # several new devices average their effects too
    advice = ask(situation, SLIP, unseen)
    closed = [1.0 - np.sqrt(1.0 - 0.05**2 / (0.05**2 + (0.05**2 + 0.1**2) / n)) for n in (1, 2, 3)]
    np.testing.assert_allclose([t.reduction for t in advice.together], closed, atol=0.03)


def test_tests_that_tell_nothing_promise_nothing():
    """Of many sets the best by chance must not be promised what chance gave it."""
    situation = make_situation(level=0.001, scatter=0.05, exponent=0.2)
    goal = parse_goal("exponent of Fc_fwd", "ksi")
    nothing = [Candidate(1.0, f, a) for f in (0.1, 1.0) for a in (0.3, 2.0)]
    advice = ask(situation, goal, *nothing, draws=600)
    assert max(t.reduction for t in advice.together) <= 0.005
    assert max(t.information for t in advice.together) <= 0.01
    assert advice[0].reduction <= 0.015
    tell = [*nothing, Candidate(1.5, 0.5, 1.0)]  # the control
    assert ask(situation, goal, *tell, draws=600).together[0].reduction > 0.3


def test_a_repeat_is_worth_little_where_the_exponent_is_unknown():
    far = parse_goal("slip at 1500 psi, 0.5 Hz, 1 in", "ksi")
    elsewhere = Candidate(1.5, 0.5, 1.0)
    situation = make_situation(level=0.002, scatter=0.002, exponent=0.1)
    rows = {row.candidate: row for row in ask(situation, far, AT_ONE, elsewhere, draws=400)}
    assert rows[AT_ONE].reduction < 0.01
    assert rows[AT_ONE].repeat
    assert rows[elsewhere].reduction > 0.8
    assert not rows[elsewhere].repeat


def test_every_gain_is_positive_and_the_table_is_in_order():
    candidates = [Candidate(p, f, a) for p, f in ((0.5, 0.1), (2.0, 2.0)) for a in (0.02, 1.0)]
    candidates.append(Candidate(1.0, 0.5, 1.0, price=0.0))
    advice = ask(make_situation(exponent=0.2), Goal(), *candidates, draws=FEW)
    assert len(advice) == len(candidates)
    assert all(min(row.reduction, row.information, row.error) >= 0.0 for row in advice)
    assert advice["reduction"] == sorted(advice["reduction"], reverse=True)
    assert [row.candidate for row in advice] == advice["candidate"]
    for key in (99, -9, None, 1.5, [0], "gain"):
        with pytest.raises(NotThereError, match=r"no (row|column) .*reduction"):
            advice[key]
    assert advice[np.int64(-1)] is advice.rows[-1]
    assert advice[:1] == advice.rows[:1]
    assert [row.per_hour for row in advice if row.candidate.price == 0.0] == [np.inf]


def test_forbidden_candidates_are_never_proposed():
    fast, long = Candidate(1.0, 2.0, 1.0), Candidate(1.0, 0.1, 4.0)
    strong = Candidate(9.0, 0.5, 1.0)
    situation = make_situation(exponent=0.2)
    limits = Limits(velocity=8.0, stroke=6.0, force=8.0)
    candidates = AT_ONE, fast, long, strong
    advice = ask(situation, Goal(), *candidates, limits=limits, draws=FEW)
    assert dict(advice.ruled_out) == {fast: "velocity", long: "stroke", strong: "force"}
    proposed = {row.candidate for row in advice}
    proposed |= {c for together in advice.together for c in together.candidates}
    assert proposed == {AT_ONE}
    unlimited = ask(situation, Goal(), *candidates, draws=FEW)
    assert {row.candidate for row in unlimited} == {AT_ONE, fast, long, strong}  # the control
    for limits, name in ((Limits(stroke=0.1), "stroke"), (Limits(force=0.001), "force")):
        with pytest.raises(CampaignError, match=name):
            ask(make_situation(), Goal(), limits=limits)
    for quantity, of in (("exponent", "Fc_fwd"), ("slope", "Fy_fwd")):  # fixed; not inferred
        with pytest.raises(CampaignError, match=of):
            ask(make_situation(), Goal(quantity, of))


def test_goal_and_simulated_tests_are_those_of_the_predictions():
    """The same quantiles as `run.predict`, which draws parameters of its own."""
    predictor, _ = make_situation(level=0.05, scatter=0.08)
    loop = Loop.of(AT_ONE, GAP)
    rng = np.random.default_rng(0)
    settings = [setting_of(loop.trace)]
    devices = SimulatedDevices.draw(predictor, settings, 1600, rng)
    for kind, scattered in (("mean", False), ("new_test", True)):
        ours = devices.damper(loop, "", scattered=scattered, seed=(1,))
        band = predictor.predict(loop.trace, PredictionOptions(kind, draws=1600))
        middle = (3 * loop.first + loop.trace.samples) // 4 + 3  # in slip, backward
        widths = [np.ptp(np.quantile(d[:, middle], [0.05, 0.95])) for d in (ours, band.draws)]
        assert widths[0] == pytest.approx(widths[1], rel=0.1)


# --- the loop of a candidate


@pytest.mark.parametrize("waveform", ["sine", "triangle"])
def test_a_loop_is_a_full_stroke_and_then_a_full_loop(waveform):
    loop = Loop.of(Candidate(1.0, 0.5, 1.0, waveform=waveform), GAP)
    x, t = loop.trace.displacement, loop.trace.time
    assert x[0] == pytest.approx(-1.0)
    assert x[loop.first] == pytest.approx(1.0)
    assert x[-1] == pytest.approx(1.0)
    assert x.min() == pytest.approx(-1.0)
    assert t[-1] - t[loop.first] == pytest.approx(2.0)
    assert np.all(np.diff(t) > 0)
    assert x.size < 70
    fastest = np.abs(loop.trace.velocity).max()
    assert fastest == pytest.approx(Candidate(1.0, 0.5, 1.0, waveform=waveform).speed, rel=0.02)


# --- remaining variance and information where both have a closed form

MANY = 20_000


def linear_gaussian(seed, noise):
    """Draws of goals A u and of summaries B u + noise of standard normal u (6,).

    And the covariance of the goals before and after the summaries are known.
    """
    rng = np.random.default_rng(seed)
    a, b = np.linalg.qr(rng.standard_normal((6, 3)))[0].T, rng.standard_normal((5, 6))
    sd, u = noise * rng.uniform(0.5, 2.0, 5), rng.standard_normal((MANY, 6))
    summaries = u @ b.T + sd * rng.standard_normal((MANY, 5))
    prior_cov = a @ a.T
    posterior_cov = prior_cov - a @ b.T @ np.linalg.inv(b @ b.T + np.diag(sd**2)) @ b @ a.T
    return u @ a.T, summaries, prior_cov, posterior_cov


def judged(goals, summaries):
    residual = fit_left_out(goals, directions_of(summaries))
    return gain_of(Goals(goals), residual), residual


@pytest.mark.parametrize("noise", [0.3, 3.0])
def test_a_linear_gaussian_population_gives_its_closed_form(noise):
    for seed in range(3):
        goals, summaries, prior_cov, posterior_cov = linear_gaussian(seed, noise)
        gain, residual = judged(goals, summaries)
        reduction = 1.0 - np.sqrt(np.diag(posterior_cov)).sum() / np.sqrt(np.diag(prior_cov)).sum()
        assert abs(gain.reduction - reduction) < 4.0 * gain.error + 0.005  # which a penalty costs
        information = 0.5 * (np.linalg.slogdet(prior_cov)[1] - np.linalg.slogdet(posterior_cov)[1])
        assert abs(gain.information - information) < 4.0 * gain.information_error
        closed = np.diag(posterior_cov) / np.diag(prior_cov)
        share = residual.var(axis=0) / goals.var(axis=0)
        np.testing.assert_allclose(share, closed, rtol=4.0 * np.sqrt(4.0 / MANY))


def test_a_test_that_tells_nothing_has_no_gain():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        goals = rng.standard_normal((1000, 2))
        gain, _ = judged(goals, rng.standard_normal((1000, 8)))
        assert 0.0 <= gain.reduction < 0.004
        assert 0.0 <= gain.information < 0.01
