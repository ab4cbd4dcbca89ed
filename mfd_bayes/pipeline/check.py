"""The checks and the verdict of a finished run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from mfd_bayes.evaluation.assessment import IDENTIFIABILITY, Assessment, stored_assessment
from mfd_bayes.runs.findings import CheckStatus
from mfd_bayes.runs.unit_system import UnitSystem, named_system


def check(
    folder: Path, units: str = "", *, trust_model: bool = False
) -> tuple[Assessment, UnitSystem]:
    """Assessment of a finished run, and the units to write it in; nothing is written.

    It is what the last report stored, and computed where there is none of this run as it is. The
    units are of a system, "us" or "si"; by default the campaign's.
    """
    if (stored := stored_assessment(folder)) is not None:
        assessment, system = stored
    else:
        from mfd_bayes.evaluation.summary import assess
        from mfd_bayes.runs.run import open_run

        run = open_run(folder, trust=trust_model)
        assessment, system = assess(run), run.system
    checks = [
        c
        for c in assessment.checks
        if c.check not in IDENTIFIABILITY or c.status != CheckStatus.PASS
    ]
    return replace(assessment, checks=tuple(checks)), named_system(units, system)
