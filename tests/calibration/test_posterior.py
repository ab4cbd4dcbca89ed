from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.calibration.noise import NOISES
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import Prior, load_priors
from mfd_bayes.errors import FitError, PriorError
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.records.trace import Trace

FILE = load_priors("brfd")
TIME = np.arange(0, 4, 1 / 64)
MOTION = np.sin(2 * np.pi * 0.5 * TIME)
FORCE = 2.0 * np.tanh(20 * np.cos(2 * np.pi * 0.5 * TIME))
TRACE = Trace.from_arrays(TIME, MOTION, actuation=0.03, force=FORCE)
CASES = pytest.mark.parametrize(
    ("model", "noise", "start"),
    [
        ("three_stage", "ou", "sample"),
        ("three_stage", "iid", "mask"),
        ("three_stage", "student_t", "sample"),
        ("lugre", "ou", "sample"),
        ("bouc_wen", "ou", "sample"),
        ("backlash", "ou", "sample"),
        ("backlash", "staged", "mask"),
    ],
)


def build(model="three_stage", noise="ou", start="sample", *, trace=TRACE, priors=None):
    file = replace(FILE, parameters=FILE.parameters | (priors or {}))
    return Posterior(trace, file, noise, model, start=start)


def points(posterior, n=20, seed=0):
    return posterior.coordinates(posterior.draw_prior(np.random.default_rng(seed), n))


def with_force(force):
    return Trace.from_arrays(TIME, MOTION, actuation=0.03, force=force)


@CASES
def test_log_posterior_is_prior_plus_likelihood(model, noise, start):
    posterior = build(model, noise, start)
    q = points(posterior)
    total = posterior.log_prob(q)
    assert total.shape == (20,)
    assert np.all(np.isfinite(total))
    np.testing.assert_allclose(total, posterior.log_prior(q) + posterior.log_likelihood(q))


@CASES
def test_likelihood_is_that_of_the_model_computed_by_hand(model, noise, start):
    posterior = build(model, noise, start)
    q = points(posterior, 3)
    values = posterior.values(q)
    place = values["start"] if posterior.model.has_gap else None
    force = posterior.model.force(posterior.model.theta(values), TRACE, place)
    residual = FORCE - values["offset"][:, None] - force
    np.testing.assert_allclose(posterior.residual(q), residual, rtol=1e-12, atol=1e-12)
    first = posterior.first
    travel = posterior.travel(values)
    travel = None if travel is None else travel[:, first:]
    expected = NOISES[noise].log_density(residual[:, first:], TIME[first:], values, travel)
    np.testing.assert_allclose(posterior.log_likelihood(q), expected, rtol=1e-12)


@CASES
def test_batch_equals_single_points(model, noise, start):
    posterior = build(model, noise, start)
    q = points(posterior, 5)
    single = [posterior.log_prob(point[None])[0] for point in q]
    np.testing.assert_allclose(posterior.log_prob(q), single, rtol=1e-9)


@pytest.mark.parametrize(("most", "expected"), [(7.0, [7, 7, 6]), (0.1, [1] * 20), (20.0, [20])])
def test_points_of_long_records_are_computed_some_at_a_time(monkeypatch, most, expected):
    posterior = build()
    q = points(posterior)
    whole = posterior.log_likelihood(q)
    sizes = []
    force = ThreeStage.force_unbounded

    def count(self, theta, *rest, **more):
        sizes.append(len(theta))
        return force(self, theta, *rest, **more)

    monkeypatch.setattr(ThreeStage, "force_unbounded", count)
    monkeypatch.setattr("mfd_bayes.calibration.posterior.AT_ONCE", int(most * TRACE.samples))
    np.testing.assert_allclose(posterior.log_likelihood(q), whole, rtol=1e-12)
    assert sizes == expected


@CASES
def test_coordinates_and_values_invert_each_other(model, noise, start):
    posterior = build(model, noise, start)
    q = points(posterior, 200)
    values = posterior.values(q)
    np.testing.assert_allclose(posterior.coordinates(values), q, rtol=1e-9, atol=1e-9)
    drawn = posterior.draw_prior(np.random.default_rng(1), 200)
    again = posterior.values(posterior.coordinates(drawn))
    for name in posterior.names:
        np.testing.assert_allclose(again[name], drawn[name], rtol=1e-9, atol=1e-12)


