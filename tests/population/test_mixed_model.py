"""The linear mixed model against dense normal distributions, which scipy computes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg, special, stats

from mfd_bayes.population.design import (
    LAW_NAMES,
    LAWS,
    Coordinates,
    TestConditions,
    design_of,
    levels_of,
    ratio,
)
from mfd_bayes.population.mixed_model import (
    MixedModel,
    StudentTProposal,
    TestGaussians,
    compare_laws,
    extrapolation_weights,
)
from tests.population.made import sample_h

NAMES = ("Fc_fwd", "sigma0", "k3", "offset")
SOME_LAWS = {"Fc_fwd": "power", "sigma0": "affine"}
CONDITIONS = [  # actuation, session, half the stroke
    (0.5, "a", 1.0), (1.0, "a", 0.5), (2.0, "a", 1.0), (1.0, "b", 2.0), (2.0, "b", 0.7),
    (0.5, "b", 1.5),
]  # fmt: skip
SETTINGS = [TestConditions(p, s, {"amplitude": x, "velocity": 3.0 * x}) for p, s, x in CONDITIONS]


def design(priors, settings=SETTINGS, names=NAMES, laws=SOME_LAWS, dependence=None):
    base = design_of(priors, names, settings, laws, dependence or {"Fc_fwd": ("amplitude",)})
    return replace(base, common=np.array([name == "k3" for name in names]))


def random_likelihoods(rng, count, d, sd=0.3):
    roots = rng.standard_normal((count, d, d + 2))
    covariance = sd**2 * roots @ roots.swapaxes(1, 2) / (d + 2)
    return 0.5 * rng.standard_normal((count, d)), np.linalg.inv(covariance)


@pytest.fixture(scope="module")
def mixed(priors):
    rng, laid = np.random.default_rng(1), design(priors)
    return MixedModel(laid, *random_likelihoods(rng, len(SETTINGS), len(NAMES)))


def choice_of(mixed):
    return np.array([LAW_NAMES.index(law) for law in mixed.design.laws.values()])


class Dense:
    """Joint normal distribution of z and of all y, by the formulas of the design's docstring."""

    def __init__(self, mixed, h):
        laid, d = mixed.design, len(mixed.design.names)
        f, effects, count = laid.free, laid.effects, len(laid.settings)
        tau = np.zeros(d)
        tau[f] = np.exp(h[: f.size]) / laid.spread[f]
        omega = np.exp(h[f.size : f.size + len(effects)])
        shapes = dict(zip(laid.shapes, h[f.size + len(effects) :], strict=True))
        p, p0 = np.array([s.actuation for s in laid.settings]), laid.reference
        columns, prior = [], []

        def column(k, values):
            full = np.zeros((count, d))
            full[:, k] = values
            columns.append(full.ravel())

        for k in range(d):
            column(k, 1.0)
            prior.append(np.eye(1))
        for name, covariates in laid.dependence.items():
            for c in covariates:
                logs, k = np.log([s.covariates[c] for s in laid.settings]), laid.names.index(name)
                column(k, (logs - logs.mean()) / laid.spread[k])
                prior.append(0.1**2 * np.eye(1))
        cells = list(dict.fromkeys((s.session, s.actuation) for s in laid.settings))
        level = np.array([a for _, a in cells])
        lag = np.sqrt(3.0) * np.abs(np.log(level[:, None] / level)) / np.log(2.0)
        far = np.maximum(lag, 1e-9)  # Matérn of order 3/2 by Bessel's K, not by its closed form
        kernel = np.sqrt(2.0 / np.pi) * far**1.5 * special.kv(1.5, far)
        kernel *= np.array([[a[0] == b[0] for b in cells] for a in cells])
        size = np.clip(p0 / level, 0.5, 2.0)
        for e, effect in enumerate(effects):
            leveled = effect.name == "level"
            labels = [(s.session, s.actuation) if leveled else s.session for s in laid.settings]
            homes = list(dict.fromkeys(labels))
            for k in effect.members:
                for label in homes:
                    column(k, np.array([mine == label for mine in labels]) / laid.spread[k])
                block = np.outer(size, size) * kernel if leveled else np.eye(len(homes))
                prior.append(omega[e] ** 2 * block)
        law = np.zeros((count, d))
        for name, kind in laid.laws.items():
            k = laid.names.index(name)
            share, exponent = {"affine": (None, 1.0), "power": (1.0, None)}[kind]
            share = special.expit(shapes[name, "share"]) if share is None else share
            exponent = shapes[name, "exponent"] if exponent is None else exponent
            law[:, k] = np.log(share * (p / p0) ** exponent + 1.0 - share) / laid.spread[k]
        scatter = np.tile(tau**2, (count, 1))
        scatter[:, f] /= mixed.weight
        self.a, self.prior, self.law = np.array(columns).T, linalg.block_diag(*prior), law.ravel()
        noise = np.diag(scatter.ravel()) + linalg.block_diag(*np.linalg.inv(mixed.p))
        self.covariance = self.a @ self.prior @ self.a.T + noise
        self.y, self.d, self.p = mixed.y.ravel(), d, mixed.p

    def log_density(self, tests):
        """Of the likelihoods of tests, each exp(-½ (x - y)' P (x - y))."""
        index = np.concatenate([np.arange(j * self.d, (j + 1) * self.d) for j in tests])
        of_y = stats.multivariate_normal(self.law[index], self.covariance[np.ix_(index, index)])
        sizes = sum(self.d * np.log(2 * np.pi) - np.linalg.slogdet(self.p[j])[1] for j in tests)
        return of_y.logpdf(self.y[index]) + 0.5 * sizes

    def coefficients(self):
        gain = np.linalg.solve(self.covariance, self.a @ self.prior).T
        return gain @ (self.y - self.law), self.prior - gain @ self.a @ self.prior


