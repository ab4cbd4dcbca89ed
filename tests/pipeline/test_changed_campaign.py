"""A run that is resumed after its campaign has changed, or on another machine: by the command."""

import json
import os
import platform
import re
import shutil
import signal
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from mfd_bayes.campaign.synthetic import Matrix, write_campaign
from mfd_bayes.cli.commands import app
from tests import run_folders

HEAD = """\
[campaign]
title = "A campaign that grows"
priors = "own.toml"
model = "lugre"
noise = "iid"
rate = "25 Hz"

[columns]
time = { name = "time_s", unit = "s" }
displacement = { name = "displacement_in", unit = "in" }
force = { name = "force_kip", unit = "kip" }
"""


def entry(name, psi, role="calibrate", more=""):
    return (
        f'\n[[test]]\nid = "{name}"\nfile = "p{psi}_f0.5.csv"\nactuation = "{psi} psi"\n'
        f'role = "{role}"\n{more}\n'
    )


A, B, C = entry("a", 500), entry("b", 1000), entry("c", 1500)
HELD_OUT, NEW = entry("v", 800, "validate"), entry("n", 1200)
USUAL = (A, B, C, HELD_OUT)


@dataclass(frozen=True)
class Lab:
    """A folder with a campaign, and its run folder."""

    home: Path

    @property
    def campaign(self):
        return self.home / "campaign" / "campaign.toml"

    @property
    def out(self):
        return self.home / "out"

    def write(self, *tests, laws=""):
        self.campaign.write_text(HEAD + laws + "".join(tests))
        return self

    def words(self, *options):
        words = ("calibrate", self.campaign, "-o", self.out, "--effort", "quick", "--jobs", 1)
        return [str(word) for word in (*words, *options)]

    def calibrate(self, *options):
        """What the command prints; it must end well."""
        outcome = CliRunner().invoke(app, self.words(*options))
        assert outcome.exit_code == 0, (outcome.output, outcome.exception)
        return outcome.output

    @property
    def posteriors(self):
        return {p.parent.name: p.read_bytes() for p in self.out.glob("tests/*/posterior.nc")}

    @property
    def manifest(self):
        return json.loads((self.out / "manifest.json").read_text())


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A finished run of a, b and c, with v held out; the record of n is there too."""
    lab = Lab(tmp_path_factory.mktemp("finished"))
    pressures = (500.0, 1000.0, 1200.0, 1500.0)
    matrix = Matrix(pressures=pressures, frequencies=(0.5,), cycles=(1,), held_out=(800.0, 0.5))
    write_campaign(lab.campaign.parent, 1, matrix)
    shutil.copy(
        Path(__file__).parents[2] / "priors" / "mfd.toml", lab.campaign.with_name("own.toml")
    )
    with pytest.MonkeyPatch.context() as patch:
        for name in ("draw_shared", "draw_test"):
            patch.setattr(f"mfd_bayes.reporting.figures.{name}", lambda *_: iter(()))
        lab.write(*USUAL).calibrate()
    return lab


@pytest.fixture
def lab(finished, tmp_path, no_figures):
    """A copy of the finished run and its campaign."""
    shutil.copytree(finished.home, tmp_path / "lab")
    return Lab(tmp_path / "lab")


@pytest.fixture
def differing(tmp_path):
    """Function that names the files in which a run folder differs from a fresh run's."""

    def differing(lab):
        fresh = Lab(tmp_path / "fresh")
        shutil.copytree(lab.campaign.parent, fresh.campaign.parent)
        fresh.calibrate()
        others = run_folders.files(lab.out) ^ run_folders.files(fresh.out)
        return [*run_folders.differing(lab.out, fresh.out), *others]

    return differing


def samples_population(printed):
    return "population: done" in printed


def test_a_test_that_is_added_first_is_sampled_alone(lab):
    before = lab.posteriors
    printed = lab.write(NEW, *USUAL).calibrate("--resume")
    assert {name: lab.posteriors[name] for name in before} == before
    assert [name for name in "abcn" if f"{name}: finding modes" in printed] == ["n"]
    assert samples_population(printed)
    assert list(lab.manifest["tests"]) == ["n", "a", "b", "c", "v"]


@pytest.mark.slow
def test_the_draft_of_the_next_test_is_added_and_the_run_is_that_of_the_whole_campaign(
    lab, differing
):
    before, draft = lab.posteriors, lab.home / "next.toml"
    words = ["next", lab.out, "--write", draft, "--draws", 400, "--candidates", "1200 psi, 1 in"]
    outcome = CliRunner().invoke(app, [str(word) for word in words])
    assert outcome.exit_code == 0, outcome.output
    text = draft.read_text()
    shutil.copy(
        lab.campaign.with_name("p1200_f0.5.csv"),
        lab.campaign.with_name(re.search('file = "(.*?)"', text)[1]),
    )
    lab.write(*USUAL, text)
    lab.calibrate("--resume")
    assert len(lab.posteriors) == len(before) + 1
    assert {name: lab.posteriors[name] for name in before} == before
    assert differing(lab) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tests", "laws", "kept", "again"),
    [
        ((A, NEW, B, C, HELD_OUT), "", "abc", True),
        ((B, C, HELD_OUT), "", "bc", True),
        ((A, B, HELD_OUT), "", "ab", True),
        ((A, B, C), "", "abc", False),
        ((C, A, B, HELD_OUT), "", "abc", True),
        ((entry("z", 500), B, C, HELD_OUT), "", "bc", True),
        ((A, entry("b", 1000, more='fit = "0 s to 1.9 s"'), C, HELD_OUT), "", "ac", True),
        ((A, B, entry("c", 1500, "validate"), HELD_OUT), "", "ab", True),
        ((A, B, C, entry("v", 800)), "", "abc", True),
        (USUAL, '\n[laws]\nsigma0 = "constant"\n', "abc", True),
        (USUAL, "\n# the same\n", "abc", False),
    ],
    ids=[
        *("added", "first removed", "last removed", "held-out removed", "reordered", "renamed"),
        *("window", "to validate", "to calibrate", "law", "comment"),
    ],
)
def test_what_is_unchanged_is_kept_and_all_is_as_in_a_fresh_run(
    lab, differing, tests, laws, kept, again
):
    before = lab.posteriors
    printed = lab.write(*tests, laws=laws).calibrate("--resume")
    after = lab.posteriors
    assert "".join(sorted(n for n in after if after[n] == before.get(n))) == kept
    assert samples_population(printed) == again
    assert differing(lab) == []


