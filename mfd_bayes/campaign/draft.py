"""A first campaign for a folder of test files, as a campaign file, and wide priors for it.

A comment stands wherever a guess is not certain.
"""

from __future__ import annotations

import os
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path

import numpy as np

from mfd_bayes.calibration.priors import SCALED, WRITTEN, find_priors, load_priors
from mfd_bayes.campaign.guesses import (
    ESSENTIAL,
    Guess,
    TestFile,
    actuation_of,
    guess_columns,
    level_in_header,
    levels_in,
    prevailing_unit,
    without_shared_levels,
    writes_decimals,
)
from mfd_bayes.campaign.schema import RESERVED
from mfd_bayes.errors import CampaignError, MfdError, RecordError
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.models import find_model
from mfd_bayes.records.cycles import Scales, middle, scales_of
from mfd_bayes.records.data_quality import contradictions, length_in_name, runs_backward
from mfd_bayes.records.readers import SUFFIXES, read_table
from mfd_bayes.records.record import Record, read_record
from mfd_bayes.records.table import listed
from mfd_bayes.store.files import commented, quoted, read_toml
from mfd_bayes.units import (
    DAMPER,
    ActuationUnit,
    Axes,
    actuation_factor,
    convert,
    in_digits,
    measures,
)

_ONE = "; columns are separated by commas, tabs, semicolons, | or blanks"
_INTERNAL = {"time": "s", "displacement": "in", "force": "kip"}
_BANDS = {"lower", "median", "upper"}  # first words of columns of a prediction
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
    scales: Scales | None  # of a damper's loops; None where a unit is unknown
    ranges: tuple[float, float] | None  # of motion and response; None where a unit is unknown

    @property
    def earthquake(self) -> bool:
        """Whether the file's name is that of one."""
        return _EARTHQUAKE.search(Path(self.file).stem) is not None


@dataclass(frozen=True, eq=False)
class Draft:
    """A campaign, as guessed from the files of a folder."""

    folder: Path
    tests: tuple[TestDraft, ...]
    left_out: tuple[tuple[str, str], ...]  # files that are not tests of the campaign, and why
    unit: ActuationUnit | None  # of the actuations, "ksi" of pressures; None if unknown
    axes: Axes = DAMPER
    model: str = "three_stage"
    own: Model | None = None  # a model with parameters of the user's own

    @property
    def ranges(self) -> list[tuple[float, float]]:
        """Motion and response of every test, in the model's units; empty where one is unknown."""
        ranges = [test.ranges for test in self.tests if test.ranges is not None]
        return ranges if len(ranges) == len(self.tests) else []

    @property
    def scales(self) -> dict[str, Scales]:
        """What the loops show, by file; empty where a unit of a test is unknown."""
        scales = {test.file: test.scales for test in self.tests if test.scales is not None}
        return scales if len(scales) == len(self.tests) else {}


def draft_campaign(folder: Path, model: str = "") -> Draft:
    """Campaign of the test files in a folder, perhaps of a user's own model, "file.py:Class"."""
    try:
        paths = [p for p in folder.iterdir() if _may_be_test(p)]
        subfolders = _tests_below(folder)
    except OSError as error:
        raise CampaignError(f"cannot read the folder {folder}: {error.strerror}") from error
    force_model = find_model(model, folder) if model else None
    axes = replace(force_model.axes, actuated=bool(force_model.actuated)) if force_model else DAMPER
    files: list[TestFile] = []
    tests: list[TestDraft] = []
    left_out: list[tuple[str, str]] = [
        (name, f"folders below are not read; this one has {count} that may be tests: init it alone")
        for name, count in subfolders.items()
    ]

    def leave_out(path: Path, error: MfdError) -> None:
        texts = path.name, str(error).replace(str(path), path.name)
        name, reason = (text.encode("utf-8", "backslashreplace").decode() for text in texts)
        left_out.append((name, reason))

    joined = writes_decimals([path.stem for path in paths])
    for path in sorted(paths, key=_natural):
        try:
            files.append(_read_file(path, folder, axes, joined=joined))
        except MfdError as error:
            leave_out(path, error)
    files = without_shared_levels(files)
    unit = prevailing_unit(files)
    for file in files:
        try:
            tests.append(_draft_test(file, unit, axes, [test.id for test in tests]))
        except MfdError as error:
            leave_out(file.path, error)
    if not tests:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in left_out[:5])
        roles = ("time",) * axes.timed + (axes.motion.name,)
        raise CampaignError(
            f"{folder} holds no test, a file with {', '.join(roles)} and {axes.response.name}"
            + (f": {reasons}" if reasons else f" and one of the suffixes {', '.join(SUFFIXES)}")
        )
    user_model = force_model if force_model and has_own_parameters(force_model) else None
    return Draft(
        folder, tuple(tests), tuple(left_out), unit, axes, model or Draft.model, user_model
    )


