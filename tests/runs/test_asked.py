"""What a prediction asks of a run."""

import json
import shutil
from pathlib import Path

import pytest

from mfd_bayes.errors import FitError
from mfd_bayes.runs.asked import new_session
from mfd_bayes.runs.opening import open_run

DATA = Path(__file__).parents[1] / "data" / "run_format_0"


def with_session(folder, name):
    """The run with all tests in one session."""
    out = Path(shutil.copytree(DATA, folder / "out"))
    manifest = json.loads((out / "manifest.json").read_text())
    for test in manifest["settings"]["tests"].values():
        test["session"] = name
    (out / "manifest.json").write_text(json.dumps(manifest))
    return open_run(out)


def test_a_session_that_no_test_has_is_told(tmp_path):
    plain = open_run(DATA)
    assert new_session(plain.manifest, "") == ()
    (said,) = new_session(plain.manifest, "spring")
    assert said.startswith("session 'spring' is taken for a new one")
    assert said.endswith("the campaign declares no sessions")
    run = with_session(tmp_path, "spring")
    assert new_session(run.manifest, "spring") == ()
    assert new_session(run.manifest, "sping")[0].endswith("the run has 'spring'")


@pytest.mark.parametrize("actuation", [None, "1 ksi", -1.0, float("nan")])
def test_a_test_is_followed_at_an_actuation_that_is_a_number(actuation):
    with pytest.raises(FitError, match="the planned actuation must be a finite number"):
        open_run(DATA).follow(actuation)
