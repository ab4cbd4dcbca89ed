"""A campaign with a model of the user's own, from its file to what is predicted with it."""

import importlib.util
import json
import py_compile
import shutil
import tomllib
from hashlib import sha256
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import mfd_bayes as mb
from mfd_bayes.runs.folder import hash_stored
from tests.command_line import refusal, said, write_csv
from tests.run_folders import BUILDING

VISCOUS = r"""
import numpy as np
import mfd_bayes as mb


class Viscous(mb.Model):
    name = "viscous"
    parameters = (
        mb.Parameter("c", "kip", follows_actuation=True, meaning="force at 1 in/s"),
        mb.Parameter("alpha", symbol=r"\alpha"),
        mb.Parameter("lean", "kip", prior="real"),
    )

    def force(self, theta, trace, scales):
        c, alpha, lean = theta[:, :1] * scales["c"], theta[:, 1:2], theta[:, 2:]
        return c * np.sign(trace.velocity) * np.abs(trace.velocity) ** alpha + lean

    def start(self, theta):
        return {"theta": theta.T}

    def step(self, state, displacement, velocity, dt, scales):
        c, alpha, lean = state["theta"]
        return scales["c"] * c * np.sign(velocity) * np.abs(velocity) ** alpha + lean, state
"""
# alpha is a name of Bouc-Wen hysteresis too, with other limits
PRIORS = """
[parameters]
c = { family = "lognormal", median = "9 kN", sigma = 0.6 }
alpha = { family = "lognormal", median = 0.6, sigma = 0.4 }
lean = { family = "normal", mean = "0 kip", sd = "0.1 kip" }
offset = { family = "normal", mean = "0 kip", sd = "0.001 kip" }
noise_sd = { family = "half_normal", sd = "0.2 kip" }

[scatter]
damper = { parameters = ["c", "alpha", "noise_sd"], sd = 0.1 }
lean = { parameters = ["lean"], sd = "10 lbf" }
offset = { parameters = ["offset"], sd = "1 lbf" }
"""
CAMPAIGN = """
[campaign]
model = "my_damper.py:Viscous"
noise = "iid"
priors = "own.toml"

[columns]
time = { name = "time_s" }
displacement = { name = "x_in" }
force = { name = "f_kip" }

[laws]
c = "affine"
"""
TRUTH = {"c": 3.0, "alpha": 0.5, "lean": 0.05}
AT = 750.0  # psi, of c
TESTS = {"a": (500.0, 0.25), "b": (1000.0, 0.5), "c": (500.0, 0.5)}


def motion(frequency):
    time = np.arange(0, 4 / frequency, 1 / (40 * frequency))
    phase = 2 * np.pi * frequency * time
    return time, np.sin(phase), 2 * np.pi * frequency * np.cos(phase)


def force(psi, speed):
    return TRUTH["c"] * psi / AT * np.sign(speed) * np.abs(speed) ** TRUTH["alpha"] + TRUTH["lean"]


@pytest.fixture
def folder(tmp_path):
    return written(tmp_path / "campaign")