def _may_be_test(path: Path) -> bool:
    """Whether a path is a file that can be read, and no shadow of one by macOS or Excel."""
    is_shadow = path.name.startswith(("._", "~$"))
    return path.suffix.lower() in SUFFIXES and not is_shadow and path.is_file()


_MOST_BELOW = 10_000  # files and folders that are looked at


def _tests_below(folder: Path) -> dict[str, int]:
    """Folders below, but for hidden ones and runs, to the number of files that may be tests."""
    counts: dict[str, int] = {}
    entries = 0
    for root, folders, names in os.walk(folder):
        path = Path(root)
        entries += len(folders) + len(names)
        if "manifest.json" in names or entries > _MOST_BELOW:
            folders.clear()
            continue
        folders[:] = sorted(name for name in folders if not name.startswith((".", "__")))
        count = sum(_may_be_test(path / name) for name in names if name != "manifest.csv")
        if path != folder and count:
            name = path.relative_to(folder).as_posix().encode("utf-8", "backslashreplace").decode()
            counts[name] = count
    return counts


def _natural(path: Path) -> tuple[list[tuple[int, str]], str]:
    """Key of sorting, with p500 before p1000."""
    tokens = re.split(r"([0-9]+)", path.name.lower())
    return [(int(p), "") if p.isdecimal() else (0, p) for p in tokens], path.name


def _read_file(path: Path, folder: Path, axes: Axes, *, joined: bool) -> TestFile:
    """Guessed columns and actuations of a file; raises where it cannot be a test."""
    _check_utf8(path.name, "its name")
    if not path.resolve().is_relative_to(folder.resolve()):
        raise RecordError("it is a link to a file outside this folder")
    table = read_table(path)
    if {name.partition("_")[0] for name in table.names} >= _BANDS:
        raise RecordError("written by mfd-bayes")
    columns = guess_columns(table, axes)
    for guess in columns.values():
        _check_utf8(guess.name, f"the name of its column {guess.name!a}")
    column = columns.pop("actuation", None)
    required = [role for role in ESSENTIAL if axes.timed or role != "time"]
    if missing := [axes.name(role) for role in required if role not in columns]:
        again = next(iter(table.blocks.values()), "")
        notes = [f"the heading is repeated from {again}: keep one block in a file"] if again else []
        raise RecordError(
            f"no column for {' and '.join(missing)} among {', '.join(table.names[:12])}"
            + "".join(f"; {note}" for note in (*notes, *table.notes))
            + _ONE * (len(table.names) == 1)
        )
    levels = (*level_in_header(table.head, table.names), *levels_in(path.stem, joined=joined))
    if column and column.unit and actuation_factor(column.unit)[1] not in ("ksi", "kip") and levels:
        column = None  # a current or a voltage, of a sensor perhaps, where the level is stated
    return TestFile(
        path, table, columns, column, tuple(sorted(levels, key=lambda v: bool(v.doubt)))
    )