def scatter_of(mixed):
    """Scatter of the first quantity at the mode."""
    return mixed.tau(mixed.from_standard_normal(mixed.mode(choice_of(mixed))[None]))[0, 0]


def some_h(mixed, n=4, seed=0):
    rng = np.random.default_rng(seed)
    h = np.log(0.5 * np.concatenate([mixed.scale, np.ones(mixed.dim - mixed.scale.size)]))
    return h + 0.5 * rng.standard_normal((n, mixed.dim))


def test_the_marginal_likelihood_is_the_dense_normal_density(mixed):
    assert {effect.name for effect in mixed.design.effects} == {"level", "session"}
    h, choice, all_tests = some_h(mixed), choice_of(mixed), range(len(SETTINGS))
    density = mixed.marginal(h, np.tile(choice, (4, 1)))[0]
    expected = [Dense(mixed, row).log_density(all_tests) for row in h]
    np.testing.assert_allclose(density - density[0], np.array(expected) - expected[0], atol=1e-5)
    assert np.ptp(expected) > 0.5  # the control: it is not the same for all h
    for tests in ([0, 1, 2], [1, 3, 5], [4]):
        partial = mixed.marginal(h, np.tile(choice, (4, 1)), tests)[0]
        fewer = [Dense(mixed, row).log_density(tests) for row in h]
        difference = np.array(fewer) - expected
        np.testing.assert_allclose(partial - density, difference, atol=1e-5)


def test_coefficients_given_h_are_those_of_the_dense_distribution(mixed):
    h = some_h(mixed, 2)
    coefficients = mixed.marginal(h, np.tile(choice_of(mixed), (2, 1)))[1]
    for row, mean, factor in zip(h, coefficients.mean, coefficients.factor, strict=True):
        expected, covariance = Dense(mixed, row).coefficients()
        np.testing.assert_allclose(mean, expected, atol=1e-5)
        np.testing.assert_allclose(np.linalg.inv(factor @ factor.T), covariance, atol=1e-5)
    normal = mixed.marginal(np.repeat(h[:1], 4000, axis=0), np.tile(choice_of(mixed), (4000, 1)))[1]
    z = normal.draw(np.random.default_rng(3))
    mean, covariance = Dense(mixed, h[0]).coefficients()
    sd = np.sqrt(np.diag(covariance))
    assert np.all(np.abs(z.mean(axis=0) - mean) < 4.5 * sd / np.sqrt(4000))
    np.testing.assert_allclose(z.std(axis=0), sd, rtol=4.5 / np.sqrt(2 * 4000))


