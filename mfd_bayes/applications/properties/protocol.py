"""The tests that a standard asks for and that were not made, in its order."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mfd_bayes.applications.properties.conformity import (
    Conformity,
    DeviceEvidence,
    conformity,
    missing_steps,
    rate_change,
)
from mfd_bayes.applications.properties.harmonic import Condition, condition_words
from mfd_bayes.applications.properties.page import to_compare
from mfd_bayes.campaign.standard import Standard, read_standard
from mfd_bayes.console import print_rows, say
from mfd_bayes.errors import CampaignError
from mfd_bayes.runs.run import Run


class PlannedTest(NamedTuple):
    """A test that a standard asks for; a frequency of NaN is any."""

    clause: str
    condition: Condition
    cycles: int


def standard_of(run: Run, name: str) -> Standard:
    """The run's own standard, or another by its name; its campaign must have a design."""
    if run.manifest.settings.design is None:
        raise CampaignError(
            f"--protocol: {run.folder} has no [design]: state its T1 and mce in the campaign file, "
            "and calibrate with --resume"
        )
    if run.manifest.standard is not None and name == run.manifest.settings.design.standard:
        return run.manifest.standard
    return read_standard(name, run.folder, "--protocol")


def missing_tests(run: Run, name: str) -> tuple[list[PlannedTest], list[str]]:
    """Tests that a standard asks for and the run lacks, in the order of the standard.

    The second list says what else it asks for and was not tested. Raises CampaignError where there
    is no such standard, or where the campaign does not state the period or the displacement.
    """
    standard, evidence = standard_of(run, name), to_compare(run, predicted=False)
    planned: list[PlannedTest] = []
    for requirement in standard.requirement:
        if requirement.statistic != "sequence":
            continue
        lacking = {"mce": evidence.largest is None, "T1": evidence.period is None}
        needed = {"mce", *({"T1"} if any(step.frequency for step in requirement.steps) else ())}
        if names := [key for key, lacks in lacking.items() if lacks and key in needed]:
            raise CampaignError(
                f"--protocol: [design] of the campaign states no {' and no '.join(names)}; add it "
                "and calibrate with --resume"
            )
        limit = requirement.rate_limit
        if limit is not None and rate_change(requirement, evidence) <= limit:
            continue
        for step, missing in missing_steps(requirement, evidence):
            planned += [PlannedTest(requirement.clause, c, step.cycles) for c in missing]
    return planned, _others(standard, evidence)


def _others(standard: Standard, evidence: DeviceEvidence) -> list[str]:
    """What else was not tested: a sentence each."""
    sentences = [
        f"{row.requirement} ({row.clause}): {row.note}"
        for row in conformity(standard, evidence)
        if row.verdict == Conformity.NOT_TESTED and not row.test
    ]
    steps = {row.requirement for row in standard.requirement if row.statistic == "sequence"}
    return [
        text
        for text in dict.fromkeys(sentences)
        if not any(text.startswith(requirement) for requirement in steps)
    ]


def print_protocol(run: Run, name: str) -> None:
    """Print the missing tests in the order of the standard."""
    planned, others = missing_tests(run, name)
    rows = [_cells(run, test, number) for number, test in enumerate(planned, start=1)]
    if rows:
        heads = ["", "clause", "test", "cycles"]
        print_rows(f"Tests that {name} asks for and that were not made", heads, rows)
    elif any(row.statistic == "sequence" for row in standard_of(run, name).requirement):
        say(f"all tests of the sequence of {name} were made")
    else:
        say(f"{name} asks for no sequence of tests")
    for sentence in others:
        say(f"not tested: {sentence}")


def _cells(run: Run, test: PlannedTest, number: int) -> Sequence[str]:
    words = condition_words(run, test.condition)
    any_rate = "" if np.isfinite(test.condition.frequency) else ", any frequency"
    return str(number), test.clause, f"{words}{any_rate}", str(test.cycles)