def _check_utf8(name: str, label: str) -> None:
    if any("\ud800" <= letter <= "\udfff" for letter in name):
        raise RecordError(f"{label} is not UTF-8, as a campaign file must be: rename it")


def _draft_test(
    file: TestFile, unit: ActuationUnit | None, axes: Axes, ids: Sequence[str]
) -> TestDraft:
    """Draft of a file; raises where the file cannot be read with the guessed columns."""
    actuation, source, doubts = (None, "", ()) if not axes.actuated else actuation_of(file, unit)
    roles, scales = dict(file.columns), None
    record, ranges = _read_record(file.path, roles, actuation, axes), None
    if all(roles[role].unit is not None for role in ("displacement", "force")):
        ranges = ranges_of(record)
    if axes.of_damper and axes.timed:
        if runs_backward(record.trace()):
            doubt = (
                "its loops run backward, with negative work, so the sign of the force is turned; "
                "if that of the displacement is wrong, write sign = -1 there instead"
            )
            force = roles["force"]
            roles["force"] = replace(force, sign=-1, doubts=(*force.doubts, doubt))
            record = _read_record(file.path, roles, actuation, axes)
        unit_roles = {role for role, guess in roles.items() if guess.unit is not None}
        doubts += tuple(str(fault.message) for fault in contradictions(record, roles=unit_roles))
        if "displacement" not in unit_roles and (length := length_in_name(record)):
            lacking = f'write unit = "{length[0]}": {length[1]}'
            roles["displacement"] = replace(roles["displacement"], lacking=lacking)
        if unit_roles.issuperset(ESSENTIAL):
            scales = scales_of(record.trace())
    return TestDraft(
        *(new_id(file.path.stem, ids), file.path.name, roles, actuation, source, doubts, scales),
        ranges,
    )


def _read_record(
    path: Path, roles: dict[str, Guess], actuation: str | Guess | None, axes: Axes
) -> Record:
    """Record of the guessed columns; unknown units are taken for the model's."""
    sources = {role: guess.source for role, guess in roles.items()}
    units = {r: axes.unit(_INTERNAL[r]) for r, g in roles.items() if g.unit is None and g.name}
    if isinstance(actuation, Guess):
        sources["actuation"] = actuation.source
    level = actuation if isinstance(actuation, str) else None
    return read_record(path, sources, units, level, axes=axes)


def new_id(stem: str, ids: Sequence[str]) -> str:
    """Id from a file's name; no id in `ids` differs from it in the case of letters only."""
    ascii_ = unicodedata.normalize("NFKD", stem).encode("ascii", "ignore").decode()
    name = re.sub(r"[^A-Za-z0-9+_.-]+", "_", ascii_).lstrip(".").strip("_")[:90] or "test"
    reserved = {existing.lower() for existing in ids} | RESERVED
    number, candidate = 2, name
    while candidate.lower() in reserved:
        candidate, number = f"{name}_{number}", number + 1
    return candidate


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
    priors, remark = _priors_of(draft)
    title = draft.folder.resolve().name.encode("utf-8", "replace").decode()
    lines = [
        "[campaign]",
        f"title = {quoted(title)}",
        f"priors = {quoted(priors)}  {commented(remark)}",
        f"model = {quoted(draft.model)}" + ("" if draft.own else f"  {commented(_MODELS)}"),
        "",
        "[columns]",
        *(_column_line(draft.axes.name(role), guess) for role, guess in shared.items()),
    ]
    for test in draft.tests:
        lines += ["", "[[test]]", f"id = {quoted(test.id)}", f"file = {quoted(test.file)}"]
        lines += [commented(f"unsure: {doubt}") for doubt in test.doubts]
        if isinstance(test.actuation, Guess):
            column = _table_of(test.actuation)
            lines.append(f"actuation = {column}  {commented('measured during the test')}")
        elif test.actuation is not None:
            lines.append(f"actuation = {quoted(test.actuation)}  {commented(test.source)}")
        elif draft.axes.actuated:
            lines.append(commented(f"FIXME: {_no_actuation(test, draft)}"))
        for role, guess in _own_columns(test, shared).items():
            line = _column_line(draft.axes.name(role), guess)
            lines.append(line if line.startswith("#") else f"columns.{line}")
        if test.earthquake:
            remark = "an earthquake by its name: to predict and score, not to fit"
            lines.append(f'# role = "validate"  {commented(remark)}')
    if draft.left_out:
        lines += ["", "# Left out:"]
        lines += [commented(f"{file}: {reason}") for file, reason in draft.left_out]
    return _HEAD + (_FIRST if lacks_priors(draft) else "") + _NEXT + "\n".join(lines) + "\n"


