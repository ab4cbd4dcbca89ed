"""Which command names a mistake that was planted into a real session, and its right cause.

    python -m benchmarks.mistakes.run > benchmarks/mistakes/mistakes.txt

plants each of 31 mistakes into three tests of real sessions of the band brake, one at a time, and
reads what `init`, `inspect`, `calibrate --dry-run`, `calibrate` and `check` say. Nothing is
sampled: `calibrate` prints the warnings of its plan before it samples and keeps them in the run,
where `check` finds them (tests/pipeline/test_warnings.py shows it on a run). Then the real records
as they are, in their sessions: every warning about a record is a false alarm; those about the laws,
such as of tests without tension, are not counted. Exit status 1: a limit was missed.
The records come from --data (MFD_BAYES_DATA, ../shared/data); --say prints every warning.
"""

from __future__ import annotations

import os

# Read when numpy is imported.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import argparse
import csv
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from benchmarks.common.data import add_data_option
from benchmarks.common.machine import platform_line
from benchmarks.mistakes.plants import MISTAKES, Mistake
from benchmarks.mistakes.sessions import HEADER, TEST, Planned, load_session, write_session
from mfd_bayes.campaign.draft import draft_campaign
from mfd_bayes.errors import MfdError
from mfd_bayes.pipeline.inspect import inspect_campaign
from mfd_bayes.pipeline.plan import Options, plan_campaign

COMMANDS = ("init", "inspect", "--dry-run", "calibrate", "check")
NAMED, ALARMS = 27, 0
"""Fewest mistakes that calibrate must name in all three places, and most false alarms."""

Said = list[tuple[str, str]]


def say_init(campaign: Path) -> Said:
    """Doubts of `init` about a folder, by test."""
    try:
        draft = draft_campaign(campaign.parent)
    except MfdError as error:
        return [("", str(error))]
    doubts = [(test.id, doubt) for test in draft.tests for doubt in test.doubts]
    return doubts + [(Path(name).stem, reason) for name, reason in draft.left_out]


def say_inspect(campaign: Path) -> Said:
    """Warnings of `inspect campaign.toml`, by test."""
    try:
        found, _ = inspect_campaign(campaign)
    except MfdError as error:
        return [("", str(error))]
    return [(one.name, str(fault.message)) for one in found for fault in one.faults]


def say_plan(campaign: Path) -> Said:
    """Warnings of the dry run, which are those of calibrate and check, by test."""
    try:
        plan = plan_campaign(campaign, Options(effort="quick"))
    except MfdError as error:
        return [("", str(error))]
    return [(found.subject, str(found.message)) for found in plan.manifest.warnings]


def named(said: Said, test: str, cause: str) -> bool:
    """Whether a sentence about the test, or that has its id, tells the cause."""
    return any(
        (subject == test or test in sentence) and re.search(cause, sentence)
        for subject, sentence in said
    )


def plant(mistake: Mistake, session: list[Planned], k: int, home: Path) -> tuple[dict, Said]:
    """Which commands name a mistake in test k, and all that the dry run says."""
    tests, test = mistake.plant(session, k)
    campaign = write_session(tests, home, mistake.name)
    planned = say_plan(campaign)
    said = {"init": say_init(campaign), "inspect": say_inspect(campaign)}
    said |= dict.fromkeys(COMMANDS[2:], planned)
    return {c: named(s, test, mistake.cause) for c, s in said.items()}, planned


def false_alarms(source: Path, home: Path) -> list[str]:
    """Every warning about the real records as they are, each by itself and in its session."""
    with (source / "manifest.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    sessions: dict[str, list[dict[str, str]]] = {}
    for row in rows:
        sessions.setdefault(row["session"], []).append(row)
    found: list[str] = []
    for name, members in sessions.items():
        folder = home / name
        folder.mkdir()
        text = HEADER.format(title=name)
        for row in members:
            (folder / row["file"]).write_bytes((source / row["file"]).read_bytes())
            metric = row["file"].endswith("_SI.csv")
            units = ("displacement_m", "force_N") if metric else ("displacement_in", "force_kip")
            text += TEST.format(
                id=row["file"].removesuffix(".csv"),
                actuation=f"{row['tension_lbf'] or 30} lbf",
                displacement=units[0],
                force=units[1],
            )
        campaign = folder / "campaign.toml"
        campaign.write_text(text, encoding="utf-8")
        found += [f"{subject}: {s}" for subject, s in say_plan(campaign) if subject != "laws"]
    return found


def report(results: dict[str, Counter], places: int, alarms: Iterable[str], records: int) -> bool:
    """Print the table; whether the limits hold."""
    print(f"{'mistake':28s}" + "".join(f"{command:>11s}" for command in COMMANDS))
    for name, counts in results.items():
        print(f"{name:28s}" + "".join(f"{counts[c]:>9d}/{places}" for c in COMMANDS))
    whole = {c: sum(counts[c] == places for counts in results.values()) for c in COMMANDS}
    print(f"{'named in every place':28s}" + "".join(f"{whole[c]:>11d}" for c in COMMANDS))
    told = list(alarms)
    for sentence in told:
        print(f"false alarm: {sentence}")
    good = whole["calibrate"] >= NAMED and len(told) <= ALARMS
    print(
        f"calibrate names {whole['calibrate']} of {len(results)} (at least {NAMED}), with "
        f"{len(told)} false alarms on {records} real records (at most {ALARMS}): "
        f"{'holds' if good else 'MISSED'}"
    )
    return good


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    add_data_option(parser)
    parser.add_argument("--say", action="store_true", help="print what the dry run says, too")
    given = parser.parse_args()
    source = given.data / "brfd"
    sessions = {name: load_session(source, name) for name in ("2022-07", "2023-04")}
    places = [("2022-07", 3), ("2022-07", 7), ("2023-04", 4)]
    print(f"mistakes planted into three tests of real sessions, {platform_line()}")
    results: dict[str, Counter] = {}
    with tempfile.TemporaryDirectory() as temporary:
        for number, mistake in enumerate(MISTAKES):
            counts: Counter = Counter()
            for at, (name, k) in enumerate(places):
                home = Path(temporary) / f"{number}_{at}"
                hits, said = plant(mistake, sessions[name], k, home)
                counts.update(command for command in COMMANDS if hits[command])
                for subject, sentence in said if given.say else ():
                    print(f"    {mistake.name}, {name} {k}: {subject}: {sentence}")
            results[mistake.name] = counts
        alarms = false_alarms(source, Path(temporary))
    records = sum(1 for _ in source.glob("*.csv")) - 1
    sys.exit(0 if report(results, len(places), alarms, records) else 1)


if __name__ == "__main__":
    main()
