"""Comparison of laws by leaving out levels, against brute force; and free exponents."""

from dataclasses import replace
from functools import cache, partial
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import special, stats

from mfd_bayes.population import law_scores
from mfd_bayes.population.law_points import draw_points, effective
from mfd_bayes.population.law_samples import problem_of
from mfd_bayes.population.law_scores import (
    LARGEST_K,
    compare_dependence,
    compare_laws,
    free_exponents,
    stack,
)
from mfd_bayes.population.laws import LAWS, SENSITIVITY
from mfd_bayes.population.design import lay_out
from mfd_bayes.population.settings import Setting

LEVELS = (0.5, 0.5, 0.8, 1.5)
MANY = tuple(np.repeat([0.4, 0.6, 0.9, 1.4, 2.0], 2))


@pytest.fixture(scope="module")
def campaign(priors, gaussian_test):
    return partial(make_campaign, priors, gaussian_test)


@pytest.fixture(scope="module")
def scored(campaign):
    """Scores of a campaign by its exponent and levels, computed once."""
    return cache(lambda *made: compare_laws(*campaign(*made)))


@pytest.fixture(scope="module")
def at_zero(campaign):
    """A campaign with a test at zero, and its scores."""
    layout, tests = campaign(levels=(0.5, 0.5, 0.8, 1.5), exponent=0.8)
    tests = [replace(tests[0], mean=np.array([-1.2, 0.0])), *tests]
    layout = replace(layout, settings=(Setting(0.0), *layout.settings))
    return layout, tests, compare_laws(layout, tests)


def make_campaign(
    priors,
    told,
    exponent=1.0,
    levels=LEVELS,
    *,
    laws=None,
    error=0.02,
    sessions=None,
    velocities=None,
    sensitivity=0.0,
):
    """Tests whose friction follows a power of the actuation, with 4 % scatter."""
    rng = np.random.default_rng(4)
    sessions = sessions or [""] * len(levels)
    velocities = velocities or [2.0] * len(levels)
    settings = [
        Setting(p, s, {"velocity": v, "amplitude": 1.0})
        for p, s, v in zip(levels, sessions, velocities, strict=True)
    ]
    layout = lay_out(priors, ("Fc_fwd", "offset"), settings, laws)
    tests = []
    for level, velocity in zip(levels, velocities, strict=True):
        q = layout.centre + np.array([0.3, 0.02])
        q[0] += exponent * np.log(level / layout.reference) + 0.04 * rng.standard_normal()
        q[0] += error * rng.standard_normal() + sensitivity * np.log(velocity)
        sd = np.array([error, 0.02]) / layout.spread
        mean = (q - layout.centre) / layout.spread
        tests.append(told(mean, np.diag(sd**2)))
    return layout, tests


def grid_of(law):
    """Shares and exponents of a law on a grid, and their log weights."""
    q = (np.arange(200) + 0.5) / 200
    if law == "affine":
        return q, np.ones(200), np.zeros(200)
    if law == "residual_power":
        both = (np.arange(50) + 0.5) / 50
        share, exponent = np.meshgrid(both, stats.norm(1.0, 0.5).ppf(both))
        return share.ravel(), exponent.ravel(), np.zeros(2500)
    if law == "power":
        exponents = stats.norm(1.0, 0.5).ppf(q)
        return np.ones(200), exponents, np.zeros(200)
    return np.array([float(law == "proportional")]), np.ones(1), np.zeros(1)


