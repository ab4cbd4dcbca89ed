"""Bands of populations of given values: laws, levels, sessions, sources, curves and starts."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from mfd_bayes.errors import FitError, NotThereError
from mfd_bayes.friction.models import find_model
from mfd_bayes.population.bands import (
    ADVICE,
    PredictionOptions,
    holds_whole,
    whole_band,
)
from mfd_bayes.population.design import setting_of, with_zeros
from mfd_bayes.population.population import SHAPES, FinalState, InitialGapPrior
from mfd_bayes.records.trace import Trace
from tests.population.made import THREE_STAGE, make_predictor, no_residual

TIME = np.arange(200) / 50.0
LEVELS = (0.5, 1.0, 2.0)
DRAWS = 4000


def motion(actuation=1.0, amplitude=1.0, rate=1.0):
    return Trace.from_arrays(TIME, amplitude * np.sin(np.pi * rate * TIME), actuation)


def settings(amplitudes=(1.0, 1.0, 1.0)):
    return [setting_of(motion(p, x)) for p, x in zip(LEVELS, amplitudes, strict=True)]


def predictor(*arguments, tested=None, **options):
    options = {"medians": THREE_STAGE} | options
    return make_predictor("three_stage", tested or settings(), *arguments, **options)


def spread(band, name="Fc_fwd"):
    return np.log(band.values[name]).std()


# --- laws, between the levels and beyond them

POWER = {"Fc_fwd": "proportional", "Fc_bwd": "proportional"}
MIXED = {"proportional": 0.5, "constant": 0.3, "power": 0.2}


def test_beyond_the_levels_laws_are_mixed_and_between_them_the_named_one_holds():
    named, mixed = (
        predictor(POWER, level_sd=0.02, scatter=0.02, alternatives=a) for a in (None, MIXED)
    )
    forecast = PredictionOptions(draws=DRAWS)
    for level in (0.5, 0.8, 1.4, 2.0):
        pure, blend = (p.predict(motion(level), forecast) for p in (named, mixed))
        np.testing.assert_array_equal(pure.draws, blend.draws)
    for level in (0.2, 5.0):
        pure, blend = (p.predict(motion(level), forecast) for p in (named, mixed))
        assert spread(blend) > 5.0 * spread(pure)
        constant = np.abs(np.log(blend.values["Fc_fwd"] / 1.3)) < 0.3
        share = MIXED["constant"]
        assert abs(constant.mean() - share) < 4.0 * np.sqrt(share * (1.0 - share) / DRAWS)
        law = np.median(pure.values["Fc_fwd"]) / 1.3
        assert law == pytest.approx(level, rel=0.02)
        assert np.mean(blend.upper - blend.lower) > 1.5 * np.mean(pure.upper - pure.lower)


def test_the_named_law_gives_the_median_and_its_slope():
    law = predictor({"Fc_fwd": "power", "Fc_bwd": "affine"}, exponent=0.6, share=0.7, level_sd=0.0)
    population = law.population
    np.testing.assert_allclose(
        population.median("Fc_fwd", [0.5, 2.0])[0, 0], [1.3 * 0.5**0.6, 1.3 * 2**0.6]
    )
    np.testing.assert_allclose(population.median("Fc_bwd", 2.0)[..., 0], 1.6 * (0.3 + 0.7 * 2.0))
    np.testing.assert_allclose(population.ratio("Fs_fwd", 2.0), 2.0**0.6)  # as its friction
    np.testing.assert_allclose(population.ratio("k3", 2.0), 1.0)
    assert population.slopes["K_c_bwd"][0, 0] == pytest.approx(1.6 * 0.7)
    assert population.slopes["Fc_bwd_0"][0, 0] == pytest.approx(1.6 * 0.3)
    assert "K_c_fwd" not in population.slopes
    with pytest.raises(NotThereError, match="no quantity 'zz'"):
        population.median("zz", 1.0)
    with pytest.raises(FitError, match="actuation must be finite numbers of at least 0"):
        population.ratio("Fc_fwd", [1.0, -1.0])


# --- a test without actuation, and one whose actuation changes


def test_without_actuation_a_law_without_an_intercept_leaves_no_friction():
    tested = with_zeros([setting_of(motion(p)) for p in (1e-5, 1.0, 2.0)])
    assert tested[0].actuation == 0.0
    band = predictor(POWER, tested=tested).predict(motion(0.0), PredictionOptions(draws=200))
    assert np.all(band.values["Fc_fwd"] < 1e-6)
    assert np.all(np.isfinite(band.draws))
    affine = predictor(dict.fromkeys(POWER, "affine"), tested=tested, share=0.7)
    friction = affine.predict(motion(0.0), PredictionOptions(draws=DRAWS)).values["Fc_fwd"]
    assert np.median(friction) == pytest.approx(1.3 * 0.3, rel=4.0 * 1.25 * 0.11 / np.sqrt(DRAWS))
    with pytest.raises(FitError, match="an actuation above zero in at least one"):
        with_zeros([setting_of(motion(0.0))])


def test_along_a_history_friction_follows_its_law_and_levels_deviate():
    law = {"Fc_fwd": "power", "Fc_bwd": "power"}
    history = np.where(TIME < 2.0, 1.0, 2.0)
    force = {}
    forecast = PredictionOptions(draws=DRAWS, session="another")
    for effect in (1e-9, 0.2):
        effects = {"level_friction": effect}
        source = predictor(law, exponent=0.5, scatter=1e-9, level_sd=0.0, effect=effects)
        draws = source.draw(motion(history), forecast, np.random.default_rng(1))
        force[effect] = draws.scales["Fc_fwd"]
        np.testing.assert_array_equal(draws.scales["Fs_fwd"], draws.scales["Fc_fwd"])
    low, high = 0, -1
    lawful = force[1e-9][:, high] / force[1e-9][:, low]
    np.testing.assert_allclose(lawful, 2.0**0.5, rtol=1e-6)
    logs = np.log(force[0.2][:, high] / force[0.2][:, low])
    # Matérn 3/2 an octave apart, with half the sd at twice the actuation
    r = np.sqrt(3.0)
    rho = (1.0 + r) * np.exp(-r)
    expected = 0.2 * np.sqrt(1.0 + 0.25 - 2.0 * 0.5 * rho)
    assert logs.std() == pytest.approx(expected, rel=4.0 / np.sqrt(2.0 * DRAWS) + 0.01)
    assert logs.mean() == pytest.approx(0.5 * np.log(2.0), abs=4.0 * expected / np.sqrt(DRAWS))


# --- sessions, motions outside the tests


@pytest.mark.parametrize("grouping", ["session", "device"])
def test_a_new_session_or_device_is_wider_than_a_known_one(grouping):
    tested = [replace(s, **{grouping: name}) for s, name in zip(settings(), "aab", strict=True)]
    effect = {f"{grouping}_friction": 0.2}
    source = predictor(tested=tested, effect=effect, scatter=0.05, level_sd=0.0)
    narrow, wide = (
        source.predict(motion(), PredictionOptions(draws=DRAWS, **{grouping: n}))
        for n in ("a", "new")
    )
    rel = 4.0 / np.sqrt(2.0 * DRAWS)
    assert spread(narrow) == pytest.approx(0.05, rel=rel)
    assert spread(wide) == pytest.approx(np.hypot(0.05, 0.2), rel=rel)
    mean = source.predict(motion(), PredictionOptions("mean", draws=DRAWS, **{grouping: "new"}))
    assert spread(mean) < 1e-6  # the mean property is that of the devices tested


def test_a_motion_outside_the_tests_is_wider_and_one_inside_is_not():
    source = predictor(scatter=0.02, level_sd=0.0, tested=settings(amplitudes=(0.5, 1.0, 1.5)))
    interior = source.predict(motion(amplitude=1.0), PredictionOptions(draws=DRAWS))
    assert spread(interior) == pytest.approx(0.02, rel=4.0 / np.sqrt(2.0 * DRAWS))
    longer = source.predict(
        motion(amplitude=1.5 * np.e, rate=1.0 / np.e), PredictionOptions(draws=DRAWS)
    )
    faster = source.predict(motion(rate=4.0), PredictionOptions(draws=DRAWS))
    assert spread(longer) > 0.15
    assert spread(interior) < spread(faster) < spread(longer)


def test_a_dependence_on_the_stroke_holds_within_the_tested_strokes():
    law = predictor(
        tested=settings(amplitudes=(0.5, 1.0, 1.5)), dependence={"Fc_fwd": ("amplitude",)},
        scatter=1e-9, level_sd=0.0,
    )  # fmt: skip
    z = law.population.draws.z
    begin = len(law.population.design.names)
    z[..., begin] = -0.3
    assert np.all(law.population.dependences["Fc_fwd_amplitude"] == -0.3)
    middles = {
        x: np.median(
            np.log(law.predict(motion(amplitude=x), PredictionOptions(draws=50)).values["Fc_fwd"])
        )
        for x in (0.5, 1.0, 1.5)
    }
    assert middles[1.0] - middles[0.5] == pytest.approx(-0.3 * np.log(2.0), rel=0.01)
    assert middles[1.5] - middles[1.0] == pytest.approx(-0.3 * np.log(1.5), rel=0.01)


# --- kinds, whole curves, sources


def test_a_band_of_whole_curves_holds_its_share_of_new_ones():
    rng, probability = np.random.default_rng(5), 0.95
    draws, fresh = (np.cumsum(rng.standard_normal((4000, 40)), axis=1) for _ in "ab")
    lower, upper = whole_band(draws, probability)
    share = np.mean(np.all((fresh >= lower) & (fresh <= upper), axis=1))
    assert share == pytest.approx(probability, abs=6.0 * np.sqrt(0.25 / 4000))
    low, high = np.quantile(draws, [0.025, 0.975], axis=0)
    assert np.all((lower <= low) & (upper >= high))
    # the control: the band of single samples holds far fewer
    assert np.mean(np.all((fresh >= low) & (fresh <= high), axis=1)) < probability - 0.1
    assert holds_whole(draws, np.zeros(40))
    assert not holds_whole(draws, np.full(40, 1e3))


def test_each_source_of_the_width_is_named_by_what_varies():
    for scatter, source in (
        ({"Fc_fwd": 0.2}, "test-to-test scatter of forward slip force"),
        ({"d2": 0.3}, "test-to-test scatter of gap"),
    ):
        scattered = predictor(scatter=scatter, level_sd=0.0)
        band = scattered.predict(motion(), PredictionOptions(draws=200))
        assert max(band.variance_shares, key=band.variance_shares.get) in (
            source,
            "start in the gap",
        )
        assert band.variance_shares[source] > 0.5
        assert sum(band.variance_shares.values()) == pytest.approx(1.0)
        assert set(band.variance_shares) <= set(ADVICE)
    law = predictor(scatter=1e-9, level_sd={"Fc_fwd": 0.2, "Fc_bwd": 0.2})
    shares = law.predict(motion(), PredictionOptions(draws=200)).variance_shares
    assert shares["law, level and session effects"] > 0.5
    noise = predictor(scatter=1e-9, level_sd=0.0, medians=THREE_STAGE | {"noise_sd": 0.3})
    assert (
        noise.predict(motion(), PredictionOptions("observation", draws=200)).variance_shares[
            "noise"
        ]
        > 0.5
    )


def test_a_discrepancy_is_added_in_proportion_to_the_slip_force():
    knots = np.full(32, 0.1)
    unbiased, shifted = (
        predictor(POWER, scatter=1e-9, level_sd=0.0, residual=r)
        for r in (no_residual(), no_residual(mean=knots, slip_force=1.45))
    )
    for level in (1.0, 2.0):
        pair = [p.predict(motion(level), PredictionOptions(draws=10)) for p in (unbiased, shifted)]
        late = slice(110, None)  # after the first full strokes
        difference = (pair[1].median - pair[0].median)[late]
        assert np.abs(difference).max() == pytest.approx(0.1 * level, rel=0.1)


# --- where new tests begin: what repeats say holds for repeats alone

LONG = np.arange(300) / 50.0
SINE = Trace.from_arrays(LONG, np.sin(np.pi * LONG), 1.0)


def test_another_kind_or_stroke_never_begins_as_repeats_did():
    weights = np.zeros((2, SHAPES.size))
    weights[1, -1] = 1.0  # as of many tests that began exactly where their motions end
    tested = [replace(setting_of(SINE), actuation=p) for p in (0.5, 1.0, 2.0)]
    source = predictor(tested=tested, scatter=1e-9, level_sd=0.0, starts=InitialGapPrior(weights))

    def uniformity(x):
        trace = Trace.from_arrays(LONG, x, 1.0)
        draws = source.draw(trace, PredictionOptions(draws=DRAWS), np.random.default_rng(1))
        return stats.kstest(draws.unshared["start"], "uniform").pvalue

    sine = np.sin(np.pi * LONG)
    assert uniformity(sine) < 1e-20  # the control
    fading = sine * np.exp(-0.6 * LONG)  # with few full strokes
    fading *= 2.0 / np.ptp(fading)
    setting = setting_of(Trace.from_arrays(LONG, fading, 1.0)).covariates
    full = setting_of(SINE).covariates["full_strokes"]
    assert abs(setting["full_strokes"] - full) > 0.25  # it differs in kind alone
    assert setting["amplitude"] == pytest.approx(1.0, rel=0.01)
    for motion in (1.3 * sine, 0.8 * sine, fading):
        assert uniformity(motion) > 1e-4


def test_starts_that_are_learned_of_are_those_of_the_tests():
    final = np.array([0.2, 0.7, 0.35, 0.6, 0.8, 0.3])
    numbers = np.random.default_rng(2).standard_normal((DRAWS, 2))

    def places(initial, ends):
        starts = InitialGapPrior.learned(np.tile(initial, (100, 1)), ends, [None] * initial.size)
        positions = starts.place(numbers, 0.75, None, repeat=True)
        return np.median(positions), np.mean(np.abs(positions - 0.75) < 0.15)

    middle, share = places(final + np.array([0.03, -0.02, 0.01, 0.0, -0.03, 0.02]), final)
    assert middle == pytest.approx(0.75, abs=0.06)
    assert share > 0.6
    assert places(np.full(6, 0.5), None)[0] == pytest.approx(0.5, abs=0.03)
    assert places(1.0 - final, final)[1] < 0.4  # the control: they began elsewhere
    assert places(final[:1] + 0.03, final[:1])[1] < share  # one test says less than six


def test_tests_that_began_without_load_make_others_begin_without_load():
    initial = np.tile([0.45, 0.5, 0.55], (200, 1))
    ends = [(np.full(200, 0.4), np.full(200, 0.6))] * 3
    learned = InitialGapPrior.learned(initial, None, ends)
    assert 0.75 < learned.unloaded <= 0.95
    loaded = InitialGapPrior.learned(np.tile([0.1, 0.9, 0.05], (200, 1)), None, ends)
    assert loaded.unloaded < 0.05
    numbers = np.random.default_rng(4).standard_normal((DRAWS, 2))
    ends = np.full(DRAWS, 0.4), np.full(DRAWS, 0.6)
    positions = learned.place(numbers, None, ends, repeat=False)
    share = np.mean((positions >= 0.4) & (positions <= 0.6))
    expected = learned.unloaded + 0.2 * (1.0 - learned.unloaded)
    assert abs(share - expected) < 4.0 * np.sqrt(expected * (1.0 - expected) / DRAWS)


@pytest.mark.parametrize("name", ["three_stage", "backlash"])
def test_a_test_that_follows_begins_where_the_one_before_ended(priors, name):
    model = find_model(name)
    typical = {
        q.name: np.full(50, priors.parameters[q.name].median)
        for q in model.quantities
        if q.name in priors.parameters
    }
    values = {"gamma1": np.ones(50), **typical, "start": np.linspace(0.05, 0.95, 50)}
    ending = FinalState.of(model, "a", SINE, values)
    again = ending.starts(model, model.theta(values), SINE, seed=1)
    assert np.ptp(again) < 0.05  # full strokes forget where they began
    assert "test a ended" in ending.words
    moved = ending.moved(model, [0.0, 0.6, -0.6]).starts(model, model.theta(values), SINE, seed=1)
    assert np.abs(np.median(moved) - np.median(again)) > 0.02  # the control
