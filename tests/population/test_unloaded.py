"""Tests of devices that are put to rest without load begin inside the gap."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad

from mfd_bayes.friction.backlash import BacklashLuGre
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.friction.weakened import Weakened
from mfd_bayes.population.setting import Setting
from mfd_bayes.population.starts import Standing, StartDensity, anywhere
from mfd_bayes.population.unloaded import BEFORE, Unloaded, chance_of

N = 4000

THETA = {
    "k_fwd": 45.0,
    "k_bwd": 50.0,
    "gap": 0.2,
    "ell": 0.01,
    "k_0": 0.5,
    "Fc_fwd": 7.0,
    "Fc_bwd": 6.0,
    "n": 1.5,
    "sigma2": 0.01,
    "static_excess_fwd": 0.1,
    "static_excess_bwd": 0.1,
    "v_s": 0.5,
}


def values(n=1, **others):
    """Quantities of n dampers of the backlash model."""
    return {name: np.full(n, value) for name, value in (THETA | others).items()}


def part(lower=0.3, upper=0.7, edge=0.04, n=N):
    """Where n devices bear no load."""
    return Unloaded(*(np.full(n, value) for value in (lower, upper, edge)))


def test_a_device_without_load_bears_a_fifth_of_its_slip_force_at_most():
    model, known = BacklashLuGre(), values()
    theta = model.theta(known)
    lower, upper, edge = (float(value[0]) for value in model.unloaded(known))

    def force(start):
        return float(model.start(theta, np.array([start])).bent[1][0])

    assert force(lower) == pytest.approx(-0.2 * 6.0, rel=1e-3)
    assert force(upper) == pytest.approx(0.2 * 7.0, rel=1e-3)
    assert force(upper + edge) == pytest.approx(0.4 * 7.0, rel=0.1)
    assert abs(force(0.5 * (lower + upper))) < 0.01 * 6.0
    # control: half way from the gap to slip it bears far more
    assert min(force(0.5 * (1.0 + upper)), -force(0.5 * lower)) > 0.4 * 6.0


@pytest.mark.parametrize(
    "others", [{"gap": 0.0}, {"gap": 0.0, "ell": 90.0}, {"gap": 1e6}, {"ell": 1e-9}]
)
def test_odd_gaps_have_a_density_too(others):
    part = Unloaded(*BacklashLuGre().unloaded(values(50, **others)))
    drawn = part.draw(np.random.default_rng(0))
    assert np.all((drawn > 0.0) & (drawn < 1.0))
    assert np.all(np.isfinite(part.log_density(drawn)))


def test_models_say_where_load_begins_or_that_there_is_none():
    assert ThreeStage().unloaded(values()) is None
    weakened = Weakened(BacklashLuGre()).unloaded(values())
    np.testing.assert_array_equal(weakened, BacklashLuGre().unloaded(values()))


@pytest.mark.parametrize("shape", [(0.3, 0.7, 0.04), (0.0, 0.4, 0.2), (0.45, 0.5, 9.0)])
def test_the_density_is_that_of_what_is_drawn(shape):
    one = part(*shape, n=1)
    total = quad(lambda w: np.exp(one.log_density(np.array([w]))[0]), 0.0, 1.0, limit=200)[0]
    assert total == pytest.approx(1.0, abs=1e-6)
    drawn = part(*shape).draw(np.random.default_rng(2))
    at = np.linspace(0.0, 1.0, 2001)
    some = Unloaded(*(np.full(at.size, value) for value in shape))
    curve = np.exp(some.log_density(at))
    curve = np.concatenate([[0.0], np.cumsum(0.5 * (curve[1:] + curve[:-1]) * np.diff(at))])
    assert stats.kstest(drawn, lambda w: np.interp(w, at, curve)).pvalue > 1e-3
    # control
    assert (
        stats.kstest(np.clip(drawn + 0.05, 0, 1), lambda w: np.interp(w, at, curve)).pvalue < 1e-3
    )


def test_tests_that_begin_without_load_say_that_others_do():
    rng = np.random.default_rng(3)
    without = [(part().draw(rng), part()) for _ in range(8)]
    assert chance_of(without) > 0.99
    one = 2.4 * BEFORE  # the gap is two fifths of the range, but for its soft ends
    assert chance_of(without[:1]) == pytest.approx(one / (one + 1.0 - BEFORE), abs=0.01)
    assert chance_of([]) == pytest.approx(BEFORE)
    loaded = [(rng.uniform(0.9, 1.0, N), part()), *without[1:]]
    assert chance_of(loaded) < 0.1


def test_a_logit_has_the_density_of_its_place():
    rng = np.random.default_rng(4)
    density = anywhere(rng, N, 0.5, Standing(unloaded=part()))
    assert 0.4 < density.instead.mean() < 0.6
    one = np.array([np.flatnonzero(density.instead)[0], np.flatnonzero(~density.instead)[0]])
    for label in one:
        chosen = np.full(4001, label)
        t = np.linspace(-20.0, 20.0, chosen.size)
        log = density.log_shape(t, chosen) - density.log_size[label]
        assert np.trapezoid(np.exp(log), t) == pytest.approx(1.0, abs=1e-3)
    drawn = density.draw(rng)
    assert stats.kstest(drawn[~density.instead], "uniform").pvalue > 1e-3
    assert np.mean((drawn > 0.25) & (drawn < 0.75), where=density.instead) > 0.95


def test_without_such_a_part_nothing_is_drawn_for_it():
    before, after = np.random.default_rng(5), np.random.default_rng(5)
    found = anywhere(after, N, 0.9, Standing())
    np.testing.assert_array_equal(found.draw(after), before.beta(np.ones(N), np.ones(N)))
    plain = StartDensity(np.ones(2), np.ones(2))
    assert np.all(plain.log_size == 0.0)


def test_short_motions_begin_without_load_where_the_tests_did(make_population):
    known = make_population()
    settings = [replace(s, covariates={"amplitude": 1.0}) for s in known.layout.settings]
    begun = np.broadcast_to(0.5, (*known.h.shape[:2], len(settings)))
    layout = replace(known.layout, settings=tuple(settings))
    population = replace(known, layout=layout, starts=begun, unloaded=1.0)
    rng = np.random.default_rng(6)
    like, shorter = (Setting(1.0, "", {"amplitude": a}) for a in (1.0, 0.5))
    standing = Standing(unloaded=part())
    within = [
        np.mean(np.abs(population.draw_starts(rng, N, setting, standing) - 0.5) < 0.25)
        for setting in (shorter, None, like)
    ]
    assert min(within[:2]) > 0.95
    anywhere = replace(population, unloaded=0.0).draw_starts(rng, N, shorter, standing)
    assert stats.kstest(anywhere, "uniform").pvalue > 1e-3
    # those like the tests begin where these show it, whatever load that is
    same = Standing(unloaded=part(0.0, 0.1))
    assert abs(population.draw_starts(rng, N, like, same).mean() - 0.5) < 0.05