def brute_force(layout, tests, law, session_effect=False):
    """Log density of all tests, and of those outside each fold, by grids and scipy."""
    k, scale = 0, layout.scatter_sd[0] / layout.spread[0]
    data = np.array([t.mean[k] for t in tests])
    noise = np.diag([t.covariance[k, k] for t in tests])
    relative = np.array([s.actuation for s in layout.settings]) / layout.reference
    taus = stats.halfnorm(scale=scale).ppf((np.arange(120) + 0.5) / 120)
    omegas = taus[::6] if session_effect else np.zeros(1)
    sessions = [s.session for s in layout.settings]
    alike = np.array([[float(a == b) for a in sessions] for b in sessions])
    share, exponent, _ = grid_of(law)
    power = np.where(relative > 0, np.maximum(relative, 1e-9) ** exponent[:, None], 0.0)
    value = share[:, None] * power + 1.0 - share[:, None]
    told = np.all(value > 0, axis=0)  # where the law has a value
    means = np.where(told, np.log(np.where(told, value, 1.0)), 0.0) / layout.spread[k]

    scatters, effects = (np.ravel(sds)[:, None, None] for sds in np.meshgrid(taus, omegas))
    covariances = scatters**2 * np.eye(len(data)) + 1.0 + effects**2 * alike
    covariances = noise + np.where(np.outer(told, told), covariances, np.eye(len(data)))

    def density(kept):
        away = (data - means)[:, kept]
        root = np.linalg.cholesky(covariances[:, kept][:, :, kept])
        white = np.linalg.solve(root, np.broadcast_to(away.T, (len(root), *away.T.shape)))
        sizes = np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)[:, None]
        terms = -0.5 * np.sum(white**2, axis=1) - sizes
        constant = 0.5 * len(kept) * np.log(2.0 * np.pi)
        return special.logsumexp(terms) - np.log(terms.size) - constant

    return density


@pytest.mark.parametrize("law", ["proportional", "affine", "power", "constant"])
def test_scores_are_brute_force(campaign, scored, law):
    layout, tests = campaign(0.8)
    density = brute_force(layout, tests, law)
    everything = density([0, 1, 2, 3])
    expected = [everything - density(kept) for kept in ([2, 3], [0, 1, 3], [0, 1, 2])]
    found = next(s for s in scored(0.8) if s.law == law)
    np.testing.assert_allclose(found.levels, expected, atol=0.03)
    assert found.elpd == pytest.approx(sum(found.levels))
    assert found.se == pytest.approx(np.sqrt(3) * np.std(found.levels, ddof=1))
    other = brute_force(layout, [*tests[:3], replace(tests[3], mean=0.9 * tests[3].mean)], law)
    assert abs(other([0, 1, 2, 3]) - other([0, 1, 2]) - found.levels[2]) > 0.03  # the control


@pytest.mark.parametrize("law", ["proportional", "affine", "power", "residual_power"])
def test_scores_with_a_test_at_zero_are_brute_force(at_zero, law):
    layout, tests, found = at_zero
    density = brute_force(layout, tests, law)
    everything = density([0, 1, 2, 3, 4])
    kept = [1, 2, 3, 4], [0, 3, 4], [0, 1, 2, 4], [0, 1, 2, 3]
    scores = {s.law: s for s in found}
    expected = [everything - density(those) for those in kept]
    np.testing.assert_allclose(scores[law].levels, expected, atol=0.05)
    assert scores["proportional"].weight == scores["power"].weight == 0.0
    assert sum(s.weight for s in scores.values()) == pytest.approx(1.0)


def test_an_exponent_is_freed_with_three_levels_above_zero(priors, gaussian_test):
    for levels, freed in (((0.0, 0.5, 1.0), set()), ((0.0, 0.5, 0.8, 1.5), {"Fc_fwd"})):
        layout = lay_out(priors, ("Fc_fwd", "offset"), [Setting(p) for p in levels])
        tests = [gaussian_test(np.zeros(2), 0.1 * np.eye(2)) for _ in levels]
        assert set(free_exponents(layout, tests)) == freed


def test_scores_know_of_sessions(campaign):
    layout, tests = campaign(0.8, sessions=["a", "b", "a", "b"])
    density = brute_force(layout, tests, "proportional", session_effect=True)
    everything = density([0, 1, 2, 3])
    expected = [everything - density(kept) for kept in ([2, 3], [0, 1, 3], [0, 1, 2])]
    found = next(s for s in compare_laws(layout, tests) if s.law == "proportional")
    np.testing.assert_allclose(found.levels, expected, atol=0.05)


