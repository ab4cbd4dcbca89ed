"""Damaged files end in a result or in one sentence; MFD_BAYES_FUZZ says how many are tried."""

import io
import json
import os
import resource
import signal
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from nptdms import ChannelObject, TdmsWriter
from openpyxl import Workbook
from scipy.io import savemat
from typer.testing import CliRunner

from mfd_bayes.applications.buildings.ground import example_ground, read_ground
from mfd_bayes.cli.commands import app
from mfd_bayes.errors import MfdError
from tests.run_folders import FORCE, MOTION, PRIORS, RECORD, TIME

INPUTS = int(os.environ.get("MFD_BAYES_FUZZ", "200"))  # these are the same each time
EVERY = settings(deadline=None, database=None, suppress_health_check=list(HealthCheck))
SECONDS, MEMORY = 20, 2**30  # of processor time and bytes, that a file may take
COLUMNS = {"time_s": TIME, "displacement_in": MOTION, "force_kip": FORCE}
CAMPAIGN = b"""\
[campaign]
priors = "own.toml"
noise = "ou"
[columns]
time = { name = "time_s", unit = "s" }
displacement = { name = "displacement_in", unit = "in", tare = "0 s to 1 s" }
force = { name = "force_kip", unit = "kip", minus_mass = "3 kg" }
[laws]
Fc_fwd = "affine"
[[test]]
id = "a"
file = "a.csv"
actuation = "500 psi"
window = "0 s to 60 s"
"""
WORDS = (
    *("", "0", "-1", "nan", "inf", "1e999", "1e-400", "1_000", "0x10", "1,5", "9" * 5000, "null"),
    *("'", '"', '"""', "\x1b[31m", "\u202e", "\u2028", "../../x", "\x00", "\ufeff", "\\", "½"),
    *("{{7*7}}", "kN", "[psi]", "degC", "1/0", "a" * 3000, "\r", "\t", ";", ",", "#", "[[test]]"),
    *("500 psi/0", "0 s to 1e999 s", "1979-05-27T07:32:00", "true", "=", "[" * 3000, "{" * 3000),
)


def workbook(file):
    book = Workbook()
    for row in ([*COLUMNS], *zip(*COLUMNS.values(), strict=True)):
        book.active.append(row)
    book.save(file)


def tdms(file):
    with TdmsWriter(file) as writer:
        writer.write_segment([ChannelObject("t", *column) for column in COLUMNS.items()])


def written(write):
    write(file := io.BytesIO())
    return file.getvalue()


SEEDS = {
    "a.csv": RECORD.encode(),
    "a.txt": b"Logger 4\n\n" + RECORD.replace(",", "\t").encode(),
    "a.json": json.dumps({name: data.tolist() for name, data in COLUMNS.items()}).encode(),
    "a.xlsx": written(workbook),
    "a.tdms": written(tdms),
    "a.mat": written(lambda file: savemat(file, COLUMNS | {"test": {"name": "p500"}})),
    "campaign.toml": CAMPAIGN,
    "own.toml": PRIORS.encode(),
    "g.AT2": example_ground().encode(),
}


@st.composite
def damaged_files(draw):
    """A file with one to four places changed."""
    name = draw(st.sampled_from(sorted(SEEDS)))
    content = SEEDS[name]
    for _ in range(draw(st.integers(1, 4))):
        position, length = draw(st.integers(0, len(content))), len(content)
        size = draw(st.sampled_from((0, 1, 1, 4, 8, 40, length)))
        excerpt = content[(start := draw(st.integers(0, length))) : start + 40]
        repeated = content[position : position + size] * draw(st.integers(0, 30))
        edit = st.sampled_from(WORDS).map(str.encode) | st.binary(min_size=min(size, 8), max_size=8)
        edit = draw(edit | st.sampled_from((excerpt, repeated)))
        content = content[:position] + edit + content[position + size :]
    return name, content


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder for the files, whose readers may take so much memory and time."""

    def stop(*_):
        raise RuntimeError(f"more than {SECONDS} s")

    signal.signal(signal.SIGPROF, stop)
    limits = resource.getrlimit(resource.RLIMIT_AS)
    if Path("/proc/self/statm").is_file():
        usage = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (usage + MEMORY, limits[1]))
    yield tmp_path_factory.mktemp("fuzz")
    resource.setrlimit(resource.RLIMIT_AS, limits)
    signal.setitimer(signal.ITIMER_PROF, 0)


@pytest.mark.slow
@settings(EVERY, max_examples=INPUTS, derandomize=INPUTS < 1000)
@given(damaged_files())
@example(("a.csv", SEEDS["a.csv"]))
def test_a_damaged_file_ends_in_a_result_or_one_sentence(folder, damaged):
    name, content = damaged
    table = name if name.startswith("a.") else "a.csv"
    files = {path: SEEDS[path] for path in (table, "campaign.toml", "own.toml")}
    files["campaign.toml"] = CAMPAIGN.replace(b"a.csv", table.encode())
    for path, data in (files | {name: content}).items():
        (folder / path).write_bytes(data)
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    if name == "g.AT2":
        try:
            read_ground(folder / name)
        except MfdError as error:
            assert 0 < len(str(error)) < 6000  # noqa: PT017
        return
    words = ["calibrate", str(folder / "campaign.toml"), "-o", str(folder / "out"), "--dry-run"]
    outcome = CliRunner().invoke(app, words)
    assert outcome.exit_code in ((0,) if content == SEEDS[name] else (0, 2)), outcome.exception
    assert outcome.exception is None or isinstance(outcome.exception, SystemExit)
    complaints = [s for s in outcome.stderr.splitlines() if not s.startswith("warning: ")]
    assert len(complaints) == (outcome.exit_code == 2), outcome.stderr
    assert all(s.startswith("mfd-bayes: ") and len(s) < 6000 for s in complaints)
