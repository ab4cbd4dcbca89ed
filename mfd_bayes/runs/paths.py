"""The names of the files in a run folder."""

from __future__ import annotations

from pathlib import Path

MANIFEST = "manifest.json"
CAMPAIGN = "campaign.toml"
PRIORS = "priors.toml"
MODEL = "model.py"
"""A copy of the file of a model of the user's own."""

POPULATION = "population.nc"
CROSSVALIDATION = "crossvalidation"
DISCARDED = f".{MANIFEST}.discarded"
"""The manifest of a run while it is removed: if that is interrupted, it can be repeated."""

FOLDERS = ("tests", "figures", CROSSVALIDATION)
"""Folders in a run folder."""

DRAWS = ("draws.csv", "draws.parquet")
ADVICE = ("next.csv", "next.json", "next.png")
"""What `mfd-bayes next` writes into a run folder where it is told no other place."""

_ON_REQUEST = ("tables.docx", "tables.xlsx", "report.pdf", "datasheet.pdf")
ON_REQUEST = (*_ON_REQUEST, *ADVICE, "figures/next.png", "figures/next.csv")
"""What is written only where it is asked for; all of it rests on the population."""

_TABLES = "parameters derived loop_estimates noises laws law_scores checks scores crossvalidation"
OUTPUTS = (
    *(f"{name}.csv" for name in (*_TABLES.split(), "tested_range")),
    *(f"{name}.{form}" for name in ("parameters", "laws") for form in ("json", "tex")),
    *("datasheet.csv", "datasheet.tex"),
    *(*_ON_REQUEST, *DRAWS, "report.html", "datasheet.html", POPULATION, CAMPAIGN, PRIORS, MODEL),
)
"""Files that a run and its report write, but for the manifest and what lies in folders."""


def folder_of(test_id: str) -> str:
    """Folder of all that is stored of a test."""
    return f"tests/{test_id}"


def posterior_of(test_id: str) -> str:
    """File of a test's posterior."""
    return f"{folder_of(test_id)}/posterior.nc"


def pooled_of(test_id: str) -> str:
    """File of a test's posterior after pooling."""
    return f"{folder_of(test_id)}/pooled.nc"


def record_of(test_id: str) -> str:
    """File of the record of a held-out test (predicted, never fitted)."""
    return f"{folder_of(test_id)}/record.nc"


def draws_as(form: str) -> str:
    """File of the table of all draws, as "csv" or "parquet"."""
    return f"draws.{form}"


def is_written_by_run(name: Path) -> bool:
    """Whether a run writes a file of this name in its folder."""
    first = name.parts[0] if name.parts else ""
    return first in FOLDERS or name.as_posix() in (*OUTPUTS, MANIFEST, DISCARDED)


def is_file_of_a_run(path: Path) -> bool:
    """Whether a path, links followed, lies in a run folder and is one that the run writes."""
    place = path.resolve()
    for folder in place.parents:
        if (folder / MANIFEST).is_file() or (folder / DISCARDED).is_file():
            return is_written_by_run(place.relative_to(folder))
    return False