def test_what_other_groups_have_in_common_plays_no_part(priors):
    settings = [Setting(p, s) for p, s in zip(LEVELS, "abab", strict=True)]
    test = SimpleNamespace(mean=np.zeros(3), covariance=np.eye(3))
    layout = lay_out(priors, ("Fc_fwd", "k3", "offset"), settings)
    assert {e.group for e in layout.effects if e.name == "session"} == {0, 1, 2}
    problem = problem_of(layout.without("level"), [test] * 4, "Fc_fwd", "proportional")
    assert problem.rows.shape == (4, 1 + 2)  # the level, and the effects of two sessions


def test_scores_are_always_the_same(campaign, scored):
    assert compare_laws(*campaign(0.8)) == scored(0.8)


def half_affine(layout):
    """Tests whose friction is by three tenths a constant, with 4 % scatter."""
    rng = np.random.default_rng(6)
    relative = np.array([s.actuation for s in layout.settings]) / layout.reference
    q = 0.3 + np.log(0.3 + 0.7 * relative) + 0.045 * rng.standard_normal(relative.size)
    return [
        SimpleNamespace(
            mean=np.array([m / layout.spread[0]]),
            covariance=np.array([[4e-4 / layout.spread[0] ** 2]]),
        )
        for m in q
    ]


@pytest.mark.parametrize(
    "count", [5, *(pytest.param(count, marks=pytest.mark.slow) for count in (10, 200, 500))]
)
def test_scores_are_the_same_with_other_points_however_many_tests_there_are(priors, count):
    levels = np.resize([0.4, 0.6, 0.9, 1.4, 2.0], count)
    layout = lay_out(priors, ("Fc_fwd",), [Setting(p) for p in levels])
    tests = half_affine(layout)
    first, second = (compare_laws(layout, tests, seed) for seed in (0, 1))
    for one, other in zip(first, second, strict=True):
        assert one.pareto_k < LARGEST_K
        assert one.elpd == pytest.approx(other.elpd, abs=0.05)
        assert one.weight == pytest.approx(other.weight, abs=0.03)
    for law in ("affine", "power"):
        points = draw_points(problem_of(layout.without("level"), tests, "Fc_fwd", law))
        log_weights = [
            w + sample.log_density(sample.sums(slice(None))) for sample, w in points.parts()
        ]
        assert effective(np.concatenate(log_weights)) > 0.2 * len(points.z)
    if count >= 200:
        assert max(first, key=lambda score: score.elpd).law == "affine"


@pytest.mark.slow
def test_a_law_whose_points_miss_the_posterior_is_not_weighed(campaign, monkeypatch):
    layout, tests = campaign(levels=MANY)
    trusted = compare_laws(layout, tests)
    assert all(score.trusted for score in trusted)

    def missing(problem, subsets=(), seed=0):
        points = draw_points(problem, subsets, seed)
        if problem.law != "power":
            return points
        z = np.random.default_rng(seed).normal(1.5, 0.2, points.z.shape)  # far from where it is
        log_weights = problem.log_prior(z) - stats.norm(1.5, 0.2).logpdf(z).sum(axis=1)
        return replace(points, z=z, log_weights=log_weights - np.log(len(z)))

    monkeypatch.setattr(law_scores, "draw_points", missing)
    found = {score.law: score for score in compare_laws(layout, tests)}
    assert found["power"].pareto_k > LARGEST_K
    assert found["power"].weight == 0.0
    assert sum(score.weight for score in found.values()) == pytest.approx(1.0)
    monkeypatch.setattr(law_scores, "LARGEST_K", -100.0)
    assert all(score.weight == 0.0 for score in compare_laws(layout, tests))


