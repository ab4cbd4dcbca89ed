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
from mfd_bayes.errors import MfdError, RecordError, UnitError
from mfd_bayes.pipeline.plan import Options, plan_campaign
from mfd_bayes.records.record import read_record
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.folder import hash_stored
from mfd_bayes.runs.manifest import check_readable, read_begun
from mfd_bayes.runs.run import open_run
from mfd_bayes.store.files import json_text
from mfd_bayes.store.netcdf import save_trace
from mfd_bayes.units import parse_actuation
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


@pytest.mark.parametrize("area", ["1e300", "1e-300", "1e11", "1e-11", '"1e300 in^2"'])
def test_an_area_that_a_run_may_not_hold_is_refused_by_a_dry_run(home, area):
    campaign = write_campaign(home, f"[campaign]\narea = {area}\n")
    outcome = here("calibrate", campaign, "-o", home / "out", "--dry-run")
    assert outcome.exit_code == 2, outcome.output
    (sentence,) = outcome.stderr.splitlines()
    assert "campaign.area" in sentence


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


def test_a_manifest_that_could_not_be_read_is_refused_before_it_is_written(home):
    manifest = plan_campaign(write_campaign(home), Options(effort="quick")).manifest
    check_readable(manifest)
    entry = manifest.tests["a"].model_copy(update={"record_rate": 1e200})
    with pytest.raises(MfdError, match="could not be opened once it is stored"):
        check_readable(manifest.changed(tests={"a": entry}))


# --- what is written is checked by what reads it


@pytest.mark.parametrize("rate", [2e-308, 1e-9, 1.0])
def test_a_rate_that_leaves_too_few_samples_is_refused(home, rate):
    with pytest.raises(RecordError, match="fewer than 20 samples"):
        read_record(home / "a.csv").trace(rate)


@pytest.mark.parametrize("scale", [1e-300, 1e-22, 1e11, 1e300])
def test_a_force_too_small_or_large_is_refused_where_the_record_is_read(tmp_path, scale):
    write_record(tmp_path / "a.csv", scale)
    with pytest.raises(RecordError, match=f"too {'small' if scale < 1 else 'large'} to use"):
        read_record(tmp_path / "a.csv")


def test_a_force_of_zero_and_a_small_one_are_read(tmp_path):
    for scale in (0.0, 1e-12):
        write_record(tmp_path / "a.csv", scale)
        assert read_record(tmp_path / "a.csv").force.max() == pytest.approx(scale, rel=1e-3)


@pytest.mark.parametrize("text", ["1e-300 psi", "1e-320 Pa", "1e14 psi", "1e300 ksi"])
def test_an_actuation_that_no_run_may_hold_is_refused(text):
    with pytest.raises(UnitError, match="expected an actuation of 0, or of 1e-20 to 1e\\+10"):
        parse_actuation(text)


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


@pytest.mark.parametrize("level", [1.45e-7, 1e-9], ids=["1 Pa", "1 µpsi"])
@pytest.mark.usefixtures("no_figures_of_tests")
def test_an_odd_test_is_named_and_left_out_of_the_report_which_is_finished(odd, level):
    out = odd(level)
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


@pytest.mark.slow
def test_a_test_far_beyond_what_was_tested_is_reported_or_named(odd):
    out = odd(1e9)
    outcome = here("report", out, "--quiet")
    assert outcome.exit_code == ("Test c is left out" in outcome.stdout)
    assert outcome.stderr == ""
    assert (out / "report.html").is_file()
