"""A user's own model: one file with one class, and one sentence about whatever is wrong with it."""

import pickle
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mfd_bayes as mb
from mfd_bayes.friction.models import MODELS, find_model

VISCOUS = """
import numpy as np
import mfd_bayes as mb


class Viscous(mb.Model):
    name = "viscous"
    parameters = (
        mb.Parameter("c", "kip", follows_actuation=True, meaning="force at 1 in/s"),
        mb.Parameter("alpha", symbol=r"\\alpha"),
    )

    def force(self, theta, trace, scales):
        c, alpha = theta[:, :1] * scales["c"], theta[:, 1:]
        return c * np.sign(trace.velocity) * np.abs(trace.velocity) ** alpha

    def start(self, theta):
        return {"c": theta[:, 0], "alpha": theta[:, 1]}

    def step(self, state, displacement, velocity, dt, scales):
        c = state["c"] * scales["c"]
        return c * np.sign(velocity) * np.abs(velocity) ** state["alpha"], state
"""
PRIORS = """
[parameters]
c = { family = "lognormal", median = "2 kN", sigma = 0.6 }
alpha = { family = "lognormal", median = 0.6, sigma = 0.4 }
offset = { family = "normal", mean = "0 kip", sd = "0.05 kip" }
noise_sd = { family = "half_normal", sd = "0.1 kip" }
"""
STEEL_PRIORS = """
[parameters]
E = { family = "lognormal", median = "200 GPa", sigma = 0.1 }
b = { family = "beta", a = 1, b = 9 }
offset = { family = "normal", mean = "0 ksi", sd = "0.05 ksi" }
noise_sd = { family = "half_normal", sd = "0.1 ksi" }
"""
TIME = np.arange(0, 8, 1 / 32)
MOTION = np.sin(np.pi * TIME)
SPEED = np.pi * np.cos(np.pi * TIME)
TRUTH = {"c": 0.4, "alpha": 0.5}
FORCE = TRUTH["c"] * np.sign(SPEED) * np.abs(SPEED) ** TRUTH["alpha"]


def trace_of(force=None, actuation=0.5):
    return mb.Trace.from_arrays(TIME, MOTION, actuation, force, SPEED)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "my_damper.py").write_text(VISCOUS, encoding="utf-8")
    (tmp_path / "priors.toml").write_text(PRIORS, encoding="utf-8")
    return tmp_path


@pytest.fixture
def viscous(folder):
    return find_model("my_damper.py:Viscous", folder)


def test_a_file_of_twenty_lines_is_a_model(viscous):
    assert (viscous.name, viscous.parameters) == ("viscous", ("c", "alpha"))
    assert (viscous.motion, viscous.response) == (("displacement", "in"), ("force", "kip"))
    assert viscous.laws == {"c": "proportional"}
    assert [q.unit for q in viscous.quantities] == ["kip", "1"]
    assert [q.html for q in viscous.quantities] == ["c", "α"]
    theta = np.array([[0.4, 0.5], [0.8, 0.5]])
    for model in (viscous, pickle.loads(pickle.dumps(viscous))):  # as in another process
        np.testing.assert_allclose(model.force(theta, trace_of()), [FORCE, 2 * FORCE])
    assert viscous.force(theta[:0], trace_of()).shape == (0, TIME.size)


def test_its_parameters_are_sampled_and_the_truth_is_inside(folder, viscous):
    noisy = FORCE + 0.02 * np.random.default_rng(1).normal(size=TIME.size)
    for model in (viscous, str(folder / "my_damper.py:Viscous")):
        posterior = mb.Posterior(trace_of(noisy), str(folder / "priors.toml"), "iid", model)
        assert posterior.names == ("c", "alpha", "offset", "noise_sd")
    draws = mb.sample(posterior, effort="quick", seed=1)
    for column, name in enumerate(TRUTH):
        values = draws.theta[..., column]
        assert abs(values.mean() - TRUTH[name]) < 4.0 * values.std()
        assert values.std() < 0.05


def test_a_changing_actuation_scales_what_follows_it(viscous):
    level = 0.5 + 0.2 * np.sin(TIME)
    trace = trace_of(actuation=level)
    expected = FORCE * level / trace.reference_actuation
    np.testing.assert_allclose(viscous.force([[0.4, 0.5]], trace)[0], expected)
    force = viscous.force([[0.4, 0.5]], trace_of(), scales={"c": np.full((1, TIME.size), 3.0)})
    np.testing.assert_allclose(force[0], 3.0 * FORCE)


