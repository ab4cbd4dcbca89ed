import numpy as np
import pytest

from mfd_bayes.errors import FitError
from mfd_bayes.friction.lugre import LuGre
from mfd_bayes.friction.model import travel_since_turn
from mfd_bayes.friction.paper import ACTUATED, PARAMETERS, check_theta
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.records.trace import Trace

MODEL = ThreeStage()
VALUES = dict(
    zip(
        PARAMETERS,
        (60.0, 0.02, 0.01, 2.4, 2.0, 1.9, 1.5, 0.5, 30.0, 0.1, 0.08, 1.0, 0.005, 0.5),
        strict=True,
    )
)
POSITIVE = ("sigma0", "gamma1", "gamma2", "v_s")


def theta(**changes):
    return np.array([list((VALUES | changes).values())])


def motion(**options):
    time = np.arange(0.0, 4.0, 0.01)
    return Trace.from_arrays(time, np.sin(np.pi * time + 0.3), **options)


def test_units_are_those_of_kip_inch_and_second():
    units = {quantity.name: quantity.unit for quantity in MODEL.quantities}
    # a stiffness times a length, a damping times a speed and a force are all in kip
    assert {units[name] for name in ("sigma0", "k2", "k3")} == {"kip/in"}
    assert {units[name] for name in ("sigma1", "sigma2")} == {"kip*s/in"}
    assert {units[name] for name in ("Fs_fwd", "Fc_fwd", "Fs_bwd", "Fc_bwd")} == {"kip"}
    assert {units[name] for name in ("d2", "d3", "gamma2")} == {"in"}
    assert (units["gamma1"], units["v_s"]) == ("1", "in/s")


@pytest.mark.parametrize("name", POSITIVE)
def test_what_the_model_divides_by_must_be_positive(name):
    with pytest.raises(FitError, match=f"parameter {name} must be finite and positive, got 0.0"):
        check_theta(MODEL, theta(**{name: 0.0}))


@pytest.mark.parametrize("name", [name for name in PARAMETERS if name not in POSITIVE])
def test_everything_else_may_be_zero_and_not_less(name):
    pair = {"Fs_fwd": "Fc_fwd", "Fs_bwd": "Fc_bwd"}
    zero = {name: 0.0} | ({pair[name]: 0.0} if name in pair else {})
    assert np.all(np.isfinite(MODEL.force(theta(**zero), motion())))
    with pytest.raises(FitError, match=f"parameter {name} must be finite and not negative, got -1"):
        check_theta(MODEL, theta(**{name: -1.0}))


@pytest.mark.parametrize("side", ["fwd", "bwd"])
def test_static_friction_is_at_least_kinetic_but_for_rounding(side):
    kinetic = VALUES[f"Fc_{side}"]
    check_theta(MODEL, theta(**{f"Fs_{side}": kinetic * (1.0 - 1e-13)}))
    with pytest.raises(FitError, match=f"Fs_{side} must be at least kinetic Fc_{side}"):
        check_theta(MODEL, theta(**{f"Fs_{side}": kinetic * (1.0 - 1e-9)}))


def test_one_vector_that_does_not_fit_is_found_among_others():
    batch = np.concatenate([theta(), theta(Fs_bwd=1.0), theta()])
    with pytest.raises(FitError, match="Fs_bwd"):
        check_theta(MODEL, batch)
    batch = np.concatenate([theta(), theta(k2=-2.0), theta()])
    with pytest.raises(FitError, match=r"k2 .* got -2\.0"):
        check_theta(MODEL, batch)


def test_travel_since_a_turn_starts_at_zero_there_in_either_direction():
    time = np.arange(0.0, 3.0, 0.01)
    x = np.interp(time, [0.0, 1.0, 2.0, 3.0], [0.2, 1.2, -0.4, 0.3])
    travel = travel_since_turn(np.ones((2, 8)), Trace.from_arrays(time, x))
    assert travel.shape == (2, time.size)
    for first, last, turn in ((0, 100, 0.2), (101, 200, 1.2), (201, 300, -0.4)):
        np.testing.assert_allclose(
            travel[:, first:last], np.abs(x[first:last] - turn)[None].repeat(2, axis=0), atol=1e-9
        )


@pytest.mark.parametrize("name", ACTUATED)
def test_scales_take_every_parameter_that_follows_the_actuation(name):
    trace = motion()
    scales = {name: np.full((1, trace.samples), 1.5)}
    changed = {name: 1.5 * VALUES[name]}
    pair = {"Fc_fwd": "Fs_fwd", "Fc_bwd": "Fs_bwd"}.get(name)
    if pair:  # static friction must stay above it
        scales[pair] = scales[name]
        changed[pair] = 1.5 * VALUES[pair]
    expected = MODEL.force(theta(**changed), trace)
    np.testing.assert_allclose(
        MODEL.force(theta(), trace, scales=scales), expected, rtol=1e-9, atol=1e-9
    )
    assert np.max(np.abs(expected - MODEL.force(theta(), trace))) > 0.01


@pytest.mark.parametrize("model", [MODEL, LuGre()], ids=lambda model: model.name)
def test_scales_of_another_name_or_shape_are_refused(model):
    trace = motion()
    batch = np.repeat(theta(), 3, axis=0)
    for name, shape in (
        ("sigma1", (1, trace.samples)),
        ("Fc_fwd", (2, trace.samples)),
        ("Fc_fwd", (1, trace.samples - 1)),
        ("Fc_fwd", (trace.samples,)),
    ):
        with pytest.raises(FitError, match=rf"scales may hold .*, got {name}"):
            model.force(batch, trace, scales={name: np.ones(shape)})
