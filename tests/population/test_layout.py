"""Layout of the hyperparameters: effects, laws of chains, priors, and refused input."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import special, stats

from mfd_bayes.errors import FitError, PriorError
from mfd_bayes.population.laws import COMPARE, LAWS
from mfd_bayes.population.design import lay_out
from mfd_bayes.population.design import LAW_NAMES
from mfd_bayes.population.settings import Setting, levels_of, same_level

NAMES = ("Fc_fwd", "Fc_bwd", "sigma0", "k3", "offset")
LEVELS = (0.5, 0.8, 0.8, 1.5)


def settings(actuations=LEVELS, sessions=None):
    sessions = sessions or [""] * len(actuations)
    return [Setting(p, s) for p, s in zip(actuations, sessions, strict=True)]


def level_of(layout, name="Fc_fwd"):
    k = layout.names.index(name)
    return next(e for e in layout.effects if e.name == "level" and k in e.members)


def correlation(first, other):
    """Of a Matérn process of order 3/2, by Bessel's K."""
    far = np.sqrt(3.0) * np.maximum(np.abs(np.log(first / other)), 1e-9) / np.log(2.0)
    return np.sqrt(2.0 / np.pi) * far**1.5 * special.kv(1.5, far)


def covariance(first, other, tested=(0.5, 0.8, 1.5)):
    """Of a level's effect: its sd is in inverse proportion to the actuation, from half to twice."""
    reference = np.prod(tested) ** (1.0 / len(tested))
    sizes = np.clip(reference / first, 0.5, 2.0) * np.clip(reference / other, 0.5, 2.0)
    return sizes * correlation(first, other)


def test_levels_belong_to_the_geometric_mean_of_the_actuations(priors):
    layout = lay_out(priors, NAMES, settings())
    assert layout.reference == pytest.approx((0.5 * 0.8 * 0.8 * 1.5) ** 0.25)


def test_tests_are_compared_at_the_mean_speed_of_a_sine_of_their_typical_peak(priors):
    peaks = (1.0, 8.0, 0.0)  # 0: the last has none
    those = [Setting(0.5, "", {"velocity": v}) for v in peaks]
    sine = np.abs(np.cos((np.arange(1000) + 0.5) * np.pi / 1000))
    expected = sine.mean() * np.sqrt(8.0)
    assert lay_out(priors, NAMES, those).coordinates.speed == pytest.approx(expected, rel=1e-5)
    unknown = lay_out(priors, NAMES, settings()).coordinates.speed
    assert unknown == pytest.approx(sine.mean(), rel=1e-5)


def test_tests_near_each_other_are_at_one_level():
    folds = levels_of(settings((1.5, 0.8, 0.5, 0.805, 1.51)))
    assert folds == [[2], [1, 3], [0, 4]]
    assert same_level(0.8, 0.805)
    assert not same_level(0.8, 0.82)


@pytest.mark.parametrize("actuations", [(0.5, 0.5), (0.5, 0.8, 0.8), (0.5, 0.503, 0.8)])
def test_two_levels_have_no_effect_of_the_level(priors, actuations):
    assert lay_out(priors, NAMES, settings(actuations)).effects == ()


def test_three_levels_have_an_effect_on_what_follows_a_law_by_group(priors):
    layout = lay_out(priors, NAMES, settings())
    found = {tuple(NAMES[k] for k in e.members): e.name for e in layout.effects}
    assert found == {("Fc_fwd", "Fc_bwd"): "level", ("sigma0",): "level"}
    for effect in layout.effects:
        assert [cell[1] for cell in effect.cells] == [0.5, 0.8, 1.5]
        assert effect.home == (0, 1, 1, 2)


def test_sessions_have_an_effect_on_everything_where_there_are_two(priors):
    one = lay_out(priors, NAMES, settings((0.5, 0.8), ["a", "a"]))
    assert one.effects == ()
    two = lay_out(priors, NAMES, settings((0.5, 0.8), ["a", "b"]))
    assert {e.name for e in two.effects} == {"session"}
    assert sorted(k for e in two.effects for k in e.members) == list(range(len(NAMES)))


