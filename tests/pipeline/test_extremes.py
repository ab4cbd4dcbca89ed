"""What a dry run accepts is stored, read again and reported, however large or small its figures."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from mfd_bayes.cli.commands import app
from mfd_bayes.errors import MfdError
from mfd_bayes.pipeline.plan import Options, plan_campaign
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.folder import hash_stored
from mfd_bayes.runs.manifest import read_begun
from mfd_bayes.runs.run import open_run
from mfd_bayes.store.files import json_text
from mfd_bayes.store.netcdf import save_trace
from tests.run_folders import write_run

TEST = '[[test]]\nid = "{id}"\nfile = "a.csv"\nactuation = "{actuation}"\n'


def here(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def write_record(path, scale=1.0):
    time = np.arange(201) / 50
    table = np.column_stack([time, np.sin(np.pi * time), scale * np.tanh(4 * np.cos(np.pi * time))])
    lines = "".join(",".join(f"{x!r}" for x in row) + "\n" for row in table.tolist())
    path.write_text("time_s,displacement_in,force_kip\n" + lines)


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    folder = tmp_path_factory.mktemp("extremes")
    write_record(folder / "a.csv")
    return folder


def write_campaign(home, head="", actuation="500 psi"):
    path = home / "campaign.toml"
    path.write_text(head + TEST.format(id="a", actuation=actuation), encoding="utf-8")
    return path


# --- one schema for the campaign and the manifest


NUMBERS = st.floats(allow_nan=False, allow_infinity=False) | st.sampled_from(
    [1e300, 1e-300, 1e10, 1e-10, 1.5, 5e-324, 1e100]
)
TEXTS = st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"]), max_size=20)


@settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    area=st.sampled_from([1e10, 1e-10, 1.5]) | NUMBERS | st.none(),
    rate=NUMBERS | st.none(),
    title=TEXTS,
    session=TEXTS,
    level=NUMBERS,
    unit=st.sampled_from(["psi", "Pa", "ksi", "lbf", "GPa"]),
)
def test_what_a_dry_run_accepts_the_manifest_gives_back(
    home, area, rate, title, session, level, unit
):
    head = f"[campaign]\ntitle = {json.dumps(title, ensure_ascii=False)}\n"
    head += "" if area is None else f"area = {area!r}\n"
    head += "" if rate is None else f"rate = {rate!r}\n"
    path = write_campaign(home, head, f"{level!r} {unit}")
    session_line = f"session = {json.dumps(session, ensure_ascii=False)}\n"
    path.write_text(path.read_text(encoding="utf-8") + session_line, encoding="utf-8")
    try:
        plan = plan_campaign(path, Options(effort="quick"))
    except MfdError:
        return
    plan.manifest.write(home)
    again = read_begun(home)
    assert json_text(again.content) == json_text(plan.manifest.content)
    assert again.settings.area == plan.manifest.settings.area
    assert again.settings.sessions == plan.manifest.settings.sessions


# --- what is written is checked by what reads it


# --- a test that cannot be shown


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stored") / "out"
    write_run(folder, small=True)
    return folder


@pytest.fixture
def odd(stored, tmp_path):
    """A run of which the held-out test is at an actuation, in ksi, that the laws cannot reach."""

    def made(level):
        out = Path(shutil.copytree(stored, tmp_path / "out"))
        trace = open_run(out).held_out["c"]
        moved = Trace.from_arrays(trace.time, trace.displacement, level, trace.force)
        save_trace(out / "tests/c/record.nc", moved, {})
        manifest = json.loads((out / "manifest.json").read_text())
        manifest["files"] |= hash_stored(out, ["tests/c/record.nc"])
        (out / "manifest.json").write_text(json.dumps(manifest))
        return out

    return made


@pytest.mark.usefixtures("no_figures_of_tests")
def test_an_odd_test_is_named_and_left_out_of_the_report_which_is_finished(odd):
    out = odd(1e-9)  # 1 µpsi
    outcome = here("report", out)
    assert outcome.exit_code == 1, outcome.output
    assert outcome.stderr == ""
    said = " ".join(outcome.stdout.split())
    assert "Test c is left out of the report: a predicted parameter holds numbers" in said
    page = (out / "report.html").read_text()
    assert "left out of the report" in page
    scores = (out / "scores.csv").read_text().splitlines()[1:]
    assert [line.split(",")[0] for line in scores] == ["a"]
    checked = here("check", out, "--quiet")
    assert checked.exit_code == 1
    assert "Test c is left out" in checked.stdout
