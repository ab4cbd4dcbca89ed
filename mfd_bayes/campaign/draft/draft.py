"""A first campaign for a folder of test files: what each file seems to be, as a campaign file.

A comment stands wherever a guess is not certain.
"""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mfd_bayes.calibration.priors import WRITTEN
from mfd_bayes.campaign.draft.guesses import (
    Guess,
    TestFile,
    actuation_of,
    guess_columns,
    level_in_header,
    levels_in,
    prevailing_unit,
    rate_in_header,
    timed_by_rate,
    without_shared_levels,
)
from mfd_bayes.campaign.draft.priors import Units, knows, priors_text
from mfd_bayes.campaign.schema import RESERVED
from mfd_bayes.errors import CampaignError, MfdError, RecordError
from mfd_bayes.records.data_quality import contradictions, force_sign, length_in_name
from mfd_bayes.records.loops import Scales, channels_swapped, scales_of
from mfd_bayes.records.readers import SUFFIXES, Table, read_table
from mfd_bayes.records.record import Record, read_record
from mfd_bayes.records.trace import without_spikes
from mfd_bayes.store.toml import commented, quoted
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
    """A test, as guessed from its file."""

    __test__ = False

    id: str
    file: str
    columns: dict[str, Guess]  # by role, without the actuation
    actuation: str | Guess | None  # a level, a column with a history, or None where it is unknown
    source: str  # where the actuation stands, or which columns might hold it
    doubts: tuple[str, ...]  # about the actuation and the file's name
    earthquake: bool  # whether the file's name is that of one
    scales: Scales | None  # None where a unit is unknown


@dataclass(frozen=True, eq=False)
class Draft:
    """A campaign, as guessed from the files of a folder."""

    folder: Path
    tests: tuple[TestDraft, ...]
    left_out: tuple[tuple[str, str], ...]  # files that are not tests of the campaign, and why
    unit: ActuationUnit | None  # of the actuations, "ksi" of pressures; None if unknown

    @property
    def scales(self) -> dict[str, Scales]:
        """What the loops show, by file; empty where a unit of a test is unknown."""
        scales = {test.file: test.scales for test in self.tests if test.scales is not None}
        return scales if len(scales) == len(self.tests) else {}


def draft_campaign(folder: Path) -> Draft:
    """Campaign of the test files in a folder; refused where there is none."""
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


def read_foreign(path: Path, folder: Path) -> Table:
    """Table of a file of this folder that this package did not write; raises for others."""
    if not _is_utf8(path.name):
        raise RecordError("its name is not UTF-8, as a campaign file must be: rename it")
    if not path.resolve().is_relative_to(folder.resolve()):
        raise RecordError("it is a link to a file outside this folder")
    table = read_table(path)
    if _is_own(path, table):
        raise RecordError("written by mfd-bayes")
    return table


def _read_file(path: Path, folder: Path) -> TestFile:
    """Guessed columns and actuations of a file; raises where it cannot be a test."""
    table = read_foreign(path, folder)
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
        id=new_id(file.path.stem, taken),
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


def new_id(stem: str, taken: Sequence[str]) -> str:
    """Id from a file's name; no id in `taken` differs from it in the case of letters only."""
    ascii_ = unicodedata.normalize("NFKD", stem).encode("ascii", "ignore").decode()
    name = re.sub(r"[^A-Za-z0-9+_.-]+", "_", ascii_).lstrip(".").strip("_")[:90] or "test"
    used = {other.lower() for other in taken} | RESERVED
    number, new = 2, name
    while new.lower() in used:
        new, number = f"{name}_{number}", number + 1
    return new


ROLES = ("time", "displacement", "force", "velocity")
_UNITS = {
    "time": '"s" or "ms"',
    "displacement": '"mm", "m" or "in"',
    "force": '"N", "kN", "lbf" or "kip"',
}

_HEAD = """\
# Written by mfd-bayes init from the files of this folder. Guesses that are not certain are marked
# "unsure", missing values "FIXME". Next:
"""
_NEXT = """\
#     mfd-bayes inspect campaign.toml
#     mfd-bayes calibrate campaign.toml -o out --dry-run

"""
_FIRST = "#     mfd-bayes init campaign.toml, once the units are complete: it writes priors.toml\n"
_MODELS = 'or "lugre", friction without a gap; "backlash", "bouc_wen"'

