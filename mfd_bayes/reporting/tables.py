"""The report's tables as CSV texts."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
from collections.abc import Iterable, Sequence

import numpy as np

from mfd_bayes.evaluation.design import BASES, DesignRow
from mfd_bayes.evaluation.next_test import advice_rows
from mfd_bayes.evaluation.views import (
    CampaignView,
    Check,
    DerivedRow,
    LawChoice,
    LeftOutView,
    NoiseRow,
    ReadingRow,
    Row,
    ScoreRow,
)
from mfd_bayes.planning.study import Advice
from mfd_bayes.population.bands import Band
from mfd_bayes.population.settings import KIND_NAMES
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.noises import noted
from mfd_bayes.reporting.symbols import printable
from mfd_bayes.runs.scores import ComparisonRow
from mfd_bayes.runs.tested_range import Span
from mfd_bayes.runs.unit_system import US, System
from mfd_bayes.units import percent

_DIGITS = 6
_FORMULA = ("=", "+", "-", "@", "＝", "＋", "－", "＠")

_QUANTILES = ("mean", "sd", "q2.5", "q50", "q97.5", "ess_bulk", "ess_tail", "r_hat", "contraction")

CROSSVALIDATION = "crossvalidation.csv"


def report_tables(view: CampaignView, system: System = US) -> dict[str, str]:
    """CSV tables of a report in the units of a system, by the name of the file."""
    found = {
        "parameters.csv": parameters_csv(r for t in view.tests for r in t.rows),
        "derived.csv": derived_csv(r for t in view.tests for r in t.derived),
        "readings.csv": readings_csv(r for t in view.tests for r in t.readings),
        "noises.csv": noises_csv(r for t in view.tests for r in t.noises),
        "laws.csv": laws_csv(view.law_rows),
        "law_scores.csv": law_scores_csv(view.law_choices),
        "checks.csv": checks_csv(view.checks),
        "scores.csv": scores_csv(view.scores, system),
        "tested_range.csv": tested_csv(view.tested),
    }
    if view.left_out is not None:
        found[CROSSVALIDATION] = crossvalidation_csv(view.left_out, system)
    return found


def parameters_csv(rows: Iterable[Row]) -> str:
    """Table I of the paper with uncertainty: one line per test and parameter.

    Quantiles bound the equal-tailed 95 % interval. A cell is empty where the value is not
    defined. The note has the value under other noises too, where that choice decides it.
    """
    lines = ((*_cells(row)[:-1], noted(row)) for row in rows)
    return csv_text(("test", "parameter", "unit", *_QUANTILES, "note"), lines)


def noises_csv(rows: Iterable[NoiseRow]) -> str:
    """Every quantity under the campaign's noise and under others, and whether they decide it."""
    head = ("test", "quantity", "unit", "noise", "q2.5", "q50", "q97.5", "other_noise")
    lines = ((*dataclasses.astuple(r)[:-1], "yes" if r.decides else "no") for r in rows)
    return csv_text((*head, "other_q2.5", "other_q50", "other_q97.5", "decides"), lines)


def readings_csv(rows: Iterable[ReadingRow]) -> str:
    """Figures read off the loops, each beside the quantity that should agree with it."""
    head = ("test", "quantity", "unit", "read_off", "q2.5", "q50", "q97.5", "tolerance", "missed")
    return csv_text((*head, "largest"), (dataclasses.astuple(row)[:-1] for row in rows))  # not far


def laws_csv(rows: Iterable[Row]) -> str:
    """Table II of the paper with uncertainty: slopes, shapes and scatter."""
    return csv_text(("group", "constant", "unit", *_QUANTILES, "note"), map(_cells, rows))


def checks_csv(checks: Iterable[Check]) -> str:
    """Every check: its value, with its unit where it has one, its limit and its verdict."""
    head = ("subject", "check", "target", "value", "limit", "verdict", "size", "tolerance", "unit")
    return csv_text(head, map(dataclasses.astuple, checks))


def _scores(system: System) -> tuple[str, ...]:
    """Columns of scores, with their unit of force."""
    force = system.force
    width = ("coverage_50", "coverage_90", "coverage_95", f"width_95_{force}")
    return (*width, f"interval_score_95_{force}", f"crps_{force}", "rrse")


def scores_csv(scores: Iterable[ScoreRow], system: System = US) -> str:
    """Scores of each record's observation bands against its force."""
    return csv_text(("test", "role", *_scores(system)), map(dataclasses.astuple, scores))


def tested_csv(spans: Iterable[Span]) -> str:
    """Smallest and largest stroke, speed, frequency and actuation of the calibrated tests."""
    return csv_text(("condition", "unit", "smallest", "largest"), map(dataclasses.astuple, spans))


def crossvalidation_csv(found: LeftOutView, system: System = US) -> str:
    """Scores of each test, predicted without its part of the campaign, and their mean."""
    fitted = (f"fitted_width_95_{system.force}", f"fitted_crps_{system.force}")
    head = ("part", "test", *_scores(system), *fitted, "width_ratio", "crps_ratio", "whole_95")
    return csv_text(head, map(dataclasses.astuple, (*found.rows, found.mean)))


def next_csv(advice: Advice, system: System, actuation_unit: str) -> str:
    """Candidates for the next test, the best first, and what each is expected to tell."""
    rows = advice_rows(advice, system, actuation_unit)
    return csv_text(list(rows[0]), (list(row.values()) for row in rows))


