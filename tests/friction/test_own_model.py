"""A user's own model: one file with one class, and one sentence about whatever is wrong with it."""

import pickle

import numpy as np
import pytest

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
c = { family = "lognormal", median = "2 kN", spread = 0.6 }
alpha = { family = "lognormal", median = 0.6, spread = 0.4 }
offset = { family = "normal", mean = "0 kip", sd = "0.05 kip" }
noise_sd = { family = "half_normal", sd = "0.1 kip" }
"""
STEEL_PRIORS = """
[parameters]
E = { family = "lognormal", median = "200 GPa", spread = 0.1 }
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


def changed(folder, old, new):
    """The file with a part replaced."""
    assert old in VISCOUS
    (folder / "my_damper.py").write_text(VISCOUS.replace(old, new), encoding="utf-8")
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
    drawn = mb.sample(posterior, effort="quick", seed=1)
    for column, name in enumerate(TRUTH):
        values = drawn.theta[..., column]
        assert abs(values.mean() - TRUTH[name]) < 4.0 * values.std()
        assert values.std() < 0.05


def test_a_changing_actuation_scales_what_follows_it(viscous):
    level = 0.5 + 0.2 * np.sin(TIME)
    trace = trace_of(actuation=level)
    expected = FORCE * level / trace.reference_actuation
    np.testing.assert_allclose(viscous.force([[0.4, 0.5]], trace)[0], expected)
    given = viscous.force([[0.4, 0.5]], trace_of(), scales={"c": np.full((1, TIME.size), 3.0)})
    np.testing.assert_allclose(given[0], 3.0 * FORCE)


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
    assert (stiffness.unit, share.least, share.most) == ("MPa", 0.0, 1.0)
    file, text = folder / "steel.toml", STEEL_PRIORS
    for wrong, of, words in (
        (text, "lugre", "unknown parameter"),  # E is none of that model's
        (text.replace("ksi", "kip"), model, r"offset.*'kip' cannot be given in 'MPa'"),
    ):
        file.write_text(wrong)
        with pytest.raises(mb.MfdError, match=words):
            mb.Posterior(trace_of(FORCE), str(file), "iid", of)
    file.write_text(text)
    posterior = mb.Posterior(trace_of(FORCE), str(file), "iid", model)
    assert posterior.priors["E"].typical == pytest.approx(2e5)
    with pytest.raises(mb.MfdError, match="no step in time"):
        model.start([[2e5, 0.1]])
    with pytest.raises(mb.MfdError, match=r"b must be finite and in \[0, 1\]"):
        model.force([[2e5, 1.1]], trace_of())


def test_a_model_of_an_installed_package_has_an_entry_point(monkeypatch, viscous):
    class Point:
        name, value = "dashpot", "package:Viscous"

        def load(self):
            return type(viscous)

    monkeypatch.setattr("mfd_bayes.friction.models.entry_points", lambda group: [Point()])
    assert find_model("dashpot").name == "viscous"
    with pytest.raises(mb.MfdError, match=r"bouc_wen, backlash, dashpot, or my_file.py:MyClass"):
        find_model("nothing")


def refused(call, *words):
    with pytest.raises(mb.MfdError) as caught:
        call()
    for word in words:
        assert word in str(caught.value)