def _priors_of(draft: Draft) -> tuple[str, str]:
    """Shipped priors that know such a device, else those read off the records; and why these."""
    later = "FIXME: once the units are complete, write it by: mfd-bayes init campaign.toml"
    if draft.own:
        wide = "wide, of the sizes of the records: replace each by what you know"
        return WRITTEN, wide if draft.ranges else later
    name, reason = _PRIORS.get(draft.unit, _OTHER)
    if draft.scales:
        if knows(name, draft.scales):
            return name, reason
        return WRITTEN, "scales read off the records: no shipped file knows such a device"
    if all(guess.unit is not None for test in draft.tests for guess in test.columns.values()):
        return name, reason
    return WRITTEN, later


def lacks_priors(draft: Draft) -> bool:
    """Whether priors are to be read off the records, and cannot yet for want of units."""
    return _priors_of(draft)[0] == WRITTEN and not (draft.ranges if draft.own else draft.scales)


def own_priors(draft: Draft) -> str | None:
    """Text of the prior file of a draft that needs one of its own, and whose units are known."""
    if draft.own:
        return priors_of_model(draft.own, draft.ranges) if draft.ranges else None
    if _priors_of(draft)[0] != WRITTEN or not draft.scales:
        return None
    force, length = (
        Counter(str(test.columns[role].unit) for test in draft.tests).most_common(1)[0][0]
        for role in ("force", "displacement")
    )
    return priors_text(draft.scales, force, length)


def doubts(draft: Draft) -> list[str]:
    """Sentences on what is not certain, each with the columns or tests that it is about."""
    pairs = []
    quake = 'its name is that of an earthquake; role = "validate" is suggested'
    for name, test, columns in _parts(draft):
        pairs += [(name, doubt) for guess in columns.values() for doubt in guess.doubts]
        if test is not None:
            pairs += [(name, doubt) for doubt in (*test.doubts, *[quake] * test.earthquake)]
        elif draft.unit is None and _priors_of(draft)[0] != WRITTEN:
            pairs.append(("priors", _PRIORS[None][1].removeprefix("unsure: ")))
    return _grouped(pairs)


def gaps(draft: Draft) -> list[str]:
    """Sentences on what is missing and must be added, each with its columns or tests."""
    pairs = []
    for name, test, columns in _parts(draft):
        pairs += [
            (name, _no_unit(role, guess)) for role, guess in columns.items() if guess.unit is None
        ]
        if test is not None and test.actuation is None and draft.axes.actuated:
            pairs.append((name, _no_actuation(test, draft)))
    return _grouped(pairs)


def _parts(draft: Draft) -> Iterator[tuple[str, TestDraft | None, dict[str, Guess]]]:
    """The table of shared columns and each test, with its name and its columns."""
    shared = _shared_columns(draft.tests)
    yield "columns", None, shared
    for test in draft.tests:
        yield test.id, test, _own_columns(test, shared)


