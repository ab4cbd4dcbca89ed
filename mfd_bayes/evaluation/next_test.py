"""The advice on the next test in words, and as a table in the units of a system."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mfd_bayes.planning.candidate import AT_MOTIONS, GAP, Candidate, typical_of
from mfd_bayes.planning.study import CURVE, TOGETHER, Advice, Row, Together
from mfd_bayes.runs.unit_system import System

LITTLE = 0.01
"""A test that is expected to narrow the band by less than this share is not worth the frame."""

FEW = 2
"""Motions of a goal that are named in its sentence."""

_SURE = 1.96  # errors of a 95 % interval

_COUNT = ("none", "one", "two", "three", "four", "five", "six")


def candidate_words(candidate: Candidate, system: System, unit: str) -> str:
    """A test in words: "1350 psi, 0.5 Hz, 1 in", with its waveform where it is no sine."""
    axes, parts = system.axes, [system.words([candidate.amplitude], "in", 3)]
    if axes.timed:
        parts.insert(0, f"{candidate.frequency:.3g} Hz")
    if axes.actuated:
        parts.insert(0, system.words([candidate.actuation], unit, actuation=True))
    parts += [f"on {candidate.device}"] if candidate.device else []
    text = ", ".join(parts)
    return text if candidate.waveform == "sine" else f"{text}, {candidate.waveform}"


def goal_words(advice: Advice, system: System, unit: str) -> str:
    """What is to be known better, in words."""
    goal = advice.goal
    if goal.quantity == "band":
        scatter = ", with test-to-test scatter," if goal.kind == "new_test" else ""
        what = f"the {100 * goal.probability:.3g} % band{scatter}"
    else:
        what = f"the {100 * goal.probability:.3g} % interval of the {system.text(goal.words)}"
    if goal.quantity not in AT_MOTIONS or (goal.quantity == GAP):
        return what
    if not goal.at:
        return f"{what} over the campaign's range"
    places = goal.places(typical_of(advice.tests))
    names = list(dict.fromkeys(candidate_words(place, system, unit) for place in places))
    if len(names) <= FEW:
        return f"{what} at {' and '.join(names)}"
    return f"{what} at {len(names)} places from {names[0]} to {names[-1]}"


def advice_sentence(advice: Advice, system: System, unit: str) -> str:
    """Which test to make next, what it is expected to tell, and when it is enough."""
    best, goal = advice[0], goal_words(advice, system, unit)
    scatter = ""
    if advice.goal.kind == "new_test":
        scatter = " This band contains test-to-test scatter, which no further test can reduce."
    if best.reduction < LITTLE:
        return (
            f"No test on this list is expected to narrow {goal} by more than "
            f"{100 * LITTLE:.0f} %: the tests are enough for this goal.{scatter}"
        )
    test = candidate_words(best.candidate, system, unit)
    text = f"One test at {test} is expected to narrow {goal} by {in_percent(best)}"
    again = next((row for row in advice if row.repeat), None)
    if again is not None and again is not best:
        old = candidate_words(again.candidate, system, unit)
        text += f"; repeating {old} by {in_percent(again)}"
    elif again is best:
        text += "; that repeats a test that was made"
    enough, steps = "", [t.reduction for t in advice.together]
    if len(steps) > TOGETHER:
        after = max(100 * (steps[TOGETHER] - steps[TOGETHER - 1]), 0.5)
        enough = (
            f"After {_COUNT[TOGETHER]} more tests no further test on this list gains more than "
            f"{after:.2g} % of today's width."
        )
    return f"{text}. {enough}{scatter}"


def in_percent(row: Row | Together) -> str:
    """Expected reduction with its 95 % interval: "18 % (14 to 22)"."""
    low, high = max(0.0, row.reduction - _SURE * row.error), row.reduction + _SURE * row.error
    digits = 0 if row.reduction >= 0.1 else 1
    figures = (f"{100 * share:.{digits}f}" for share in (row.reduction, low, min(1.0, high)))
    return "{} % ({} to {})".format(*figures)


def together_words(advice: Advice, system: System, unit: str) -> list[str]:
    """The best two and three tests together, a sentence each."""
    sentences = []
    for together in advice.together[1:TOGETHER]:
        tests = "; ".join(candidate_words(c, system, unit) for c in together.candidates)
        count = _COUNT[len(together.candidates)]
        sentences.append(f"The best {count} together, {in_percent(together)}: {tests}.")
    return sentences


def advice_rows(advice: Advice, system: System, unit: str) -> list[dict[str, str | float]]:
    """Rows of the table, the best first, and then what the limits rule out; by column."""
    by, name = system.of_actuation(unit)
    figures = {
        "expected_reduction": "reduction",
        "error": "error",
        "cost_h": "",
        "reduction_per_h": "per_hour",
        "information_nat": "information",
        "information_error": "information_error",
    }
    entries: list[tuple[Candidate, Row | None, str]] = [(row.candidate, row, "") for row in advice]
    entries += [(candidate, None, why) for candidate, why in advice.ruled_out]
    rows = []
    for candidate, score, why in entries:
        row: dict[str, str | float] = {"candidate": candidate_words(candidate, system, unit)}
        for column, field in figures.items():
            row[column] = getattr(score, field) if score and field else float("nan")
        row |= {
            "cost_h": candidate.cost,
            f"actuation_{name}": candidate.actuation * by,
            "frequency_Hz": candidate.frequency,
            system.column("amplitude", "in"): candidate.amplitude * system.factor("in"),
            "cycles": candidate.cycles,
            "waveform": candidate.waveform,
            "repeats_a_test": "" if score is None else "yes" if score.repeat else "no",
            "ruled_out_by": why,
        }
        rows.append(row)
    if any(candidate.device for candidate, _, _ in entries):
        rows = [
            row | {"device": candidate.device}
            for row, (candidate, _, _) in zip(rows, entries, strict=True)
        ]
    lost = {f"actuation_{name}": not system.axes.actuated, "frequency_Hz": not system.axes.timed}
    return [{key: value for key, value in row.items() if not lost.get(key)} for row in rows]


def advice_content(advice: Advice, system: System, unit: str) -> dict[str, Any]:
    """Everything of the advice, for JSON."""
    factor = system.factor(advice.unit)
    return {
        "goal": goal_words(advice, system, unit),
        "unit": system.unit(advice.unit),
        "width_now": advice.width * factor,
        "draws": advice.draws,
        "sentence": advice_sentence(advice, system, unit),
        "remarks": list(advice.remarks),
        "candidates": advice_rows(advice, system, unit),
        "together": [
            {
                "candidates": [candidate_words(c, system, unit) for c in together.candidates],
                "expected_reduction": together.reduction,
                "error": together.error,
                "information_nat": together.information,
                "cost_h": sum(c.cost for c in together.candidates),
            }
            for together in advice.together[:TOGETHER]
        ],
        "curve": [
            {"tests": number, "expected_width": float(width) * factor}
            for number, width in enumerate(advice.curve[: CURVE + 1])
        ],
    }


def shown_rows(advice: Advice, system: System, unit: str, most: int) -> Sequence[tuple[str, ...]]:
    """Cells of the first rows, and of the best repeat, as a terminal shows them."""
    chosen = list(advice[:most])
    again = next((row for row in advice if row.repeat), None)
    if again is not None and again not in chosen:
        chosen.append(again)
    return [
        (
            candidate_words(row.candidate, system, unit),
            in_percent(row),
            f"{row.cost:.2f}",
            f"{100 * row.per_hour:.1f} %",
            f"{row.information:.3f} ± {row.information_error:.3f}",
            "yes" if row.repeat else "",
        )
        for row in chosen
    ]