def test_both_directions_of_friction_have_a_pivot():
    posterior = build()
    assert len(posterior.pivots) == 2
    q = points(posterior)
    values = posterior.values(q)
    for pivot in posterior.pivots:
        assert 0 < pivot.share < 1
        kinetic, excess = posterior.names[pivot.kinetic], posterior.names[pivot.excess]
        usual = values[kinetic] * (1 + pivot.share * values[excess])
        np.testing.assert_allclose(q[:, pivot.kinetic], np.log(usual), rtol=1e-12, atol=1e-12)


def test_friction_that_follows_from_several_coordinates_is_derived():
    # both static forces, and both kinetic ones, which are computed from a pivot
    posterior = build()
    q = points(posterior)
    theta = posterior.theta(posterior.values(q))
    names = posterior.model.parameters
    columns = [names.index(name) for name in ("Fs_fwd", "Fc_fwd", "Fs_bwd", "Fc_bwd")]
    np.testing.assert_array_equal(posterior.derived(q), theta[:, columns])
    fixed = {f"static_excess_{side}": Prior("fixed", {"value": 0.1}) for side in ("fwd", "bwd")}
    plain = build(priors=fixed)
    assert plain.derived(points(plain)).shape == (20, 0)


@CASES
def test_log_prior_is_the_density_of_the_values_times_the_jacobian(model, noise, start):
    # p(q) = p(x) |dx/dq|, the determinant by differences over all coordinates at once
    posterior = build(model, noise, start)

    def vector(q):
        values = posterior.values(q[None])
        return np.array([values[name][0] for name in posterior.names])

    for q in points(posterior, 4, seed=2):
        step = 1e-5
        columns = [
            (vector(q + step * axis) - vector(q - step * axis)) / (2 * step)
            for axis in np.eye(posterior.dim)
        ]
        _, log_det = np.linalg.slogdet(np.stack(columns, axis=1))
        x = vector(q)
        density = 0.0
        for name, value in zip(posterior.names, x, strict=True):
            prior = posterior.priors[name]
            own = prior.coordinate(np.array([value]))
            slope = (prior.value(own + step) - prior.value(own - step)) / (2 * step)
            density += float((prior.log_density(own) - np.log(slope))[0])
        assert posterior.log_prior(q[None])[0] == pytest.approx(density + log_det, abs=1e-4)


def test_prior_draws_have_the_log_prior_of_their_coordinates():
    # E[exp(log r - log p)] = 1 with r a normalised density: the prior is normalised in q
    posterior = build("lugre", "iid")
    q = points(posterior, 20000, seed=3)
    mean, covariance = q.mean(axis=0), 0.5 * np.cov(q.T)
    factor = np.linalg.cholesky(covariance)
    standard = np.linalg.solve(factor, (q - mean).T)
    normal = -0.5 * np.sum(standard**2, axis=0) - np.log(np.diag(factor)).sum()
    normal -= 0.5 * posterior.dim * np.log(2 * np.pi)
    ratio = np.exp(normal - posterior.log_prior(q))
    assert ratio.mean() == pytest.approx(1.0, abs=4 * ratio.std() / np.sqrt(ratio.size))
    assert ratio.std() / np.sqrt(ratio.size) < 0.05


@pytest.mark.parametrize("far", [-1e5, 1e5, np.inf, -np.inf])
def test_out_of_range_is_minus_infinity(far):
    posterior = build()
    q = np.repeat(points(posterior, 1), posterior.dim + 1, axis=0)
    q[np.arange(posterior.dim), np.arange(posterior.dim)] = far
    density = posterior.log_prob(q)
    assert np.isfinite(density[-1])
    # a logit or a plain coordinate is far out at 1e5, the logarithm of a value beyond range
    tame = [name in ("start", "offset") and np.isfinite(far) for name in posterior.names]
    assert np.all(density[:-1][np.logical_not(tame)] == -np.inf)
    assert np.all(density[:-1][tame] < -9e4)


