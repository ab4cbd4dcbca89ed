"""The population by `sample_joint` against brute force, and its derived properties."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.calibration.effort import Effort
from mfd_bayes.population import sampling, warm_up
from mfd_bayes.population.apart import joined, set_apart
from mfd_bayes.population.design import lay_out
from mfd_bayes.population.moves import exchange
from mfd_bayes.population.population import Population
from mfd_bayes.population.sampling import WALKERS, JointProblem, _correlate, sample_joint
from mfd_bayes.population.settings import Setting
from mfd_bayes.population.surrogate import Surrogate

EFFORT = Effort(ess=800, limit=1000, r_hat=1.03, ensembles=12, kept=3000)
"""Many chains, of which a sweep takes hardly longer: 20 sweeps are enough."""

MEAN, SPREAD = 0.1, 0.1


@pytest.fixture(autouse=True, scope="module")
def _short_warm_up():
    """These tests are near their Gaussians, so that a few sweeps bring the chains there."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(warm_up, "GAUSSIAN", 12)
        patch.setattr(warm_up, "SETTLE", 8)
        yield


def run(linear, priors, tests=None, layout=None, effort=EFFORT, seed=5):
    tests = linear.likelihoods() if tests is None else tests
    chosen = linear.layout if layout is None else layout
    problem = JointProblem(chosen, set_apart(chosen, tests), priors.parameters, "ksi")
    return sample_joint(problem, effort, np.random.default_rng(seed))


def deviations(linear, draws):
    """Largest deviation of a mean, in sds, and of an sd, from brute force."""
    layout, population = linear.layout, draws.population
    exact = linear.solve(np.random.default_rng(7), n=1)
    d, effects = len(layout.names), len(layout.effects)
    h = population.h.reshape(population.size, -1)
    latent = population.latent.reshape(population.size, -1, d)
    found = {"sd": np.exp(h[:, : d + effects])}
    u = [latent[:, 0]]
    if effects:
        u.append(latent[:, 1:, 0] / (np.exp(h[:, d : d + 1]) / layout.spread[0]))
    if layout.laws:
        u.append((h[:, -1:] - 1.0) / 0.5)
    found["u"] = np.concatenate(u, axis=1)
    own = [joined(layout, j, x) for j, x in enumerate(draws.tests)]
    found["x"] = np.stack([x.reshape(population.size, -1) for x in own], axis=1)
    means = [np.abs(v.mean(axis=0) - exact.mean[k]) / exact.sd[k] for k, v in found.items()]
    sds = [np.abs(v.std(axis=0) / exact.sd[k] - 1.0) for k, v in found.items()]
    return max(float(np.max(m)) for m in means), max(float(np.max(s)) for s in sds)


CASES = {
    "one quantity": ((0.5, 0.5, 0.9, 0.9), ("offset",)),
    "with a power law": ((0.5, 0.5, 0.9, 0.9, 0.9), ("Fc_fwd",)),
    "with an effect of the level": ((0.5, 0.5, 0.9, 1.6), ("Fc_fwd",)),
    "two quantities, known together": ((0.5, 0.5, 0.9, 0.9), ("Fc_fwd", "offset")),
    "one for the device, and one that differs": ((0.5, 0.5, 0.9, 0.9), ("Fc_fwd", "k3")),
    "two that are one for the device": ((0.5, 0.5, 0.9, 0.9), ("k3", "sigma2")),
    "a test at zero": ((0.0, 0.5, 0.5, 0.9, 0.9), ("Fc_fwd", "offset")),
}


@pytest.mark.parametrize("case", CASES)
def test_inference_is_brute_force_where_everything_is_gaussian(make_linear, priors, case):
    linear = make_linear(*CASES[case], seed=4)
    assert bool(linear.layout.effects) == (case == "with an effect of the level")
    mean, sd = deviations(linear, run(linear, priors))
    assert mean < MEAN
    assert sd < SPREAD


WITH_SURROGATES = (
    "with an effect of the level",
    "one for the device, and one that differs",
    "a test at zero",
)


@pytest.mark.parametrize("case", WITH_SURROGATES)
def test_with_surrogates_it_is_brute_force_too(make_linear, priors, squared, case):
    linear = make_linear(*CASES[case], seed=4)
    tests = [squared(test) for test in linear.likelihoods()]
    draws = run(linear, priors, tests, effort=replace(EFFORT, ensembles=8))
    assert draws.accepted["exchange"] > 0.9
    mean, sd = deviations(linear, draws)
    assert mean < MEAN
    assert sd < SPREAD