_PRIORS = {
    "ksi": ("mfd", "for drum brakes: actuations here are pressures"),
    "kip": ("brfd", "for band brakes: actuations here are tensions"),
    None: ("mfd", 'unsure: no actuation is known; "mfd" is for pressures, "brfd" for tensions'),
}
_OTHER = ("mfd", "for drum brakes; its priors do not depend on the unit of actuation")


def campaign_text(draft: Draft) -> str:
    """Campaign file of a draft; valid TOML whatever the names of files and columns are."""
    shared = _shared_columns(draft.tests)
    priors, why = _priors_of(draft)
    title = draft.folder.resolve().name.encode("utf-8", "replace").decode()
    lines = [
        "[campaign]",
        f"title = {quoted(title)}",
        f"priors = {quoted(priors)}  {commented(why)}",
        f'model = "three_stage"  {commented(_MODELS)}',
        "",
        "[columns]",
        *(_column_line(role, guess) for role, guess in shared.items()),
    ]
    for test in draft.tests:
        lines += ["", *_test_lines(test, shared, draft)]
    if draft.left_out:
        lines += ["", "# Left out:"]
        lines += [commented(f"{file}: {reason}") for file, reason in draft.left_out]
    first = _FIRST if lacks_priors(draft) else ""
    return _HEAD + first + _NEXT + "\n".join(lines) + "\n"


def _priors_of(draft: Draft) -> tuple[str, str]:
    """Shipped priors that know such a device, else those read off the records; and why these."""
    name, why = _PRIORS.get(draft.unit, _OTHER)
    if not draft.scales:
        guesses = [guess for test in draft.tests for guess in test.columns.values()]
        if all(guess.unit is not None for guess in guesses):
            return name, why
        how = "FIXME: once the units are complete, write it by: mfd-bayes init campaign.toml"
        return WRITTEN, how
    if knows(name, draft.scales):
        return name, why
    return WRITTEN, "scales read off the records: no shipped file knows such a device"


def lacks_priors(draft: Draft) -> bool:
    """Whether priors are to be read off the records, and cannot yet for want of units."""
    return not draft.scales and _priors_of(draft)[0] == WRITTEN


def own_priors(draft: Draft) -> str | None:
    """Text of the prior file of a draft that needs one of its own, and whose units are known."""
    if _priors_of(draft)[0] != WRITTEN or not draft.scales:
        return None
    usual = []
    for role in ("force", "displacement"):
        units = Counter(test.columns[role].unit for test in draft.tests)
        usual.append(str(units.most_common(1)[0][0]))
    return priors_text(draft.scales, Units(*usual))


def doubts(draft: Draft) -> list[str]:
    """Sentences on what is not certain, each with the columns or tests that it is about."""
    shared = _shared_columns(draft.tests)
    pairs = [("columns", doubt) for guess in shared.values() for doubt in guess.doubts]
    if draft.unit is None and _priors_of(draft)[0] != WRITTEN:
        pairs.append(("priors", _PRIORS[None][1].removeprefix("unsure: ")))
    for test in draft.tests:
        own = [doubt for _, guess in _own_columns(test, shared) for doubt in guess.doubts]
        quake = 'its name is that of an earthquake; role = "validate" is suggested'
        own += [*test.doubts, *([quake] if test.earthquake else [])]
        pairs += [(test.id, doubt) for doubt in own]
    return _grouped(pairs)


def gaps(draft: Draft) -> list[str]:
    """Sentences on what is missing and must be added, each with its columns or tests."""
    shared = _shared_columns(draft.tests)
    pairs = [("columns", _no_unit(role, g)) for role, g in shared.items() if g.unit is None]
    for test in draft.tests:
        own = [_no_unit(role, g) for role, g in _own_columns(test, shared) if g.unit is None]
        own += [_no_actuation(test, draft)] if test.actuation is None else []
        pairs += [(test.id, sentence) for sentence in own]
    return _grouped(pairs)