@pytest.mark.parametrize("law", ["affine", "power"])
def test_points_have_the_prior_of_the_laws(campaign, law):
    layout, tests = campaign(sessions=list("abab"))
    problem = problem_of(layout, tests, "Fc_fwd", law, ["velocity"])
    assert problem.dim == 5  # scatter, level, session, shape, slope
    sample = problem.sample(np.random.default_rng(3).standard_normal((40_000, 5)))
    unit = layout.scatter_sd[0] / layout.spread[0]
    scatter = np.sqrt(sample.variances[:, 0] - problem.noise[0])
    level, session = sample.sds[:, [1, -1]].T
    for sd in (scatter, level / 2.0, session):  # levels deviate by more
        assert stats.kstest(sd / unit, stats.halfnorm.cdf).statistic < 0.01
    if law == "power":
        assert stats.kstest(sample.exponent, stats.norm(1.0, 0.5).cdf).statistic < 0.01
    relative = np.log(LEVELS[-1] / layout.reference)
    means = (problem.data - sample.residuals)[:, -1] * layout.spread[0]
    assert stats.kstest(means, reference_means(law, relative)).statistic < 0.012


def reference_means(law, fold):
    """Draws of a law's logarithm at a fold of the actuation, speeds being all the same."""
    rng = np.random.default_rng(4)
    if law == "power":
        return fold * rng.normal(1.0, 0.5, 200_000)
    share = rng.random(200_000)
    return np.log(share * np.exp(fold) + 1.0 - share)


def test_a_smooth_effect_of_many_levels_has_few_parts(priors):
    settings = [Setting(p) for p in np.geomspace(0.2, 2.0, 300)]
    layout = lay_out(priors, ("Fc_fwd",), settings)
    tests = [SimpleNamespace(mean=np.zeros(1), covariance=np.eye(1))] * 300
    problem = problem_of(layout, tests, "Fc_fwd", "power")
    assert problem.rows.shape[1] < 40
    effect = layout.effects[0]
    root = effect.root[list(effect.home)]
    np.testing.assert_allclose(
        problem.rows[:, 1:] @ problem.rows[:, 1:].T, root @ root.T, atol=0.01
    )


@pytest.mark.parametrize(
    ("exponent", "right", "wrong"),
    [
        (1.0, {"proportional", "power"}, {"constant"}),
        (0.0, {"constant", "power"}, {"proportional"}),
        (0.5, {"power"}, {"constant", "proportional"}),
    ],
)
def test_laws_that_tests_obey_score_better_than_others(scored, exponent, right, wrong):
    found = {s.law: s for s in scored(exponent, MANY)}
    assert {s.quantity for s in found.values()} == {"Fc_fwd"}
    assert max(found[law].elpd for law in wrong) < min(found[law].elpd for law in right) - 4.0
    assert sum(s.weight for s in found.values()) == pytest.approx(1.0)
    assert max(found[law].weight for law in wrong) < 0.05


@pytest.mark.parametrize("levels", [(0.5, 0.5), (0.5, 0.8, 0.8), (0.5, 0.503, 0.8)])
def test_two_levels_say_nothing(campaign, levels):
    layout, tests = campaign(levels=levels)
    assert compare_laws(layout, tests) == ()
    assert free_exponents(layout, tests) == {}


@pytest.mark.parametrize("exponent", [1.0, 0.5])
def test_the_exponent_of_the_tests_is_inside_its_interval(campaign, exponent):
    low, middle, high = free_exponents(*campaign(exponent, MANY))["Fc_fwd"]
    assert low < exponent < high
    assert middle == pytest.approx(exponent, abs=0.1)
    assert (low < 1.0 < high) == (exponent == 1.0)


