"""The command predict with --given, on the small synthetic campaign."""

import re
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from typer.testing import CliRunner

import mfd_bayes as mb
from mfd_bayes.cli.commands import app


@pytest.fixture(scope="module")
def out(finished_run) -> Path:
    assert finished_run.code == 0, finished_run.stderr
    return finished_run.out


@pytest.fixture(scope="module")
def record(finished_run) -> Path:
    """The record that was held out."""
    return finished_run.campaign.parent / "p1200_f0.5.csv"


@pytest.fixture
def ask(out, tmp_path):
    def predict(*options, actuation="1200 psi"):
        arguments = ("predict", out, "--actuation", actuation, "-o", tmp_path / "bands.csv")
        return CliRunner().invoke(app, [str(a) for a in (*arguments, "--force", *options)])

    return predict


def table(path):
    text = path.read_text()
    return text, pd.read_csv(StringIO(text), comment="#")


def test_the_part_is_marked_and_the_rest_narrower(ask, out, record, tmp_path):
    options = "--given", "0 s to 1 s", "--kind", "observation", "--compare", "--whole"
    found = ask("--motion", record, *options)
    assert found.exit_code == 0, found.output
    assert "the force given from 0 s to 1 s" in " ".join(found.stdout.split())
    text, narrow = table(tmp_path / "bands.csv")
    assert "# given: 1 where the force was given, 0 elsewhere" in text
    np.testing.assert_array_equal(narrow.given == 1, narrow.time_s <= 1.0)
    assert np.all(narrow.whole_upper_kip >= narrow.upper_kip)
    rest = narrow.time_s > 1.0
    words = " ".join(found.stdout.split())
    counted = re.search(r"of the (\d+) measured samples in motion that were not given", words)
    assert counted is not None
    assert 0.9 * rest.sum() <= int(counted[1]) <= rest.sum()
    trace = mb.read_record(record).trace()
    motion = mb.Trace.from_arrays(trace.time, trace.displacement, 1.2)
    before = mb.open_run(out).predict(motion, "observation")
    width = np.mean((narrow.upper_kip - narrow.lower_kip)[rest])
    assert width < 0.9 * np.mean((before.upper - before.lower)[rest])
    picture = np.asarray(Image.open(tmp_path / "bands_history.png").convert("RGB"))
    assert np.count_nonzero((picture == [0xFF, 0xF3, 0xD6]).all(axis=2)) > 1000


def test_the_force_outside_the_window_does_not_matter(ask, record, tmp_path):
    """Also where the motion is thinned behind a low-pass filter."""
    whole, bands = pd.read_csv(record, comment="#"), []
    late = whole.time_s > 1.0
    for factor in (1.0, -3.0):
        whole.assign(force_kip=whole.force_kip.where(~late, factor * whole.force_kip)).to_csv(
            tmp_path / "m.csv", index=False
        )
        options = "--given", "0 s to 1 s", "--rate", "12 Hz", "--no-figures"
        found = ask("--motion", tmp_path / "m.csv", *options)
        assert found.exit_code == 0, found.output
        bands.append(table(tmp_path / "bands.csv")[1])
    assert len(bands[0]) < len(whole)
    np.testing.assert_array_equal(bands[0].upper_kip, bands[1].upper_kip)


def test_what_cannot_be_is_one_sentence(ask, record, tmp_path):
    for options, said in [
        (("--given", "soon"), "--given must be two times such as '0 s to 60 s', got 'soon'"),
        (("--given", "0 s to 60 s"), "must lie within the record, which goes from 0 s to"),
        (("--given", "0 s to 1 s", "--kind", "device"), "for the kinds new_test and observation"),
        (("--given", "1 ms to 2 ms"), "holds 0 samples, too few"),
        (("--given", "0 s to 1 s", "--design"), "--design cannot be combined with --given"),
        (
            ("--given", "0 s to 1 s", "--test", "p500_f0.5", "--extrapolate"),
            "given cannot be combined with a calibrated test ('p500_f0.5')",
        ),
    ]:
        found = ask("--motion", record, *options)
        assert found.exit_code == 2, found.output
        (sentence,) = found.stderr.splitlines()
        assert said in sentence
        assert not (tmp_path / "bands.csv").exists()


def test_a_motion_without_a_force_is_refused(ask, tmp_path):
    time = np.arange(300) / 100.0
    columns = np.column_stack([time, np.sin(np.pi * time)])
    np.savetxt(
        tmp_path / "m.csv", columns, "%.6f", ",", header="time_s,displacement_in", comments=""
    )
    found = ask("--motion", tmp_path / "m.csv", "--given", "0 s to 1 s")
    assert found.exit_code == 2
    assert "--given '0 s to 1 s' needs a column of the force in" in found.stderr
    sine = ask("--sine", "1 in, 0.5 Hz, 3 cycles", "--given", "0 s to 1 s")
    assert "--compare, --given and --rate need a --motion file" in sine.stderr
