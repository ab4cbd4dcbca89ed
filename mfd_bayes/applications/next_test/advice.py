"""The advice on the next test: in words, as a table in the units of a system, and as a figure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from mfd_bayes.applications.next_test.study import CURVE, TOGETHER, Advice, Together
from mfd_bayes.applications.next_test.study import Row as AdviceRow
from mfd_bayes.campaign.candidate import AT_MOTIONS, GAP, Candidate, typical_of
from mfd_bayes.reporting.figures import new_figure, style
from mfd_bayes.reporting.page import Addition
from mfd_bayes.reporting.symbols import DATA
from mfd_bayes.reporting.tables import table_of, to_csv
from mfd_bayes.runs.unit_system import UnitSystem

LITTLE = 0.01
"""A test that is expected to narrow the band by less than this share is not worth the frame."""

FEW = 2
"""Motions of a goal that are named in its sentence."""

_SURE = 1.96  # errors of a 95 % interval

_COUNT = ("none", "one", "two", "three", "four", "five", "six")


def in_percent(row: AdviceRow | Together) -> str:
    """Expected reduction with its 95 % interval: "18 % (14 to 22)"."""
    low, high = max(0.0, row.reduction - _SURE * row.error), row.reduction + _SURE * row.error
    digits = 0 if row.reduction >= 0.1 else 1
    figures = (f"{100 * share:.{digits}f}" for share in (row.reduction, low, min(1.0, high)))
    return "{} % ({} to {})".format(*figures)


@dataclass(frozen=True, eq=False)
class AdviceInWords:
    """Advice on the next test for a reader; `unit` is the internal one of the actuation."""

    advice: Advice
    system: UnitSystem
    unit: str

    def candidate(self, candidate: Candidate) -> str:
        """A test in words: "1350 psi, 0.5 Hz, 1 in", with its waveform where it is no sine."""
        axes, fields = self.system.axes, [self.system.words([candidate.amplitude], "in", 3)]
        if axes.timed:
            fields.insert(0, f"{candidate.frequency:.3g} Hz")
        if axes.actuated:
            fields.insert(0, self.system.words([candidate.actuation], self.unit, actuation=True))
        fields += [f"on {candidate.device}"] if candidate.device else []
        text = ", ".join(fields)
        return text if candidate.waveform == "sine" else f"{text}, {candidate.waveform}"

    @property
    def goal(self) -> str:
        """What is to be known better, in words."""
        goal = self.advice.goal
        if goal.quantity == "band":
            scatter = ", with test-to-test scatter," if goal.kind == "new_test" else ""
            text = f"the {100 * goal.probability:.3g} % band{scatter}"
        else:
            words = self.system.text(goal.words)
            text = f"the {100 * goal.probability:.3g} % interval of the {words}"
        if goal.quantity not in AT_MOTIONS or (goal.quantity == GAP):
            return text
        if not goal.at:
            return f"{text} over the campaign's range"
        places = goal.places(typical_of(self.advice.tests))
        names = list(dict.fromkeys(self.candidate(test) for test in places))
        if len(names) <= FEW:
            return f"{text} at {' and '.join(names)}"
        return f"{text} at {len(names)} places from {names[0]} to {names[-1]}"

    @property
    def sentence(self) -> str:
        """Which test to make next, what it is expected to tell, and when it is enough."""
        best, goal = self.advice[0], self.goal
        scatter = ""
        if self.advice.goal.kind == "new_test":
            scatter = " This band contains test-to-test scatter, which no further test can reduce."
        if best.reduction < LITTLE:
            return (
                f"No test on this list is expected to narrow {goal} by more than "
                f"{100 * LITTLE:.0f} %: the tests are enough for this goal.{scatter}"
            )
        test = self.candidate(best.candidate)
        text = f"One test at {test} is expected to narrow {goal} by {in_percent(best)}"
        again = next((row for row in self.advice if row.repeat), None)
        if again is not None and again is not best:
            repeat = self.candidate(again.candidate)
            text += f"; repeating {repeat} by {in_percent(again)}"
        elif again is best:
            text += "; that repeats a test that was made"
        enough, steps = "", [t.reduction for t in self.advice.together]
        if len(steps) > TOGETHER:
            gain = max(100 * (steps[TOGETHER] - steps[TOGETHER - 1]), 0.5)
            enough = (
                f"After {_COUNT[TOGETHER]} more tests no further test on this list gains more than "
                f"{gain:.2g} % of today's width."
            )
        return f"{text}. {enough}{scatter}"

    @property
    def together(self) -> list[str]:
        """The best two and three tests together, a sentence each."""
        sentences = []
        for together in self.advice.together[1:TOGETHER]:
            tests = "; ".join(self.candidate(c) for c in together.candidates)
            count = _COUNT[len(together.candidates)]
            sentences.append(f"The best {count} together, {in_percent(together)}: {tests}.")
        return sentences

    def rows(self) -> list[dict[str, str | float]]:
        """Rows of the table, the best first, and then what the limits rule out; by column."""
        axes, (factor, name) = self.system.axes, self.system.of_actuation(self.unit)
        entries: list[tuple[Candidate, AdviceRow | None, str]] = [
            (r.candidate, r, "") for r in self.advice
        ]
        entries += [(candidate, None, reason) for candidate, reason in self.advice.ruled_out]
        devices = any(candidate.device for candidate, _, _ in entries)
        rows = []
        for candidate, score, reason in entries:
            row: dict[str, str | float] = {
                "candidate": self.candidate(candidate),
                "expected_reduction": score.reduction if score else math.nan,
                "error": score.error if score else math.nan,
                "cost_h": candidate.cost,
                "reduction_per_h": score.per_hour if score else math.nan,
                "information_nat": score.information if score else math.nan,
                "information_error": score.information_error if score else math.nan,
            }
            if axes.actuated:
                row[f"actuation_{name}"] = candidate.actuation * factor
            if axes.timed:
                row["frequency_Hz"] = candidate.frequency
            amplitude = candidate.amplitude * self.system.factor("in")
            row |= {
                self.system.column("amplitude", "in"): amplitude,
                "cycles": candidate.cycles,
                "waveform": candidate.waveform,
                "repeats_a_test": "" if score is None else "yes" if score.repeat else "no",
                "ruled_out_by": reason,
            }
            rows.append(row | {"device": candidate.device} if devices else row)
        return rows

    def content(self) -> dict[str, Any]:
        """Everything of the self.advice, for JSON."""
        factor = self.system.factor(self.advice.unit)
        return {
            "goal": self.goal,
            "unit": self.system.unit(self.advice.unit),
            "width_now": self.advice.width * factor,
            "draws": self.advice.draws,
            "sentence": self.sentence,
            "remarks": list(self.advice.remarks),
            "candidates": self.rows(),
            "together": [
                {
                    "candidates": [self.candidate(c) for c in together.candidates],
                    "expected_reduction": together.reduction,
                    "error": together.error,
                    "information_nat": together.information,
                    "cost_h": sum(c.cost for c in together.candidates),
                }
                for together in self.advice.together[:TOGETHER]
            ],
            "curve": [
                {"tests": number, "expected_width": float(width) * factor}
                for number, width in enumerate(self.advice.curve[: CURVE + 1])
            ],
        }

    def section(self) -> Addition:
        """Its section of a report."""
        figure = draw_next(self.advice, self.system, self.unit, "Which test next")
        return Addition("next", self, {table_of("next"): next_csv(self)}, figure)

    def shown(self, count: int) -> list[tuple[str, ...]]:
        """Cells of the first rows, and of the best repeat, as a terminal shows them."""
        rows = list(self.advice[:count])
        again = next((row for row in self.advice if row.repeat), None)
        if again is not None and again not in rows:
            rows.append(again)
        return [
            (
                self.candidate(row.candidate),
                in_percent(row),
                f"{row.cost:.2f}",
                f"{100 * row.per_hour:.1f} %",
                f"{row.information:.3f} ± {row.information_error:.3f}",
                "yes" if row.repeat else "",
            )
            for row in rows
        ]


def next_csv(advice: AdviceInWords) -> str:
    """Candidates for the next test, the best first, and what each is expected to tell."""
    import pandas as pd

    return to_csv(pd.DataFrame(advice.rows()))


@style()
def draw_next(advice: Advice, system: UnitSystem, unit: str, title: str) -> Any:
    """Candidates by actuation and frequency, coloured by gain, and the curve of the width."""
    from matplotlib.ticker import MaxNLocator, ScalarFormatter

    figure = new_figure(8.6, 3.6)
    figure.suptitle(title, x=0.01, ha="left", wrap=True, fontsize=9)
    map_axes, curve_axes = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    factor, name = system.of_actuation(unit)
    gains: dict[tuple[float, float], float] = {}  # of the best amplitude
    for row in reversed([*advice]):
        gains[row.candidate.actuation * factor, row.candidate.frequency] = 100.0 * row.reduction
    shades: dict[str, Any] = {"cmap": "YlGnBu", "vmin": 0.0, "edgecolors": "#888888"}
    points = map_axes.scatter(
        *zip(*gains, strict=True), s=130, c=[*gains.values()], lw=0.5, **shades
    )
    best = advice[0].candidate
    ring: dict[str, Any] = {"mfc": "none", "mec": DATA, "mew": 1.6, "ms": 15}
    map_axes.plot(best.actuation * factor, best.frequency, "o", label="best", **ring)
    levels = [test.actuation * factor for test in advice.tests]
    frequencies = [test.frequency for test in advice.tests]
    map_axes.plot(levels, frequencies, "x", color="#c0392b", ms=5, label="tests made")
    map_axes.set_yscale("log")
    map_axes.yaxis.set_major_formatter(ScalarFormatter())
    map_axes.yaxis.set_minor_formatter(ScalarFormatter())
    map_axes.set(xlabel=f"actuation, {name}", ylabel="frequency, Hz")
    map_axes.set_title("Expected reduction, best amplitude")
    map_axes.margins(0.12)
    map_axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2)
    figure.colorbar(points, ax=map_axes, label="%")
    curve = advice.curve * system.factor(advice.unit)
    arms = curve[0] * np.array([0.0, *(1.96 * t.error for t in advice.together)])
    steps = np.arange(curve.size)
    curve_axes.errorbar(steps, curve, arms, fmt="o-", color=DATA, markersize=4, capsize=2)
    curve_axes.set_ylim(0.0, 1.1 * float(np.max(curve + arms)))
    curve_axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    curve_axes.set_xlabel("further tests, the best together")
    curve_axes.set_ylabel(f"expected width, {system.unit(advice.unit)}")
    curve_axes.set_title("When it is enough")
    return figure