def test_the_exponents_interval_is_brute_force(campaign):
    layout, tests = campaign(0.8)
    data = np.array([t.mean[0] for t in tests])
    noise = np.diag([t.covariance[0, 0] for t in tests])
    folds = np.log(np.array(LEVELS) / layout.reference) / layout.spread[0]
    exponents = np.linspace(0.0, 2.0, 801)
    scale = layout.scatter_sd[0] / layout.spread[0]
    apart = np.sqrt(3.0) * np.abs(np.log(np.array(LEVELS)[:, None] / LEVELS)) / np.log(2.0)
    sizes = np.exp(np.mean(np.log(np.unique(LEVELS)))) / np.array(LEVELS)
    assert sizes.min() >= 0.5
    assert sizes.max() <= 2.0
    alike = sizes[:, None] * sizes * (1.0 + apart) * np.exp(-apart)
    sds = stats.halfnorm(scale=scale).ppf((np.arange(60) + 0.5) / 60)
    density, without = np.zeros((2, exponents.size))
    for tau in sds:
        for omega in (0.0, *(2.0 * sds)):  # levels deviate by more
            c = noise + tau**2 * np.eye(4) + 1.0 + omega**2 * alike
            normal = stats.multivariate_normal(cov=c).pdf(data - exponents[:, None] * folds)
            density, without = (
                density + (omega > 0) * normal,
                without + (omega == 0) * normal,
            )

    def quantiles(density):
        mass = np.cumsum(density * stats.norm(1.0, 0.5).pdf(exponents))
        return np.interp([0.025, 0.5, 0.975], mass / mass[-1], exponents)

    found = free_exponents(layout, tests)["Fc_fwd"]
    np.testing.assert_allclose(found, quantiles(density), atol=0.02)
    assert np.max(np.abs(found - quantiles(without))) > 0.08  # the control


def deviating(priors, runs, each, exponent):
    """Share of campaigns that contradict a proportional law, with smooth deviations of 5 %."""
    at = np.array([0.4, 0.6, 0.9, 1.4, 2.0])
    apart = np.log(at[:, None] / at)
    root = np.linalg.cholesky(np.exp(-0.5 * (apart / np.log(2.0)) ** 2) + 1e-9 * np.eye(5))
    layout = lay_out(priors, ("Fc_fwd",), [Setting(p) for p in np.repeat(at, each)])
    rng, bad = np.random.default_rng(11), 0
    for _ in range(runs):
        q = exponent * np.log(at / layout.reference) + 0.05 * root @ rng.standard_normal(5)
        q = np.repeat(q, each) + 0.04 * rng.standard_normal(5 * each)
        tests = [
            SimpleNamespace(mean=np.array([m]), covariance=np.array([[v]]))
            for m, v in zip(
                q / layout.spread[0], [0.02**2 / layout.spread[0] ** 2] * q.size, strict=True
            )
        ]
        low, _, high = free_exponents(layout, tests)["Fc_fwd"]
        bad += not low <= 1.0 <= high
    return bad / runs


@pytest.mark.slow
def test_levels_that_deviate_a_little_do_not_contradict_a_law(priors):
    assert deviating(priors, 240, 10, 1.0) <= 0.08  # 0.55 without the effect of the level
    assert deviating(priors, 10, 10, 0.5) == 1.0  # the control: the law is wrong


def test_only_proportional_laws_are_freed(campaign):
    assert free_exponents(*campaign(laws={"Fc_fwd": "power"})) == {}


SPEEDS = [1.0, 8.0, 4.0, 2.0, 1.0, 8.0, 4.0, 2.0, 1.0, 8.0]


@pytest.fixture(scope="module")
def without_dependence(campaign):
    """Scores of tests whose speeds differ, and do not matter."""
    return compare_dependence(*campaign(levels=MANY, velocities=SPEEDS))


def test_a_dependence_on_speed_is_found_where_there_is_one(campaign, without_dependence):
    found = compare_dependence(*campaign(levels=MANY, velocities=SPEEDS, sensitivity=0.3))
    assert [(s.quantity, s.covariate) for s in found] == [("Fc_fwd", ""), ("Fc_fwd", "velocity")]
    assert found[1].difference > 2 * found[1].se > 0
    assert found[1].difference == pytest.approx(found[1].elpd - found[0].elpd)
    none = without_dependence[1]  # the control
    assert none.difference < 2 * none.se


