"""The first fit of synthetic tests: its parameters, the discrepancy, and the noise's memory."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.population import pilot
from mfd_bayes.population.design import lay_out
from mfd_bayes.population.pilot import Pilot, fit_pilot
from mfd_bayes.population.settings import Setting
from mfd_bayes.population.discrepancy import FINE, KNOTS, TravelBasis
from mfd_bayes.population.working import WorkingLikelihood, working_likelihood
from mfd_bayes.records.trace import Trace

NOISE = 0.02
"""Standard deviation of the noise, kip; slip forces are near 1 kip."""

TRUTH = {
    "sigma0": 30.0,
    "sigma1": 0.02,
    "sigma2": 0.015,
    "Fc_fwd": 1.0,
    "Fc_bwd": 1.2,
    "static_excess_fwd": 0.15,
    "static_excess_bwd": 0.1,
    "v_s": 0.4,
    "offset": 0.03,
    "noise_sd": NOISE,
}
FRICTION = (0.9, 1.0, 1.1, 1.25)
"""Of each test, over that of the first."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fit of synthetic tests, its tests, their truths in prior units, and the waves."""

    found: Pilot
    likelihoods: list[WorkingLikelihood]
    truths: list[np.ndarray]
    added: list[np.ndarray]


def apart_from_parameters(made):
    """Two waves in a stroke, less what the parameters of all tests can do, in each test, (T,).

    A function of the travel and the direction: what of it a parameter can do, is the parameter's.
    """
    basis = TravelBasis.of([test.trace for test, _ in made])
    functions, slopes, waves = [], [], []
    for (test, values), friction in zip(made, FRICTION, strict=True):
        q = test.coordinates(values)[0]
        steps = 1e-4 * np.eye(q.size)
        slopes.append((test.residual(q + steps) - test.residual(q - steps)).T / 2e-4)
        functions.append(friction * basis.values(test.trace))
        travel = np.arange(KNOTS) / (KNOTS - 1)
        one = 0.25 * np.sin(4.0 * np.pi * np.expm1(travel * np.log1p(FINE)) / FINE)
        waves = np.concatenate([one, -one])
    ties = np.concatenate([a.T @ b for a, b in zip(slopes, functions, strict=True)])
    _, singular, axes = np.linalg.svd(
        ties / np.maximum(np.linalg.norm(ties, axis=1), 1e-9)[:, None]
    )
    ties = axes[: np.count_nonzero(singular > 0.02)]  # each test's slopes, not only their sum
    waves = waves - np.linalg.pinv(ties) @ (ties @ waves)
    return [one @ waves for one in functions]


def records_of(priors, *, waves=False, phi=0.0, samples=300):
    """Posteriors of synthetic tests, the values of each, and the wave that is added to each."""
    rng = np.random.default_rng(1)
    time, made = np.arange(samples) / 60.0, []
    for j, friction in enumerate(FRICTION):
        motion = (0.5, 0.5, 0.45, 0.5)[j] * np.sin(2 * np.pi * (0.4, 0.6, 0.4, 0.5)[j] * time)
        blank = replace(Trace.from_arrays(time, motion, 0.8), force=np.zeros(samples))
        values = {name: np.array([value]) for name, value in TRUTH.items()}
        values["Fc_fwd"], values["Fc_bwd"] = (friction * values[n] for n in ("Fc_fwd", "Fc_bwd"))
        values |= {"start": np.array([0.5]), "gamma1": np.ones(1)}
        made.append((Posterior(blank, priors, "iid", "lugre", start="mask"), values))
    added, found = apart_from_parameters(made), []
    for (source, values), one in zip(made, added, strict=True):
        noise = rng.standard_normal(samples)
        for i in range(1, samples):
            noise[i] = phi * noise[i - 1] + np.sqrt(1 - phi**2) * noise[i]
        force = source.force(values)[0] + values["offset"] + waves * one + NOISE * noise
        trace = replace(source.trace, force=force)
        found.append((Posterior(trace, priors, "iid", "lugre", start="mask"), values))
    return found, added


