"""Laws and the coordinates in which tests are compared."""

import numpy as np
import pytest

from mfd_bayes.population.design import (
    LAWS,
    Coordinates,
    complete_laws,
    default_laws,
    ratio,
)

SOME = {"share": 0.3, "exponent": 0.6}


def at(law: str, relative: np.ndarray, **free: float) -> np.ndarray:
    """Ratio of a law by name, with the given share and exponent where they are free."""
    share, exponent = (
        np.array(getattr(LAWS[law], s) if getattr(LAWS[law], s) is not None else (SOME | free)[s])
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
    for law, left in zip(LAWS, (0.0, 0.7, 0.0, 1.0, 0.7), strict=True):  # without actuation
        with np.errstate(all="raise"):
            assert at(law, np.zeros(1)) == pytest.approx(left)
        assert LAWS[law].intercept == (left > 0.0)


def test_the_papers_laws_are_the_default_and_others_follow_the_given_ones():
    paper = default_laws()
    assert paper["Fc_fwd"] == paper["Fc_bwd"] == paper["Fy_fwd"] == "proportional"
    assert paper["sigma0"] == "affine"
    assert complete_laws({"Fc_fwd": "power"})["Fy_fwd"] == "power"
    assert complete_laws({"Fc_fwd": "power"})["Fs_fwd"] == "power"
    assert complete_laws({"Fc_fwd": "power"})["Fs_bwd"] == "proportional"
    chosen = complete_laws({"Fc_fwd": "power", "Fy_fwd": "affine"})
    found = chosen["Fc_fwd"], chosen["Fy_fwd"], chosen["Fy_bwd"]
    assert found == ("power", "affine", "proportional")


# --- coordinates

NAMES = ("sigma0", "Fc_fwd", "Fc_bwd", "static_excess_fwd", "static_excess_bwd", "k3", "d2", "d3")
NAMES = (*NAMES, "v_s", "offset")
SPEED = 0.6
SUBSETS = (NAMES, ("Fc_fwd", "static_excess_fwd"), ("d3", "offset"))  # without speeds, or a gap


def coordinates(priors, names=NAMES):
    return Coordinates(names, {n: priors.parameters[n] for n in names}, SPEED)


def draw(priors, names=NAMES, n=50):
    rng = np.random.default_rng(1)
    return {name: priors.parameters[name].draw(rng, n) for name in names}


@pytest.mark.parametrize("names", SUBSETS)
def test_prior_units_are_those_of_the_prior_and_the_change_has_determinant_one(priors, names):
    shared, values = coordinates(priors, names), draw(priors, names)
    back = shared.values(shared.of(values))
    for name in names:
        np.testing.assert_allclose(back[name], values[name], rtol=1e-9, atol=1e-12)
    x = shared.of(draw(priors, names, 4000))
    np.testing.assert_allclose(x.mean(axis=0), 0.0, atol=4.0 * np.sqrt(2.0 / 4000))
    np.testing.assert_allclose(x.std(axis=0), 1.0, atol=0.1)
    for one in x[:5]:
        steps = 1e-5 * np.eye(len(names))
        jacobian = (
            (shared.of_priors(one + steps) - shared.of_priors(one - steps)) / 2e-5 / shared.spread
        )
        assert abs(np.linalg.det(jacobian)) == pytest.approx(1.0, abs=1e-6)


def test_slip_forces_at_a_common_speed_and_the_width_of_the_gap_are_compared(priors):
    shared, values = coordinates(priors), draw(priors)
    q = shared.centre + shared.spread * shared.of(values)
    stribeck = np.exp(-((SPEED / values["v_s"]) ** 2))
    for side in ("fwd", "bwd"):
        slip = values[f"Fc_{side}"] * (1.0 + values[f"static_excess_{side}"] * stribeck)
        np.testing.assert_allclose(np.exp(q[:, NAMES.index(f"Fc_{side}")]), slip, rtol=1e-10)
        assert np.max(np.abs(slip / values[f"Fc_{side}"] - 1.0)) > 0.05
    width, share = (np.exp(q[:, NAMES.index(name)]) for name in ("d2", "d3"))
    np.testing.assert_allclose(width, values["d2"] + values["d3"], rtol=1e-10)
    np.testing.assert_allclose(share, values["d3"] / values["d2"], rtol=1e-10)
    for name in ("sigma0", "v_s", "static_excess_fwd", "k3", "offset"):
        own = priors.parameters[name].coordinate(values[name])
        np.testing.assert_allclose(q[:, NAMES.index(name)], own, rtol=1e-10, atol=1e-12)
