"""Shared coordinates: their values, and that their transforms have determinant 1."""

import numpy as np
import pytest
from scipy import integrate, stats

from mfd_bayes.calibration.priors import Prior
from mfd_bayes.population.coordinates import Coordinates

NAMES = (
    "sigma0",
    "Fc_fwd",
    "Fc_bwd",
    "static_excess_fwd",
    "static_excess_bwd",
    "k3",
    "d2",
    "d3",
    "v_s",
    "offset",
)
SPEED = 0.6


def coordinates(priors, names=NAMES):
    return Coordinates(names, {n: priors.parameters[n] for n in names}, SPEED)


def draw(priors, names=NAMES, n=50):
    rng = np.random.default_rng(1)
    return {name: priors.parameters[name].draw(rng, n) for name in names}


SUBSETS = (
    NAMES,
    ("Fc_fwd", "static_excess_fwd"),  # without v_s there is no reference for speeds
    ("Fc_fwd", "static_excess_fwd", "v_s"),
    ("k3", "d2", "d3"),
    ("d3", "offset"),
)


@pytest.mark.parametrize("names", SUBSETS)
def test_values_come_back(priors, names):
    shared, values = coordinates(priors, names), draw(priors, names)
    q = shared.of(values)
    assert q.shape == (50, len(names))
    back = shared.values(q)
    for name in names:
        np.testing.assert_allclose(back[name], values[name], rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(shared.from_own(shared.to_own(q)), q, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("names", SUBSETS)
def test_determinants_are_one(priors, names):
    shared = coordinates(priors, names)
    for q in shared.of(draw(priors, names, 5)):
        steps = 1e-5 * np.eye(len(names))
        jacobian = (shared.to_own(q + steps) - shared.to_own(q - steps)) / 2e-5
        assert abs(np.linalg.det(jacobian)) == pytest.approx(1.0, abs=1e-6)


def test_a_determinant_that_is_not_one_would_be_seen(priors):
    shared = coordinates(priors)
    q = shared.of(draw(priors, n=1))
    steps = 1e-5 * np.eye(len(NAMES))
    values = [np.stack(list(shared.values(q + s * steps).values()), axis=1) for s in (1, -1)]
    assert abs(abs(np.linalg.det((values[0] - values[1]) / 2e-5)) - 1.0) > 1e-3


@pytest.mark.parametrize("side", ["fwd", "bwd"])
def test_friction_is_pooled_as_the_slip_force_at_the_common_speed(priors, side):
    values = draw(priors)
    q = coordinates(priors).of(values)[:, NAMES.index(f"Fc_{side}")]
    kinetic = values[f"Fc_{side}"]
    static = kinetic * (1.0 + values[f"static_excess_{side}"])
    stribeck = np.exp(-((SPEED / values["v_s"]) ** 2))
    np.testing.assert_allclose(np.exp(q), kinetic + (static - kinetic) * stribeck, rtol=1e-12)
    assert np.max(np.abs(np.exp(q) / kinetic - 1.0)) > 0.05


def test_the_gap_is_pooled_by_its_width_and_its_parts_ratio(priors):
    values = draw(priors)
    q = coordinates(priors).of(values)
    width = np.exp(q[:, NAMES.index("d2")])
    np.testing.assert_allclose(width, values["d2"] + values["d3"], rtol=1e-12)
    shares = np.exp(q[:, NAMES.index("d3")])
    np.testing.assert_allclose(shares, values["d3"] / values["d2"], rtol=1e-12)


def test_what_is_not_named_keeps_its_priors_coordinate(priors):
    values = draw(priors)
    q = coordinates(priors).of(values)
    for name in ("sigma0", "v_s", "static_excess_fwd", "k3", "offset"):
        own = priors.parameters[name].coordinate(values[name])
        np.testing.assert_array_equal(q[:, NAMES.index(name)], own)


def test_without_all_that_it_needs_a_coordinate_is_the_priors(priors):
    names = ("Fc_fwd", "static_excess_fwd", "k3", "d3")
    values = draw(priors, names)
    own = np.stack([priors.parameters[n].coordinate(values[n]) for n in names], axis=1)
    np.testing.assert_array_equal(coordinates(priors, names).of(values), own)


def test_the_density_is_that_of_the_priors_after_the_change_of_variables(priors):
    shared, values = coordinates(priors), draw(priors)
    expected = np.zeros(50)
    for name in NAMES:
        prior = priors.parameters[name]
        expected += prior.log_density(prior.coordinate(values[name]))
    np.testing.assert_allclose(shared.log_prior(shared.of(values)), expected, rtol=1e-10)


def test_the_density_of_the_gap_has_mass_one():
    prior = Prior("lognormal", {"median": 0.1, "spread": 0.6})
    shared = Coordinates(("d2", "d3"), {"d2": prior, "d3": prior}, SPEED)

    def density(ratio, width):
        return np.exp(shared.log_prior(np.array([[width, ratio]])))[0]

    mass, _ = integrate.dblquad(density, -6, 3, -6, 6, epsabs=1e-5)
    assert mass == pytest.approx(1.0, abs=1e-3)


def test_log_density_of_a_ratio_is_that_of_scipy():
    prior = Prior("lognormal", {"median": 0.1, "spread": 0.6})
    shared = Coordinates(("d2", "d3"), {"d2": prior, "d3": prior}, SPEED)
    ratio = np.linspace(-2, 2, 9)
    width = np.linspace(-9, 5, 4001)
    grid = np.stack(np.meshgrid(width, ratio, indexing="ij"), axis=-1).reshape(-1, 2)
    marginal = np.exp(shared.log_prior(grid)).reshape(4001, 9).sum(axis=0) * (width[1] - width[0])
    np.testing.assert_allclose(marginal, stats.norm(0, 0.6 * np.sqrt(2)).pdf(ratio), rtol=1e-6)