@pytest.fixture(scope="module")
def known(priors):
    """Tests whose coordinates are all but exactly known; one says nothing of sigma0."""
    laid, rng = design(priors), np.random.default_rng(4)
    x = 0.5 * rng.standard_normal((len(SETTINGS), len(NAMES)))
    x[:, NAMES.index("k3")] = 0.1  # the same in all tests
    precision = np.tile(1e8 * np.eye(len(NAMES)), (len(x), 1, 1))
    precision[5, 1, 1] = 1e-8
    weight = np.ones((len(x), 3))
    weight[2, 0] = 0.04
    return MixedModel(laid, x, precision, weight)


def moments_given_tests(mixed, chains=64, sweeps=240):
    """Means of h, of its squares, and of the coefficients z, by chain, after a sixth of the sweeps.

    The coefficients are those of quantities that differ between tests.
    """
    rng, pooled = np.random.default_rng(5), np.ones(mixed.weight.shape, dtype=bool)
    pooled[5, 1] = False
    h, z = some_h(mixed, chains), np.zeros((chains, mixed.design.quantity.size))
    step, choice, draws = np.ones(mixed.dim), choice_of(mixed), []
    x = np.tile(mixed.y, (chains, 1, 1))
    for sweep in range(sweeps):
        h, z, tuned = mixed.move_given_tests(h, z, x, pooled, choice, step, rng)
        if sweep < sweeps // 6:
            step = tuned
        else:
            draws.append(np.column_stack([h, h**2, z[:, differing(mixed)]]))
    return np.mean(draws, axis=0)


def differing(mixed):
    return np.isin(mixed.design.quantity, mixed.free)


def moments_by_importance(mixed):
    """The same by importance sampling of h, whose marginal likelihood is tested above."""
    h = sample_h(mixed, choice_of(mixed), np.random.default_rng(6), 6000)
    z = np.concatenate([mixed.marginal(b, choice_of(mixed))[1].mean for b in np.split(h, 60)])
    return np.column_stack([h, h**2, z[:, differing(mixed)]])


def errors_given_tests(mixed):
    """Differences of the two, in standard errors; six draws of the sample count as one point."""
    by_chain, points = moments_given_tests(mixed), moments_by_importance(mixed)
    variance = by_chain.var(axis=0) / len(by_chain) + 6.0 * points.var(axis=0) / len(points)
    return (by_chain.mean(axis=0) - points.mean(axis=0)) / np.sqrt(variance)


def test_moves_given_the_tests_have_the_moments_of_an_importance_sample(known):
    assert {effect.name for effect in known.design.effects} == {"level", "session"}
    assert {shape for _, shape in known.design.shapes} == {"share", "exponent"}
    assert np.abs(errors_given_tests(known)).max() < 6.0  # 42 of them, 3.9 in six seeds


@pytest.mark.parametrize("term", ["log_prior", "prior_precision"])
def test_a_wrong_term_of_the_moves_given_the_tests_would_be_seen(known, monkeypatch, term):
    """Twice the log prior of h, or twice the precision of the coefficients."""
    expected, exact = moments_by_importance(known), getattr(MixedModel, term)
    monkeypatch.setattr(MixedModel, term, lambda self, h: 2.0 * exact(self, h))
    by_chain = moments_given_tests(known, sweeps=90)
    errors = (by_chain - expected.mean(axis=0)).mean(axis=0)
    errors /= by_chain.std(axis=0) / np.sqrt(len(by_chain))
    assert np.abs(errors).max() > 12.0


def clean(priors, seed, count=10):
    """Tests at one level that scatter by half the prior's scale, known to a fifth of that."""
    rng = np.random.default_rng(seed)
    laid = design(
        priors, [TestConditions(1.0)] * count, ("Fc_fwd", "sigma0", "offset"), dependence={"": ()}
    )
    laid = replace(laid, common=np.zeros(3, dtype=bool))
    tau = 0.5 * laid.scatter_sd / laid.spread
    y = tau * rng.standard_normal((count, 3))
    precision = np.tile(np.diag((0.2 * tau) ** -2.0), (count, 1, 1))
    return laid, y, precision, tau


