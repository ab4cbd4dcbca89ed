"""The text of a first campaign file, with a comment wherever a guess is not certain."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace

from mfd_bayes.calibration.prior_files import WRITTEN
from mfd_bayes.campaign.draft.columns import Guess
from mfd_bayes.campaign.draft.draft import Draft, TestDraft
from mfd_bayes.campaign.draft.priors import Units, knows, priors_text
from mfd_bayes.campaign.draft.toml import column, commented, quoted

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

Shared = dict[str, Guess]


def campaign_text(draft: Draft) -> str:
    """Campaign file of a draft; valid TOML whatever the names of files and columns are."""
    shared = shared_columns(draft.tests)
    name, why = priors_of(draft)
    title = draft.folder.resolve().name.encode("utf-8", "replace").decode()
    lines = [
        *("[campaign]", f"title = {quoted(title)}"),
        f"priors = {quoted(name)}  {commented(why)}",
        *(f'model = "three_stage"  {commented(_MODELS)}', "", "[columns]"),
        *(_column_line(role, shared[role]) for role in ROLES if role in shared),
    ]
    for test in draft.tests:
        lines += ["", *_test_lines(test, shared, draft)]
    if draft.left_out:
        lines += ["", "# Left out:"]
        lines += [commented(f"{file}: {reason}") for file, reason in draft.left_out]
    steps = _FIRST + _NEXT if lacks_priors(draft) else _NEXT
    return _HEAD + steps + "\n" + "\n".join(lines) + "\n"


def priors_of(draft: Draft) -> tuple[str, str]:
    """Name of the priors of a draft, and why these.

    Those of a shipped file where it knows such a device, else those that are read off the records.
    """
    name, why = _PRIORS.get(draft.unit, _OTHER)
    if not draft.scales:
        lacking = any(guess.unit is None for test in draft.tests for guess in test.columns.values())
        if lacking:
            return WRITTEN, (
                "FIXME: once the units are complete, write it by: mfd-bayes init campaign.toml"
            )
        return name, why
    if knows(name, draft.scales):
        return name, why
    return WRITTEN, "scales read off the records: no shipped file knows such a device"


def lacks_priors(draft: Draft) -> bool:
    """Whether priors are to be read off the records, and cannot yet for want of units."""
    return not draft.scales and priors_of(draft)[0] == WRITTEN


def own_priors(draft: Draft) -> str | None:
    """Text of the prior file of a draft that needs one of its own, and whose units are known."""
    if priors_of(draft)[0] != WRITTEN or not draft.scales:
        return None
    columns = [test.columns for test in draft.tests]
    units = Units(*(_usual(c[role].unit for c in columns) for role in ("force", "displacement")))
    return priors_text(draft.scales, units)


def _usual(units: Iterable[str | None]) -> str:
    return Counter(unit for unit in units if unit is not None).most_common(1)[0][0]


def doubts(draft: Draft) -> list[str]:
    """Sentences on what is not certain, each with the columns or tests that it is about."""
    shared = shared_columns(draft.tests)
    found = [("columns", doubt) for guess in shared.values() for doubt in guess.doubts]
    if draft.unit is None and priors_of(draft)[0] != WRITTEN:
        found.append(("priors", _PRIORS[None][1].removeprefix("unsure: ")))
    for test in draft.tests:
        own = [doubt for _, guess in _own_columns(test, shared) for doubt in guess.doubts]
        found += [(test.id, doubt) for doubt in (*own, *test.doubts)]
        if test.earthquake:
            found.append(
                (test.id, 'its name is that of an earthquake; role = "validate" is suggested')
            )
    return _grouped(found)


def gaps(draft: Draft) -> list[str]:
    """Sentences on what is missing and must be added, each with its columns or tests."""
    shared = shared_columns(draft.tests)
    found = [("columns", _no_unit(role, g)) for role, g in shared.items() if g.unit is None]
    for test in draft.tests:
        own = [_no_unit(role, g) for role, g in _own_columns(test, shared) if g.unit is None]
        own += [_no_actuation(test, draft)] if test.actuation is None else []
        found += [(test.id, text) for text in own]
    return _grouped(found)


def _grouped(found: Iterable[tuple[str, str]]) -> list[str]:
    """Each sentence once, with all the columns or tests that it is about."""
    subjects: dict[str, list[str]] = {}
    for subject, sentence in found:
        subjects.setdefault(sentence, []).append(subject)
    return [f"{_subjects(names)}: {sentence}" for sentence, names in subjects.items()]


def _subjects(names: list[str]) -> str:
    shown = ", ".join(names[:3])
    return shown if len(names) <= 3 else f"{shown} and {len(names) - 3} more"


def shared_columns(tests: Iterable[TestDraft]) -> Shared:
    """Most frequent column of each role that every test has, with the doubts of all tests."""
    drafts = list(tests)
    shared: Shared = {}
    for role in ROLES:
        guesses = [test.columns[role] for test in drafts if role in test.columns]
        if len(guesses) < len(drafts):
            continue
        key = Counter(guess.key for guess in guesses).most_common(1)[0][0]
        alike = [guess for guess in guesses if guess.key == key]
        told = dict.fromkeys(doubt for g in alike for doubt in g.doubts)
        lacking = "; ".join(dict.fromkeys(g.lacking for g in alike if g.lacking))
        shared[role] = replace(alike[0], doubts=tuple(told), lacking=lacking)
    return shared


def _own_columns(test: TestDraft, shared: Shared) -> Iterator[tuple[str, Guess]]:
    """Columns of a test that are not the shared ones."""
    for role in ROLES:
        guess, common = test.columns.get(role), shared.get(role)
        if guess is not None and (common is None or guess.key != common.key):
            yield role, guess


def _test_lines(test: TestDraft, shared: Shared, draft: Draft) -> Iterator[str]:
    yield "[[test]]"
    yield f"id = {quoted(test.id)}"
    yield f"file = {quoted(test.file)}"
    for doubt in test.doubts:
        yield commented(f"unsure: {doubt}")
    if test.actuation is None:
        yield commented(f"FIXME: {_no_actuation(test, draft)}")
    elif isinstance(test.actuation, Guess):
        told = column(*test.actuation.key)
        yield f"actuation = {told}  {commented('measured during the test')}"
    else:
        yield f"actuation = {quoted(test.actuation)}  {commented(test.source)}"
    for role, guess in _own_columns(test, shared):
        line = _column_line(role, guess)
        yield line if line.startswith("#") else f"columns.{line}"
    if test.earthquake:
        yield '# role = "validate"  # an earthquake by its name: to predict and score, not to fit'


def _column_line(role: str, guess: Guess) -> str:
    remarks = [f"FIXME: {_no_unit(role, guess)}"] if guess.unit is None else []
    remarks += [f"unsure: {doubt}" for doubt in guess.doubts]
    behind = f"  {commented('; '.join(remarks))}" if remarks else ""
    if not guess.name and not guess.rate:
        return f'# {role} = {{ rate = "100 Hz" }}{behind}'
    return f"{role} = {column(*guess.key)}{behind}"


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