def test_nan_and_other_shapes_raise():
    posterior = build()
    q = points(posterior, 2)
    with pytest.raises(FitError, match=r"\(n, 17\)"):
        posterior.log_prob(q[0])
    with pytest.raises(FitError, match="shape"):
        posterior.log_prob(q[:, 1:])
    q[1, 3] = np.nan
    for density in (posterior.log_prob, posterior.log_prior, posterior.log_likelihood):
        with pytest.raises(FitError, match="NaN"):
            density(q)


def test_gamma1_is_not_sampled_but_keeps_its_prior():
    posterior = build()
    assert "gamma1" not in posterior.names
    assert "ell" in posterior.names
    values = posterior.values(points(posterior, 3))
    np.testing.assert_array_equal(values["gamma1"], 1.0)
    drawn = posterior.draw_prior(np.random.default_rng(0), 500)
    assert np.std(np.log(drawn["gamma1"])) == pytest.approx(0.5, rel=0.15)
    columns = dict(zip(ThreeStage().parameters, posterior.theta(drawn).T, strict=True))
    np.testing.assert_allclose(columns["gamma2"] / columns["gamma1"], drawn["ell"])


def test_static_friction_is_at_least_kinetic_for_every_coordinate():
    posterior = build()
    q = 5 * np.random.default_rng(4).normal(size=(500, posterior.dim))
    columns = dict(
        zip(ThreeStage().parameters, posterior.theta(posterior.values(q)).T, strict=True)
    )
    for side in ("fwd", "bwd"):
        assert np.all(columns[f"Fs_{side}"] >= columns[f"Fc_{side}"])


@pytest.mark.parametrize(
    ("name", "value"),
    [("v_s", 0.4), ("static_excess_fwd", 0.1), ("start", 0.2), ("offset", 0.3), ("noise_sd", 0.1)],
)
def test_a_fixed_prior_removes_a_dimension(name, value):
    posterior = build(priors={name: Prior("fixed", {"value": value})})
    assert posterior.dim == build().dim - 1
    assert name not in posterior.names
    q = points(posterior)
    np.testing.assert_array_equal(posterior.values(q)[name], value)
    np.testing.assert_allclose(posterior.coordinates(posterior.values(q)), q, atol=1e-9)
    assert np.all(np.isfinite(posterior.log_prob(q)))


def test_noise_models_add_their_own_dimensions():
    sampled = {noise: set(build(noise=noise).names) for noise in NOISES}
    assert sampled["ou"] - sampled["iid"] == {"noise_time"}
    assert sampled["student_t"] - sampled["ou"] == {"noise_dof"}


def test_mask_drops_the_samples_before_the_first_slip():
    posterior = build(start="mask")
    assert "start" not in posterior.names
    assert posterior.first > 0
    travel = np.abs(MOTION[: posterior.first + 1] - MOTION[0])
    assert travel.max() > 2 * FILE.gap
    assert build().first == 0

    # samples before it do not matter; those after it do
    changed = FORCE.copy()
    changed[: posterior.first] += 5.0
    q = points(posterior)
    expected = posterior.log_likelihood(q)
    masked = build(start="mask", trace=with_force(changed))
    np.testing.assert_array_equal(masked.log_likelihood(q), expected)
    changed = FORCE.copy()
    changed[posterior.first] += 5.0
    assert not np.any(build(start="mask", trace=with_force(changed)).log_likelihood(q) == expected)


def test_masked_likelihood_does_not_depend_on_the_place_in_the_gap():
    posterior = build(start="mask")
    values = posterior.draw_prior(np.random.default_rng(5), 10)
    narrow = np.full(10, 0.1)
    values |= {"d2": narrow, "d3": narrow, "ell": 0.05 * narrow}
    forces = [posterior.force(values | {"start": np.full(10, w)}) for w in (0.05, 0.95)]
    after = slice(posterior.first, None)
    np.testing.assert_allclose(forces[0][:, after], forces[1][:, after], atol=1e-5)


def test_a_mask_needs_a_record_that_slips():
    small = Trace.from_arrays(TIME, 0.01 * MOTION, force=FORCE)
    with pytest.raises(FitError, match="mask"):
        build(start="mask", trace=small)