@pytest.mark.slow
def test_surrogates_that_are_wrong_change_nothing(make_linear, priors, squared, monkeypatch):
    """They are three quarters as wide as likelihoods; where they decide, the result is wrong."""
    linear = make_linear(*CASES["two quantities, known together"], seed=4)
    tests = [squared(test) for test in linear.likelihoods()]
    weight = Surrogate.__call__

    def narrow(surrogate, x):
        return 1.8 * weight(surrogate, x)

    monkeypatch.setattr(Surrogate, "__call__", narrow)
    draws = run(linear, priors, tests, effort=replace(EFFORT, ess=500))
    assert 0.2 < draws.accepted["exchange"] < 0.95
    mean, sd = deviations(linear, draws)
    assert mean < MEAN
    assert sd < SPREAD
    monkeypatch.setattr(exchange, "_gain", lambda *given: np.zeros(len(given[1].h)))
    draws = run(linear, priors, tests, effort=replace(FEWER, ess=400))
    assert draws.accepted["exchange"] == 1.0
    mean, sd = deviations(linear, draws)
    assert mean > 2 * MEAN or sd > 2 * SPREAD


def test_surrogates_that_nothing_is_exchanged_with_are_given_up(
    make_linear, priors, squared, monkeypatch
):
    linear = make_linear(*CASES["one quantity"], seed=4)
    monkeypatch.setattr(exchange, "_gain", lambda *given: np.full(len(given[1].h), -np.inf))
    draws = run(linear, priors, [squared(test) for test in linear.likelihoods()])
    assert "exchange" not in draws.accepted
    assert deviations(linear, draws)[0] < MEAN


def test_a_test_at_zero_that_informs_a_power_law_is_told_apart(make_linear, priors, monkeypatch):
    """The control: where its value is taken for one of the law's, level and scatter follow it."""
    linear = make_linear(*CASES["a test at zero"], seed=4)
    everyone = replace(linear.layout, settings=(Setting(0.02), *linear.layout.settings[1:]))
    draws = run(linear, priors, layout=everyone, effort=FEWER)
    mean, sd = deviations(linear, draws)
    assert mean > 3 * MEAN or sd > 3 * SPREAD


FEWER = Effort(ess=100, limit=200, r_hat=1.1, kept=3000)


def test_a_wrong_prior_of_scatter_is_told_apart(make_linear, priors):
    linear = make_linear(*CASES["with a power law"], seed=4)
    narrow = replace(linear.layout, scatter_sd=linear.layout.scatter_sd / 3.0)
    mean, sd = deviations(linear, run(linear, priors, layout=narrow, effort=FEWER))
    assert mean > 3 * MEAN or sd > 3 * SPREAD


def test_a_half_normal_scatter_of_a_device_s_quantity_is_told_apart(make_linear, priors):
    linear = make_linear((0.5, 0.5, 0.9, 0.9), ("k3",), noise=6.0, seed=4)
    assert linear.layout.sparse == (True,)
    mean, sd = deviations(linear, run(linear, priors))
    assert mean < MEAN
    assert sd < SPREAD
    half_normal = replace(linear.layout, sparse=(False,))
    mean, sd = deviations(linear, run(linear, priors, layout=half_normal, effort=FEWER))
    assert mean > 2 * MEAN or sd > 2 * SPREAD


def test_a_posterior_that_is_taken_for_a_likelihood_is_told_apart(make_linear, priors):
    """The interim prior of each test is then counted twice."""
    linear = make_linear((0.5, 0.5, 0.9, 0.9), ("Fc_fwd",), level=1.5, noise=6.0, seed=3)
    tests = linear.likelihoods()
    right = deviations(linear, run(linear, priors, tests, effort=FEWER))
    wrong = [replace(t, log_likelihood=_with_prior(t)) for t in tests]
    mean, _ = deviations(linear, run(linear, priors, wrong, effort=FEWER))
    assert mean > 3 * right[0]
    assert mean > 3 * MEAN


def _with_prior(test):
    return lambda x: test.log_likelihood(x) - 0.5 * np.sum(x**2, axis=1)