def test_effects_of_tested_levels_have_the_covariance_of_their_process(priors):
    effect = level_of(lay_out(priors, NAMES, settings()))
    rows = np.array([effect.row(cell)[0] for cell in effect.cells])
    at = np.array([0.5, 0.8, 1.5])
    np.testing.assert_allclose(rows @ rows.T, covariance(at[:, None], at), atol=1e-12)
    assert all(effect.row(cell)[1] == 0.0 for cell in effect.cells)


@pytest.mark.parametrize("new", [0.1, 0.65, 1.2, 4.0])
def test_an_untested_level_has_the_covariance_of_the_process_too(priors, new):
    effect = level_of(lay_out(priors, NAMES, settings()))
    row, sd = effect.row(("", new))
    at = np.array([0.5, 0.8, 1.5])
    np.testing.assert_allclose(row @ effect.root.T, covariance(new, at))
    assert row @ row + sd**2 == pytest.approx(covariance(new, new))
    assert 0.0 < sd < np.sqrt(covariance(new, new))
    sizes = covariance(new, at) / correlation(new, at)
    wrong = row @ effect.root.T / sizes - correlation(new, np.array([0.6, 0.8, 1.5]))
    assert np.max(np.abs(wrong)) > 0.01  # the control


def test_levels_of_different_sessions_have_nothing_in_common(priors):
    three = lay_out(priors, NAMES, settings((0.5, 0.8, 0.5, 0.8, 1.2), ["a", "a", "b", "b", "c"]))
    two = lay_out(priors, NAMES, settings((0.5, 0.8, 0.5, 0.8), ["a", "a", "b", "b"]))
    # two levels in two sessions are two: nothing tells them from a law
    assert "level" not in [effect.name for effect in two.effects]
    effect = level_of(three)
    rows = np.array([effect.row(cell)[0] for cell in effect.cells])
    found = rows @ rows.T
    np.testing.assert_allclose(found[:2, 2:], 0.0, atol=1e-12)
    levels = (0.5, 0.8, 0.5, 0.8, 1.2)
    assert found[0, 1] == pytest.approx(covariance(0.5, 0.8, levels))
    row, sd = effect.row(("d", 0.5))
    np.testing.assert_array_equal(row, 0.0)
    assert sd == pytest.approx(np.sqrt(covariance(0.5, 0.5, levels)))


def test_effects_are_smooth_over_the_actuation(priors):
    effect = level_of(lay_out(priors, NAMES, settings()))

    def lost(apart):
        """One less the correlation of a tested level with one nearby."""
        row, sd = effect.row(("", 0.8 * np.exp(apart)))
        sizes = np.linalg.norm(effect.root[1]) * np.hypot(np.linalg.norm(row), sd)
        return 1.0 - row @ effect.root[1] / sizes

    assert lost(0.02) / lost(0.01) == pytest.approx(4.0, abs=0.2)  # 2 where it is not smooth


def test_a_population_of_an_earlier_version_keeps_its_kernel(priors):
    today = level_of(lay_out(priors, NAMES, settings()))
    effect = replace(today, kernel="exponential", reference=0.0)
    row, _ = effect.row(("", 0.65))
    expected = np.exp(-np.abs(np.log(0.65 / np.array([0.5, 0.8, 1.5]))) / np.log(2.0))
    np.testing.assert_allclose(row @ effect.root.T, expected)
    assert today.kernel == "matern"
    assert today.reference == pytest.approx((0.5 * 0.8 * 1.5) ** (1.0 / 3.0))