def test_a_test_that_stands_apart_weighs_less_and_clean_ones_do_not(priors):
    flagged, wider = 0, []
    for seed in range(10):
        laid, y, precision, tau = clean(priors, seed)
        mixed = MixedModel(laid, y, precision)
        mixed.find_outliers(choice_of(mixed))
        flagged += np.count_nonzero(mixed.weight != 1.0)
        y = y.copy()
        y[3, 0] += 15.0 * tau[0]
        odd = MixedModel(laid, y, precision)
        wide = scatter_of(odd)
        odd.find_outliers(choice_of(odd))
        assert odd.weight[3, 0] == 0.01
        np.testing.assert_array_equal(np.delete(odd.weight[:, 0], 3), 1.0)
        robust = scatter_of(odd)
        assert wide > 2.0 * robust  # the control: with all weights even
        nine = clean(priors, seed, 9)[0]
        wider.append(robust / scatter_of(MixedModel(nine, np.delete(y, 3, 0), precision[1:])))
    assert flagged <= 0.01 * 10 * 30
    assert np.exp(np.mean(np.log(wider))) < 1.5  # than without that test; one of 200 is 3 times


def test_draws_find_the_scatter_that_a_grid_finds(priors):
    laid, y, precision, _ = clean(priors, 0)
    mixed = MixedModel(laid, y, precision)
    choice = choice_of(mixed)
    assert mixed.dim == 5  # three scatters, and two shapes of which one level says nothing
    draws = sample_h(mixed, choice, np.random.default_rng(1), 8000)
    axis = np.linspace(-5.0, 1.5, 400)
    middle = draws.mean(axis=0)
    for i in range(3):  # the three are independent here
        grid = np.tile(middle, (axis.size, 1))
        grid[:, i] = axis + np.log(mixed.scale[i])
        weight = special.softmax(
            mixed.log_prior(grid).sum(axis=1) + mixed.marginal(grid, choice)[0]
        )
        mean = weight @ grid[:, i]
        sd = np.sqrt(weight @ (grid[:, i] - mean) ** 2)
        assert abs(draws[:, i].mean() - mean) < 0.15 * sd
        assert draws[:, i].std() == pytest.approx(sd, rel=0.15)
        # the control: it is not the prior
        prior = special.softmax(mixed.log_prior(grid).sum(axis=1))
        prior_sd = np.sqrt(prior @ (grid[:, i] - prior @ grid[:, i]) ** 2)
        assert draws[:, i].std() < 0.5 * prior_sd


def test_levels_left_out_are_scored_by_differences_of_dense_densities(priors):
    rng = np.random.default_rng(2)
    laid = design(priors, names=("Fc_fwd", "offset"), laws={"Fc_fwd": "power"})
    laid = replace(laid, common=np.zeros(2, dtype=bool))
    y, precision = random_likelihoods(rng, len(SETTINGS), 2)
    tests = TestGaussians.given_common(laid, y, precision, np.zeros(2))
    folds = levels_of(laid.settings)
    assert [[laid.settings[j].actuation for j in f] for f in folds] == [
        [p] * 2 for p in (0.5, 1, 2)
    ]
    log, h = tests.densities("Fc_fwd", "power", folds)
    fields = {n: getattr(laid, n)[:1] for n in ("names", "spread", "scatter_sd", "common")}
    reduced = replace(laid, **fields, leveled=False)
    model = MixedModel(reduced, tests.mean[:, [0]], 1.0 / tests.variance[:, [0], None])
    rows = set(range(len(SETTINGS)))
    for i in (3, 500, 900):
        dense = Dense(model, h[i])
        for f, fold in enumerate(folds):
            expected = dense.log_density(sorted(rows)) - dense.log_density(sorted(rows - {*fold}))
            assert log[i, 0] - log[i, 1 + f] == pytest.approx(expected, abs=1e-5)