def test_what_is_not_there_is_named(folder):
    (folder.parent / "outside.py").write_text(VISCOUS)
    (folder / "link.py").symlink_to(folder.parent / "outside.py")
    for name, *words in (
        ("nowhere.py:Viscous", "nowhere.py", "there is no file"),
        ("my_damper.py:Other", "no class Other in my_damper.py", "it has Viscous"),
        ("my_damper.py", "my_damper.py:MyClass", "it has Viscous"),
        ("my_damper.py:np", "np in my_damper.py must be a class"),
        ("../outside.py:Viscous", "outside the campaign's folder"),
        ("link.py:Viscous", "outside the campaign's folder"),
        ("my_damper:Viscous", "unknown model 'my_damper:Viscous'", "three_stage"),
        ("\0.py:Viscous", "cannot be found"),
        *((name, f"unknown model {name!r}") for name in (None, 5, ["lugre"], {}, "lugre+x")),
    ):
        refused(lambda name=name: find_model(name, folder), *words)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"kip"', '"kipp"', ("parameter 'c'", "'kipp' is unknown")),
        ('"kip"', "5", ("parameter 'c'", "unit 5")),
        ('"alpha"', '"c"', ("two parameters 'c'",)),
        ('"alpha"', '"noise_sd"', ("parameter 'noise_sd'", "of every record")),
        ('"alpha"', '"my alpha"', ("parameter 'my alpha'", "word")),
        ("=True", '="quadratic"', ("parameter 'c'", "follows_actuation", "'quadratic'")),
        ('symbol=r"\\alpha"', 'prior="wide"', ("parameter 'alpha'", "fraction", "'wide'")),
        ('name = "viscous"', "", ("Viscous in my_damper.py needs name",)),
        ('"viscous"', '"lugre"', ("'lugre' is that of a model",)),
        ("    parameters = (", "    others = (", ("needs parameters",)),
        ("    parameters = (", "    parameters = () and (", ("Viscous", "tuple of Parameter")),
        ("def force", "def forces", ("needs a function force",)),
        ("class Viscous(mb.Model)", "class Viscous", ("on top of mfd_bayes.Model",)),
        ("import numpy as np", "import numpie as np", ("line 2", "numpie")),
        ("def force", "deff force", ("line 13", "SyntaxError")),
        ('name = "viscous"', 'name = "viscous"; response = "stress, Mpaa"', ("response", "Mpaa")),
        ("class Viscous", "raise SystemExit\nclass Viscous", ("line 6", "SystemExit")),
        ("def start(self, theta)", "def __init__(self)", ("without arguments", "NameError")),
    ],
)
def test_a_class_that_is_no_model_is_named(folder, old, new, words):
    refused(lambda: changed(folder, old, new), "my_damper.py", *words)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("return c * np.sign(trace", "return 1.0 or np.sign(trace", ("shape (1, 256)",)),
        ("** alpha\n", "** (alpha * np.nan)\n", ("no finite", "c = 0.4496", "alpha = 0.6")),
        ("** alpha\n", "** trace.alpha\n", ("AttributeError", "alpha")),
        ("** alpha\n", "** exit()\n", ("SystemExit",)),
        ("return c * np.sign(trace", "return 'f' or np.sign(trace", ("real",)),
        ("trace, scales):", "trace):\n        scales = {'c': 1}", ("the actuation changes",)),
    ],
)
def test_a_force_that_cannot_be_used_is_refused_before_it_is_sampled(folder, old, new, words):
    level = 0.5 + 0.1 * np.sin(TIME) if "the actuation changes" in words else 0.5
    trace, priors = trace_of(FORCE, level), str(folder / "priors.toml")
    # of no other size: Python keeps a compiled file by its second and its size
    mb.Posterior(trace, priors, "iid", changed(folder, "** alpha\n", "** alpha[0][None]\n"))
    model = changed(folder, old, new)
    made = "class Viscous of my_damper.py"
    refused(lambda: mb.Posterior(trace, priors, "iid", model), made, *words)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('return {"c"', 'return [] and {"c"', "dict of arrays"),
        ('theta[:, 0], "alpha"', 'theta[0, 0], "alpha"', "2 values on its last axis"),
        ('state["alpha"], state', 'state["alpha"]', "the force and the new state"),
        ('state["alpha"], state', "state.alpha, state", "AttributeError"),
    ],
)
def test_a_step_that_cannot_be_used_is_named(folder, old, new, words):
    model, theta = changed(folder, old, new), [[0.4, 0.5], [0.4, 0.5]]
    made = "class Viscous of my_damper.py"
    refused(lambda: model.step(model.start(theta), 0.0, 1.0, 0.1), made, words)


def test_classes_of_ones_own_may_share_a_base():
    class Base(mb.Model):
        parameters = (mb.Parameter("k", "kip/in"),)

        def force(self, theta, trace):
            return theta * trace.displacement

    class Stiff(Base):
        name = "stiff"

        def force(self, theta, trace):
            return 2.0 * theta * trace.displacement

    for cls, by in ((Base, 1.0), (Stiff, 2.0)):
        np.testing.assert_allclose(cls().force([[3.0]], trace_of())[0], 3.0 * by * MOTION)
    with pytest.raises(mb.MfdError, match="force must be a function"):
        type("Wrong", (Base,), {"force": 5})


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