def test_a_level_lies_off_a_law_as_if_its_actuation_were_wrong_by_as_much_as_others(priors):
    effect = level_of(lay_out(priors, NAMES, settings()))
    sd = {
        p: np.hypot(np.linalg.norm(row), rest)
        for p in (0.5, 0.7, 1.2, 1.5)
        for row, rest in [effect.row(("", p))]
    }
    force = {p: p * share for p, share in sd.items()}  # under a proportional law
    assert list(force.values()) == pytest.approx([effect.reference] * 4)
    for far, size in ((0.01, 2.0), (8.0, 0.5)):
        row, rest = effect.row(("", far))
        assert np.hypot(np.linalg.norm(row), rest) == pytest.approx(size)
    older = replace(effect, reference=0.0)  # the control
    assert np.linalg.norm(older.row(("", 0.5))[0]) == pytest.approx(1.0)


def test_without_actuation_a_level_has_nothing_in_common_with_others(priors):
    effect = level_of(lay_out(priors, NAMES, settings()))
    row, sd = effect.row(("", 0.0))
    np.testing.assert_allclose(row, 0.0)
    assert sd == 2.0


def test_the_design_gives_tests_their_covariance(priors):
    layout = lay_out(priors, NAMES, settings())
    rng = np.random.default_rng(1)
    h = rng.normal(-1.0, 0.5, size=(1, layout.dim))
    design, sd = layout.design(), layout.effect_sd(h)[0]
    root = np.concatenate([np.ones((1, len(NAMES))), sd])
    for name in NAMES:
        k = NAMES.index(name)
        columns = design * root[:, k]
        expected = np.ones((4, 4))
        if name in layout.laws:
            i = [k in e.members for e in layout.effects].index(True)
            omega = np.exp(h[0, len(NAMES) + i]) / layout.spread[k]
            at = np.array(LEVELS)
            expected = expected + omega**2 * covariance(at[:, None], at)
        np.testing.assert_allclose(columns @ columns.T, expected, atol=1e-12)


def test_a_setting_near_a_level_belongs_to_its_cell(priors):
    layout = lay_out(priors, NAMES, settings())
    effect = level_of(layout)
    assert effect.cell_of(Setting(0.803), layout.settings) == ("", 0.8)
    assert effect.cell_of(Setting(0.9), layout.settings) == ("", 0.9)
    assert effect.cell_of(Setting(0.8, "b"), layout.settings) == ("b", 0.8)


def test_offsets_are_the_logarithms_of_the_laws(priors):
    layout = lay_out(priors, NAMES, settings(), {"Fc_bwd": "power", "k3": "constant"})
    h = np.zeros((2, layout.dim))
    shapes = dict.fromkeys(layout.shapes)
    assert list(shapes) == [("Fc_bwd", "exponent"), ("sigma0", "share")]
    h[:, -2], h[:, -1] = 1.4, 0.5
    share = 1.0 / (1.0 + np.exp(-0.5))
    relative = np.array(LEVELS) / layout.reference
    found = layout.offsets(h, layout.draw_choice(2)) * layout.spread
    expected = np.zeros((4, 5))
    expected[:, 0], expected[:, 1] = np.log(relative), 1.4 * np.log(relative)
    expected[:, 2] = np.log(share * relative + 1.0 - share)
    np.testing.assert_allclose(found, np.tile(expected, (2, 1, 1)), atol=1e-12)


def test_a_dependence_shifts_a_quantity_per_fold(priors):
    given = [Setting(p, "", {"velocity": v}) for p, v in zip(LEVELS, (1, 2, 4, 8), strict=True)]
    layout = lay_out(priors, NAMES, given, dependence={"k3": ("velocity",)})
    assert layout.covariate_reference["velocity"] == pytest.approx(np.sqrt(8.0))
    h = np.zeros((1, layout.dim))
    h[:, -1] = 0.25
    shift = layout.offsets(h, layout.draw_choice(1))[0, :, 3] * layout.spread[3]
    np.testing.assert_allclose(shift, 0.25 * np.log(np.array([1, 2, 4, 8]) / np.sqrt(8.0)))