def power_tests(priors, scatter, noise):
    """Tests at four levels that follow a power law with an exponent of 0.4."""
    settings = [TestConditions(p) for p in (0.25, 0.25, 0.5, 0.5, 1.0, 1.0, 2.0, 2.0)]
    laid = design(priors, settings, ("Fc_fwd", "offset"), {"Fc_fwd": "compare"}, {"": ()})
    laid = replace(laid, common=np.zeros(2, dtype=bool))
    rng, p = np.random.default_rng(4), np.array([s.actuation for s in settings])
    y = np.zeros((len(p), 2))
    logs = 0.4 * np.log(p / laid.reference) + scatter * rng.standard_normal(p.size)
    y[:, 0] = logs / laid.spread[0]
    precision = np.tile(np.diag((noise / laid.spread) ** -2.0), (p.size, 1, 1))
    return TestGaussians.given_common(laid, y, precision, np.zeros(2))


def test_a_law_that_predicts_the_levels_left_out_is_preferred(priors):
    tests = power_tests(priors, 0.04, 0.04)
    scores = {score.law: score for score in compare_laws(tests)}
    assert max(scores.values(), key=lambda s: s.elpd).law == "power"
    assert sum(s.weight for s in scores.values()) == pytest.approx(1.0)
    assert scores["power"].weight > 0.5 > 0.01 > scores["proportional"].weight
    weights = extrapolation_weights(tests, ["Fc_fwd"], ["proportional", "power", "constant"])
    assert weights[1] == max(weights)
    assert weights.sum() == pytest.approx(1.0)
    narrow = replace(tests.design, settings=tests.design.settings[2:6])
    two = TestGaussians(narrow, tests.mean[2:6], tests.variance[2:6])
    equal = extrapolation_weights(two, ["Fc_fwd"], ["power", "affine"])
    np.testing.assert_allclose(equal, 0.5)
    assert compare_laws(two) == ()


# --- dates


def test_a_drift_is_found_where_there_is_one(priors):
    rng, years = np.random.default_rng(3), np.repeat(2020.0 + np.arange(5.0), 3)
    tested, slopes = [TestConditions(1.0, "", {"date": year}) for year in years], []
    laid = design(priors, tested, ("Fc_fwd",), {"Fc_fwd": "proportional"}, {"Fc_fwd": ("date",)})
    laid = replace(laid, leveled=False)
    for rate in (-0.04, 0.0):
        values = rate * (years - 2022.0) + rng.normal(0.0, 0.02, years.size)
        precision = np.full((years.size, 1, 1), (laid.spread[0] / 0.002) ** 2)
        mixed = MixedModel(laid, values[:, None] / laid.spread[0], precision)
        h = sample_h(mixed, np.array([0]), np.random.default_rng(1), 2000)
        z = mixed.marginal(h, np.array([0]))[1].draw(rng)
        slopes.append((np.mean(z[:, 1] / 4.0), np.std(z[:, 1] / 4.0)))  # of four years
    (drift, error), (null, wide) = slopes
    assert abs(drift + 0.04) < 4.0 * error
    assert drift + 4.0 * error < 0.0
    assert abs(null) < 4.0 * wide
    assert laid.changed("date", TestConditions(1.0)) == pytest.approx(0.5)  # the latest one
    later = TestConditions(1.0, "", {"date": 2030.0})
    assert laid.changed("date", later) == pytest.approx(2.0)


# --- laws, and the coordinates in which tests are compared

SOME = {"share": 0.3, "exponent": 0.6}


def at(law: str, relative: np.ndarray, **shapes: float) -> np.ndarray:
    """Ratio of a law by name, with the given share and exponent where they are free."""
    share, exponent = (
        np.array(getattr(LAWS[law], s) if getattr(LAWS[law], s) is not None else (SOME | shapes)[s])
        for s in ("share", "exponent")
    )
    return ratio(relative, share, exponent)


def test_laws_are_their_formulas():
    relative = np.array([0.2, 0.5, 1.0, 3.0])
    np.testing.assert_allclose(at("proportional", relative), relative)
    np.testing.assert_allclose(at("affine", relative, share=0.7), 0.3 + 0.7 * relative)
    np.testing.assert_allclose(at("power", relative, exponent=1.7), relative**1.7)
    np.testing.assert_array_equal(at("constant", relative), 1.0)
    residual = at("residual_power", relative, share=0.7, exponent=1.4)
    np.testing.assert_allclose(residual, 0.3 + 0.7 * relative**1.4)
    with np.errstate(all="raise"):
        assert np.isfinite(ratio(np.array([1e10]), np.array([1.0]), np.array([40.0])))
    for law, intercept in zip(LAWS, (0.0, 0.7, 0.0, 1.0, 0.7), strict=True):  # without actuation
        with np.errstate(all="raise"):
            assert at(law, np.zeros(1)) == pytest.approx(intercept)
        assert LAWS[law].intercept == (intercept > 0.0)