def test_a_step_equals_the_record_and_leaves_the_old_state(viscous):
    theta = np.array([[0.4, 0.5], [0.8, 0.7]])
    state, forces = viscous.start(theta, reference_actuation=0.5), []
    for x, v in zip(MOTION, SPEED, strict=True):
        force, state = viscous.step(state, x, v, 1 / 32, 0.5)
        again, _ = viscous.step(state, x, v, 1 / 32, 1.0)
        np.testing.assert_allclose(again, 2.0 * force)
        forces.append(force)
    np.testing.assert_allclose(np.transpose(forces), viscous.force(theta, trace_of()))


def test_other_quantities_have_their_own_units(folder):
    (folder / "steel.py").write_text(
        "import mfd_bayes as mb\n"
        "class Elastic(mb.Model):\n"
        "    name = 'elastic'\n"
        "    motion, response, rate_independent = 'strain', 'stress, MPa', True\n"
        "    parameters = (mb.Parameter('E', 'MPa'), mb.Parameter('b', prior='fraction'))\n"
        "    def force(self, theta, trace):\n"
        "        return theta[:, :1] * trace.displacement\n",
        encoding="utf-8",
    )
    model = find_model("steel.py:Elastic", folder)
    assert (model.motion, model.response) == (("strain", "1"), ("stress", "MPa"))
    assert model.rate_independent
    stiffness, share = model.quantities
    assert (stiffness.unit, share.lower, share.upper) == ("MPa", 0.0, 1.0)
    (folder / "steel.toml").write_text(STEEL_PRIORS)
    posterior = mb.Posterior(trace_of(FORCE), str(folder / "steel.toml"), "iid", model)
    assert posterior.priors["E"].median == pytest.approx(2e5)
    with pytest.raises(mb.MfdError, match="no step in time"):
        model.start([[2e5, 0.1]])
    with pytest.raises(mb.MfdError, match=r"b must be finite and in \[0, 1\]"):
        model.force([[2e5, 1.1]], trace_of())


def test_a_model_of_an_installed_package_has_an_entry_point(folder, monkeypatch):
    (folder / "damper-1.0.dist-info").mkdir()
    points = "[mfd_bayes.models]\ndashpot = my_damper:Viscous\n"
    (folder / "damper-1.0.dist-info" / "entry_points.txt").write_text(points)
    monkeypatch.syspath_prepend(folder)
    assert find_model("dashpot").name == "viscous"
    with pytest.raises(mb.MfdError, match=r"bouc_wen, backlash, dashpot, or my_file.py:MyClass"):
        find_model("nothing")


def test_what_is_not_there_is_named(folder):
    (folder.parent / "outside.py").write_text(VISCOUS)
    (folder / "link.py").symlink_to(folder.parent / "outside.py")
    for name, words in (
        ("nowhere.py:Viscous", "nowhere.py"),
        ("my_damper.py:Other", "it has Viscous"),
        ("my_damper.py", "my_damper.py:MyClass"),
        ("my_damper.py:np", "np in my_damper.py"),
        ("../outside.py:Viscous", "outside"),
        ("link.py:Viscous", "outside"),
        ("my_damper:Viscous", "'my_damper:Viscous'"),
        ("\0.py:Viscous", "cannot be found"),
        *((name, "unknown model") for name in (None, 5, ["lugre"], {}, "lugre+x")),
    ):
        with pytest.raises(mb.MfdError) as caught:
            find_model(name, folder)
        assert words in str(caught.value)