def test_the_density_of_the_hyperparameters_is_scipys_up_to_a_constant(priors):
    layout = lay_out(priors, NAMES, settings(), {"Fc_fwd": "power"})
    rng = np.random.default_rng(2)
    h = rng.normal(-1.5, 0.7, size=(7, layout.dim))
    sds = len(layout.sd_scale)
    assert 0 < np.sum(layout.sparse) < len(layout.names)
    sparse = np.append(layout.sparse, np.zeros(len(layout.effects))).astype(bool)  # no effect is
    half_normal = stats.halfnorm(scale=layout.sd_scale).logpdf(np.exp(h[:, :sds]))
    exponential = stats.expon(scale=layout.sd_scale).logpdf(np.exp(h[:, :sds]))
    expected = np.sum(np.where(sparse, exponential, half_normal) + h[:, :sds], axis=1)
    densities = {"exponent": stats.norm(1.0, 0.5), "share": stats.logistic}
    for i, (_, shape) in enumerate(layout.shapes):
        expected += densities[shape].logpdf(h[:, sds + i])
    left = layout.log_prior(h).sum(axis=1) - expected
    np.testing.assert_allclose(left, left[0], atol=1e-10)


def test_each_block_holds_the_density_of_its_own_group(priors):
    layout = lay_out(priors, NAMES, settings())
    rng = np.random.default_rng(3)
    h = rng.normal(-1.5, 0.7, size=(1, layout.dim))
    before = layout.log_prior(h)
    for i, group in enumerate(layout.block):
        moved = h.copy()
        moved[:, i] += 0.3
        changed = np.flatnonzero(layout.log_prior(moved) != before)
        np.testing.assert_array_equal(changed, [group])


def compared(priors, weights):
    laws = dict.fromkeys(("Fc_fwd", "Fc_bwd", "sigma0"), COMPARE)
    return replace(lay_out(priors, NAMES, settings(), laws), weights=dict.fromkeys(laws, weights))


def test_chains_have_laws_in_the_proportion_of_their_weights(priors):
    weights = {"proportional": 0.5, "affine": 0.0, "power": 0.3, "constant": 0.2}
    layout = compared(priors, weights)
    choice = layout.draw_choice(400)
    for column in choice.T:
        shares = np.bincount(column, minlength=5) / 400
        np.testing.assert_allclose(shares, [weights.get(law, 0) for law in LAW_NAMES], atol=0.01)
    np.testing.assert_array_equal(choice, layout.draw_choice(400))


def test_laws_of_different_quantities_are_independent(priors):
    layout = compared(priors, {"proportional": 0.5, "power": 0.5})
    choice = layout.draw_choice(1000)
    for a, b in ((0, 1), (0, 2), (1, 2)):
        both = np.mean((choice[:, a] == 0) & (choice[:, b] == 0))
        assert both == pytest.approx(0.25, abs=0.03)


def test_one_law_is_the_law_of_all_chains(priors):
    layout = lay_out(priors, NAMES, settings())
    choice = layout.draw_choice(16)
    names = [[LAW_NAMES[i] for i in row] for row in choice]
    assert names == [["proportional", "proportional", "affine"]] * 16
    assert list(layout.laws) == ["Fc_fwd", "Fc_bwd", "sigma0"]
    assert set(layout.weights["sigma0"]) == {"affine"}
    mixed = lay_out(priors, NAMES, settings(), {"sigma0": COMPARE})
    assert mixed.weights["sigma0"] == dict.fromkeys(LAWS, 0.2)


def test_what_no_test_shares_is_not_pooled(priors):
    layout = lay_out(priors, ("Fc_fwd", "noise_dof"), settings())
    assert layout.names == ("Fc_fwd",)


@pytest.mark.parametrize("bad", [(-1.0, 1.0), (float("nan"), 1.0), (0.0, 0.0)])
def test_some_actuation_is_needed_and_none_may_be_negative(priors, bad):
    with pytest.raises(FitError, match="need an actuation above zero in at least one calibrated"):
        lay_out(priors, ("Fc_fwd",), settings(bad))


LAWS_OF = {"Fc_fwd": "proportional", "Fc_bwd": "residual_power", "sigma0": COMPARE}