@pytest.mark.parametrize("sessions", [None, list("aabba")], ids=["one session", "two sessions"])
def test_leaving_out_a_level_of_one_test_is_leaving_out_that_test(campaign, sessions, monkeypatch):
    monkeypatch.setattr(law_scores, "LAWS", {"power": LAWS["power"]})  # each is scored by itself
    apart = {"levels": (0.4, 0.6, 0.9, 1.4, 2.0), "velocities": SPEEDS[:5], "sessions": sessions}
    layout, tests = campaign(0.8, laws={"Fc_fwd": "power"}, **apart)
    (by_level,) = compare_laws(layout, tests)
    by_test = compare_dependence(layout, tests)[0]
    assert by_test.covariate == ""
    assert by_test.elpd == pytest.approx(by_level.elpd, rel=1e-6)


def test_scores_of_a_dependence_are_brute_force(campaign):
    layout, tests = campaign(
        levels=(0.4, 0.6, 0.9, 1.4, 2.0), velocities=SPEEDS[:5], sensitivity=SENSITIVITY
    )
    data = np.array([t.mean[0] for t in tests])
    noise = np.diag([t.covariance[0, 0] for t in tests])
    relative = np.array([s.actuation for s in layout.settings]) / layout.reference
    folds = np.log(SPEEDS[:5]) - np.mean(np.log(SPEEDS[:5]))
    places = (np.arange(60) + 0.5) / 60
    slopes = stats.norm(0.0, SENSITIVITY).ppf(places)[:, None]
    away = data - (np.log(relative) + slopes * folds) / layout.spread[0]
    scale = layout.scatter_sd[0] / layout.spread[0]

    def density(kept):
        terms = []
        for tau in stats.halfnorm(scale=scale).ppf(places):
            c = noise + tau**2 * np.eye(5) + 1.0
            normal = stats.multivariate_normal(cov=c[np.ix_(kept, kept)])
            terms.append(normal.logpdf(away[:, kept]))
        return special.logsumexp(terms)

    everyone = list(range(5))
    parts = [density(everyone) - density([i for i in everyone if i != j]) for j in everyone]
    found = compare_dependence(layout, tests)[1]
    assert found.covariate == "velocity"
    assert found.elpd == pytest.approx(sum(parts), abs=0.1)


def test_a_dependence_needs_tests_and_speeds_that_differ(campaign, without_dependence):
    assert compare_dependence(*campaign(levels=(0.5, 0.8, 1.5), velocities=[1.0, 2.0, 4.0])) == ()
    assert compare_dependence(*campaign(levels=MANY)) == ()
    layout, tests = campaign(levels=MANY, velocities=SPEEDS)
    assert without_dependence != ()
    unknown = (Setting(MANY[0]), *layout.settings[1:])  # one test without a speed
    assert compare_dependence(replace(layout, settings=unknown), tests) == ()


# stacking


def test_the_only_law_that_predicts_has_all_weight():
    scores = np.array([[0.0, -20.0, -30.0]] * 5)
    np.testing.assert_allclose(stack(scores), [1.0, 0.0, 0.0], atol=1e-6)


def test_laws_that_predict_different_levels_share_the_weight():
    scores = np.log(np.array([[0.9, 0.1], [0.1, 0.9]] * 3))
    np.testing.assert_allclose(stack(scores), [0.5, 0.5], atol=1e-3)


def test_weights_are_the_best_ones():
    scores = np.random.default_rng(1).normal(size=(7, 2))
    share = np.linspace(0, 1, 2001)
    density = np.exp(scores)
    total = np.log(density @ np.stack([share, 1.0 - share])).sum(axis=0)
    best = share[np.argmax(total)]
    assert 0.02 < best < 0.98
    np.testing.assert_allclose(stack(scores), [best, 1.0 - best], atol=2e-3)


def test_a_law_that_is_never_best_has_no_weight():
    scores = np.log(np.array([[0.5, 0.4, 0.3], [0.4, 0.5, 0.3], [0.5, 0.4, 0.3]]))
    weights = stack(scores)
    assert weights[2] == 0.0
    assert weights.sum() == pytest.approx(1.0)