def fit(priors, **how) -> Fitted:
    """The fit, from half of a prior sd beside the truth."""
    made, added = records_of(priors, **how)
    names = made[0][0].names
    assert set(names) == set(TRUTH)
    layout = lay_out(priors, names, [Setting(0.8, "", {"velocity": 1.2})] * len(made))
    likelihoods = [working_likelihood(layout, test, priors) for test, _ in made]
    truths = [
        (layout.coordinates.of(values)[0] - layout.centre) / layout.spread for _, values in made
    ]
    starts = [truth + 0.3 * np.cos(np.arange(truth.size)) for truth in truths]
    return Fitted(fit_pilot(likelihoods, starts), likelihoods, truths, added)


@pytest.fixture(scope="module")
def right(priors):
    """The model is true, and the noise independent."""
    return fit(priors)


@pytest.fixture(scope="module")
def wavy(priors):
    """The same records and a wave in each."""
    return fit(priors, waves=True)


def largest_miss(fitted):
    """Largest distance of the Gaussians' means from the truths, in sds."""
    worst = 0.0
    for test, truth in zip(fitted.found.tests, fitted.truths, strict=True):
        sd = np.sqrt(np.diag(test.covariance))
        worst = max(worst, float(np.max(np.abs(test.mean - truth) / sd)))
    return worst


def discrepancies(fitted):
    """Discrepancy in all tests where a stroke is known, and the wave there, (n,) each, kip."""
    found, true = [], []
    for test, one in zip(fitted.found.tests, fitted.added, strict=True):
        kept = slice(test.log_likelihood.posterior.trace.turning_points[1], None)
        found.append(test.log_likelihood.discrepancy[kept])
        true.append(one[kept])
    return np.concatenate(found), np.concatenate(true)


def test_a_true_model_leaves_little_over(right):
    found, _ = discrepancies(right)
    assert found.std() < 0.25 * NOISE
    assert right.found.residual.information == pytest.approx(1.0, abs=0.15)
    shape = np.exp(right.found.residual.log_shape)
    np.testing.assert_allclose(shape, 1.0, atol=0.25)


def test_its_parameters_are_near_the_truth(right):
    assert largest_miss(right) < 4.0  # of 40 coordinates
    for test, truth in zip(right.found.tests, right.truths, strict=True):
        names = right.likelihoods[0].layout.names
        for name in ("Fc_fwd", "Fc_bwd", "noise_sd"):
            k = names.index(name)
            assert np.sqrt(test.covariance[k, k]) < 0.3
            assert test.mean[k] == pytest.approx(truth[k], abs=0.2)


def test_what_is_one_for_the_device_is_the_same_in_all_tests(right):
    layout = right.likelihoods[0].layout
    sparse = np.array(layout.sparse)
    assert 0 < sparse.sum() < sparse.size
    k = layout.names.index("Fc_fwd")
    means = np.array([test.mean[k] for test in right.found.tests])
    assert np.all(np.diff(means) > 0)  # it differs between tests, as the truth does


def test_the_gaussians_are_near_the_likelihoods(right):
    """One sd along each axis of the Gaussian costs half a unit, more or less."""
    for test in right.found.tests:
        values, axes = np.linalg.eigh(test.covariance)
        tight = values < 1e-3  # where a test says much more than its prior
        assert tight.sum() >= 3
        steps = (axes * np.sqrt(values))[:, tight].T
        cost = test.log_likelihood(test.mean[None]) - test.log_likelihood(test.mean + steps)
        cost += test.log_likelihood(test.mean[None]) - test.log_likelihood(test.mean - steps)
        np.testing.assert_allclose(cost, 1.0, rtol=0.5)


def test_a_function_of_the_travel_is_found(right, wavy):
    found, true = discrepancies(wavy)
    assert np.corrcoef(found, true)[0, 1] > 0.9
    assert found.std() == pytest.approx(true.std(), rel=0.3)
    none, _ = discrepancies(right)
    assert abs(np.corrcoef(none, true)[0, 1]) < 0.7  # the control: it is not there


def pooled(fitted):
    """What is one for the device, by all tests and its prior: means and sds."""
    those = np.array(fitted.likelihoods[0].layout.sparse)
    precision, pull = np.eye(those.sum()), np.zeros(those.sum())
    for test in fitted.found.tests:
        own = np.linalg.inv(test.covariance[np.ix_(those, those)])
        precision, pull = precision + own, pull + own @ test.mean[those]
    covariance = np.linalg.inv(precision)
    return covariance @ pull, np.sqrt(np.diag(covariance))