def _grouped(pairs: Iterable[tuple[str, str]]) -> list[str]:
    """Each sentence once, with all the columns or tests that it is about."""
    subjects: dict[str, list[str]] = {}
    for subject, sentence in pairs:
        subjects.setdefault(sentence, []).append(subject)
    return [f"{listed(names, 3, str)}: {sentence}" for sentence, names in subjects.items()]


_as_written = attrgetter("name", "unit", "number", "sign", "rate")
"""What the campaign file says of a column."""


def _shared_columns(tests: Sequence[TestDraft]) -> dict[str, Guess]:
    """Most frequent column of each role that every test has, with the doubts of all tests."""
    shared: dict[str, Guess] = {}
    for role in ESSENTIAL:
        guesses = [test.columns[role] for test in tests if role in test.columns]
        if len(guesses) < len(tests):
            continue
        common = Counter(map(_as_written, guesses)).most_common(1)[0][0]
        alike = [guess for guess in guesses if _as_written(guess) == common]
        all_doubts = dict.fromkeys(doubt for guess in alike for doubt in guess.doubts)
        lacking = "; ".join(dict.fromkeys(guess.lacking for guess in alike if guess.lacking))
        shared[role] = replace(alike[0], doubts=tuple(all_doubts), lacking=lacking)
    return shared


def _own_columns(test: TestDraft, shared: dict[str, Guess]) -> dict[str, Guess]:
    """Columns of a test that are not the shared ones."""
    common = {role: _as_written(guess) for role, guess in shared.items()}
    return {role: g for role, g in test.columns.items() if common.get(role) != _as_written(g)}


def _table_of(guess: Guess) -> str:
    """TOML inline table of a column, given by its number where it has one, or of a rate."""
    if guess.rate:
        return f"{{ rate = {quoted(guess.rate)} }}"
    entries = [
        f"name = {quoted(guess.name)}" if guess.number is None else f"column = {guess.number}"
    ]
    entries += [] if guess.unit is None else [f"unit = {quoted(guess.unit)}"]
    entries += [] if guess.sign == 1 else [f"sign = {guess.sign}"]
    return f"{{ {', '.join(entries)} }}"


def _column_line(name: str, guess: Guess) -> str:
    remarks = [f"FIXME: {_no_unit(name, guess)}"] if guess.unit is None else []
    remarks += [f"unsure: {doubt}" for doubt in guess.doubts]
    comment = f"  {commented('; '.join(remarks))}" if remarks else ""
    if not guess.name and not guess.rate:
        return f'# {name} = {{ rate = "100 Hz" }}{comment}'
    return f"{name} = {_table_of(guess)}{comment}"


def _no_unit(role: str, guess: Guess) -> str:
    advice = guess.lacking or f"add unit = {_UNITS.get(role, '…')}"
    return f"the unit of {role} is unknown; {advice}"


def _no_actuation(test: TestDraft, draft: Draft) -> str:
    examples = {None: "500 psi", "ksi": "500 psi", "kip": "30 lbf"}
    example = examples.get(draft.unit, f"1 {draft.unit}")
    return (
        f'add actuation = "{example}" or similar; no column, header line or file name has it'
        f"{test.source}"
    )


# The first prior file: of a device that no shipped file knows, or of a user's own model.

OTHER = 2.0
"""A slip force so many of the prior's standard deviations off is that of another device."""

LONG, SHORT = 5.0, 2.0
"""A length so many times the prior's gap, or a stroke that is not so many gaps, is of another."""

_PRIORS_HEAD = """\
# Written by mfd-bayes init. The scales below are read off the records of this folder, so the data
# are used for orders of magnitude here and once more in the calibration. That is harmless only
# because the priors are wide: a sigma of 1.1 is a factor of 3 both ways. Replace what you know
# better. Families and keys: priors/mfd.toml of mfd_bayes.
"""
_WIDE = 1.1
_INTERNAL_UNITS = {
    "force": "kip",
    "length": "in",
    "speed": "in/s",
    "force/length": "kip/in",
    "force/speed": "kip*s/in",
    "length/speed": "s",
}
_MULTIPLE = re.compile(rf"(\S+) ({'|'.join(_INTERNAL_UNITS)})")


