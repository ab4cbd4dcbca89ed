"""What makes a band wide: shares of a population with given values."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from mfd_bayes.assessment.width import width_sentence
from mfd_bayes.calibration.noises import find_noise
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.population.drawn import Drawn
from mfd_bayes.population.bands import Forecast
from mfd_bayes.population.parts import Parts
from mfd_bayes.population.bands import Predictor
from mfd_bayes.population.bands import ADVICE, GROUPS, PERMUTATIONS, SOURCES, shapley, shares_of
from mfd_bayes.records.trace import Trace

TIME = np.arange(401) / 100
MOTION = np.sin(2 * np.pi * 0.5 * TIME)

SCATTER = [name for name in ADVICE if name.startswith("test-to-test")]


def shares(population, actuation=1.0, kind="observation", seed=0, noise="ou"):
    trace = Trace.from_arrays(TIME, MOTION, actuation)
    forecast = Forecast(kind, draws=200, seed=seed, permutations=8)
    return Predictor(population, ThreeStage(), find_noise(noise)).predict(trace, forecast).shares


@pytest.fixture(scope="module")
def population(make_population):
    return make_population(level_sd=0.02, scatter=0.1)


@pytest.mark.parametrize("kind", ["device", "new_test", "observation"])
def test_shares_sum_to_one(population, kind):
    found = shares(population, kind=kind)
    assert sum(found.values()) == pytest.approx(1.0)
    assert min(found.values()) >= 0.0
    assert ("noise" in found) == (kind == "observation")
    assert any(name in found for name in SCATTER) == (kind != "device")


def test_without_scatter_its_shares_are_zero(make_population):
    found = shares(make_population(level_sd=0.02, scatter=0.0))
    assert sum(found.get(name, 0.0) for name in SCATTER) < 1e-6
    assert found["parameters"] > 0.1
    assert sum(shares(make_population()).get(name, 0.0) for name in SCATTER) > 0.5  # the control


def test_scatter_of_one_quantity_is_found_under_its_name(make_population):
    """Only the backward slip force scatters, by 20 %."""
    known = make_population(level_sd=0.001, scatter=0.001)
    h = known.h.copy()
    h[..., known.layout.names.index("Fc_bwd")] = np.log(0.2)
    found = shares(replace(known, h=h), kind="new_test")
    assert found["test-to-test scatter of backward slip force"] > 0.85
    assert found["test-to-test scatter of forward slip force"] < 0.02
    said = width_sentence(found)
    assert "backward slip force" in said
    assert "difference between tests of this device" in said


def test_shares_are_those_of_the_variances_where_sources_only_add(make_population):
    """Offset 0.06 and noise 0.08 kip beside a damper that is known: 36 to 64."""
    known = make_population(level_sd=1e-9, scatter=1e-9)
    h = known.h.copy()
    names = known.layout.names
    h[..., names.index("offset")] = np.log(0.06)
    latent = known.latent.copy()
    k = names.index("noise_sd")
    latent[:, :, 0, k] += np.log(0.08 / 0.05) / known.layout.spread[k]
    found = shares(replace(known, h=h, latent=latent), noise="iid")
    start = found["start in the gap"]
    assert start < 0.4
    offset = found["test-to-test scatter of the offset"]
    assert offset / (1 - start) == pytest.approx(0.36, abs=0.07)  # 200 draws of the offset
    assert found["noise"] / (1 - start) == pytest.approx(0.64, abs=0.07)


def test_far_from_tested_levels_the_law_and_its_deviation_widen_the_band(make_population):
    known = make_population(level_sd=0.01, scatter=0.02, effect=0.2)
    name = "law, level and session effects"
    near, far = (shares(known, p, "new_test").get(name, 0.0) for p in (1.0, 8.0))
    assert near < 0.05
    assert far > 0.7


def test_level_and_law_that_only_their_sum_is_known_of_are_not_both_wide():
    rng = np.random.default_rng(0)
    level = rng.normal(size=(400, 1))
    parts = Parts(level, -level + 0.1 * rng.normal(size=(400, 1)), np.zeros((400, 1)))
    drawn = Drawn(parts, {"start": np.full(400, 0.5)}, {})

    def total(drawn, damper):
        return drawn.parts.total, drawn.parts.total

    found = shares_of(drawn, ["k2"], total)
    assert found["law, level and session effects"] > 0.95
    apart = drawn.untangled().parts
    np.testing.assert_allclose(apart.total, parts.total, atol=1e-12)
    assert np.var(apart.level) < 0.02


def test_the_same_seed_gives_the_same_shares_and_the_same_band(population):
    assert shares(population) == shares(population)
    trace = Trace.from_arrays(TIME, MOTION, 1.0)
    predictor = Predictor(population, ThreeStage(), find_noise("ou"))
    plain, told = (
        predictor.predict(trace, Forecast(draws=50, permutations=n)).draws for n in (0, 2)
    )
    np.testing.assert_array_equal(plain, told)


def test_every_quantity_has_one_group():
    named = [name for group in GROUPS.values() for name in group]
    assert len(named) == len(set(named))
    assert len(ADVICE) == len(SOURCES)
    assert all(source.advice.endswith(".") for source in SOURCES)


# --- Shapley values


def game(free):
    """Two players that are worth most together, and one that adds a constant."""
    return 3.0 * ("a" in free and "b" in free) + 1.0 * ("a" in free) + 2.0 * ("c" in free)


def test_shapley_values_are_those_of_all_orders():
    exact = dict.fromkeys("abc", 0.0)
    for order in permutations("abc"):
        for k, name in enumerate(order):
            exact[name] += (game(frozenset(order[: k + 1])) - game(frozenset(order[:k]))) / 6
    found = shapley("abc", game, 200, np.random.default_rng(0))
    for name, value in exact.items():
        assert found[name] == pytest.approx(value / 6.0, abs=0.02)
    assert found["c"] == pytest.approx(2.0 / 6.0)


def test_nothing_that_varies_has_no_shares():
    assert shapley("ab", lambda free: 0.0, 4, np.random.default_rng(0)) == {}
    assert width_sentence({}) == ""


@pytest.mark.parametrize(
    ("share", "words"),
    [
        (0.71, "Seven tenths of the band's variance come from noise."),
        (0.52, "Half of the band's variance comes from noise."),
        (0.97, "Nearly all of the band's variance comes from noise."),
        (0.12, "A tenth of the band's variance comes from noise."),
    ],
)
def test_a_sentence_counts_in_tenths(share, words):
    rest = {f"other {k}": (1 - share) / 20 for k in range(20)}
    assert words in width_sentence({"noise": share, **rest})


def test_a_band_has_its_shares_when_they_are_looked_at(population):
    predictor = Predictor(population, ThreeStage(), find_noise("ou"))
    trace = Trace.from_arrays(TIME, MOTION, 1.0)
    known, later = (
        predictor.predict(trace, Forecast("observation", draws=200, permutations=n))
        for n in (PERMUTATIONS, 0)
    )
    assert known.explained == known.shares
    assert later.explained == {}
    assert later.shares == known.shares
    assert later.shares is later.shares  # computed once
    assert sum(later.shares.values()) == pytest.approx(1.0)