def written(folder):
    folder.mkdir()
    rng, text = np.random.default_rng(3), CAMPAIGN
    for name, (psi, frequency) in TESTS.items():
        time, x, speed = motion(frequency)
        noisy = force(psi, speed) * np.exp(0.03 * rng.normal()) + 0.05 * rng.normal(size=x.size)
        write_csv(folder / f"{name}.csv", time, x, noisy, names=("time_s", "x_in", "f_kip"))
        text += f'\n[[test]]\nid = "{name}"\nfile = "{name}.csv"\nactuation = "{psi:g} psi"\n'
    for name, content in {"my_damper.py": VISCOUS, "own.toml": PRIORS, "all.toml": text}.items():
        (folder / name).write_text(content, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run whose campaign is gone, in another place than where it was computed; what was said."""
    base = tmp_path_factory.mktemp("own")
    campaign, run_folder = written(base / "campaign"), base / "out"
    with pytest.MonkeyPatch.context() as patch:
        for name in ("draw_shared", "draw_test"):
            patch.setattr(f"mfd_bayes.reporting.figures.{name}", lambda *_: iter(()))
        quick = ("--effort", "quick", "--jobs", 2)
        words = said("calibrate", campaign / "all.toml", "-o", run_folder, *quick)
    shutil.rmtree(campaign)
    moved = tmp_path_factory.mktemp("moved") / "run"
    shutil.move(run_folder, moved)
    return moved, words


def test_its_file_is_said_to_be_run_and_the_truth_is_inside(finished):
    run_folder, words = finished
    assert words.count("runs my_damper.py") == 1
    assert "lag" not in words  # a force that follows the speed is what this model describes
    run = mb.open_run(run_folder)
    for name, truth in {"alpha": TRUTH["alpha"], "lean": TRUTH["lean"]}.items():
        for test in run.tests.values():
            middle, low, high = test.intervals[name]
            assert abs(truth - middle) < 2.0 * (high - low), name
    median = run.population.median("c", [AT * 1e-3]).ravel()
    assert np.quantile(median, 0.01) < TRUTH["c"] < np.quantile(median, 0.99)
    time, x, speed = motion(0.4)
    band = run.predict(mb.Trace.from_arrays(time, x, 0.75, velocity=speed), draws=200)
    covered = (band.lower <= force(AT, speed)) & (force(AT, speed) <= band.upper)
    assert covered.mean() > 0.9


def test_its_units_and_words_are_in_the_tables_and_the_report(finished):
    run_folder, _ = finished
    parameters = pd.read_csv(run_folder / "parameters.csv").groupby("parameter")["unit"].unique()
    assert parameters["c"].tolist() == ["kip"]
    assert "gamma1" not in parameters
    units = pd.read_csv(run_folder / "laws.csv").set_index("constant")["unit"]
    assert units[["c", "scatter_c", "scatter_lean"]].tolist() == ["kip", "1", "kip"]
    page = (run_folder / "report.html").read_text()
    assert "force at 1 in/s" in page
    assert "Bouc" not in page


def test_every_command_takes_its_run(finished, tmp_path):
    run_dir, _ = finished
    said("check", run_dir)
    words = ("--sine", "1 in, 0.5 Hz, 3 cycles", "--actuation", "800 psi", "--no-figures")
    assert "mean property" in said("predict", run_dir, *words, "--design", "-o", tmp_path / "b.csv")
    options = ("--candidates", "800 psi, 0.5 Hz, 1 in", "--draws", 200)
    slope = said("next", run_dir, *options, "--goal", "slope of c", "-o", tmp_path / "slope")
    assert "narrow the 95 % interval of the slope of c" in slope
    assert "no slip force" in said("next", run_dir, "--goal", "slip at 800 psi", code=2)
    assert "they are c, " in said("next", run_dir, "--goal", "slope of alpha", code=2)
    said("export", run_dir, "--to", "csv", "-o", tmp_path / "samples")
    for form in ("c", "fmu"):
        words = said("export", run_dir, "--to", form, "-o", tmp_path / form, code=2)
        assert "in Python only: give --to csv" in words
        assert not (tmp_path / form).exists()
    (tmp_path / "b.toml").write_text(BUILDING)
    time = np.arange(40) / 20
    names = ("time_s", "acceleration_in/s^2")
    write_csv(tmp_path / "g.csv", time, 100.0 * np.sin(10 * time), names=names)
    building = ("--building", tmp_path / "b.toml", "--ground", tmp_path / "g.csv")
    words = said("respond", run_dir, *building, "--draws", 10, "--jobs", 1, "-o", tmp_path / "r")
    assert "storey drift" in words


def test_a_loop_that_grows_with_its_stroke_is_no_fault(tmp_path):
    """With the control: one of three tests of the same motion has its force in kip, not in kN."""
    folder = written(tmp_path / "campaign")
    text = CAMPAIGN.replace('[laws]\nc = "affine"\n', "")
    for number, size in enumerate((0.4, 1.0, 2.0, 0.6, 0.96, 1.04)):
        time, x, speed = motion(0.5)
        rng = np.random.default_rng(number)
        forces = force(AT, size * speed) * np.exp(0.05 * rng.normal()) + 0.05 * rng.normal(
            size=x.size
        )
        columns = time, size * x, forces
        write_csv(folder / f"s{number}.csv", *columns, names=("time_s", "x_in", "f_kip"))
        text += f'\n[[test]]\nid = "s{number}"\nfile = "s{number}.csv"\nactuation = "750 psi"\n'
    (folder / "all.toml").write_text(text)
    dry = ("calibrate", folder / "all.toml", "-o", tmp_path / "out", "--dry-run")
    assert "warning" not in said(*dry)
    wrong = np.loadtxt(folder / "s4.csv", delimiter=",", skiprows=1).T * [[1.0], [1.0], [4.448]]
    write_csv(folder / "s4.csv", *wrong, names=("time_s", "x_in", "f_kip"))
    assert "s4: " in said(*dry)


def test_init_drafts_its_priors_once_the_units_are_known(tmp_path):
    (tmp_path / "my_damper.py").write_text(VISCOUS)
    for name, frequency in {"25mm0x25Hz0x5A.txt": 0.25, "25mm0x5Hz1x0A.txt": 0.5}.items():
        time, x, speed = motion(frequency)
        newtons = 800.0 * np.tanh(10 * speed)
        np.savetxt(tmp_path / name, np.column_stack([time, 25.0 * x, newtons]))
    model_option = ("--model", "my_damper.py:Viscous")
    words = said("init", tmp_path, *model_option)
    assert "the unit of force is unknown" in words
    assert "Hz, but" not in words  # an x between digits is a decimal point
    assert "init" in words.partition("then:")[2]
    assert not (tmp_path / "priors.toml").exists()
    campaign = tmp_path / "campaign.toml"
    text = campaign.read_text()
    assert 'actuation = "0.5 A"' in text
    assert 'actuation = "1 A"' in text
    text = text.replace("{ column = 2 }", '{ column = 2, unit = "mm" }')
    campaign.write_text(text.replace("{ column = 3 }", '{ column = 3, unit = "N" }'))
    for model in ((), model_option):
        said("init", campaign, *model, "--force")
        drafted = tomllib.loads((tmp_path / "priors.toml").read_text())
        assert set(drafted["parameters"]) == {*TRUTH, "offset", "noise_sd", "noise_time"}
        assert abs(float(drafted["parameters"]["c"]["median"].split()[0]) - 0.18) < 0.01  # kip
        groups = [group["parameters"] for group in drafted["scatter"].values()]
        assert sorted(groups) == sorted([name] for name in drafted["parameters"])
    said("calibrate", campaign, "-o", tmp_path / "out", "--dry-run")


FAULTS = [
    ("all.toml", ":Viscous", ":Nope", ("no class Nope in my_damper.py", "Viscous")),
    ("all.toml", "my_damper.py", "../other.py", ("other.py", "outside the campaign's folder")),
    ("all.toml", 'c = "affine"', 'd = "affine"', ("'d' in [laws]", "my_damper.py", "c")),
    ("my_damper.py", r"\alpha", r"\alfa", ("my_damper.py", "'alpha'", "symbol")),
    ("my_damper.py", "** alpha + lean\n\n    def start", "** np.nan\n\n    def start", ("no",)),
    ("my_damper.py", "class", "raise ValueError('x')\nclass", ("line 6", "ValueError")),
    ("own.toml", '"9 kN"', '"9 kN/m"', ("own.toml", "c", "kN/m")),
]


@pytest.mark.parametrize(("file", "target", "replacement", "words"), FAULTS)
def test_what_cannot_be_used_is_one_sentence(folder, tmp_path, file, target, replacement, words):
    (tmp_path / "other.py").write_text(VISCOUS)
    text = (folder / file).read_text()
    assert target in text
    (folder / file).write_text(text.replace(target, replacement, 1))
    sentence = refusal("calibrate", folder / "all.toml", "-o", tmp_path / "out")
    assert all(word in sentence for word in words)
    assert not (tmp_path / "out").exists()


# --- a run that was received

CARRIED = """
from pathlib import Path
import mfd_bayes as mb
Path(__file__).with_name("executed").touch()
"""


def hashed(run_folder, **settings):
    """Write the hashes of a run's files, as they are, and other settings into its manifest."""
    manifest = json.loads((run_folder / "manifest.json").read_text())
    manifest["files"] |= hash_stored(run_folder, [*manifest["files"], "model.py"])
    manifest["settings"]["campaign"] |= settings
    (run_folder / "manifest.json").write_text(json.dumps(manifest))


@pytest.fixture
def received(finished, tmp_path):
    """A run whose model is another text than any that was calibrated here."""
    run_folder = Path(shutil.copytree(finished[0], tmp_path / "received"))
    (run_folder / "model.py").write_text(CARRIED + VISCOUS)
    hashed(run_folder)
    return run_folder


SINE = ("--sine", "1 in, 0.5 Hz, 3 cycles", "--actuation", "800 psi")
OPENING = {
    "check": ("OUT",),
    "report": ("OUT",),
    "draws": ("OUT", "--to", "csv"),
    "predict": ("OUT", *SINE, "--no-figures", "-o", "TO/b.csv"),
    "accept": ("OUT", "TO/new.csv", "--actuation", "800 psi", "-o", "TO/qc"),
    "next": ("OUT", "-o", "TO/next.csv"),
    "respond": ("OUT", "--building", "TO/b.toml", "--ground", "TO/g.csv", "-o", "TO/r"),
    "export": ("OUT", "--to", "csv", "-o", "TO/samples"),
    "serve": ("OUT", "--port", 0),
    "watch": ("TO/new.csv", "--run", "OUT"),
}


@pytest.mark.parametrize("command", OPENING)
def test_no_command_executes_the_model_of_a_received_run(received, tmp_path, command):
    time, x, speed = motion(0.5)
    write_csv(tmp_path / "new.csv", time, x, force(750.0, speed), names=("time_s", "x_in", "f_kip"))
    (tmp_path / "b.toml").write_text(BUILDING)
    (tmp_path / "g.csv").write_text("time_s,acceleration_g\n0,0\n0.01,0.1\n0.02,-0.1\n")
    places = {"OUT": str(received), "TO/": f"{tmp_path}/"}
    words = [str(word) for word in OPENING[command]]
    for name, path in places.items():
        words = [word.replace(name, path) for word in words]
    sentence = refusal(command, *words)
    assert "would execute its own model.py" in sentence
    assert "--trust-model" in sentence
    assert not (received / "executed").exists()


def test_a_received_model_is_executed_by_one_who_trusts_it(received, finished):
    with pytest.raises(mb.MfdError, match="trust=True"):
        mb.open_run(received)
    assert not (received / "executed").exists()
    assert mb.open_run(received, trust=True).model.name == "viscous"
    assert (received / "executed").exists()
    said("check", received, "--trust-model")
    with pytest.raises(mb.MfdError, match="trust=True"):
        mb.open_run(received)  # it holds for once
    mb.open_run(finished[0])  # the control: calibrated here, and moved since


def test_the_run_of_another_user_is_received(finished, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    with pytest.raises(mb.MfdError, match="trust=True"):
        mb.open_run(finished[0])
    # a list beside the run is not the user's
    monkeypatch.chdir(tmp_path)
    listed = Path("state/mfd_bayes/calibrated_models.txt")
    listed.parent.mkdir(parents=True)
    listed.write_text(sha256((finished[0] / "model.py").read_bytes()).hexdigest())
    for name, value in {"XDG_STATE_HOME": "state", "HOME": str(tmp_path)}.items():
        monkeypatch.setenv(name, value)
        with pytest.raises(mb.MfdError, match="trust=True"):
            mb.open_run(finished[0])


def test_a_run_of_a_built_in_model_does_not_become_a_carrier(small_run, tmp_path):
    run_folder = Path(shutil.copytree(small_run, tmp_path / "received"))
    (run_folder / "model.py").write_text(CARRIED)
    hashed(run_folder, model="any.py:LuGre")
    assert "would execute its own model.py" in refusal("check", run_folder)
    assert not (run_folder / "executed").exists()


def test_bytecode_beside_a_trusted_model_is_not_executed(finished, tmp_path):
    run_folder = Path(shutil.copytree(finished[0], tmp_path / "received"))
    carrier = tmp_path / "carrier.py"
    carrier.write_text(f"open({str(tmp_path / 'executed')!r}, 'w')\n" + VISCOUS)
    cache = importlib.util.cache_from_source(str(run_folder / "model.py"))
    unchecked = py_compile.PycInvalidationMode.UNCHECKED_HASH
    py_compile.compile(str(carrier), cache, invalidation_mode=unchecked)
    assert mb.open_run(run_folder).model.name == "viscous"
    assert not (tmp_path / "executed").exists()
