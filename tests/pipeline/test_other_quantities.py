"""Models of stress over strain, moment over rotation, pressure over flow; with and without time."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import mfd_bayes as mb
from mfd_bayes.friction.models import find_model
from tests.command_line import refusal, said, write_csv

ROOT = Path(__file__).parents[2]
STEEL = """
import numpy as np
import mfd_bayes as mb


class Steel(mb.Model):
    name = "steel"
    motion = "strain"
    response = "stress, MPa"
    rate_independent = True
    parameters = (
        mb.Parameter("E", "GPa", meaning="stiffness at rest"),
        mb.Parameter("strength", "MPa"),
    )

    def force(self, theta, trace):
        E, strength = 1e3 * theta[:, :1], theta[:, 1:]
        return strength * np.tanh(E * trace.displacement / strength)
"""
PRIORS = """
[parameters]
E = { family = "lognormal", median = "30000 ksi", sigma = 0.3 }
strength = { family = "lognormal", median = "400 MPa", sigma = 0.3 }
offset = { family = "normal", mean = "0 MPa", sd = "1 MPa" }
noise_sd = { family = "half_normal", sd = "20 MPa" }

[scatter]
steel = { parameters = ["E", "strength", "noise_sd"], sd = 0.05 }
offset = { parameters = ["offset"], sd = "1 MPa" }
"""
CAMPAIGN = """
[campaign]
model = "steel.py:Steel"
noise = "iid"
priors = "own.toml"