def _grouped(pairs: Iterable[tuple[str, str]]) -> list[str]:
    """Each sentence once, with all the columns or tests that it is about."""
    subjects: dict[str, list[str]] = {}
    for subject, sentence in pairs:
        subjects.setdefault(sentence, []).append(subject)
    sentences = []
    for sentence, names in subjects.items():
        more = f" and {len(names) - 3} more" if len(names) > 3 else ""
        sentences.append(f"{', '.join(names[:3])}{more}: {sentence}")
    return sentences


def _as_written(guess: Guess) -> tuple[object, ...]:
    """What the campaign file says of a column."""
    return guess.name, guess.unit, guess.number, guess.sign, guess.rate


def _shared_columns(tests: tuple[TestDraft, ...]) -> dict[str, Guess]:
    """Most frequent column of each role that every test has, with the doubts of all tests."""
    shared: dict[str, Guess] = {}
    for role in ROLES:
        guesses = [test.columns[role] for test in tests if role in test.columns]
        if len(guesses) < len(tests):
            continue
        usual = Counter(map(_as_written, guesses)).most_common(1)[0][0]
        alike = [guess for guess in guesses if _as_written(guess) == usual]
        doubts_ = dict.fromkeys(doubt for guess in alike for doubt in guess.doubts)
        lacking = "; ".join(dict.fromkeys(guess.lacking for guess in alike if guess.lacking))
        shared[role] = replace(alike[0], doubts=tuple(doubts_), lacking=lacking)
    return shared


def _own_columns(test: TestDraft, shared: dict[str, Guess]) -> Iterator[tuple[str, Guess]]:
    """Columns of a test that are not the shared ones."""
    for role in ROLES:
        guess, common = test.columns.get(role), shared.get(role)
        if guess and not (common and _as_written(guess) == _as_written(common)):
            yield role, guess


def _test_lines(test: TestDraft, shared: dict[str, Guess], draft: Draft) -> Iterator[str]:
    yield "[[test]]"
    yield f"id = {quoted(test.id)}"
    yield f"file = {quoted(test.file)}"
    for doubt in test.doubts:
        yield commented(f"unsure: {doubt}")
    if test.actuation is None:
        yield commented(f"FIXME: {_no_actuation(test, draft)}")
    elif isinstance(test.actuation, Guess):
        column = table_of_column(test.actuation)
        yield f"actuation = {column}  {commented('measured during the test')}"
    else:
        yield f"actuation = {quoted(test.actuation)}  {commented(test.source)}"
    for role, guess in _own_columns(test, shared):
        line = _column_line(role, guess)
        yield line if line.startswith("#") else f"columns.{line}"
    if test.earthquake:
        yield '# role = "validate"  # an earthquake by its name: to predict and score, not to fit'


def table_of_column(guess: Guess) -> str:
    """TOML inline table of a column, given by its number where it has one, or of a rate."""
    if guess.rate:
        return f"{{ rate = {quoted(guess.rate)} }}"
    parts = [f"name = {quoted(guess.name)}" if guess.number is None else f"column = {guess.number}"]
    parts += [] if guess.unit is None else [f"unit = {quoted(guess.unit)}"]
    parts += [] if guess.sign == 1 else [f"sign = {guess.sign}"]
    return f"{{ {', '.join(parts)} }}"


def _column_line(role: str, guess: Guess) -> str:
    remarks = [f"FIXME: {_no_unit(role, guess)}"] if guess.unit is None else []
    remarks += [f"unsure: {doubt}" for doubt in guess.doubts]
    behind = f"  {commented('; '.join(remarks))}" if remarks else ""
    if not guess.name and not guess.rate:
        return f'# {role} = {{ rate = "100 Hz" }}{behind}'
    return f"{role} = {table_of_column(guess)}{behind}"


def _no_unit(role: str, guess: Guess) -> str:
    if guess.lacking:
        return f"the unit of {role} is unknown; {guess.lacking}"
    return f"the unit of {role} is unknown; add unit = {_UNITS.get(role, '…')}"


def _no_actuation(test: TestDraft, draft: Draft) -> str:
    examples = {None: "500 psi", "ksi": "500 psi", "kip": "30 lbf"}
    example = examples.get(draft.unit, f"1 {draft.unit}")
    return (
        f'add actuation = "{example}" or similar; no column, header line or file name has it'
        f"{test.source}"
    )