def test_the_reference_is_the_mean_over_tests_with_actuation(priors):
    layout = lay_out(priors, NAMES, settings((0.0, 0.5, 0.0, 0.8)))
    assert layout.reference == pytest.approx(np.sqrt(0.5 * 0.8))


def test_a_test_at_zero_informs_only_laws_with_an_intercept(priors):
    layout = lay_out(priors, NAMES, settings((0.0, 0.5, 0.8, 1.5)), LAWS_OF)
    k = NAMES.index("Fc_fwd")
    assert not layout.informs[0, k]
    assert np.count_nonzero(~layout.informs) == 1
    assert np.all(lay_out(priors, NAMES, settings(), LAWS_OF).informs)


def test_with_a_test_at_zero_only_laws_with_a_value_there_are_compared(priors):
    layout = lay_out(priors, NAMES, settings((0.0, 0.5)), LAWS_OF)
    third = pytest.approx(1 / 3)
    assert layout.weights["sigma0"] == {"affine": third, "constant": third, "residual_power": third}


def test_offsets_at_zero_are_those_of_the_intercept_or_none(priors):
    layout = lay_out(priors, NAMES, settings((0.0, 0.5, 0.8)), LAWS_OF | {"sigma0": "affine"})
    h = np.zeros((1, layout.dim))  # a share of one half
    offsets, choice = layout.offsets(h, layout.draw_choice(1)), layout.draw_choice(1)
    for name, at_zero in (("Fc_fwd", 0.0), ("Fc_bwd", np.log(0.5)), ("sigma0", np.log(0.5))):
        k = NAMES.index(name)
        assert offsets[0, 0, k] == pytest.approx(at_zero / layout.spread[k])
    predicted = layout.offsets(h, choice, [Setting(0.0)])[0, 0]
    assert np.exp(predicted[NAMES.index("Fc_fwd")] * layout.spread[0]) < 1e-200
    assert predicted[NAMES.index("sigma0")] == offsets[0, 0, NAMES.index("sigma0")]


@pytest.mark.parametrize(("shown", "zero"), [(1e-4, True), (0.01, False)])
def test_what_a_gauge_shows_with_nothing_applied_is_zero(priors, shown, zero):
    layout = lay_out(priors, NAMES, settings((shown, 0.5, 0.8, 1.5)))
    assert (layout.settings[0].actuation == 0.0) == zero


def test_the_effect_of_zero_is_independent_of_all_others(priors):
    laws = {"Fc_fwd": "affine", "Fc_bwd": "affine"}
    effect = level_of(lay_out(priors, NAMES, settings((0.0, 0.5, 0.8)), laws))
    rows = np.array([effect.row(("", p))[0] for p in (0.0, 0.5, 0.8)])
    np.testing.assert_allclose((rows @ rows.T)[0], [4.0, 0.0, 0.0], atol=1e-12)
    assert (rows @ rows.T)[1, 2] > 0.4  # the control
    new, sd = effect.row(("", 0.1))
    assert new @ effect.root[0] == 0.0
    assert 0.0 < sd < 2.0


def test_a_level_that_does_not_inform_does_not_count_towards_an_effect(priors):
    for pressures, members in (((0.0, 0.5, 0.8), {"sigma0"}), ((0.0, 0.5, 0.8, 1.5), set(LAWS_OF))):
        layout = lay_out(priors, NAMES, settings(pressures))
        assert {NAMES[k] for e in layout.effects for k in e.members} == members


def test_a_law_needs_a_positive_quantity(priors):
    with pytest.raises(FitError, match="a law for offset needs a prior on the positive half line"):
        lay_out(priors, ("offset",), settings(), {"offset": "proportional"})


def test_a_pooled_quantity_needs_a_scatter_prior(priors):
    bare = replace(priors, scatter={"friction": priors.scatter["friction"]})
    with pytest.raises(PriorError, match=r"mfd\.toml has no \[scatter\] group with k3"):
        lay_out(bare, ("Fc_fwd", "k3"), settings())
