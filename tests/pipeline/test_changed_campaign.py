"""A run that is resumed by the command after its campaign has changed."""

import re
import shutil

import pytest

from mfd_bayes.campaign.synthetic import Matrix, write_campaign
from tests import run_folders
from tests.command_line import said

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("no_figures")]

HEAD = """\
[campaign]
title = "A campaign that grows"
model = "lugre"
noise = "iid"
rate = "25 Hz"
"""


def entry(name, psi, role="calibrate", keys=""):
    text = f'\n[[test]]\nid = "{name}"\nfile = "p{psi}_f0.5.csv"\nactuation = "{psi} psi"\n'
    return f'{text}role = "{role}"\n{keys}\n'


A, B, C = entry("a", 500), entry("b", 1000), entry("c", 1500)
HELD_OUT = entry("v", 800, "validate")
SHORTER = entry("b", 1000, keys='window = "0 s to 1.9 s"')
USUAL = (A, B, C, HELD_OUT)


def calibrate(folder, *options):
    """What the command prints of the campaign in a folder, beside which the run is."""
    campaign, run_folder = folder / "campaign" / "campaign.toml", folder / "out"
    quick = ("--effort", "quick", "--jobs", 1)
    return said("calibrate", campaign, "-o", run_folder, *quick, *options)


def posteriors(folder):
    return {p.parent.name: p.read_bytes() for p in folder.glob("out/tests/*/posterior.nc")}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A finished run of a, b and c, with v held out; the record of n is there too."""
    folder = tmp_path_factory.mktemp("finished")
    pressures = (500.0, 1000.0, 1200.0, 1500.0)
    matrix = Matrix(pressures=pressures, frequencies=(0.5,), cycles=(1,), held_out=(800.0, 0.5))
    write_campaign(folder / "campaign", 1, matrix)
    (folder / "campaign" / "campaign.toml").write_text(HEAD + "".join(USUAL))
    with pytest.MonkeyPatch.context() as patch:
        for name in ("draw_shared", "draw_test"):
            patch.setattr(f"mfd_bayes.reporting.figures.{name}", lambda *_: iter(()))
        calibrate(folder)
    return folder


@pytest.fixture
def home(finished, tmp_path):
    """A copy of the finished run and its campaign."""
    return shutil.copytree(finished, tmp_path / "lab")


def test_the_draft_of_the_next_test_is_added_and_what_is_there_is_kept(home):
    initial, draft = posteriors(home), home / "next.toml"
    options = ("--draws", 400, "--candidates", "1200 psi, 1 in")
    said("next", home / "out", "--write", draft, *options)
    text, folder = draft.read_text(), home / "campaign"
    shutil.copy(folder / "p1200_f0.5.csv", folder / re.search('file = "(.*?)"', text)[1])
    (folder / "campaign.toml").write_text(HEAD + "".join(USUAL) + text)
    calibrate(home, "--resume")
    final = posteriors(home)
    assert len(final) == len(initial) + 1
    assert initial.items() <= final.items()


@pytest.mark.parametrize(
    ("tests", "laws", "unchanged", "again"),
    [
        ((C, entry("z", 500), entry("v", 800)), "", "c", True),  # renamed; to calibrate
        ((A, SHORTER, entry("c", 1500, "validate")), "", "a", True),
        (USUAL, '\n[laws]\nsigma0 = "constant"\n', "abc", True),
        (USUAL, "\n# the same\n", "abc", False),
    ],
)
def test_what_is_unchanged_is_kept_and_all_is_as_in_a_fresh_run(
    home, tmp_path, tests, laws, unchanged, again
):
    initial, run_folder, fresh = posteriors(home), home / "out", tmp_path / "fresh"
    for name in ("next.csv", "draws.csv"):
        (run_folder / name).write_text("of the tests before")
    (home / "campaign" / "campaign.toml").write_text(HEAD + laws + "".join(tests))
    printed = calibrate(home, "--resume")
    final = posteriors(home)
    assert (run_folder / "next.csv").exists() != again
    assert (run_folder / "draws.csv").exists() == (unchanged == "abc")
    assert "".join(sorted(n for n in final if final[n] == initial.get(n))) == unchanged
    assert ("population: done" in printed) == again
    if again:
        (run_folder / "draws.csv").unlink(missing_ok=True)
        shutil.copytree(home / "campaign", fresh / "campaign")
        calibrate(fresh)
        assert run_folders.files(run_folder) == run_folders.files(fresh / "out")
        assert run_folders.differing(run_folder, fresh / "out") == []


def test_damage_is_computed_again_and_what_is_not_the_runs_stays(home):
    initial, run_folder = posteriors(home), home / "out"
    notes = [run_folder / "tests/b/notes.txt", run_folder / "figures/mine.png"]
    for path in notes:
        path.parent.mkdir(exist_ok=True)
        path.write_text("mine")
    (run_folder / "tests/b/posterior.nc").write_bytes(b"")
    assert "b is sampled again" in calibrate(home, "--resume")
    final = posteriors(home)
    assert set(final) == set(initial)
    assert [name for name in final if final[name] != initial[name]] in ([], ["b"])
    calibrate(home, "--force")
    assert [path.read_text() for path in notes] == ["mine", "mine"]


def test_the_report_of_an_earlier_campaign_says_so_until_it_is_written_again(home, monkeypatch):
    from mfd_bayes.pipeline import calibrate as pipeline

    folder, pages, words = home / "out", [], "This page is of an earlier calibration"
    infer = pipeline.infer_population

    def observed(*args, **options):
        pages.extend((folder / name).read_text() for name in ("report.html", "tests/a/page.html"))
        return infer(*args, **options)

    monkeypatch.setattr(pipeline, "infer_population", observed)
    text = HEAD + '\n[laws]\nsigma0 = "constant"\n' + "".join(USUAL)
    (home / "campaign" / "campaign.toml").write_text(text)
    calibrate(home, "--resume")
    assert [page.count(words) for page in pages] == [1, 1]
    assert words not in (folder / "report.html").read_text()
