import numpy as np
import pytest
from scipy import integrate, stats

from mfd_bayes.population.laws import LAWS, PAPER

SHAPES = np.array([-2.0, 0.3, 1.0, 2.5])


@pytest.mark.parametrize("name", LAWS)
def test_every_law_is_one_at_the_reference(name):
    np.testing.assert_allclose(LAWS[name].ratio(np.ones(1), SHAPES), 1.0, rtol=1e-15)


def test_friction_that_is_proportional_vanishes_without_actuation():
    assert LAWS["proportional"].ratio(np.zeros(1), np.zeros(1)) == 0.0
    np.testing.assert_allclose(LAWS["proportional"].ratio(np.array([0.5, 2.0]), 0.0), [0.5, 2.0])


def test_the_affine_law_keeps_its_intercept_without_actuation():
    left = LAWS["affine"].ratio(np.zeros(1), SHAPES)
    np.testing.assert_allclose(left, 1 - 1 / (1 + np.exp(-SHAPES)), rtol=1e-12)
    assert np.all((left > 0) & (left < 1))


def test_the_affine_law_is_between_constant_and_proportional():
    ratio = np.linspace(0, 3, 31)
    affine = LAWS["affine"].ratio
    np.testing.assert_allclose(affine(ratio, np.array(40.0)), ratio, atol=1e-12)
    np.testing.assert_allclose(affine(ratio, np.array(-40.0)), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.diff(affine(ratio, np.array(0.7)), n=2), 0.0, atol=1e-12)


def test_a_power_law_has_no_friction_without_actuation_and_no_nan():
    power = LAWS["power"].ratio
    np.testing.assert_array_equal(power(np.zeros(3), np.array([0.5, 1.0, 2.0])), 0.0)
    np.testing.assert_allclose(power(np.array([4.0]), np.array([0.5])), 2.0, rtol=1e-15)
    np.testing.assert_allclose(power(np.array([0.3]), np.array([1.0])), 0.3, rtol=1e-15)


def test_a_falling_power_law_overflows_nowhere():
    # exponents below zero are within reach of the prior where all tests are at one level
    with np.errstate(over="raise", invalid="raise"):
        found = LAWS["power"].ratio(np.array([0.0, 0.5]), np.array([[-1.5]]))
    assert found[0, 1] == pytest.approx(0.5**-1.5)


@pytest.mark.parametrize(
    ("name", "shape"), [("proportional", 0.0), ("affine", 0.4), ("power", 0.6)]
)
def test_laws_rise_with_the_actuation(name, shape):
    values = LAWS[name].ratio(np.linspace(0, 4, 101), np.array(shape))
    assert np.all(np.diff(values) > 0)
    constant = LAWS["constant"].ratio(np.linspace(0, 4, 101), np.array(shape))
    assert np.all(np.diff(constant) == 0)  # the control


@pytest.mark.parametrize("name", LAWS)
def test_ratios_broadcast_draws_against_actuations(name):
    shape = np.linspace(-1, 1, 6).reshape(2, 3, 1)
    assert LAWS[name].ratio(np.linspace(0.1, 2, 5), shape).shape == (2, 3, 5)


def test_the_share_of_the_affine_law_is_uniform():
    density = LAWS["affine"].log_prior
    mass, _ = integrate.quad(lambda q: np.exp(density(np.array(q))), -40, 40)
    assert mass == pytest.approx(1.0, abs=1e-8)
    share = np.linspace(0.01, 0.99, 50)
    q = np.log(share / (1 - share))
    np.testing.assert_allclose(np.exp(density(q)) / (share * (1 - share)), 1.0, rtol=1e-12)


def test_the_exponent_of_the_power_law_is_normal_about_one_up_to_a_constant():
    b = np.linspace(-2, 4, 25)
    left = LAWS["power"].log_prior(b) - stats.norm(1.0, 0.5).logpdf(b)
    np.testing.assert_allclose(left, left[0], atol=1e-12)
    wrong = LAWS["power"].log_prior(b) - stats.norm(1.0, 0.6).logpdf(b)
    assert np.ptp(wrong) > 1  # the control


def test_laws_without_a_shape_say_nothing_about_one():
    for law in LAWS.values():
        if not law.shape:
            np.testing.assert_array_equal(law.log_prior(SHAPES), 0.0)


def test_the_papers_laws_are_known():
    assert set(PAPER.values()) <= set(LAWS)
    assert PAPER["Fc_fwd"] == PAPER["Fc_bwd"] == "proportional"
    assert PAPER["sigma0"] == "affine"