def change_file(lab):
    path = lab.campaign.with_name("p1000_f0.5.csv")
    path.write_text(path.read_text() + "\n")


def change_prior(lab):
    path = lab.campaign.with_name("own.toml")
    text = path.read_text()
    assert '"80 kip/in"' in text
    path.write_text(text.replace('"80 kip/in"', '"81 kip/in"', 1))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "kept"), [(change_file, "ac"), (change_prior, "")], ids=["file", "prior"]
)
def test_what_rests_on_another_file_is_sampled_again_and_said(lab, differing, change, kept):
    before = lab.posteriors
    change(lab)
    printed = lab.calibrate("--resume")
    after = lab.posteriors
    assert "".join(sorted(n for n in after if after[n] == before[n])) == kept
    again = ", ".join(name for name in "abc" if name not in kept)
    assert f"so they are sampled again: {again}" in printed
    assert differing(lab) == []


@pytest.mark.slow
def test_a_killed_run_is_finished_with_one_more_test(lab, differing, without_figures):
    shutil.rmtree(lab.out)
    process = subprocess.Popen(
        [*without_figures, *lab.words()],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    while process.poll() is None and not lab.posteriors:
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    before = lab.posteriors
    assert before
    printed = lab.write(A, B, NEW, C, HELD_OUT).calibrate("--resume")
    for name, content in before.items():
        assert f"{name}: done before" in printed
        assert lab.posteriors[name] == content
    assert differing(lab) == []


def test_a_run_of_other_tests_is_refused_and_stays(lab):
    before = (lab.out / "manifest.json").read_bytes()
    lab.write(NEW)
    outcome = CliRunner().invoke(app, lab.words("--resume"))
    assert outcome.exit_code == 2
    (sentence,) = outcome.stderr.splitlines()
    assert "it is a run of other tests (a, b, c, v)" in sentence
    assert (lab.out / "manifest.json").read_bytes() == before
    assert len(lab.posteriors) == 3


# --- another machine


def on_machine(lab, without_figures, **environment):
    """What the command says of a resumption in a process with this environment."""
    ended = subprocess.run(
        [*without_figures, *lab.words("--resume", "--quiet")],
        capture_output=True,
        text=True,
        env=os.environ | environment,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    return [line for line in ended.stderr.splitlines() if "machine" in line]


def test_another_blas_kernel_or_set_of_instructions_is_said_in_one_line(lab, without_figures):
    (machine,) = lab.manifest["machines"]
    assert machine["processor"]
    assert machine["instructions"]
    found = np.show_config(mode="dicts").get("SIMD Extensions", {}).get("found", [])
    blas = [words for name, words in machine.items() if "BLAS" in name]
    if platform.machine() != "x86_64" or not found or "openblas" not in "".join(blas):
        pytest.skip("needs OpenBLAS on a processor of x86-64 whose instructions NumPy chooses")
    assert on_machine(lab, without_figures) == []
    (line,) = on_machine(lab, without_figures, OPENBLAS_CORETYPE="Nehalem")
    assert "another machine" in line
    assert re.search("BLAS.* was openblas .*, is openblas .*Nehalem", line)
    assert "instructions" not in line
    (line,) = on_machine(lab, without_figures, NPY_DISABLE_CPU_FEATURES=found[0])
    assert re.search(f"instructions was .*{found[0]}.*, is ", line)
    assert "BLAS" not in line
    assert lab.manifest["machines"] == [machine]  # nothing was computed there


@pytest.mark.slow
def test_a_run_knows_every_machine_that_has_computed_a_part_of_it(lab, without_figures):
    (machine,) = lab.manifest["machines"]
    if "openblas" not in str(machine) or platform.machine() != "x86_64":
        pytest.skip("needs OpenBLAS on a processor of x86-64")
    before = lab.posteriors
    lab.write(*USUAL, NEW)
    assert len(on_machine(lab, without_figures, OPENBLAS_CORETYPE="Nehalem")) == 1
    first, second = lab.manifest["machines"]
    assert first == machine
    assert "Nehalem" in str(second)
    assert {name: lab.posteriors[name] for name in before} == before
    assert len(on_machine(lab, without_figures)) == 1  # still of two machines
    assert "machine 2" in (lab.out / "report.html").read_text()
