"""Run folders written by earlier versions of this program.

`run_format_0` is of commit 4b0c3bd, before the manifest had hashes and the number of a format:
two synthetic tests at 500 and 1000 psi with few draws, and one at 800 psi held out. Its population
was inferred again since.
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from mfd_bayes.errors import StoreError
from mfd_bayes.pipeline.plan import effort_of
from mfd_bayes.pipeline.report import check, report
from mfd_bayes.runs.manifest import FORMAT
from mfd_bayes.runs.opening import open_run

DATA = Path(__file__).parents[1] / "data"


@pytest.fixture
def older(tmp_path):
    return Path(shutil.copytree(DATA / "run_format_0", tmp_path / "out"))


def rewrite(folder, **entries):
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps(manifest | entries))


def test_an_older_run_opens_and_predicts(older):
    run = open_run(older)
    assert sorted(run.tests) == ["p1000_f0.5", "p500_f0.5"]
    assert not run.hashed
    slip = [np.median(test.stored.values()["Fc_fwd"]) for _, test in sorted(run.tests.items())]
    assert slip == pytest.approx([1.3, 0.65], rel=0.3)  # in proportion, as it was made
    held_out = run.held_out["p800_f0.5"]
    band = run.predict(held_out, "observation", draws=200)
    inside = (band.lower <= held_out.force) & (held_out.force <= band.upper)
    assert np.mean(inside) > 0.8


@pytest.mark.slow
def test_an_older_run_is_reported_and_checked(older):
    view = report(older)
    assert any("older version" in remark for remark in view.remarks)
    assert (older / "report.html").is_file()
    assert check(older).verdict == view.verdict == "not usable"  # the run has very few draws
    assert effort_of(older, None, resume=True) == "quick"


def test_a_run_of_a_later_version_says_which_version_it_needs(older):
    open_run(older)
    rewrite(older, format=FORMAT + 1, versions={"mfd_bayes": "7.3"})
    with pytest.raises(StoreError, match=rf"of format {FORMAT + 1}.*open it with mfd_bayes 7\.3"):
        open_run(older)
    rewrite(older, format=10**30, versions=7)
    with pytest.raises(StoreError, match="open it with a later mfd_bayes"):
        open_run(older)
    rewrite(older, format="one")
    with pytest.raises(StoreError, match="format"):
        open_run(older)
