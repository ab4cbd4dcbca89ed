"""A first campaign for a folder of test files: what each file seems to be."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mfd_bayes.campaign.draft.actuation import (
    TestFile,
    actuation_of,
    level_in_header,
    levels_in,
    prevailing_unit,
    rate_in_header,
    without_shared_levels,
)
from mfd_bayes.campaign.draft.columns import Guess, guess_columns, timed_by_rate
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
_OWN = re.compile(
    r"(?:parameters|derived|laws|law_scores|checks|scores|crossvalidation)\.(?:csv|json)"
    r"|comparison\.csv|manifest\.json"
)
"""Names of the tables of a run."""

_EARTHQUAKE = re.compile(
    r"quake|seism|(?<![a-z])(?:eq|gm|dbe|mce|sle)(?![a-z])|dbe|mce|kobe|centro|northridge"
    r"|imperial|kocaeli|chi-?chi|prieta|tabas|landers|duzce|ground.?motion|random|white.?noise",
    re.IGNORECASE,
)


@dataclass(frozen=True, eq=False)
class TestDraft:
    """A test, as guessed from its file.

    Attributes
    ----------
    columns : dict of str to Guess
        Role to column, without the actuation.
    actuation : str or Guess or None
        A level, a column with a history, or None where it is unknown.
    source : str
        Where the actuation stands, or which columns might hold it.
    doubts : tuple of str
        What is not certain about the actuation, and what contradicts the file's name.
    earthquake : bool
        Whether the file's name is that of an earthquake.
    scales : Scales or None
        What its loops show; None where a unit is unknown.
    """

    __test__ = False

    id: str
    file: str
    columns: dict[str, Guess]
    actuation: str | Guess | None
    source: str
    doubts: tuple[str, ...]
    earthquake: bool
    scales: Scales | None = None


@dataclass(frozen=True, eq=False)
class Draft:
    """A campaign, as guessed from the files of a folder.

    Attributes
    ----------
    left_out : tuple of (str, str)
        Files that are not tests of the campaign, and why.
    unit : str or None
        "ksi" where actuations are pressures, "kip" of tensions, …; None if unknown.
    """

    folder: Path
    tests: tuple[TestDraft, ...]
    left_out: tuple[tuple[str, str], ...]
    unit: ActuationUnit | None

    @property
    def scales(self) -> dict[str, Scales]:
        """What the loops show, by file; empty where a unit of a test is unknown."""
        scales = {test.file: test.scales for test in self.tests if test.scales is not None}
        return scales if len(scales) == len(self.tests) else {}


def draft_campaign(folder: Path) -> Draft:
    """Campaign of the test files in a folder, guessed from names, units and numbers.

    Raises
    ------
    CampaignError
        When the folder cannot be read or holds no test.
    """
    try:
        paths = [p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and p.is_file()]
    except OSError as error:
        raise CampaignError(f"cannot read the folder {folder}: {error.strerror}") from error
    files: list[TestFile] = []
    left_out: list[tuple[str, str]] = []
    for path in sorted(paths, key=_natural):
        try:
            files.append(_read_file(path, folder))
        except MfdError as error:
            left_out.append(_reason(path, error))
    files = without_shared_levels(files)
    unit = prevailing_unit(files)
    tests: list[TestDraft] = []
    for file in files:
        try:
            tests.append(_draft_test(file, unit, [test.id for test in tests]))
        except MfdError as error:
            left_out.append(_reason(file.path, error))
    if not tests:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in left_out[:5])
        raise CampaignError(
            f"{folder} holds no test, a file with time, displacement and force"
            + (f": {reasons}" if reasons else f" and one of the suffixes {', '.join(SUFFIXES)}")
        )
    return Draft(folder, tuple(tests), tuple(left_out), unit)


def _natural(path: Path) -> tuple[list[tuple[int, str]], str]:
    """Key of sorting, with p500 before p1000."""
    parts = re.split(r"([0-9]+)", path.name.lower())
    return [(int(p), "") if p.isdecimal() else (0, p) for p in parts], path.name


def _reason(path: Path, error: MfdError) -> tuple[str, str]:
    """Name of a file and why it is left out, with escapes for what UTF-8 cannot encode."""
    texts = path.name, str(error).replace(str(path), path.name)
    name, reason = (text.encode("utf-8", "backslashreplace").decode() for text in texts)
    return name, reason


def _is_utf8(name: str) -> bool:
    return not any("\ud800" <= letter <= "\udfff" for letter in name)


def _read_file(path: Path, folder: Path) -> TestFile:
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
        notes = [f"the heading is repeated from {again}: keep one block in a file"] if again else []
        raise RecordError(
            f"no column for {' and '.join(missing)} among {', '.join(table.names[:12])}"
            + "".join(f"; {note}" for note in (*notes, *table.notes))
        )
    for guess in (*columns.values(), column):
        if guess and not _is_utf8(guess.name):
            raise RecordError(f"the name of its column {guess.name!a} is not UTF-8: rename it")
    header, named = level_in_header(table.head, table.names), levels_in(path.stem)
    other = column and column.unit and actuation_factor(column.unit)[1] not in ("ksi", "kip")
    if other and (header or named):
        column = None  # a current or a voltage, of a sensor perhaps, where the level is stated
    return TestFile(path, table, columns, column, header, named)


def _is_own(path: Path, table: Table) -> bool:
    """Whether this package wrote a file: a table of a run, or a prediction."""
    names = set(table.names)
    units = [name.removeprefix("lower_") for name in names if name.startswith("lower_")]
    bands = any({f"median_{unit}", f"upper_{unit}"} <= names for unit in units)
    derived = path.stem.endswith("_derived") and "quantity" in table.names
    return bands or derived or _OWN.fullmatch(path.name) is not None


def _draft_test(file: TestFile, unit: ActuationUnit | None, taken: Sequence[str]) -> TestDraft:
    """Draft of a file; raises where the file cannot be read with the guessed columns."""
    actuation, source, doubts = actuation_of(file, unit)
    roles = dict(file.columns)
    record = _read_record(file.path, roles, actuation)
    sound = without_spikes(record.trace())
    if any(force_sign(sound)) and not channels_swapped(sound):
        doubt = (
            "its loops run backward, with negative work, so the sign of the force is turned; if "
            "that of the displacement is wrong, write sign = -1 there instead"
        )
        force = roles["force"]
        roles["force"] = replace(force, sign=-1, doubts=(*force.doubts, doubt))
        record = _read_record(file.path, roles, actuation)
    known = {role for role, guess in roles.items() if guess.unit is not None}
    doubts += tuple(str(fault.message) for fault in contradictions(record, roles=known))
    if "displacement" not in known and (length := length_in_name(record)):
        lacking = f'write unit = "{length[0]}": {length[1]}'
        roles["displacement"] = replace(roles["displacement"], lacking=lacking)
    complete = known.issuperset(_ESSENTIAL)
    return TestDraft(
        id=_new_id(file.path.stem, taken),
        file=file.path.name,
        columns=roles,
        actuation=actuation,
        source=source,
        doubts=doubts,
        earthquake=_EARTHQUAKE.search(file.path.stem) is not None,
        scales=scales_of(without_spikes(record.trace())) if complete else None,
    )


def _read_record(path: Path, roles: dict[str, Guess], actuation: str | Guess | None) -> Record:
    """Record of the guessed columns; unknown units are taken for the internal ones."""
    sources = {role: guess.source for role, guess in roles.items()}
    units = {r: _INTERNAL[r] for r, g in roles.items() if g.unit is None and g.name}
    if isinstance(actuation, Guess):
        sources["actuation"] = actuation.source
    return read_record(path, sources, units, actuation if isinstance(actuation, str) else None)


def _new_id(stem: str, taken: Sequence[str]) -> str:
    """Id from a file's name; no id in `taken` differs from it in the case of letters only."""
    ascii_ = unicodedata.normalize("NFKD", stem).encode("ascii", "ignore").decode()
    name = re.sub(r"[^A-Za-z0-9+_.-]+", "_", ascii_).lstrip(".").strip("_")[:90] or "test"
    used = {other.lower() for other in taken} | RESERVED
    number, new = 2, name
    while new.lower() in used:
        new, number = f"{name}_{number}", number + 1
    return new