NEXT = "\n        return c * np.sign(trace"
WRONG = [
    # as a class
    ('"kip"', '"kipp"', "'kipp'"),
    ('"alpha"', '"c"', "two parameters 'c'"),
    ('"alpha"', '"noise_sd"', "'noise_sd'"),
    ('"alpha"', '"my alpha"', "'my alpha'"),
    ("=True", '="quadratic"', "'quadratic'"),
    ('name = "viscous"', "", "needs name"),
    ('"viscous"', '"lugre"', "'lugre'"),
    ("    parameters = (", "    others = (", "needs parameters"),
    ("def force", "def forces", "function force"),
    ("class Viscous(mb.Model)", "class Viscous", "mfd_bayes.Model"),
    ("def force", "deff force", "line 13"),
    ('name = "viscous"', 'name = "viscous"; response = "stress, Mpaa"', "Mpaa"),
    ("class Viscous", "raise SystemExit\nclass Viscous", "line 6"),
    ("def start(self, theta)", "def __init__(self)", "NameError"),
    # by its force, before it is sampled
    ("return c * np.sign(trace", "return 1.0 or np.sign(trace", "shape (1, 256)"),
    ("** alpha\n", "** (alpha * np.nan)\n", "c = 0.4496"),
    ("** alpha\n", "** exit()\n", "SystemExit"),
    ("return c * np.sign(trace", "return 'f' or np.sign(trace", "real"),
    ("trace, scales):", "trace):\n        scales = {'c': 1}", "the actuation changes"),
    ("** alpha\n", "** alpha * np.random.default_rng().normal()\n", "draw random numbers"),
    (
        "return c * np.sign(trace",
        f"self.n = n = getattr(self, 'n', 0) + c[0, 0]; c = c * n{NEXT}",
        "a state",
    ),
    ("return c * np.sign(trace", f"c = c / c.max(){NEXT}", "where a row of theta stands alone"),
    ("return c * np.sign(trace", f"c = np.cumsum(c, axis=0){NEXT}", "another order"),
    ("return c * np.sign(trace", f"c = c.astype(int){NEXT}", "whole numbers"),
    ("** alpha\n", "** alpha // 0.1 * 0.1\n", "must not round"),
    ("return c * np.sign(trace", f"return (theta[:, :1] * trace.time).astype(int){NEXT}", "floats"),
    # by its step
    ('return {"c"', 'return [] and {"c"', "dict of arrays"),
    ('c = state["c"]', 'state["c"] += 1; c = state["c"]', "read-only"),
    ('theta[:, 0], "alpha"', 'theta[0, 0], "alpha"', "2 values on its last axis"),
    ('state["alpha"], state', 'state["alpha"]', "the force and the new state"),
    ('state["alpha"], state', "state.alpha, state", "AttributeError"),
]


@pytest.mark.parametrize(("target", "replacement", "words"), WRONG)
def test_a_class_that_is_no_model_is_named_with_its_file(folder, target, replacement, words):
    assert target in VISCOUS
    (folder / "my_damper.py").write_text(VISCOUS.replace(target, replacement), encoding="utf-8")
    trace = trace_of(FORCE, 0.5 + 0.1 * np.sin(TIME))

    def use():
        model = find_model("my_damper.py:Viscous", folder)
        mb.Posterior(trace, str(folder / "priors.toml"), "iid", model)
        model.step(model.start([[0.4, 0.5]] * 2), 0.0, 1.0, 0.1)

    with pytest.raises(mb.MfdError) as caught:
        use()
    assert "my_damper.py" in str(caught.value)
    assert words in str(caught.value)


def test_a_built_in_model_is_changed_by_what_it_computes():
    with pytest.raises(mb.MfdError, match="gives compute_force"):

        class Warm(mb.LuGre):
            def force(self, theta, trace):
                return 1.1 * super().force(theta, trace)

    class Warmer(mb.LuGre):
        name = "warmer"

        def compute_force(self, c, trace, start, factors):
            return 1.1 * super().compute_force(c, trace, start, factors)

    theta = np.ones((2, 8))
    np.testing.assert_allclose(
        Warmer().force(theta, trace_of()), 1.1 * MODELS["lugre"].force(theta, trace_of())
    )


# --- the steel of examples/coupons beside OpenSees' Steel02, written out step by step

EXAMPLES = Path(__file__).parents[2] / "examples"
STEELS = np.array(
    [[2.0e5, 450.0, 0.02, 0.9, 0.1, 0.03, 0.02], [1.8e5, 520.0, 0.005, 0.85, 0.2, 0, 0.1]]
)


