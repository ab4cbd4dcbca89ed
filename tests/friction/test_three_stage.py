"""Three stages, and LuGre without the gap, against a stiff solver and the model's text."""

import itertools
import math

import numpy as np
import pytest

from mfd_bayes.errors import FitError
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.quantities import Parameter
from mfd_bayes.friction.three_stage import LuGre, ThreeStage
from mfd_bayes.records.trace import Trace
from tests.friction.motions import off_after_cut, sine, solved

MODEL = ThreeStage()
ROW = (60.0, 0.02, 0.01, 2.4, 2.0, 1.9, 1.5, 0.5, 30.0, 0.1, 0.08, 1.0, 0.005, 0.5)
VALUES = dict(zip(MODEL.parameters, ROW, strict=True))
D = VALUES["d2"] + VALUES["d3"]
SECONDS = 8.0


def theta(**changes):
    values = VALUES | changes
    return np.array([[values[name] for name in MODEL.parameters]])


def random_theta(rng, n, **fixed):
    batch = theta(**fixed) * rng.lognormal(0, 0.4, size=(n, len(VALUES)))
    for kinetic in (MODEL.parameters.index(name) for name in ("Fc_fwd", "Fc_bwd")):
        batch[:, kinetic - 1] = batch[:, kinetic] * rng.uniform(1, 1.5, n)
    return batch


class Sines:
    """Motion of sines with their own growth: amplitude (a + b t), frequency, phase."""

    def __init__(self, *terms):
        self.terms = terms

    def x(self, t):
        return sum((a + b * t) * np.sin(2 * np.pi * f * t + p) for a, b, f, p in self.terms)

    def v(self, t):
        w = 2 * np.pi
        return sum(
            b * np.sin(w * f * t + p) + (a + b * t) * w * f * np.cos(w * f * t + p)
            for a, b, f, p in self.terms
        )

    def trace(self, rate=100.0, seconds=SECONDS, **kwargs):
        time = np.arange(round(seconds * rate) + 1) / rate
        return Trace.from_arrays(time, self.x(time), velocity=self.v(time), **kwargs)


FULL = Sines((1.0, 0.0, 0.5, 0.3))
PARTIAL = Sines((0.02, 0.05, 0.5, 0.0), (0.0, 0.012, 1.3, 1.0))
IN_GAP = Sines((0.05, 0.0, 0.5, 0.0), (0.02, 0.0, 1.1, 0.4))
ON_SAMPLES = Sines((1.0, 0.0, 0.5, 0.0))
MOTIONS = (ON_SAMPLES, FULL, PARTIAL, IN_GAP)


def stribeck(velocity, values=VALUES):
    side = "fwd" if velocity >= 0 else "bwd"
    static, kinetic = values[f"Fs_{side}"], values[f"Fc_{side}"]
    return kinetic + (static - kinetic) * math.exp(-((velocity / values["v_s"]) ** 2))


def bristle_rate(_, z, v, values=VALUES):
    return v - values["sigma0"] * abs(v) * z / stribeck(v, values)


def reference_slip(values, motion, time):
    """F1 by a stiff solver on the motion itself, (T,), kip."""

    def rate(t, z, v):
        return bristle_rate(t, z, v, values)

    edges, v = np.linspace(time[0], time[-1], 100), motion.v(time)
    z = solved(rate, time, edges, lambda t, _: float(motion.v(t)), 0.0)
    z_rate = np.array([rate(*state) for state in zip(time, z, v, strict=True)])
    return values["sigma0"] * z + values["sigma1"] * z_rate + values["sigma2"] * v


def reference_gap(values, x, slip, w0):
    """Force by model.md sections 3 and 4, sample by sample."""
    d2, width = values["d2"], values["d2"] + values["d3"]
    ell = values["gamma2"] / values["gamma1"]
    moving = np.flatnonzero(np.diff(x))
    direction = s = 1.0 if x[moving[0] + 1] > x[moving[0]] else -1.0
    y = s * (w0 - 0.5) * width
    carried = 0.0

    def m(distance):
        return 0.5 * (1 + math.tanh(0.5 * distance / ell))

    def blended(u, s, f1):
        force = f1
        m12 = max(2 * m(u) - 1, 0.0)
        force = (1 - m12) * force + m12 * s * values["k2"] * u
        m23 = m(u - d2)
        force = (1 - m23) * force + m23 * s * (values["k2"] * d2 + values["k3"] * (u - d2))
        m31 = m(u - width)
        return (1 - m31) * force + m31 * f1

    forces = [blended(width / 2 + s * y, s, slip[0])]
    for n in range(1, len(x)):
        dx = x[n] - x[n - 1]
        if dx * direction < 0:  # the sample before was a turning point
            direction = -direction
            u = width / 2 + s * y
            if u >= width or u <= 0:
                y = math.copysign(width / 2, y)
                s = direction
                carried = forces[-1] - blended(0.0, s, slip[n - 1])
        y += dx
        u = width / 2 + s * y
        fading = carried * (1 - math.tanh(abs(u) / (2 * ell)))
        forces.append(blended(u, s, slip[n]) + fading)
    return np.array(forces)