[columns]
strain = { name = "eps", unit = "%" }
stress = { name = "sig_ksi" }
"""
KSI = 6.894757
NOT_ITS_WORDS = r"(?i)\b(forces?|displacements?|velocit\w+|strokes?|slip|kip|kN|Hz|gap|actuation)\b"


@pytest.fixture
def folder(tmp_path):
    return written(tmp_path)


def written(folder):
    text = CAMPAIGN
    for seed in range(1, 5):
        rng = np.random.default_rng(seed)
        strain = 0.01 * np.sin(np.linspace(0, 4 * np.pi, 60)) * (1 + 0.1 * seed)
        stress = 420 * np.exp(0.02 * rng.normal()) * np.tanh(200e3 * strain / 420)
        stress += 4 * rng.normal(size=60)
        columns = {"names": ("eps", "sig_ksi")}
        write_csv(folder / f"bar{seed}.csv", 100 * strain, stress / KSI, **columns)
        role = '\nrole = "validate"' if seed == 4 else ""
        text += f'\n[[test]]\nid = "bar{seed}"\nfile = "bar{seed}.csv"{role}\n'
    for name, content in {"steel.py": STEEL, "own.toml": PRIORS, "all.toml": text}.items():
        (folder / name).write_text(content, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = written(tmp_path_factory.mktemp("steel"))
    options = ("--effort", "quick", "--jobs", "1")
    words = said("calibrate", folder / "all.toml", "-o", folder / "out", *options)
    return folder, words


def test_a_record_without_time_is_fitted_and_the_truth_is_inside(finished):
    folder, words = finished
    assert not re.search(NOT_ITS_WORDS, words.replace("steel.py", ""))
    run = mb.open_run(folder / "out")
    for test in run.tests.values():
        middle, low, high = test.intervals["E"]
        assert abs(middle - 200.0) < 2.0 * (high - low)
        assert not test.trace.timed
    strain = 0.012 * np.sin(np.linspace(0, 10, 300))
    band = run.predict(mb.Trace.from_arrays(None, strain), draws=200)
    truth = 420 * np.tanh(200e3 * strain / 420)
    assert np.mean((band.lower <= truth) & (truth <= band.upper)) > 0.9


def test_tables_and_pages_speak_of_stress_in_the_unit_of_the_records(finished):
    run_folder = finished[0] / "out"
    record = pd.read_csv(run_folder / "tests" / "bar1" / "record.csv")
    assert list(record.columns[:3]) == ["sample", "strain_%", "stress_ksi"]
    data = pd.read_csv(finished[0] / "bar1.csv")
    np.testing.assert_allclose(record["strain_%"], data["eps"], rtol=1e-4)
    np.testing.assert_allclose(record["stress_ksi"], data["sig_ksi"], rtol=1e-4)
    units = pd.read_csv(run_folder / "parameters.csv").groupby("parameter")["unit"].first()
    assert units[["E", "strength", "offset"]].tolist() == ["GPa", "ksi", "ksi"]
    for path in [*run_folder.glob("*.csv"), *run_folder.glob("tests/*/*.csv")]:
        assert not re.search(NOT_ITS_WORDS, path.read_text().replace("_", " ")), path.name
    for path in [*run_folder.glob("*.html"), *run_folder.glob("tests/*/*.html")]:
        page = re.sub(r"<(script|style).*?</\1>|<[^>]*>", " ", path.read_text(), flags=re.DOTALL)
        assert "stress" in page
        assert not re.search(r"(?i)\b(forces?|displacement|kip|kN|Hz|velocity)\b", page)
    derived = set(pd.read_csv(run_folder / "derived.csv")["quantity"])
    assert {"peak_fwd", "energy_per_cycle"} <= derived
    medians = pd.read_csv(run_folder / "laws.csv").set_index("constant")["q50"]
    assert abs(medians["E"] - 200.0) < 20.0  # GPa, of the population
    assert not derived & {"slip_fwd", "c_eq", "gap", "build_up_slope"}


def test_every_command_takes_it(finished, tmp_path):
    folder, run_dir = finished[0], finished[0] / "out"
    look = said("inspect", folder / "all.toml", "-o", tmp_path)
    assert "strain: eps [%], stress: sig_ksi [ksi]" in look
    assert not re.search(NOT_ITS_WORDS, look)
    said("check", run_dir)
    said("export", run_dir, "--to", "quofem", "-o", tmp_path / "samples")
    metadata = json.loads((tmp_path / "samples" / "about.json").read_text())
    assert "actuation" not in metadata
    assert metadata["variables"] == {"E": "GPa", "strength": "MPa"}
    assert not (tmp_path / "samples" / "start.txt").exists()
    options = ("--no-figures", "-o", tmp_path / "sine.csv", "--force")
    sine = ("predict", run_dir, "--sine", "1 %, 3 cycles", *options)
    words = said(*sine, "--session", "other")
    assert "of the device without offset" in words
    assert "session 'other' is taken for a new one" in words
    assert not re.search(r"\b(damper|laws|load cell)\b", words)
    assert "peak_fwd" in said(*sine, "--design")
    assert "sample,strain_%,lower_ksi" in (tmp_path / "sine.csv").read_text()
    assert "ksi" in said("predict", run_dir, "--motion", folder / "bar3.csv", "--compare", *options)
    assert "narrow" in said("next", run_dir, "-o", tmp_path / "next.csv")
    assert "Hz" not in (tmp_path / "next.csv").read_text()
    assert "--actuation" in refusal(*sine, "--actuation", "5 psi")
    assert "strain" in refusal("predict", run_dir, "--sine", "1 in, 3 cycles", *options)
    ended = said("accept", run_dir, folder / "bar4.csv", "-o", tmp_path / "qc")
    names = pd.read_csv(tmp_path / "qc" / "acceptance.csv", comment="#")["name"].tolist()
    assert "peak_fwd" in names
    assert not [name for name in names if name.startswith(("slip", "gap", "build_up"))]
    assert not re.search(NOT_ITS_WORDS, ended.replace("steel.py", ""))


FAULTS = [
    ("all.toml", 'unit = "%"', 'unit = "mm"', ("bar1.csv", "'mm'", "strain")),
    ("all.toml", ', unit = "%"', "", ("bar1.csv", "'eps'", "no unit", "strain")),
    ("all.toml", "strain =", "displacement =", ("all.toml", "'displacement'", "strain")),
    ("all.toml", '"iid"', '"iid"\nrate = "64 Hz"', ("all.toml", "rate", "rate-independent")),
    ("all.toml", 'file = "bar1', 'window = "0 s to 2 s"\nfile = "bar1', ("bar1", "0 to 300")),
    ("all.toml", 'file = "bar1', 'actuation = "5 psi"\nfile = "bar1', ("bar2", "in all tests")),
    ("steel.py", "rate_independent = True", "", ("bar1.csv", "no column for time", "rate")),
    ("steel.py", '"stress, MPa"', '"tension"', ("steel.py", "Steel", "response", "unit")),
    ("steel.py", '"stress, MPa"', '"force, N"', ("class Steel", "in kip", "such as 'load, N'")),
    ("steel.py", '"strain"', '"displacement, mm"', ("Steel", "in in", "such as 'travel, mm'")),
    ("own.toml", '"1 MPa"', '"1 kip"', ("own.toml", "offset", "'kip'")),
]  # fmt: skip


@pytest.mark.parametrize(("file", "target", "replacement", "words"), FAULTS)
def test_what_does_not_fit_is_one_sentence(folder, tmp_path, file, target, replacement, words):
    text = (folder / file).read_text()
    assert target in text
    (folder / file).write_text(text.replace(target, replacement, 1))
    sentence = refusal("calibrate", folder / "all.toml", "-o", tmp_path / "out")
    assert all(word in sentence for word in words)
    assert not (tmp_path / "out").exists()


HINGE = """
import mfd_bayes as mb


