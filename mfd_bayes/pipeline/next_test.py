"""Which test to make next, from a finished run, written as files."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

from mfd_bayes.campaign.draft.toml import commented, quoted
from mfd_bayes.errors import CampaignError, StoreError
from mfd_bayes.evaluation.next_test import (
    advice_content,
    advice_sentence,
    candidate_words,
    shown_rows,
    together_words,
)
from mfd_bayes.pipeline.outputs import check_outputs
from mfd_bayes.planning.candidate import Candidate
from mfd_bayes.planning.study import Advice
from mfd_bayes.records.regular import why_no_file
from mfd_bayes.reporting.tables import next_csv
from mfd_bayes.runs.lock import alone_in
from mfd_bayes.runs.manifest import unchanged
from mfd_bayes.runs.paths import ADVICE
from mfd_bayes.runs.run import Run, open_run
from mfd_bayes.runs.unit_system import System
from mfd_bayes.store.files import json_text, write_bytes, write_text

SHOWN = 10
"""Candidates that are shown on a terminal."""

_DRAFT = "# Drafted by mfd-bayes next"
_OF_FILES = (".txt", ".csv", ".toml", ".lst")
_LARGEST = 2**20  # bytes of a file of candidates


@dataclass(frozen=True)
class Wish:
    """What is asked about the next test.

    Attributes
    ----------
    goal, candidates, limits : str
        In words; empty for those of the campaign file. Candidates may be a file with a test in
        each line.
    table : Path or None
        CSV to write, with JSON and PNG beside it; None for next.csv in the run folder.
    draft : Path or None
        TOML to write, with the campaign's next tests.
    tests : int
        How many tests are drafted: the best one, or the best two or three together.
    draws, seed : int
    units : {"", "us", "si"}
    force : bool
        Whether files of other programs are replaced.
    """

    goal: str = ""
    candidates: str = ""
    limits: str = ""
    table: Path | None = None
    draft: Path | None = None
    tests: int = 1
    draws: int = 2000
    seed: int = 0
    units: str = ""
    force: bool = False


@dataclass(frozen=True, eq=False)
class Told:
    """Advice on the next test, in words.

    Attributes
    ----------
    advice : Advice
    sentence : str
    together : list of str
        The best two and three tests together.
    rows : sequence of tuple of str
        Cells of the first candidates.
    files : list of Path
        That were written.
    """

    advice: Advice
    sentence: str
    together: list[str]
    rows: list[tuple[str, ...]]
    files: list[Path]


def next_test(out: Path, wish: Wish) -> Told:
    """Which test to make next; the table, its JSON and a picture are written.

    Raises
    ------
    MfdError
        When the run, the goal, the candidates or the limits cannot be used, or a file may not be
        written.
    """
    if wish.tests > 1 and wish.draft is None:
        raise CampaignError("--tests says how many tests --write drafts: give --write too")
    table = out / ADVICE[0] if wish.table is None else wish.table
    files = _files(table, wish)
    candidates = _candidates(wish.candidates)
    run = replace(open_run(out), units=wish.units)
    with unchanged(run.folder, run.manifest):
        advice = run.next_test(
            wish.goal or None,
            candidates,
            limits=wish.limits or None,
            draws=wish.draws,
            seed=wish.seed,
        )
    system = run.system
    if wish.table is None:
        with alone_in(out):
            _write(run, advice, files, system)
    else:
        _write(run, advice, files, system)
    if wish.draft is not None:
        write_text(wish.draft, _drafted(advice, wish, system, run.actuation_unit))
    units = system, run.actuation_unit
    return Told(
        advice,
        advice_sentence(advice, *units),
        together_words(advice, *units),
        list(shown_rows(advice, *units, SHOWN)),
        [*files, *([wish.draft] if wish.draft else [])],
    )


def _files(table: Path, wish: Wish) -> list[Path]:
    """CSV, JSON and PNG, which must be free to be written."""
    if table.suffix.lower() in (".json", ".png"):
        raise StoreError(f"{table} must not end in {table.suffix}: JSON and PNG go beside it")
    files = [table, table.with_suffix(".json"), table.with_suffix(".png")]
    inputs = [Path(wish.candidates)] if _is_path(wish.candidates) else []
    if wish.table is not None:  # else they are the run's own
        check_outputs(files, inputs, force=wish.force)
    if wish.draft is not None:
        check_outputs([wish.draft], inputs, force=wish.force)
    return files


def _candidates(text: str) -> str | list[str] | None:
    """Candidates of a text, or of the lines of a file."""
    if not _is_path(text):
        if Path(text).suffix in _OF_FILES:
            raise CampaignError(f"--candidates: there is no file {text}")
        return text or None
    path = Path(text)
    if reason := why_no_file(path):
        raise CampaignError(f"--candidates: {path} {reason}")
    try:
        if path.stat().st_size > _LARGEST:
            raise CampaignError(f"--candidates: {path} is larger than 1 MB")
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, ValueError) as error:
        raise CampaignError(f"--candidates: cannot read {path}: {error}") from error
    found = [line for line in (line.partition("#")[0].strip() for line in lines) if line]
    if not found:
        raise CampaignError(f"--candidates: {path} has no test; one a line is expected")
    return found


def _is_path(text: str) -> bool:
    """Whether candidates are the name of a file: one that exists, or a text without any comma."""
    if not text.strip() or len(text) > 1000 or "|" in text or "\0" in text:
        return False
    try:
        return Path(text).exists()
    except OSError:
        return False


def _write(run: Run, advice: Advice, files: list[Path], system: System) -> None:
    """Write table, JSON and picture."""
    from mfd_bayes.reporting.figures import draw_next, to_png

    units = system, run.actuation_unit
    write_text(files[0], next_csv(advice, *units))
    write_text(files[1], json_text(advice_content(advice, *units), indent=2) + "\n")
    title = f"Next test: {candidate_words(advice[0].candidate, *units)}"
    write_bytes(files[2], to_png(draw_next(advice, system, run.actuation_unit, title)))


def _drafted(advice: Advice, wish: Wish, system: System, unit: str) -> str:
    """Entries of a campaign file for the best tests."""
    chosen = advice.together[min(wish.tests, len(advice.together)) - 1]
    if wish.tests == 1:
        tests: tuple[Candidate, ...] = (advice[0].candidate,)
    else:
        tests = chosen.candidates
    lines = [f"{_DRAFT}: add these to campaign.toml once the tests are made."]
    for number, test in enumerate(tests, 1):
        words = candidate_words(test, system, unit)
        name = f"next{number}_" + re.sub(r"[^A-Za-z0-9.]+", "_", words)
        level = words.split(",", maxsplit=1)[0]
        lines += [
            "",
            commented(f"motion: {words}, {test.cycles:g} cycles ({test.waveform})"),
            "[[test]]",
            f"id = {quoted(name)}",
            f"file = {quoted(f'{name}.csv')}  # the record, once it is there",
            f"actuation = {quoted(level)}",
            'role = "calibrate"',
        ]
    return "\n".join(lines) + "\n"