def reference(values, motion, *, w0=0.5, finer=20, rate=100.0):
    """Force at 100 Hz of the motion in continuous time (turning points to 1/2000 s)."""
    time = np.arange(round(SECONDS * rate * finer) + 1) / (rate * finer)
    slip = reference_slip(values, motion, time)
    return reference_gap(values, motion.x(time), slip, w0)[::finer]


def test_force_agrees_with_a_stiff_solver_within_two_thousandths_of_the_peak():
    soft = {"gamma2": 0.01, "k3": 20.0, "sigma0": 25.0}
    cases = [(motion, {}, 0.5) for motion in MOTIONS]
    for motion, changes, start in [*cases, (PARTIAL, soft, 0.1), (PARTIAL, soft, 0.9)]:
        expected = reference(VALUES | changes, motion, w0=start)
        force = MODEL.force(theta(**changes), motion.trace(), start)[0]
        peak = np.max(np.abs(expected))
        assert peak > 0.01
        assert np.max(np.abs(force - expected)) < 2e-3 * peak
        # the control: a gap that is a fiftieth wider is another force
        perturbed = MODEL.force(theta(**changes, d2=1.02 * VALUES["d2"]), motion.trace(), start)[0]
        assert motion is IN_GAP or np.max(np.abs(perturbed - expected)) > 2e-3 * peak


def test_travel_begins_where_the_damper_starts_and_at_every_turn_after_slip():
    time = np.arange(0.0, 3.0, 0.01)
    x = np.interp(time, [0.0, 1.0, 3.0], [0.0, 1.0, -1.0])
    trace = Trace.from_arrays(time, x)
    batch = np.concatenate([theta(), theta(d2=0.3)])
    width = batch[:, 9:10] + batch[:, 10:11]
    for start in (np.array([0.0, 0.8]), None):
        travel = MODEL.travel(batch, trace, start=start)
        begin = 0.5 * width if start is None else start[:, None] * width
        np.testing.assert_allclose(travel[:, :101], begin + x[:101], atol=1e-12)
        np.testing.assert_allclose(
            travel[:, 102:], np.broadcast_to(1.0 - x[102:], (2, 198)), atol=1e-12
        )
    with pytest.raises(FitError, match="start"):
        MODEL.travel(batch, trace, start=1.5)


def test_only_the_quotient_of_the_gammas_reaches_the_force():
    trace = PARTIAL.trace()
    expected = MODEL.force(theta(), trace)
    for factor in (1e-3, 0.7, 50.0):
        scaled = theta(gamma1=factor, gamma2=VALUES["gamma2"] * factor)
        np.testing.assert_allclose(MODEL.force(scaled, trace), expected, rtol=1e-9, atol=1e-11)
    assert np.max(np.abs(MODEL.force(theta(gamma1=2.0), trace) - expected)) > 0.1


def test_friction_follows_the_actuation_or_the_factors_that_are_given():
    trace = FULL.trace()
    late = trace.time >= 4.0
    history = FULL.trace(actuation=np.where(late, 2.0, 1.0))
    mean = history.reference_actuation
    vector = theta(sigma2=0.0, Fs_fwd=2.0, Fs_bwd=1.5)  # at the mean actuation
    friction_only = dict.fromkeys(("Fs_fwd", "Fc_fwd"), np.where(late, 3.0, 1.0)[None])
    deep = (np.abs(trace.velocity) > 2.9) & (trace.displacement * trace.velocity > 0)  # full slip
    for force, mask, forward, backward in (
        (MODEL.force(vector, history)[0], trace.time > 5, 4.0 / mean, -3.0 / mean),
        (MODEL.force(vector, history)[0], (trace.time > 1) & ~late, 2.0 / mean, -1.5 / mean),
        (MODEL.force(vector, trace, scales=friction_only)[0], trace.time > 5, 6.0, -1.5),
    ):
        slip = force[mask & deep]
        np.testing.assert_allclose(slip[slip > 0], forward, rtol=1e-3)
        np.testing.assert_allclose(slip[slip < 0], backward, rtol=1e-3)
    # none at all switches the law off
    unscaled = MODEL.force(vector, history, scales={})
    np.testing.assert_allclose(unscaled, MODEL.force(vector, trace), rtol=1e-12)


