"""What a command states of a test of a run: its conditions, its actuation, its record."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import ValidationError

from mfd_bayes.campaign.schema import ForceColumn, TestTable
from mfd_bayes.errors import CampaignError
from mfd_bayes.population.design import CONDITIONS
from mfd_bayes.records.readers import read_table
from mfd_bayes.records.record import NO_ACTUATION, Record, read_record
from mfd_bayes.runs.run import Run
from mfd_bayes.units import actuation_kind


def stated_conditions(command: Any) -> dict[str, float]:
    """Date, count of cycles and temperature of a command, as a campaign reads them."""
    conditions = {name: getattr(command, name) for name in CONDITIONS}
    conditions = {name: value for name, value in conditions.items() if value not in ("", None)}
    try:
        return TestTable.model_validate({"id": "x", "file": "x.csv", **conditions}).conditions
    except ValidationError as error:
        wrong = error.errors()[0]
        raise CampaignError(
            f"--{wrong['loc'][0]}: {wrong['msg'].removeprefix('Value error, ')}"
        ) from error


def stated_uncertainty(text: str) -> float:
    """Standard uncertainty of a load cell, a share, of `--uncertainty "0.5 %"`; 0 of ""."""
    if not text:
        return 0.0
    try:
        return ForceColumn.model_validate({"column": 1, "uncertainty": text}).uncertainty or 0.0
    except ValidationError as error:
        message = error.errors()[0]["msg"].removeprefix("Value error, ")
        raise CampaignError(f"--uncertainty: {message}, got {text!r:.60}") from error


def stated_actuation(run: Run, text: str) -> str:
    """The actuation of a command; that of a model without one is not to be given."""
    if not run.system.axes.actuated:
        if text:
            raise CampaignError("--actuation: the campaign's tests have none; leave it out")
        return NO_ACTUATION
    if not text:
        raise CampaignError(f"--actuation is missing: give {actuation_kind(run.actuation_unit)}")
    return text


def read_as_tests(run: Run, path: Path, actuation: str) -> Record:
    """A record by the campaign's columns where the file has them, else by its own headers."""
    stated = run.manifest.settings.columns.given
    names, axes = read_table(path).names, run.system.axes
    columns = {role: c.source for role, c in stated.items() if role != "actuation"}
    has_columns = all(c.key in names or c.name is None for r, c in stated.items() if r in columns)
    return read_record(
        path, columns if columns and has_columns else None, actuation=actuation, axes=axes
    )