# --- coordinates

EVERY = ("sigma0", "Fc_fwd", "Fc_bwd", "static_excess_fwd", "static_excess_bwd", "k3", "d2", "d3")
EVERY = (*EVERY, "v_s", "offset")
SPEED = 0.6
SUBSETS = (EVERY, ("Fc_fwd", "static_excess_fwd"), ("d3", "offset"))  # without speeds, or a gap


def coordinates(priors, names=EVERY):
    return Coordinates(names, {n: priors.parameters[n] for n in names}, SPEED)


def draw(priors, names=EVERY, n=50):
    rng = np.random.default_rng(1)
    return {name: priors.parameters[name].draw(rng, n) for name in names}


@pytest.mark.parametrize("names", SUBSETS)
def test_prior_units_are_those_of_the_prior_and_the_change_has_determinant_one(priors, names):
    shared, values = coordinates(priors, names), draw(priors, names)
    restored = shared.values(shared.of(values))
    for name in names:
        np.testing.assert_allclose(restored[name], values[name], rtol=1e-9, atol=1e-12)
    x = shared.of(draw(priors, names, 4000))
    np.testing.assert_allclose(x.mean(axis=0), 0.0, atol=4.0 * np.sqrt(2.0 / 4000))
    np.testing.assert_allclose(x.std(axis=0), 1.0, atol=0.1)
    for row in x[:5]:
        steps = 1e-5 * np.eye(len(names))
        jacobian = (
            (shared.of_priors(row + steps) - shared.of_priors(row - steps)) / 2e-5 / shared.spread
        )
        assert abs(np.linalg.det(jacobian)) == pytest.approx(1.0, abs=1e-6)


def test_slip_forces_at_a_common_speed_and_the_width_of_the_gap_are_compared(priors):
    shared, values = coordinates(priors), draw(priors)
    q = shared.centre + shared.spread * shared.of(values)
    stribeck = np.exp(-((SPEED / values["v_s"]) ** 2))
    for side in ("fwd", "bwd"):
        slip = values[f"Fc_{side}"] * (1.0 + values[f"static_excess_{side}"] * stribeck)
        np.testing.assert_allclose(np.exp(q[:, EVERY.index(f"Fc_{side}")]), slip, rtol=1e-10)
        assert np.max(np.abs(slip / values[f"Fc_{side}"] - 1.0)) > 0.05
    width, share = (np.exp(q[:, EVERY.index(name)]) for name in ("d2", "d3"))
    np.testing.assert_allclose(width, values["d2"] + values["d3"], rtol=1e-10)
    np.testing.assert_allclose(share, values["d3"] / values["d2"], rtol=1e-10)
    for name in ("sigma0", "v_s", "static_excess_fwd", "k3", "offset"):
        coordinate = priors.parameters[name].coordinate(values[name])
        np.testing.assert_allclose(q[:, EVERY.index(name)], coordinate, rtol=1e-10, atol=1e-12)


def test_a_student_t_of_each_row_is_that_of_the_row_alone():
    rng = np.random.default_rng(0)
    means, roots = rng.standard_normal((3, 2)), np.tril(1.0 + rng.random((3, 2, 2)))
    together = StudentTProposal(means, roots)
    g = together.draw(np.random.default_rng(1), 3)
    rows = zip(means, roots, g, strict=True)
    alone = [StudentTProposal(m, root).log_density(row[None])[0] for m, root, row in rows]
    np.testing.assert_allclose(together.log_density(g), alone, rtol=1e-12)
    first = StudentTProposal(means[0], roots[0])  # the control: rows differ
    assert not np.allclose(first.log_density(g), alone)
    np.testing.assert_allclose(first.draw(np.random.default_rng(1), 3)[0], g[0], rtol=1e-12)