def law_scores_csv(choices: Iterable[LawChoice]) -> str:
    """Scores of each law of each quantity at levels that were left out, best first."""
    head = ("quantity", "law", "chosen", "elpd", "elpd_se", "elpd_difference")
    lines = (
        (
            *(r.quantity, r.law, "yes" if r.chosen else "no", r.elpd, r.elpd_se),
            *(r.difference, r.difference_se, r.weight, r.pareto_k),
        )
        for choice in choices
        for r in choice.rows
    )
    return csv_text((*head, "elpd_difference_se", "weight", "pareto_k"), lines)


def derived_csv(rows: Iterable[DerivedRow]) -> str:
    """Derived quantities of every test, with equal-tailed 95 % intervals.

    A cell is empty where the record does not have the value.
    """
    head = ("test", "role", "quantity", "unit", *_QUANTILES[:5], "measured", "note")
    return csv_text(head, ((r.subject, r.role, *_derived_cells(r)) for r in rows))


def predicted_csv(rows: Iterable[DerivedRow], actuation: str, probability: float) -> str:
    """Derived quantities of a prediction, with intervals of this probability."""
    head = ("quantity", "unit", "mean", "sd", "lower", "median", "upper", "measured", "note")
    shown = tuple(rows)
    about = (
        f"# derived quantities of the damper, without offset and noise, of kind {shown[0].role}: "
        f"equal-tailed {percent(probability)} % intervals\n"
        f"# actuation {actuation}; measured: of the force in the motion's file, as it is\n"
    )
    return about + csv_text(head, map(_derived_cells, shown))


def design_csv(rows: Iterable[DesignRow], actuation: str) -> str:
    """Mean and bounding properties with their factors, by property, then by basis."""
    shown = tuple(rows)
    tail = 50.0 * (1.0 - shown[0].probability)
    head = ("property", "unit", "basis", "name", "nominal", "lower", "upper")
    lines = (
        (
            *(r.name, r.unit, r.basis, BASES[r.basis], r.nominal, r.lower, r.upper),
            *(r.lambda_min, r.lambda_max, r.note),
        )
        for r in shown
    )
    about = (
        f"# mean and bounding properties; each bound is exceeded with a probability of {tail:g} %\n"
        "# lambda: bound over the nominal value, which is the mean of the mean property\n"
        f"# actuation {actuation}\n"
    )
    return about + csv_text((*head, "lambda_min", "lambda_max", "note"), lines)


def bands_csv(trace: Trace, band: Band, about: Sequence[str], system: System) -> str:
    """Band of a prediction at every sample, with the measured force of the trace if it has one.

    Parameters
    ----------
    trace : Trace
    band : Band
    about : sequence of str
        Lines of its head, besides what the band is.
    system : System
        Of the units in the columns' names.
    """
    length, force = system.length, system.force
    columns = {"time_s": trace.time}
    columns[f"displacement_{length}"] = trace.displacement * system.factor("in")
    forces = {"force": trace.force, "lower": band.lower, "median": band.median, "upper": band.upper}
    forces |= {"whole_lower": band.whole_lower, "whole_upper": band.whole_upper}
    by = system.factor("kip")
    columns |= {f"{name}_{force}": v * by for name, v in forces.items() if v is not None}
    if band.given is not None:
        columns["given"] = band.given.holds(trace.time).astype(np.float64)
    head = (
        f"{band.interval} {percent(band.probability)} % band of kind {band.kind} "
        f"({KIND_NAMES[band.kind]}), for each sample by itself; from {band.source}",
        *(
            ["whole: band of the whole history, of the same probability"]
            * (forces["whole_lower"] is not None)
        ),
        *(["given: 1 where the force was given, 0 elsewhere"] * (band.given is not None)),
        *(f"warning: {remark}" for remark in band.remarks),
        *about,
    )
    lines = "".join(f"# {' '.join(line.split())}\n" for line in head) + ",".join(columns) + "\n"
    rows = zip(*columns.values(), strict=True)
    # times may be seconds since 1970
    cells = ([f"{time:.15g}", *(f"{value:.8g}" for value in rest)] for time, *rest in rows)
    return lines + "".join(",".join(row) + "\n" for row in cells)


def _derived_cells(row: DerivedRow) -> tuple[str | float, ...]:
    return (row.name, row.unit, *_spread(row), row.measured, row.note)


def comparison_csv(rows: Iterable[ComparisonRow]) -> str:
    """Scores of each model on unseen cycles, per test and in all."""
    head = (
        *("test", "model", "cycles", "elpd", "elpd_se", "p_loo", "worst_pareto_k", "share_bad_k"),
        *("share_unsettled", "elpd_difference", "elpd_difference_se", "rrse_in_sample"),
    )
    return csv_text(head, map(dataclasses.astuple, rows))


def _cells(row: Row) -> tuple[str | float, ...]:
    sampler = (row.ess_bulk, row.ess_tail, row.r_hat, row.contraction)
    return (row.subject, row.name, row.unit, *_spread(row), *sampler, row.note)


def _spread(row: Row | DerivedRow) -> tuple[float, ...]:
    return (row.mean, row.sd, row.lower, row.median, row.upper)


def csv_text(head: Sequence[str], lines: Iterable[Sequence[str | float]]) -> str:
    """A table as CSV: numbers with six digits, and no text that a spreadsheet runs."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows([_cell(value) for value in line] for line in lines)
    return text.getvalue()


def _cell(value: str | float) -> str:
    """A number with six digits, or a text that no spreadsheet takes for a formula."""
    if isinstance(value, str):
        text = printable(value)
        return f"'{text}" if text.lstrip().startswith(_FORMULA) else text
    return "" if math.isnan(value) else f"{value:.{_DIGITS}g}"
