"""What each test may be used for, and why: in words, the worst first."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from mfd_bayes.evaluation.checks import CALIBRATION, MODES, SAMPLING, SHOWN
from mfd_bayes.evaluation.views import COVERAGE, NOISE, PREDICTIVE, READING, Check, Judgement
from mfd_bayes.runs.findings import Finding
from mfd_bayes.runs.verdict import Use, Verdict

MILD = 3.0
"""Doubt, in tolerances, that a fault of a record gives which does not spoil it."""

_SPOILS, _LOST, _UNREACHED, _UNLIKE = 1000.0, 2000.0, 500.0, 100.0

_HINTS = {
    "residual rms": "the noise model is not that of the record, or the model lacks something",
    "lag-one residual correlation": "the noise model is not that of the record",
    "energy": (
        "the area of the loop is not the model's: the device changes during the test, or parts of "
        "the record differ"
    ),
    "peak force": "spikes at build-up that the model does not have, or a force that drifts",
    "force at mid-gap": "the gap is not as in the model",
    "coverage": "the bands are too narrow for this record",
}


def judge(
    subjects: Iterable[str], checks: Sequence[Check], findings: Sequence[Finding]
) -> tuple[Judgement, ...]:
    """Judgement of each test, the one to believe least first.

    Doubt is counted in tolerances: 1 where the model misses a figure by as much as its tolerance.
    What is wrong with the record itself counts more than any misfit.
    """
    found = []
    for subject in subjects:
        own = [check for check in checks if check.subject == subject]
        told = [f for f in findings if f.subject == subject and f.name != NOISE]
        aside = [str(f.message) for f in findings if f.subject == subject and f.name == NOISE]
        found.append(_judge(subject, own, told, aside))
    return tuple(sorted(found, key=lambda j: -j.doubt))


def _judge(
    subject: str, checks: Sequence[Check], findings: Sequence[Finding], aside: Sequence[str]
) -> Judgement:
    """Judgement of one test from its own checks and warnings, and what is to be said besides."""
    missed = sorted(
        (c for c in checks if _is_of_fit(c) and c.verdict in (Verdict.CARE, Verdict.FAIL)),
        key=lambda check: -doubt_of(check),
    )
    reasons: list[tuple[float, str]] = [*_of_record(findings, missed), *_of_sampler(checks)]
    reasons += _of_readings(checks)
    counted = bool(missed) and not any(f.spoils for f in findings)
    if counted:
        reasons.append((doubt_of(missed[0]), _misses(missed)))
    failed = {c.name for c in checks if c.verdict == Verdict.FAIL}
    wrong = any(f.spoils for f in findings) or bool(failed - set(SAMPLING))
    use = Use.NOT_USABLE if wrong or failed else Use.WITH_CARE if reasons else Use.USABLE
    reasons.sort(key=lambda reason: -reason[0])
    told = "; ".join(words for _, words in reasons)
    least = max((doubt_of(c) for c in checks if _is_of_fit(c)), default=0.0)
    doubt = sum(size for size, _ in reasons) if reasons else min(least, 1.0)
    if reasons and not counted:  # else the worst misfit is one of the reasons
        doubt += least
    return Judgement(subject, use, told, doubt, wrong, "; ".join(_notes(checks, aside)))


def _is_of_fit(check: Check) -> bool:
    return check.name in (PREDICTIVE, COVERAGE)


def doubt_of(check: Check) -> float:
    """Size of a miss over its tolerance; of a band, only what is missing inside."""
    size = -check.size if check.name == COVERAGE else abs(check.size)
    return max(float(size / check.tolerance), 0.0) if np.isfinite(check.tolerance) else 0.0


def _of_record(findings: Sequence[Finding], missed: Sequence[Check]) -> Iterable[tuple[float, str]]:
    """What is wrong with the record, after the figure that shows it best."""
    for number, finding in enumerate(sorted(findings, key=lambda f: not f.spoils)):
        shows = finding.spoils and finding.name != "time unit"  # no clock changes an energy
        shown = f"{miss_of(missed[0])}: " if missed and number == 0 and shows else ""
        yield (_SPOILS if finding.spoils else MILD), f"{shown}{finding.message}"


def _of_sampler(checks: Sequence[Check]) -> Iterable[tuple[float, str]]:
    """Sampling that did not reach its targets, a test that was lost, and several modes."""
    if any(check.name == CALIBRATION for check in checks):
        yield _LOST, "it could not be calibrated"
    if any(check.name == SHOWN for check in checks):
        yield _LOST, "it could not be shown in the report"
    short = [c for c in checks if c.name in SAMPLING and c.verdict == Verdict.FAIL]
    if short:
        more = f" and {len(short) - 1} more" if short[1:] else ""
        first = f"{short[0].name} of {short[0].target}{more}"
        yield _UNREACHED, f"the sampling did not reach its targets ({first})"
    for check in (c for c in checks if c.name == MODES and c.verdict == Verdict.CARE):
        yield MILD, f"{check.value:.0f} different sets of parameters explain it{_held(check)}"


def _of_readings(checks: Sequence[Check]) -> Iterable[tuple[float, str]]:
    """Slip forces that are far from what is read off the loop, and whether the band is usable."""
    far = [c.target for c in checks if c.name == READING and c.verdict == Verdict.FAIL]
    if far:
        bands = [c for c in checks if c.name == COVERAGE]
        holds = bands and all(c.verdict in (Verdict.PASS, Verdict.NOTE) for c in bands)
        use = "its band is usable, its parameters are not" if holds else "do not use its parameters"
        yield (
            _UNLIKE,
            f"{use}: a slip force is far from what is read off the loop, so that the noise stands "
            f"in for friction: {'; '.join(far)}",
        )


def _notes(checks: Sequence[Check], aside: Sequence[str]) -> list[str]:
    """What a reader must know of a test besides.

    Modes of little weight, readings that are missed, and what the noise model decides.
    """
    modes = [
        f"note: {check.value:.0f} sets of parameters explain it, but nearly all draws belong to "
        f"one of them{_held(check)}"
        for check in checks
        if check.name == MODES and check.verdict == Verdict.NOTE
    ]
    missed = [c.target for c in checks if c.name == READING and c.verdict == Verdict.NOTE]
    if missed:
        modes.append(f"note: differs from what is read off the loop: {'; '.join(missed)}")
    return modes + [f"note: {sentence}" for sentence in aside]


def _held(check: Check) -> str:
    """Shares of the draws that the modes have: " (97 %, 3 % of the draws)"."""
    return check.target.removeprefix("posterior")


def miss_of(check: Check) -> str:
    """What the model misses: "energy per cycle -5.31 kip·in where 0.299 kip·in is expected"."""
    name, _, seen = check.target.partition(" (observed ")
    what, _, unit = name.partition(", ")
    figures = seen.rstrip(")").split(", ")
    measured = f" {unit}" if unit else ""
    if check.name == COVERAGE:
        return f"{what}: {float(figures[0]):.0%} of the samples are inside"
    expected = figures[1].removeprefix("expected ")
    return f"{what} {figures[0]}{measured} where {expected}{measured} is expected"


def _misses(missed: Sequence[Check]) -> str:
    """The worst miss with its likely cause, then the others in few words."""
    worst = missed[0]
    name = worst.target.split(" (")[0]
    cause = next((text for start, text in _HINTS.items() if name.startswith(start)), "")
    observed = worst.target.partition("(observed ")[2]
    if name.startswith("energy") and observed.startswith("-"):
        cause = "the sign of the force or of the displacement is probably swapped"
    sizes = f"{abs(worst.size):.0%} off, tolerance {worst.tolerance:.0%}"
    others = ", ".join(miss_of(check) for check in missed[1:3])
    more = f", and {len(missed) - 3} more" if missed[3:] else ""
    also = f"; also {others}{more}" if others else ""
    return f"{miss_of(worst)} ({sizes}): {cause}{also}"


def least_believed(judged: Sequence[Judgement]) -> str:
    """Which test to believe least; "" where there is none to compare it with."""
    if len(judged) < 2:
        return ""
    worst, second = judged[:2]
    if worst.use == Use.USABLE:
        return f"no test stands out; the model fits {worst.subject} least well"
    alone = "" if second.doubt < worst.doubt else f" (as little as {second.subject})"
    return f"the test to believe least is {worst.subject}{alone}"


def use_of(judged: Iterable[Judgement], checks: Iterable[Check]) -> Use:
    """What the whole run may be used for: as its worst test, check or law."""
    verdicts = {check.verdict for check in checks}
    found = {j.use for j in judged}
    if Verdict.FAIL in verdicts or Use.NOT_USABLE in found:
        return Use.NOT_USABLE
    return Use.WITH_CARE if Verdict.CARE in verdicts or Use.WITH_CARE in found else Use.USABLE