def noise_sds(fitted):
    """Coordinates of the tests' noise, less the truth, mean over tests."""
    k = fitted.likelihoods[0].layout.names.index("noise_sd")
    pairs = zip(fitted.found.tests, fitted.truths, strict=True)
    return np.mean([test.mean[k] - truth[k] for test, truth in pairs])


def test_it_is_kept_apart_from_the_parameters(right, wavy):
    before, sd = pooled(right)
    after, _ = pooled(wavy)
    np.testing.assert_array_less(np.abs(after - before), sd)
    assert largest_miss(wavy) < 4.0
    assert noise_sds(wavy) == pytest.approx(noise_sds(right), abs=0.05)  # it is no noise either


def test_without_a_discrepancy_the_wave_is_taken_for_noise(priors, right, monkeypatch):
    """The control."""
    monkeypatch.setattr(pilot._Fit, "_learn_discrepancy", lambda self: None)
    fitted = fit(priors, waves=True)
    assert noise_sds(fitted) > noise_sds(right) + 0.2
    assert fitted.found.residual.information < right.found.residual.information - 0.2


def test_noise_with_a_memory_tells_less(priors, right):
    found = fit(priors, phi=0.8, samples=900)
    expected = (1 - 0.8) / (1 + 0.8)
    assert found.found.residual.information == pytest.approx(expected, rel=0.35)
    assert found.found.residual.noise_time == pytest.approx(-1 / 60 / np.log(0.8), rel=0.35)
    k = found.likelihoods[0].layout.names.index("Fc_fwd")
    for test, other in zip(found.found.tests, right.found.tests, strict=True):
        wider = test.covariance[k, k] / other.covariance[k, k]
        assert wider == pytest.approx(1.0 / expected / 3.0, rel=0.4)  # of three times the samples


def test_the_likelihoods_have_what_the_residual_has(wavy):
    residual = wavy.found.residual
    basis = TravelBasis.of([one.posterior.trace for one in wavy.likelihoods])
    assert residual.basis == basis
    for test, before in zip(wavy.found.tests, wavy.likelihoods, strict=True):
        likelihood, trace = test.log_likelihood, before.posterior.trace
        np.testing.assert_allclose(likelihood.shape, residual.shape(trace))
        assert likelihood.information <= residual.information  # levels of strokes are in the noise
        one = residual.discrepancy(trace, np.array([residual.slip_force]), residual.mean[None])[0]
        own = likelihood.discrepancy
        scale = (own @ one) / (one @ one)  # the test's slip force over the typical one
        np.testing.assert_allclose(own, scale * one, atol=1e-9)
        assert 0.7 < scale < 1.4


def test_draws_of_the_residual_have_its_moments(wavy):
    residual, trace = wavy.found.residual, wavy.likelihoods[0].posterior.trace
    rng = np.random.default_rng(2)
    drawn = residual.draw_coefficients(rng, 20_000)
    np.testing.assert_allclose(drawn.mean(axis=0), residual.mean, atol=3e-3)
    np.testing.assert_allclose(np.cov(drawn.T), residual.covariance, atol=1e-4)
    noise = residual.draw_noise(rng, trace, np.full(4000, 0.05))
    np.testing.assert_allclose(noise.std(axis=0), 0.05 * residual.shape(trace), rtol=0.06)


def test_a_fit_that_ends_once_it_has_settled_is_that_of_all_steps(priors, monkeypatch):
    steps = []
    take = pilot._Fit.step
    monkeypatch.setattr(pilot._Fit, "step", lambda one: (steps.append(1), take(one))[1])
    early = fit(priors, waves=True)
    assert len(steps) < 0.75 * pilot.STEPS
    monkeypatch.setattr(pilot, "SETTLED", pilot.STEPS)
    late = fit(priors, waves=True)
    assert len(steps) > pilot.STEPS
    for one, other in zip(early.found.tests, late.found.tests, strict=True):
        sd = np.sqrt(np.diag(other.covariance))
        assert np.max(np.abs(one.mean - other.mean) / sd) < 0.1
    size = np.linalg.norm(late.found.residual.mean)
    assert np.linalg.norm(early.found.residual.mean - late.found.residual.mean) < 0.02 * size
