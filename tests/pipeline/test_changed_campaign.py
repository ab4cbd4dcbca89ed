"""A run that is resumed by the command after its campaign has changed."""

import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest

from mfd_bayes.campaign.synthetic import Matrix, write_campaign
from tests import run_folders
from tests.command_line import said

pytestmark = pytest.mark.slow

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
HELD_OUT = entry("v", 800, "validate")
SHORTER = entry("b", 1000, more='fit = "0 s to 1.9 s"')
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
        return said(*self.words(*options))

    @property
    def posteriors(self):
        return {p.parent.name: p.read_bytes() for p in self.out.glob("tests/*/posterior.nc")}


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


def test_the_draft_of_the_next_test_is_added_and_what_is_there_is_kept(lab):
    before, draft = lab.posteriors, lab.home / "next.toml"
    words = ["next", lab.out, "--write", draft, "--draws", 400, "--candidates", "1200 psi, 1 in"]
    said(*words)
    text = draft.read_text()
    shutil.copy(
        lab.campaign.with_name("p1200_f0.5.csv"),
        lab.campaign.with_name(re.search('file = "(.*?)"', text)[1]),
    )
    lab.write(*USUAL, text)
    lab.calibrate("--resume")
    assert len(lab.posteriors) == len(before) + 1
    assert {name: lab.posteriors[name] for name in before} == before


@pytest.mark.parametrize(
    ("tests", "laws", "kept", "again"),
    [
        ((C, entry("z", 500), entry("v", 800)), "", "c", True),  # renamed; to calibrate
        ((A, SHORTER, entry("c", 1500, "validate")), "", "a", True),
        (USUAL, '\n[laws]\nsigma0 = "constant"\n', "abc", True),
        (USUAL, "\n# the same\n", "abc", False),
    ],
)
def test_what_is_unchanged_is_kept_and_all_is_as_in_a_fresh_run(
    lab, differing, tests, laws, kept, again
):
    before = lab.posteriors
    (lab.out / "next.csv").write_text("of the laws before")
    (lab.out / "draws.csv").write_text("of the tests before")
    printed = lab.write(*tests, laws=laws).calibrate("--resume")
    after = lab.posteriors
    assert (lab.out / "next.csv").exists() != again
    assert (lab.out / "draws.csv").exists() == (kept == "abc")
    for name in ("next.csv", "draws.csv"):
        (lab.out / name).unlink(missing_ok=True)
    assert "".join(sorted(n for n in after if after[n] == before.get(n))) == kept
    assert ("population: done" in printed) == again
    if again:
        assert differing(lab) == []