def steel02(strain, modulus, yielding, b, c1, c2, a1, a3, r0=20.0):
    """Stress after Steel02's sequence of conditions, one sample after the other."""
    hard, eps_y = b * modulus, yielding / modulus
    highest, lowest, way, stress = eps_y, -eps_y, 0, [0.0]
    origin, base = strain[0], 0.0
    for previous, now in pairwise(strain):
        direction = np.sign(now - previous) or way
        if direction != way:
            shift = 1.0
            if way:
                origin, base = previous, stress[-1]
                highest, lowest = max(highest, origin), min(lowest, origin)
                shift += (a3 if direction > 0 else a1) * ((highest - lowest) / (2 * eps_y)) ** 0.8
            way = direction
            level = direction * shift * (yielding - hard * eps_y)
            knee = (level - base + modulus * origin) / (modulus - hard)
            top = level + hard * knee
            xi = abs(((highest if direction > 0 else lowest) - knee) / eps_y)
            r = r0 * (1 - c1 * xi / (c2 + xi))
        x = (now - origin) / (knee - origin)
        stress.append(base + (b * x + (1 - b) * x / (1 + abs(x) ** r) ** (1 / r)) * (top - base))
    return np.array(stress)


def test_the_example_agrees_with_steel02_in_steps():
    turns = np.append(0.0, 0.01 * np.cumsum(np.random.default_rng(2).normal(0, 1, 30)))
    strain = np.interp(np.arange(0, 30, 0.1), np.arange(31), turns)
    strain[40] = strain[39]  # a sample that is there twice keeps the direction
    trace = mb.Trace.from_arrays(np.arange(strain.size, dtype=float), strain)
    stress = find_model("steel.py:Steel", EXAMPLES / "coupons").force(STEELS, trace)
    for row, values in zip(stress, STEELS, strict=True):
        assert np.max(np.abs(row - steel02(strain, *values))) < 1e-8
        hardened = [*values[:-1], values[-1] + 0.01]  # the control: another hardening
        assert np.max(np.abs(row - steel02(strain, *hardened))) > 1.0


# --- the damper of examples/self_energising

SELF_ENERGISING = [60.0, 50.0, 0.25, 0.02, 0.3, 3.0, 2.5, 0.1, 0.5, 0.8]


def exact(trace, values, start):
    """Force by an ODE solver: c dz/dt = what the force of the damped end is, less G(z)."""
    k_f, k_b, width, rounding, k_gap, forward, backward, c, beta_f, beta_b = values

    def spring(z):
        ahead, behind = (z - width / 2) / rounding, -(z + width / 2) / rounding
        force = k_f * rounding * np.logaddexp(0, ahead) - k_b * rounding * np.logaddexp(0, behind)
        return force + k_gap * z

    def limited(t, z):
        now, v = spring(z), np.interp(t, trace.time, trace.velocity)
        up = forward * (1 - beta_f) + beta_f * np.maximum(now, 0)
        down = -backward * (1 - beta_b) + beta_b * np.minimum(now, 0)
        return np.clip(now + c * v, down, up), now

    def rate(t, z):
        force, now = limited(t, z)
        return (force - now) / c

    low, high = -width / 2 - backward / k_b, width / 2 + forward / k_f
    begin, span = [low + start * (high - low)], (trace.time[0], trace.time[-1])
    z = solve_ivp(rate, span, begin, t_eval=trace.time, max_step=1e-3, rtol=1e-8).y[0]
    return limited(trace.time, z)[0]


def test_the_damped_example_agrees_with_an_ode_solver_and_steps_as_it_goes():
    time = np.arange(0, 2, 1 / 2048)
    motion, speed = np.sin(np.pi * time), np.pi * np.cos(np.pi * time)
    trace = mb.Trace.from_arrays(time, motion, velocity=speed, actuation=1.0)
    model = find_model("damper.py:SelfEnergising", EXAMPLES / "self_energising")
    theta = np.array([SELF_ENERGISING])
    force = model.force(theta, trace, 0.3)[0, 1:]  # the first sample has no step before it
    assert np.max(np.abs(force - exact(trace, SELF_ENERGISING, 0.3)[1:])) < 0.02
    halved = [*SELF_ENERGISING[:7], 0.05, *SELF_ENERGISING[8:]]  # the control: half of the damping
    assert np.max(np.abs(force - exact(trace, halved, 0.3)[1:])) > 0.1
    low, high = -0.125 - 2.5 / 50.0, 0.125 + 3.0 / 60.0
    force = model.force(theta, trace, -low / (high - low))[0]  # from the middle, as a step does
    state, steps = model.start(theta, reference_actuation=1.0), []
    for x, v, dt in zip(motion, speed, np.diff(time, prepend=0.0), strict=True):
        now, state = model.step(state, x, v, dt, 1.0)
        steps.append(now[0])
    np.testing.assert_allclose(steps, force, atol=2e-3)
