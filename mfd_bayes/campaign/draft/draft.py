"""A first campaign for a folder of test files: what each file seems to be."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mfd_bayes.campaign.draft.actuation import (
    Candidate,
    actuation_of,
    prevailing_unit,
    without_shared_levels,
)
from mfd_bayes.campaign.draft.columns import Guess, guess_columns, timed_by_rate
from mfd_bayes.campaign.draft.levels import level_in_header, levels_in, rate_in_header
from mfd_bayes.campaign.schema import RESERVED
from mfd_bayes.errors import CampaignError, MfdError, RecordError
from mfd_bayes.records.data_quality import force_sign
from mfd_bayes.records.file_name_check import contradictions, length_in_name
from mfd_bayes.records.loop_features import Scales, scales_of
from mfd_bayes.records.loops import channels_swapped
from mfd_bayes.records.readers import SUFFIXES, Table, read_table
from mfd_bayes.records.record import Record, read_record
from mfd_bayes.records.spikes import without_spikes
from mfd_bayes.units import ActuationUnit, actuation_factor

_ESSENTIAL = ("time", "displacement", "force")
_INTERNAL = {"time": "s", "displacement": "in", "force": "kip", "velocity": "in/s"}
_TABLES = ("parameters", "derived", "laws", "law_scores", "checks", "scores", "crossvalidation")
_OWN = frozenset(f"{name}{suffix}" for name in _TABLES for suffix in (".csv", ".json"))
_OWN |= {"comparison.csv", "manifest.json"}
_EARTHQUAKE = re.compile(
    r"quake|seism|(?<![a-z])(?:eq|gm|dbe|mce|sle)(?![a-z])|dbe|mce|kobe|centro|northridge"
    r"|imperial|kocaeli|chi-?chi|prieta|tabas|landers|duzce|ground.?motion|random|white.?noise",
    re.IGNORECASE,
)


@dataclass(frozen=True, eq=False)
class TestDraft:
    """A test, as guessed from its file."""

    id: str
    file: str
    columns: dict[str, Guess]
    """Role to column, without the actuation."""
    actuation: str | Guess | None
    """A level, a column with a history, or None where it is unknown."""
    source: str
    """Where the actuation was found, or which columns might hold it."""
    doubts: tuple[str, ...]
    """What is not certain about the actuation, and what contradicts the file's name."""
    earthquake: bool
    """Whether the file's name is that of an earthquake."""
    scales: Scales | None = None
    """What its loops show; None where a unit is unknown."""


@dataclass(frozen=True, eq=False)
class Draft:
    """A campaign, as guessed from the files of a folder."""

    folder: Path
    tests: tuple[TestDraft, ...]
    left_out: tuple[tuple[str, str], ...]
    """Files that are not tests of the campaign, and why."""
    unit: ActuationUnit | None
    """"ksi" where actuations are pressures, "kip" of tensions, …; None if unknown."""

    @property
    def scales(self) -> dict[str, Scales]:
        """What the loops show, by file; empty where a unit of a test is unknown."""
        found = {test.file: test.scales for test in self.tests if test.scales is not None}
        return found if len(found) == len(self.tests) else {}


def draft_campaign(folder: Path) -> Draft:
    """Campaign of the test files in a folder, guessed from names, units and numbers.

    Raises
    ------
    CampaignError
        When the folder cannot be read or holds no test.
    """
    files: list[Candidate] = []
    left_out: list[tuple[str, str]] = []
    for path in _files(folder):
        try:
            files.append(_look_at(path, folder))
        except MfdError as error:
            left_out.append(_reason(path, error))
    files = without_shared_levels(files)
    unit = prevailing_unit(files)
    tests: list[TestDraft] = []
    for one in files:
        try:
            tests.append(_test(one, unit, [test.id for test in tests]))
        except MfdError as error:
            left_out.append(_reason(one.path, error))
    if not tests:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in left_out[:5])
        raise CampaignError(
            f"{folder} holds no test, a file with time, displacement and force"
            + (f": {reasons}" if reasons else f" and one of the suffixes {', '.join(SUFFIXES)}")
        )
    return Draft(folder, tuple(tests), tuple(left_out), unit)


def _reason(path: Path, error: MfdError) -> tuple[str, str]:
    """Name of a file and why it is left out, with escapes for what UTF-8 cannot encode."""
    texts = path.name, str(error).replace(str(path), path.name)
    name, reason = (text.encode("utf-8", "backslashreplace").decode() for text in texts)
    return name, reason


def _is_utf8(name: str) -> bool:
    """Whether UTF-8 can encode a name."""
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return True


def _files(folder: Path) -> list[Path]:
    """Files of a folder that may be tests, sorted with p500 before p1000."""
    try:
        found = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES]
    except OSError as error:
        raise CampaignError(f"cannot read the folder {folder}: {error.strerror}") from error
    return sorted((path for path in found if path.is_file()), key=lambda path: _natural(path.name))


