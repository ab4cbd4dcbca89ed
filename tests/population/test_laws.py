import numpy as np
import pytest
from scipy import integrate, stats

from mfd_bayes.population.laws import (
    COMPARE,
    LAWS,
    SENSITIVITY,
    complete_laws,
    default_laws,
    draw_shape,
    log_prior,
    ratio,
    ratios_along,
    shapes_of,
    value_of,
)

DENSITIES = {
    "share": stats.logistic,
    "exponent": stats.norm(1.0, 0.5),
    "velocity": stats.norm(0.0, SENSITIVITY),
    "amplitude": stats.norm(0.0, SENSITIVITY),
}
"""Densities of the coordinates of shapes; a logistic logit is a uniform share."""
SOME = {"share": 0.3, "exponent": 0.6}


def at(law: str, relative: np.ndarray, **free: float) -> np.ndarray:
    """Ratio of a law by name, with the given share and exponent where they are free."""
    share, exponent = (
        np.array(getattr(LAWS[law], s) if getattr(LAWS[law], s) is not None else (SOME | free)[s])
        for s in ("share", "exponent")
    )
    return ratio(relative, share, exponent)


@pytest.mark.parametrize("law", LAWS)
def test_every_law_is_one_at_the_reference(law):
    np.testing.assert_allclose(at(law, np.ones(1)), 1.0, rtol=1e-15)


@pytest.mark.parametrize("law", ["proportional", "power"])
def test_what_is_in_proportion_vanishes_without_actuation(law):
    with np.errstate(all="raise"):
        assert at(law, np.zeros(1)) == 0.0


@pytest.mark.parametrize("exponent", [-1.5, 0.0, 2.0])
def test_a_power_law_has_no_friction_without_actuation_whatever_its_exponent(exponent):
    # the prior allows exponents below zero where all tests are at one level
    with np.errstate(all="raise"):
        found = at("power", np.array([0.0, 0.5]), exponent=exponent)
    np.testing.assert_allclose(found, [0.0, 0.5**exponent])


def test_laws_are_their_formulas():
    relative = np.array([0.2, 0.5, 1.0, 3.0])
    np.testing.assert_allclose(at("proportional", relative), relative)
    np.testing.assert_allclose(at("affine", relative, share=0.7), 0.3 + 0.7 * relative)
    np.testing.assert_allclose(at("power", relative, exponent=1.7), relative**1.7)
    np.testing.assert_array_equal(at("constant", relative), 1.0)


def test_the_affine_law_keeps_its_intercept_without_actuation():
    assert at("affine", np.zeros(1), share=0.7) == pytest.approx(0.3)


def test_residual_friction_is_left_without_actuation():
    relative, free = np.array([0.0, 0.5, 2.0]), {"share": 0.7, "exponent": 1.4}
    found = at("residual_power", relative, **free)
    np.testing.assert_allclose(found, 0.3 + 0.7 * relative**1.4)


def test_laws_with_an_intercept_are_known():
    with_one = {name for name, law in LAWS.items() if law.intercept}
    assert with_one == {"affine", "constant", "residual_power"}


def test_stored_numbers_of_laws_keep_their_meaning():
    assert tuple(LAWS)[:4] == ("proportional", "affine", "power", "constant")


def test_ratios_broadcast_draws_against_actuations():
    share = np.linspace(0, 1, 6).reshape(2, 3, 1)
    found = ratio(np.linspace(0.1, 2, 5), share, np.ones((2, 3, 1)))
    assert found.shape == (2, 3, 5)
    np.testing.assert_allclose(found[1, 2], np.linspace(0.1, 2, 5))


def test_ratios_along_a_history_are_those_at_each_actuation():
    history = np.array([-0.1, 0.0, 1e-6, 0.3, 1.0, 2.5, 1e10])
    share, exponent = np.array([1.0, 1.0, 0.4, 0.0]), np.array([1.0, 40.0, 0.7, 1.0])
    found = ratios_along(history, share, exponent)
    expected = ratio(history, share[:, None], exponent[:, None]).T
    np.testing.assert_allclose(found, expected, rtol=1e-13)
    assert np.all(found[:2] == [0.0, 0.0, 0.6, 1.0])


@pytest.mark.parametrize("shape", DENSITIES)
def test_densities_of_shapes_are_scipys_up_to_a_constant(shape):
    q = np.linspace(-3, 4, 25)
    left = log_prior(shape, q) - DENSITIES[shape].logpdf(q)
    np.testing.assert_allclose(left, left[0], atol=1e-12)
    wrong = log_prior(shape, q) - stats.norm(0.4, 0.7).logpdf(q)
    assert np.ptp(wrong) > 1  # the control


@pytest.mark.parametrize("shape", DENSITIES)
def test_draws_of_shapes_are_their_quantiles(shape):
    uniform = np.linspace(0.01, 0.99, 20)
    np.testing.assert_allclose(draw_shape(shape, uniform), DENSITIES[shape].ppf(uniform))


def test_a_dependence_is_expected_to_change_a_parameter_little_per_e_fold():
    # at one prior sd, and at two
    assert draw_shape("velocity", stats.norm.cdf(1.0)) == pytest.approx(0.1)
    assert np.exp(draw_shape("amplitude", stats.norm.cdf(2.0))) == pytest.approx(np.exp(0.2))


def test_a_share_is_uniform_and_lies_between_nothing_and_all():
    uniform = np.array([1e-9, 0.2, 0.9])
    np.testing.assert_allclose(value_of("share", draw_shape("share", uniform)), uniform)
    mass, _ = integrate.quad(lambda q: np.exp(log_prior("share", np.array(q))), -40, 40)
    assert mass == pytest.approx(1.0, abs=1e-8)
    assert value_of("exponent", np.array(1.7)) == 1.7


def test_a_law_infers_what_it_leaves_open():
    assert {law: shapes_of(law) for law in (*LAWS, COMPARE)} == {
        "proportional": (),
        "affine": ("share",),
        "power": ("exponent",),
        "constant": (),
        "residual_power": ("share", "exponent"),
        COMPARE: ("share", "exponent"),
    }


def test_the_papers_laws_are_known():
    paper = default_laws()
    assert set(paper.values()) <= set(LAWS)
    assert paper["Fc_fwd"] == paper["Fc_bwd"] == "proportional"
    assert paper["Fy_fwd"] == paper["Fy_bwd"] == "proportional"
    assert paper["sigma0"] == "affine"


def test_an_actuation_beyond_all_range_has_a_ratio():
    found = ratio(np.array([1e10]), np.array([1.0]), np.array([40.0]))
    assert np.all(np.isfinite(found))


def test_the_yield_force_follows_frictions_law_where_it_has_none_of_its_own():
    assert complete_laws({"Fc_fwd": "power"})["Fy_fwd"] == "power"
    assert complete_laws({"Fc_fwd": "power"})["Fs_fwd"] == "power"
    assert complete_laws({"Fc_fwd": "power"})["Fs_bwd"] == "proportional"
    chosen = complete_laws({"Fc_fwd": "power", "Fy_fwd": "affine"})
    found = chosen["Fc_fwd"], chosen["Fy_fwd"], chosen["Fy_bwd"]
    assert found == ("power", "affine", "proportional")
