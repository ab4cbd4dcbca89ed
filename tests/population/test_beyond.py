"""Bands are wider for motions that lie outside those of the calibrated tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.population.population import RATE, STROKE, folds_beyond, unknown_beyond
from mfd_bayes.population.settings import Setting


def setting(stroke: float, speed: float) -> Setting:
    return Setting(1.0, "", {"amplitude": stroke, "velocity": speed})


TESTED = [setting(0.5, 1.0), setting(1.5, 3.0), setting(1.0, 6.0)]


@pytest.mark.parametrize(
    ("asked", "stroke", "rate"),
    [
        (setting(1.0, 3.0), 0.0, 0.0),
        (setting(0.5, 0.01), 0.0, 0.0),  # slow: every test passes through all speeds
        (setting(0.5 / np.e, 1.0 / np.e), 1.0, 0.0),
        (setting(1.5 * np.e**2, 3.0), 2.0, 0.0),
        (setting(1.0, 6.0 * np.e), 0.0, 1.0),
        (setting(1.5 * np.e, 6.0 * np.e), 1.0, 1.0),
        (setting(0.5, 6.0), 0.0, np.log(2.0)),  # stroke and speed as tested, twice the frequency
    ],
)
def test_folds_are_counted_from_the_nearest_test(asked, stroke, rate):
    assert folds_beyond(asked, TESTED) == pytest.approx((stroke, rate))


def test_unknown_motions_and_tests_are_not_outside():
    assert folds_beyond(Setting(1.0), TESTED) == (0.0, 0.0)
    assert folds_beyond(TESTED[0], [Setting(1.0)]) == (0.0, 0.0)


def test_what_differs_between_tests_may_be_another_outside(make_population):
    population = make_population()
    layout = replace(population.layout, settings=tuple(TESTED))
    outside, inside = setting(0.5 / np.e, 0.3), setting(1.0, 3.0)
    found = {layout.names[k]: sd for _, k, sd in unknown_beyond(layout, outside, 3)}
    assert {"Fc_fwd", "Fc_bwd", "sigma0", "d2"} <= set(found)
    assert not {"k2", "k3", "ell", "offset", "noise_sd"} & set(found)
    k = layout.names.index("d2")
    assert found["d2"] * layout.spread[k] == pytest.approx(np.full(3, STROKE))
    assert unknown_beyond(layout, inside, 3) == []
    fast = {layout.names[k]: sd for _, k, sd in unknown_beyond(layout, setting(1.0, 6.0 * np.e), 3)}
    k = layout.names.index("Fc_fwd")
    assert fast["Fc_fwd"] * layout.spread[k] == pytest.approx(np.full(3, RATE))
    assert not np.any(fast["d2"])  # the gap does not change with the speed


@pytest.mark.parametrize("scattered", [False, True])
def test_draws_outside_are_wider_by_the_slope_and_have_the_same_median(make_population, scattered):
    known = make_population()
    population = replace(known, layout=replace(known.layout, settings=tuple(TESTED)))
    index = np.random.default_rng(0).choice(population.size, size=4000)
    logs = [
        np.log(
            population.draw_test(asked, index, np.random.default_rng(1), scattered=scattered)["d2"]
        )
        for asked in (setting(1.0, 3.0), setting(0.5 / np.e, 0.3))
    ]
    assert logs[1].mean() == pytest.approx(logs[0].mean(), abs=0.015)
    assert logs[1].var() == pytest.approx(logs[0].var() + STROKE**2, rel=0.1)
    assert logs[0].std() < 0.8 * STROKE  # so that the difference can be seen


def test_what_was_found_to_differ_between_tests_widens_outside_them(make_population):
    layout = replace(make_population().layout, settings=tuple(TESTED))
    k = layout.names.index("Fc_fwd")
    sparse = tuple(i == k for i in range(len(layout.names)))
    freed = replace(layout, sparse=sparse, common=(False,) * len(layout.names))
    same = replace(layout, sparse=sparse, common=sparse)
    outside = setting(0.5 / np.e, 0.3)
    wider, fixed = ({one[1] for one in unknown_beyond(of, outside, 3)} for of in (freed, same))
    assert k in wider
    assert k not in fixed