class Hinge(mb.Model):
    name, motion, response = "hinge", "{motion}", "{response}"
    parameters = (mb.Parameter("c", "{unit}"),)

    def force(self, theta, trace):
        return theta * trace.velocity
"""


@pytest.mark.parametrize(
    ("motion", "response", "unit", "heads", "scale"),
    [
        ("rotation", "moment", "kN*m", ("rot_deg", "M_kip-in"), (57.29578, 8.850746)),
        ("flow", "pressure, kPa", "kPa", ("Q_gpm", "p_bar"), (0.26417205, 0.01)),
        ("flow, m^3/s", "pressure", "MPa", ("Q [L/min]", "p (psi)"), (6e4, 145.03774)),
        ("curvature, 1/m", "torque, N*m", "N*m", ("k (1/mm)", "T_kNm"), (1e-3, 1e-3)),
    ],
)
def test_each_quantity_is_read_in_any_of_its_units(tmp_path, motion, response, unit, heads, scale):
    names = [text.partition(",")[0] for text in (motion, response)]
    time = np.arange(0, 8, 0.02)
    x, y = 0.02 * np.sin(2 * time), 5 * np.tanh(4 * np.cos(2 * time))
    write_csv(tmp_path / "a.csv", time, scale[0] * x, scale[1] * y, names=("time_s", *heads))
    code = HINGE.format(motion=motion, response=response, unit=unit)
    (tmp_path / "hinge.py").write_text(code)
    columns = {"time": "time_s", names[0]: heads[0], names[1]: heads[1]}
    axes = find_model("hinge.py:Hinge", tmp_path).axes
    record = mb.read_record(tmp_path / "a.csv", columns, axes=axes)
    np.testing.assert_allclose(record.displacement, x, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(record.force, y, rtol=1e-6)


def test_a_model_that_needs_time_refuses_a_trace_without(tmp_path):
    (tmp_path / "steel.py").write_text(STEEL.replace("rate_independent = True", ""))
    trace = mb.Trace.from_arrays(None, 0.01 * np.sin(np.arange(50)))
    with pytest.raises(mb.MfdError, match="steel needs the time"):
        find_model("steel.py:Steel", tmp_path).force([[200.0, 400.0]], trace)


def test_init_drafts_a_campaign_and_priors_for_a_model(tmp_path, data_folder):
    shutil.copy(ROOT / "examples/coupons/steel.py", tmp_path)
    for record in sorted((data_folder.parent / "coupons").glob("0[1-3]_*.csv")):
        shutil.copy(record, tmp_path)
    (tmp_path / "notes.csv").write_text("time,temperature\n1,20\n2,21\n")
    words = said("init", tmp_path, "--model", "steel.py:Steel")
    assert "left out: notes.csv: no column for strain and stress" in words
    assert "tests 3" in words
    text = (tmp_path / "campaign.toml").read_text()
    assert text.count('stress = { name = "stress_MPa", unit = "MPa" }') == 1
    assert "actuation" not in text
    said("calibrate", tmp_path / "campaign.toml", "-o", tmp_path / "out", "--dry-run")
    assert "exists" in refusal("init", tmp_path, "--model", "steel.py:Steel")
    assert "Iron" in refusal("init", tmp_path, "--model", "steel.py:Iron", "--force")
