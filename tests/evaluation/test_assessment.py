"""The stored assessment of a run."""

import math
from pathlib import Path

import pytest

from mfd_bayes.errors import StoreError, hash_file
from mfd_bayes.evaluation.assessment import (
    Assessment,
    Check,
    Judgement,
    stored_assessment,
    write_assessment,
)
from mfd_bayes.messages import Measure, Message
from mfd_bayes.runs.findings import CheckStatus, Finding, Fitness
from mfd_bayes.runs.unit_system import US

STUCK = Check("p500", "R-hat", "k3", math.inf, 1.01, CheckStatus.FAIL)
JUMP = Message(
    "the force jumps by {jump} in {part}", {"jump": Measure((0.2,), "kip"), "part": "it"}
)
ASSESSMENT = Assessment(
    verdict=Fitness.NOT_USABLE,
    sentences=(JUMP,),
    checks=(STUCK,),
    judgements=(Judgement("p500", Fitness.NOT_USABLE, (JUMP,), math.inf, wrong=True),),
    warnings=(Finding("p500", "force", JUMP),),
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A run folder with an assessment of its manifest and of one stored file."""
    for name in ("manifest.json", "population.nc"):
        (tmp_path / name).write_text("{}")
    files = {"population.nc": hash_file(tmp_path / "population.nc")}
    write_assessment(tmp_path, ASSESSMENT, files, US)
    return tmp_path


def test_what_is_stored_is_read_again(folder):
    assessment, system = stored_assessment(folder)
    assert repr(vars(assessment)) == repr(vars(ASSESSMENT))  # NaN is not equal to itself
    assert system == US


@pytest.mark.parametrize("name", ["manifest.json", "assessment.json"])
def test_what_is_of_another_run_is_not_taken(folder, name):
    (folder / name).write_text('{"manifest": "of another"}')
    assert stored_assessment(folder) is None


def test_a_stored_file_that_was_changed_is_refused(folder):
    (folder / "population.nc").write_text("other draws")
    with pytest.raises(StoreError, match=r"population\.nc is not what this run wrote"):
        stored_assessment(folder)