def test_missing_force_unknown_names_and_missing_priors_are_refused():
    with pytest.raises(FitError, match="force"):
        Posterior(Trace.from_arrays(TIME, MOTION), "brfd")
    with pytest.raises(FitError, match=r"'maxwell'.*three_stage, lugre, bouc_wen, backlash"):
        Posterior(TRACE, "brfd", model="maxwell")
    with pytest.raises(FitError, match=r"'pink'.*ou, iid, student_t"):
        Posterior(TRACE, "brfd", noise="pink")
    with pytest.raises(PriorError, match=r"'brdf'.*brfd, mfd"):
        Posterior(TRACE, "brdf")
    fewer = {k: v for k, v in FILE.parameters.items() if k not in ("k3", "ell")}
    with pytest.raises(PriorError, match=r"brfd\.toml has no prior for k3, ell"):
        Posterior(TRACE, replace(FILE, parameters=fewer))


def test_an_unknown_treatment_of_the_start_is_refused():
    with pytest.raises(FitError, match=r"start.*sample.*mask"):
        Posterior(TRACE, "brfd", start="masked")


@pytest.mark.parametrize("name", ["Fc_fwd", "k3", "noise_sd"])
def test_a_prior_that_allows_negative_values_is_refused_or_out_of_support(name):
    # a normal prior on a positive quantity must not stop the sampler half-way
    normal = Prior("normal", {"mean": 1.0, "sd": 1.0})
    try:
        posterior = build(priors={name: normal})
    except PriorError as error:
        pytest.fail(f"{name} is not named: {error}") if name not in str(error) else None
        return
    q = points(build(), 1).copy()
    q[0, posterior.names.index(name)] = -1.0
    assert posterior.log_prob(q)[0] == -np.inf


def test_a_posterior_is_made_from_names_and_is_immutable():
    posterior = Posterior(TRACE, "brfd")
    assert posterior.model == ThreeStage()
    with pytest.raises(AttributeError):
        posterior.first = 3


def test_log_posterior_at_truth_is_above_that_of_far_points():
    posterior = build()
    rng = np.random.default_rng(6)
    truth = posterior.draw_prior(rng, 1)
    force = posterior.force(truth)[0] + posterior.noise.draw(rng, TIME, truth)[0]
    posterior = build(trace=with_force(force + truth["offset"]))
    q = posterior.coordinates(truth)
    assert np.all(posterior.log_prob(points(posterior, 200)) < posterior.log_prob(q)[0])


@pytest.mark.parametrize(
    ("name", "prior", "words"),
    [
        ("exponent", Prior("lognormal", {"median": 2.0, "spread": 0.5}), "below 1"),
        ("exponent", Prior("fixed", {"value": 0.5}), "below 1"),
        ("beta", Prior("uniform", {"lower": 0.4, "upper": 1.0}), "below 0.5"),
        ("alpha", Prior("half_normal", {"sd": 0.1}), "above 1"),
        ("alpha", Prior("normal", {"mean": 0.1, "sd": 0.1}), "negative values"),
    ],
)
def test_priors_beyond_what_bouc_wen_admits_are_refused(name, prior, words):
    with pytest.raises(PriorError, match=rf"{name} in brfd.toml.*{words}"):
        build("bouc_wen", priors={name: prior})
    build("lugre", priors={name: prior})  # a model without these parameters


def test_priors_of_a_model_are_needed_only_where_it_is_chosen():
    own = {k: v for k, v in FILE.parameters.items() if k not in ("Fy_fwd", "exponent", "alpha")}
    with pytest.raises(PriorError, match="alpha, Fy_fwd, exponent"):
        Posterior(TRACE, replace(FILE, parameters=own), model="bouc_wen")
    Posterior(TRACE, replace(FILE, parameters=own), model="three_stage")


def test_a_mask_that_leaves_next_to_nothing_is_refused():
    swing = 0.05 * np.sin(2 * np.pi * 2.0 * TIME)
    ramp = 20.0 * np.maximum(TIME - 0.9 * TIME[-1], 0.0)
    late = Trace.from_arrays(TIME, swing + ramp, actuation=0.03, force=FORCE)
    with pytest.raises(FitError, match=r"mask.* goes on after a stroke of twice"):
        build(start="mask", trace=late)


@pytest.mark.parametrize("model", ["three_stage", "backlash"])
def test_no_points_have_no_residuals(model):
    posterior = build(model)
    assert posterior.residual(np.empty((0, posterior.dim))).shape == (0, TIME.size)