def knows(priors: str, scales: Mapping[str, Scales]) -> bool:
    """Whether a shipped prior file expects slip forces and lengths such as these."""
    file, typical = load_priors(priors), middle(scales.values())
    slip = file.parameters["Fc_fwd"].figures
    distance = abs(np.log(typical.force / slip["median"])) / slip["sigma"]
    gap = file.gap or typical.length
    return bool(distance < OTHER and typical.length < LONG * gap and typical.stroke > SHORT * gap)


def priors_text(scales: Mapping[str, Scales], force: str, length: str) -> str:
    """Prior file for records of known scales, by the names of their tests, in these units."""
    scale = middle(scales.values())
    sizes = {"force": scale.force, "length": scale.length, "speed": scale.speed}
    units = {
        "force": force,
        "length": length,
        "speed": f"{length}/s",
        "force/length": f"{force}/{length}",
        "force/speed": f"{force}*s/{length}",
        "length/speed": "s",
    }

    def quantity(value: float, kind: str) -> str:
        return f"{in_digits(value * convert(_INTERNAL_UNITS[kind], units[kind]), 3)} {units[kind]}"

    def lognormal(value: float, kind: str, sigma: float, reason: str) -> dict[str, object]:
        reason = f"{reason}; sigma is a factor of {np.exp(sigma):.2g}"
        median = quantity(value, kind)
        return {"family": "lognormal", "median": median, "sigma": sigma, "reason": reason}

    forces = [entry.force for entry in scales.values()]
    ends = dict.fromkeys(quantity(f, "force") for f in (min(forces), max(forces)))
    sigma = max(_WIDE, 0.5 * float(np.log(max(forces) / min(forces))) + 0.7)
    source = f"the slip force of {listed(list(scales), 1, str)}, {' to '.join(ends)}"
    slip = lognormal(scale.force, "force", sigma, source)
    build_up = "the slope at which the force comes back"
    slope = lognormal(scale.build_up, "force/length", 1.5, build_up)
    noise = (
        f"samples differ by {quantity(scale.noise, 'force')} from their neighbours; model error is "
        "some percent more"
    )
    noise_sd = max(3.0 * scale.noise, 0.03 * scale.force)
    offset = max(0.3 * scale.force, 2.0 * max(abs(entry.offset) for entry in scales.values()))
    read_off = {
        **dict.fromkeys(("Fc_fwd", "Fc_bwd", "Fy_fwd", "Fy_bwd"), slip),
        **dict.fromkeys(("k3", "k", "k_fwd", "k_bwd"), slope),
        "sigma0": lognormal(scale.unloading, "force/length", 1.5, "the slope after reversals"),
        "noise_sd": lognormal(noise_sd, "force", 1.2, noise),
        "offset": {
            "family": "normal",
            "mean": "0 force",
            "sd": quantity(offset, "force"),
            "reason": "a third of the slip force, or twice the middle of the loops if that is more",
        },
    }
    content, text = read_toml(find_priors("any")), f"{_PRIORS_HEAD}title = "
    text += quoted(f"{SCALED}: {listed(list(scales), 1, str)}") + "\n"
    for section, entry in (("parameters", read_off), ("scatter", {})):
        for name, table in (content[section] | entry).items():
            text += f"\n[{section}.{name}]\n"
            for key, value in table.items():
                match = _MULTIPLE.fullmatch(value) if isinstance(value, str) else None
                if match is None:
                    text += f"{key} = {_toml(value)}\n"
                else:  # a multiple of scales
                    numerator, _, denominator = match[2].partition("/")
                    size = float(match[1]) * sizes[numerator] / sizes.get(denominator, 1.0)
                    text += f"{key} = {quoted(quantity(size, match[2]))}  {commented(value)}\n"
    return text