def _natural(name: str) -> tuple[list[tuple[int, str]], str]:
    parts = re.split(r"([0-9]+)", name.lower())
    return [(int(p), "") if p.isdecimal() else (0, p) for p in parts], name


def _look_at(path: Path, folder: Path) -> Candidate:
    """Guessed columns and actuations of a file; raises where it cannot be a test."""
    if not _is_utf8(path.name):
        raise RecordError("its name is not UTF-8, as a campaign file must be: rename it")
    if not path.resolve().is_relative_to(folder.resolve()):
        raise RecordError("it is a link to a file outside this folder")
    table = read_table(path)
    if _is_own(path, table):
        raise RecordError("written by mfd-bayes")
    columns = guess_columns(table)
    column = columns.pop("actuation", None)
    rate, doubt = rate_in_header(table.head)
    if rate or not (table.notes or table.blocks):
        columns = timed_by_rate(columns, rate, doubt)
    missing = [role for role in _ESSENTIAL if role not in columns]
    if missing:
        again = next(iter(table.blocks.values()), "")
        blocks = (
            f"; the heading is repeated from {again}: keep one block in a file" if again else ""
        )
        blocks += "".join(f"; {note}" for note in table.notes)
        raise RecordError(
            f"no column for {' and '.join(missing)} among {', '.join(table.names[:12])}{blocks}"
        )
    odd = [
        guess.name for guess in (*columns.values(), column) if guess and not _is_utf8(guess.name)
    ]
    if odd:
        raise RecordError(f"the name of its column {odd[0]!a} is not UTF-8: rename it")
    header, named = level_in_header(table.head, table.names), levels_in(path.stem)
    other = column is not None and column.unit and actuation_factor(column.unit)[1]
    if (header or named) and other not in (None, False, "ksi", "kip"):
        column = None  # a current or a voltage, of a sensor perhaps, where the level is stated
    return Candidate(path, table, columns, column, header, named)


def _is_own(path: Path, table: Table) -> bool:
    """Whether this package wrote a file: a table of a run, or a prediction."""
    names = set(table.names)
    units = [name.removeprefix("lower_") for name in names if name.startswith("lower_")]
    bands = any({f"median_{unit}", f"upper_{unit}"} <= names for unit in units)
    derived = path.stem.endswith("_derived") and "quantity" in table.names
    return bands or derived or path.name in _OWN


def _test(one: Candidate, unit: ActuationUnit | None, taken: Sequence[str]) -> TestDraft:
    """Draft of a file; raises where the file cannot be read with the guessed columns."""
    actuation, source, doubts = actuation_of(one, unit)
    roles = dict(one.columns)
    record = _record(one.path, roles, actuation)
    sound = without_spikes(record.trace())
    if any(force_sign(sound)) and not channels_swapped(sound):
        doubt = (
            "its loops run backward, with negative work, so the sign of the force is turned; if "
            "that of the displacement is wrong, write sign = -1 there instead"
        )
        force = roles["force"]
        roles["force"] = replace(force, sign=-1, doubts=(*force.doubts, doubt))
        record = _record(one.path, roles, actuation)
    known = {role for role, guess in roles.items() if guess.unit is not None}
    doubts += tuple(str(fault.message) for fault in contradictions(record, roles=known))
    if "displacement" not in known and (length := length_in_name(record)):
        lacking = f'write unit = "{length[0]}": {length[1]}'
        roles["displacement"] = replace(roles["displacement"], lacking=lacking)
    return TestDraft(
        id=_id(one.path.stem, taken),
        file=one.path.name,
        columns=roles,
        actuation=actuation,
        source=source,
        doubts=doubts,
        earthquake=_EARTHQUAKE.search(one.path.stem) is not None,
        scales=_scales(record, roles),
    )


def _record(path: Path, roles: dict[str, Guess], actuation: str | Guess | None) -> Record:
    """Record of the guessed columns; unknown units are taken for the internal ones."""
    sources = {role: guess.source for role, guess in roles.items()}
    units = {r: _INTERNAL[r] for r, g in roles.items() if g.unit is None and g.name}
    if isinstance(actuation, Guess):
        sources["actuation"] = actuation.source
    return read_record(path, sources, units, actuation if isinstance(actuation, str) else None)


def _scales(record: Record, roles: dict[str, Guess]) -> Scales | None:
    """Scales of a record whose units are known."""
    known = all(roles[role].unit is not None for role in _ESSENTIAL)
    return scales_of(without_spikes(record.trace())) if known else None


def _id(stem: str, taken: Sequence[str]) -> str:
    """Id from a file's name; no id in `taken` differs from it in the case of letters only."""
    plain = unicodedata.normalize("NFKD", stem).encode("ascii", "ignore").decode()
    name = re.sub(r"[^A-Za-z0-9+_.-]+", "_", plain).lstrip(".").strip("_")[:90] or "test"
    used = {other.lower() for other in taken} | RESERVED
    number, found = 2, name
    while found.lower() in used:
        found, number = f"{name}_{number}", number + 1
    return found
