"""The text of a first campaign file, with a comment wherever a guess is not certain."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace

from mfd_bayes.calibration.priors import WRITTEN
from mfd_bayes.campaign.draft.columns import Guess
from mfd_bayes.campaign.draft.draft import Draft, TestDraft
from mfd_bayes.campaign.draft.priors import Units, knows, priors_text
from mfd_bayes.campaign.draft.toml import commented, quoted

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
    """Name of the priors of a draft, and why these.

    Those of a shipped file where it knows such a device, else those that are read off the records.
    """
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
        yield f"actuation = {_column(test.actuation)}  {commented('measured during the test')}"
    else:
        yield f"actuation = {quoted(test.actuation)}  {commented(test.source)}"
    for role, guess in _own_columns(test, shared):
        line = _column_line(role, guess)
        yield line if line.startswith("#") else f"columns.{line}"
    if test.earthquake:
        yield '# role = "validate"  # an earthquake by its name: to predict and score, not to fit'


def _column(guess: Guess) -> str:
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
    return f"{role} = {_column(guess)}{behind}"


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