def test_releasing_the_brake_at_rest_makes_no_spike():
    for residual in [0.0, 0.01, 0.1]:
        # slip, rest while the pressure falls, then move on: micro-damping must not see an
        # infinite bristle rate where F1 = σ0 z is far above what friction holds now
        time = np.arange(0, 3, 0.01)
        motion = np.interp(time, [0, 1, 2, 3], [0, 1, 1, 2])
        history = np.where(time < 1.5, 1.0, residual)
        force = MODEL.force(theta(), Trace.from_arrays(time, motion, actuation=history))[0]
        highest = VALUES["Fs_fwd"] / np.mean(history)
        assert np.max(np.abs(force)) < 1.1 * highest


# --- without the gap

LUGRE = LuGre()


def lugre(**changes):
    values = VALUES | changes
    return np.array([[values[name] for name in LUGRE.parameters]])


def test_exact_step_equals_a_stiff_solver_while_the_velocity_is_constant():
    samples, rate = 20, 50.0
    for velocities in [(0.3, -0.3), (3.0, -1.0, 0.2), (-0.05, 0.4, -4.0)]:
        v = np.repeat(velocities, samples)
        time, motion = np.arange(v.size + 1) / rate, np.append(0.0, np.cumsum(v) / rate)

        def velocity(_, middle, v=v):
            return v[int(middle * rate)]

        z = solved(bristle_rate, time, time[::samples], velocity, 0.0)
        force = LUGRE.force(lugre(sigma1=0.0, sigma2=0.0), Trace.from_arrays(time, motion))[0]
        np.testing.assert_allclose(force, VALUES["sigma0"] * z, rtol=1e-7, atol=1e-9)


def test_a_sample_without_a_step_keeps_the_bristles_and_has_its_rate_terms():
    for velocity in [0.2, -0.2]:
        for way in [0.02, -0.02]:
            # forward or backward, then at the same place with a velocity that is still measured
            time = np.array([0.0, 0.1, 0.2])
            trace = Trace.from_arrays(time, [0.0, way, way], velocity=[0.0, 0.0, velocity])
            elastic, force = (
                LUGRE.force(lugre(sigma1=sigma1, sigma2=0.0), trace)[0] for sigma1 in (0.0, 0.03)
            )
            assert elastic[2] == elastic[1]
            z = elastic[1] / VALUES["sigma0"]
            rate = velocity - VALUES["sigma0"] * abs(velocity) * z / VALUES["Fs_fwd"]
            assert force[2] == pytest.approx(elastic[2] + 0.03 * rate, rel=1e-9)


# --- where in the gap a motion ends: one cut in two goes on as the whole does


def motion_of(*corners, samples=40):
    """Straight from corner to corner, at 1 in/s or less."""
    pieces = [np.linspace(a, b, samples)[1:] for a, b in itertools.pairwise(corners)]
    x = np.concatenate([[corners[0]], *pieces])
    return Trace.from_arrays(0.02 * np.arange(x.size), x, velocity=np.zeros(x.size), hysteresis=0.0)


def test_a_motion_cut_in_the_gap_goes_on_as_the_whole_does():
    fixed = {"d2": 0.12, "d3": 0.1}
    batch = np.concatenate([theta(), random_theta(np.random.default_rng(1), 4, **fixed)])
    for sign in [1.0, -1.0]:
        for reached in [0.04, 0.1, 0.16]:
            corners = [0.0, 0.6, -0.6, -0.6 + 0.5 * reached, -0.6 + reached, 0.5, -0.5]
            trace, index = motion_of(*sign * np.array(corners)), 4 * 39
            deviation = off_after_cut(MODEL, batch, trace, index)
            assert np.max(deviation[39 + 5 :]) < 1e-6  # past the first turn after slip
            middle = off_after_cut(MODEL, batch, trace, index, start=0.5)
            # before it, bristles that begin at rest differ on a short way
            assert np.linalg.norm(deviation[:39]) < 0.6 * np.linalg.norm(middle[:39])


def test_at_a_turn_after_slip_a_motion_begins_at_an_end_of_the_gap():
    for x, expected in ((0.6, 1.0), (-0.6, 0.0)):
        end = MODEL.end(theta(), motion_of(0.0, x))
        assert end == expected
        assert MODEL.start_at(end, motion_of(x, 0.0)) == 0.0  # travel since the slip
        assert MODEL.start_at(end, motion_of(x, 2.0 * x)) == 1.0
    motion = motion_of(0.6, -0.6, -0.6 + 0.25 * D)
    assert MODEL.end(theta(), motion) == pytest.approx(0.25)


def test_a_model_of_ones_own_with_a_gap_must_say_where_it_ends():
    class Own(Model):
        name = "own"
        parameters = (Parameter("k"),)
        has_gap = True

    with pytest.raises(FitError, match="the model own does not say where in its gap"):
        Own().end(np.ones((1, 1)), sine())