QUICK = Effort(ess=10, limit=100, r_hat=1.2, ensembles=2, kept=300)


def test_the_same_seed_gives_the_same_bits(make_linear, priors):
    linear = make_linear(*CASES["with an effect of the level"])
    first, again, other = (run(linear, priors, effort=QUICK, seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(first.population.h, again.population.h)
    np.testing.assert_array_equal(first.population.latent, again.population.latent)
    for x, same in zip(first.tests, again.tests, strict=True):
        np.testing.assert_array_equal(x, same)
    assert np.any(first.population.h != other.population.h)


def test_draws_are_laid_out_by_chain_and_walker(make_linear, priors):
    linear = make_linear(*CASES["two quantities, known together"])
    found = run(linear, priors, effort=QUICK)
    population = found.population
    chains, draws, dim = population.h.shape
    assert (chains, dim) == (QUICK.ensembles, linear.layout.dim)
    assert draws % WALKERS == 0
    assert population.latent.shape == (chains, draws, 1, 2)
    assert population.choice.shape == (chains, draws, 1)
    assert population.levels.shape == (chains, draws, 2)
    assert [x.shape for x in found.tests] == [(chains, draws, 2)] * 4
    assert found.sweeps >= 20
    assert all(0.0 <= share <= 1.0 for share in found.accepted.values())


LONG = Effort(ess=400, limit=1000, r_hat=0.9, ensembles=2, kept=300)


@pytest.mark.slow
def test_as_many_states_are_kept_as_are_asked_for(make_linear, priors, monkeypatch):
    monkeypatch.setitem(sampling.SWEEPS, LONG.ess, 450)
    found = run(make_linear(*CASES["one quantity"]), priors, effort=LONG)
    kept = found.population.h.shape[1]
    assert found.sweeps == 450  # it cannot converge to this
    assert sampling.KEPT <= kept <= 2.3 * sampling.KEPT
    assert [x.shape[1] for x in found.tests] == [kept] * 4


def test_convergence_is_looked_at_now_and_then_and_at_the_limit():
    assert sampling._looks(160) == [20, 30, 45, 67, 100, 150, 160]
    assert sampling._looks(30) == [20, 30]


def test_chains_keep_their_laws(make_linear, priors):
    linear = make_linear(*CASES["with a power law"])
    weights = {"Fc_fwd": {"power": 0.5, "constant": 0.5}}
    found = run(linear, priors, layout=replace(linear.layout, weights=weights), effort=QUICK)
    choice = found.population.choice.reshape(QUICK.ensembles, WALKERS, -1)
    assert np.all(choice == choice[:, :, :1])
    exponents = found.population.shapes("Fc_fwd")[1].reshape(choice.shape)
    shares = found.population.shapes("Fc_fwd")[0].reshape(choice.shape)
    np.testing.assert_array_equal(shares == 0.0, choice == 3)
    assert np.all(exponents[choice == 3] == 1.0)
    assert np.mean(choice == 3) == pytest.approx(0.5, abs=0.05)


# properties of a population with made-up draws


def written(priors, laws=None, n=50, actuations=(0.5, 1.0, 2.0)):
    """A population of two chains with made-up draws, laws and effects."""
    names = ("sigma0", "Fc_fwd", "Fc_bwd", "static_excess_fwd", "static_excess_bwd", "offset")
    layout = lay_out(priors, names, [Setting(p) for p in actuations], laws)
    rng = np.random.default_rng(1)
    cells = sum(len(e.cells) for e in layout.effects)
    h = rng.normal(-2.0, 0.2, size=(2, n, layout.dim))
    together = _correlate(products_of(rng.normal(size=(2, n, 3, len(names)))))
    return Population(
        layout=layout,
        h=h,
        latent=0.1 * rng.normal(size=(2, n, 1 + cells, len(names))),
        choice=layout.draw_choice(2 * n).reshape(2, n, -1),
        together=together,
        priors={name: priors.parameters[name] for name in names},
        actuation_unit="ksi",
        walkers=10,
        convergence=Convergence(np.ones(1), np.ones(1), np.ones(1)),
    )


def test_medians_follow_the_laws(priors):
    population = written(priors)
    at = population.median("Fc_fwd", np.array([0.5, 1.0, 2.0]))
    assert at.shape == (2, 50, 3)
    np.testing.assert_allclose(at[..., 0] * 4, at[..., 2], rtol=1e-12)
    stiffness = population.median("sigma0", np.array([0.0, 1.0, 2.0]))
    np.testing.assert_allclose(np.diff(stiffness, n=2), 0.0, atol=1e-9)
    level = population.levels[..., 1]
    np.testing.assert_allclose(at[..., 1], np.exp(level), rtol=1e-12)
    np.testing.assert_array_equal(
        population.median("offset", np.array([0.3]))[..., 0], population.levels[..., 5]
    )


def test_slopes_are_the_papers_constants(priors):
    population = written(priors)
    slopes, p = population.slopes, np.array([1.7])
    np.testing.assert_allclose(slopes["K_c_fwd"] * p, population.median("Fc_fwd", p)[..., 0])
    excess = population.median("static_excess_bwd", p)[..., 0]
    static = population.median("Fc_bwd", p)[..., 0] * (1.0 + excess)
    np.testing.assert_allclose(slopes["K_s_bwd"] * p, static)
    stiffness = population.median("sigma0", p)[..., 0]
    np.testing.assert_allclose(slopes["alpha_sigma0"] * p + slopes["sigma0_0"], stiffness)
    power = written(priors, {"Fc_fwd": "power", "sigma0": "power"}).slopes
    assert set(power) == {"K_c_bwd", "K_s_bwd"}


def test_straight_laws_with_residual_friction_have_slope_and_intercept(priors):
    laws = {"Fc_fwd": "affine", "Fc_bwd": "residual_power", "sigma0": "residual_power"}
    population = written(priors, laws)
    slopes, p = population.slopes, np.array([0.0, 1.7])
    friction = population.median("Fc_fwd", p)
    np.testing.assert_allclose(slopes["Fc_fwd_0"], friction[..., 0])
    np.testing.assert_allclose(slopes["Fc_fwd_0"] + 1.7 * slopes["K_c_fwd"], friction[..., 1])
    assert np.all(slopes["Fc_fwd_0"] > 0)
    for name in ("Fc_bwd", "sigma0"):
        np.testing.assert_allclose(slopes[f"{name}_0"], population.median(name, p)[..., 0])
    assert not {"K_c_bwd", "alpha_sigma0"} & set(slopes)  # these laws are bent


def test_a_drawn_test_has_scatter_about_the_median(priors):
    population = written(priors, n=1)
    n, rng = 40_000, np.random.default_rng(2)
    index = np.zeros(n, dtype=np.intp)
    drawn = population.draw_test(Setting(1.0), index, rng)
    middle = population.draw_test(Setting(1.0), index[:1], rng, scattered=False)
    q = population.layout.coordinates.of(drawn) - population.layout.coordinates.of(middle)
    scatter = [float(tau[0, 0]) for tau in population.scatters.values()]
    np.testing.assert_allclose(q.mean(axis=0) / scatter, 0.0, atol=0.03)
    np.testing.assert_allclose(q.std(axis=0), scatter, rtol=0.02)
    factor = population.together[0, 0]
    np.testing.assert_allclose(np.corrcoef(q.T), factor @ factor.T, atol=0.03)


def test_a_drawn_test_at_a_new_level_has_the_effects_that_are_new_besides(priors):
    population = written(priors, n=1)
    layout, n = population.layout, 40_000
    index = np.zeros(n, dtype=np.intp)
    k = layout.names.index("Fc_fwd")
    drawn = population.draw_test(Setting(6.0), index, np.random.default_rng(2))
    i = next(i for i, e in enumerate(layout.effects) if k in e.members)
    row, new = layout.effects[i].row(("", 6.0))
    omega = np.exp(population.h[0, 0, len(layout.names) + i])
    tau = population.scatters["Fc_fwd"][0, 0]
    q = layout.coordinates.of(drawn)[:, k]
    assert q.std() == pytest.approx(np.hypot(tau, new * omega), rel=0.02)
    begin = 1 + sum(len(e.cells) for e in layout.effects[:i])
    parts = population.latent[0, 0, begin : begin + len(row), k] @ row
    expected = population.levels[0, 0, k] + np.log(6.0 / layout.reference)
    expected += layout.spread[k] * parts
    assert q.mean() == pytest.approx(expected, abs=0.02)


def test_a_drawn_test_at_a_tested_level_has_that_levels_effect(priors):
    population = written(priors, n=1)
    layout = population.layout
    middle = population.draw_test(
        Setting(2.0), np.zeros(1, dtype=np.intp), np.random.default_rng(2), scattered=False
    )
    k = layout.names.index("Fc_bwd")
    i = next(i for i, e in enumerate(layout.effects) if k in e.members)
    begin = 1 + sum(len(e.cells) for e in layout.effects[:i])
    parts = population.latent[0, 0, begin : begin + 3, k]
    effect = layout.spread[k] * layout.effects[i].root[2] @ parts
    law = np.log(2.0 / layout.reference)
    found = np.log(middle["Fc_bwd"][0])
    assert found == pytest.approx(population.levels[0, 0, k] + law + effect)


def test_correlations_are_those_of_the_places_less_than_they_show(priors):
    rng = np.random.default_rng(1)
    places = rng.normal(size=(1, 1, 400, 3))
    places[..., 1] = 0.8 * places[..., 0] + 0.6 * places[..., 1]
    factor = _correlate(products_of(places))[0, 0]
    correlation = factor @ factor.T
    np.testing.assert_allclose(np.diag(correlation), 1.0)
    assert correlation[0, 1] == pytest.approx(0.8, abs=0.06)
    assert correlation[0, 2] == pytest.approx(0.0, abs=0.12)
    alone = _correlate(products_of(places[:, :, :1]))[0, 0]
    assert np.max(np.abs((alone @ alone.T)[np.triu_indices(3, 1)])) < 0.75
    np.testing.assert_allclose(_correlate(np.zeros((1, 1, 3, 3)))[0, 0], np.eye(3))


def products_of(places):
    return np.swapaxes(places, -1, -2) @ places


def test_shapes_are_watched_where_a_law_of_weight_has_them(priors):
    settings = [Setting(p) for p in (0.5, 0.9, 1.6)]
    mixed = lay_out(priors, ["Fc_fwd"], settings, {"Fc_fwd": "compare"})
    shapes = [shape for _, shape in mixed.shapes]
    assert sorted(shapes) == ["exponent", "share"]
    begin = len(mixed.names) + len(mixed.effects)

    def watched(**weights):
        layout = replace(mixed, weights={"Fc_fwd": weights})
        active = set(sampling._active(layout).tolist())
        assert active >= {*range(begin), layout.dim}
        return {shape for i, shape in enumerate(shapes) if begin + i in active}

    assert watched(power=0.4, affine=0.6) == {"exponent", "share"}
    assert watched(power=0.4, affine=0.0, proportional=0.6) == {"exponent"}
    assert watched(power=0.0, affine=1.0) == {"share"}
    assert watched(proportional=1.0) == set()


def test_effects_and_dependences_have_columns_of_their_own(priors):
    known = {"velocity": 1.0, "amplitude": 2.0}
    settings = [Setting(p, s, known) for p in (0.5, 0.9, 1.6) for s in ("a", "b")]
    follows = {"Fc_fwd": ("velocity", "amplitude")}
    laws = {"Fc_fwd": "power"}
    layout = lay_out(priors, ["Fc_fwd", "offset"], settings, laws, follows)
    assert len(layout.effects) > 2
    h = np.arange(layout.dim, dtype=float) * np.ones((2, 3, 1))
    d, cells = len(layout.names), sum(len(effect.cells) for effect in layout.effects)
    population = Population(
        layout=layout,
        h=h,
        latent=np.zeros((2, 3, 1 + cells, d)),
        choice=np.zeros((2, 3, 1), dtype=int),
        together=np.broadcast_to(np.eye(d), (2, 3, d, d)),
        priors=priors.parameters,
        actuation_unit="ksi",
        walkers=1,
        convergence=None,
    )
    sds = population.effect_sds
    for i, effect in enumerate(layout.effects):
        found = sds[f"{effect.name}_{layout.groups[effect.group]}"]
        np.testing.assert_allclose(found, np.exp(d + i))
    begin = d + len(layout.effects)
    shapes = [f"{name}_{shape}" for name, shape in layout.shapes]
    assert set(population.dependences) == {"Fc_fwd_velocity", "Fc_fwd_amplitude"}
    for name, found in population.dependences.items():
        np.testing.assert_array_equal(found, begin + shapes.index(name))