def _toml(value: object) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    return quoted(value) if isinstance(value, str) else f"{value:.3g}"


_HEAD_OWN = """\
# Written by mfd-bayes init for a model of your own. Every size below is a guess: parameters in the
# units of the response, the motion or their ratio have the size of the records, all others 0.3.
# For a motion without a unit, such as strain, a stiffness looks like a response: give its size.
# A sigma of 1.5 is a factor of 4.5 both ways. Replace each by what you know, and say why.
# The parameters of one group under [scatter] share one spread between tests, one between sessions
# and one between levels: each has a group of its own here.
"""


def has_own_parameters(model: Model) -> bool:
    """Whether a model has parameters that no model of the package has, and no prior file of it."""
    return not model.standard_names.issuperset(q.name for q in model.quantities)


def ranges_of(record: Record) -> tuple[float, float]:
    """Ranges of motion and response of a record, in the model's units."""
    return float(np.ptp(record.displacement)), float(np.ptp(np.asarray(record.force)))


def priors_of_model(model: Model, ranges: Sequence[tuple[float, float]]) -> str:
    """Prior file of a user's own model, wide, in the ranges of the records' motion and response."""
    x, f = model.axes.motion.unit, model.axes.response.unit
    motion, response = np.maximum(0.5 * np.median(ranges, axis=0), 1e-12).tolist()
    ratio = response / motion
    sizes = {f: response, x: motion, f"({f})/({x})": ratio, f"({x})/s": motion}
    sizes[f"({f})*s/({x})"] = ratio
    lines = [_HEAD_OWN, f"title = {quoted(f'{model.name}, drafted')}\n", "[parameters]"]
    scatter: dict[str, str] = {}
    for quantity in model.quantities:
        name, unit = quantity.name, quantity.unit
        alike = next((u for u in sizes if unit != "1" and measures(u, unit)), "")
        size = sizes[alike] * convert(alike, unit) if alike else 0.3
        if quantity.lower == -np.inf:
            prior = (
                f'family = "normal", mean = {_with_unit(0.0, unit)}, sd = {_with_unit(size, unit)}'
            )
            scatter[name] = _with_unit(0.1 * size, unit)
        else:
            scatter[name] = "0.2"
            prior = f'family = "lognormal", median = {_with_unit(size, unit)}, sigma = 1.5'
            if quantity.upper == 1.0:
                prior = 'family = "beta", a = 2, b = 2'
        reason = quoted(f"FIXME: a guess; {quantity.meaning}")
        lines.append(f"{name} = {{ {prior}, reason = {reason} }}")
    zero, offset, noise = (_with_unit(share * response, f) for share in (0.0, 0.02, 0.1))
    memory = '"0.1 s"' if model.axes.timed else "3"
    noise_priors = {
        "offset": f'family = "normal", mean = {zero}, sd = {offset}, reason = "zero of the sensor"',
        "noise_sd": f'family = "half_normal", sd = {noise}, reason = "what the model misses"',
        "noise_time": f'family = "lognormal", median = {memory}, sigma = 1.0, reason = "FIXME"',
    }
    lines += [*(f"{name} = {{ {prior} }}" for name, prior in noise_priors.items()), "\n[scatter]"]
    scatter |= {"offset": offset, "noise_sd": "0.3", "noise_time": "0.3"}
    remark = commented("from test to test: replace it by what you know")
    for name, sd in scatter.items():
        lines.append(f"{name} = {{ parameters = {_toml([name])}, sd = {sd} }}  {remark}")
    return "\n".join(lines) + "\n"


def _with_unit(value: float, unit: str) -> str:
    """A figure in TOML: a number, or a text with its unit."""
    return f"{value:.3g}" if unit == "1" else quoted(f"{in_digits(value, 3)} {unit}")
