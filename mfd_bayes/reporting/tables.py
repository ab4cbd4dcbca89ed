"""The report's tables as CSV texts."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
from collections.abc import Iterable, Sequence

from mfd_bayes.assessment.views import (
    CampaignView,
    Check,
    DerivedRow,
    LawChoice,
    LeftOutView,
    ReadingRow,
    Row,
    ScoreRow,
)
from mfd_bayes.population.predict import Band
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.symbols import printable
from mfd_bayes.runs.results import ComparisonRow
from mfd_bayes.units import percent

_DIGITS = 6
_FORMULA = ("=", "+", "-", "@", "＝", "＋", "－", "＠")

_QUANTILES = ("mean", "sd", "q2.5", "q50", "q97.5", "ess_bulk", "ess_tail", "r_hat", "contraction")
_SCORES = (
    *("coverage_50", "coverage_90", "coverage_95", "width_95_kip"),
    *("interval_score_95_kip", "crps_kip", "rrse"),
)

CROSSVALIDATION = "crossvalidation.csv"


def report_tables(view: CampaignView) -> dict[str, str]:
    """CSV tables of the report, by the name of the file."""
    found = {
        "parameters.csv": parameters_csv(r for t in view.tests for r in t.rows),
        "derived.csv": derived_csv(r for t in view.tests for r in t.derived),
        "readings.csv": readings_csv(r for t in view.tests for r in t.readings),
        "laws.csv": laws_csv(view.law_rows),
        "law_scores.csv": law_scores_csv(view.law_choices),
        "checks.csv": checks_csv(view.checks),
        "scores.csv": scores_csv(view.scores),
    }
    if view.left_out is not None:
        found[CROSSVALIDATION] = crossvalidation_csv(view.left_out)
    return found


def parameters_csv(rows: Iterable[Row]) -> str:
    """Table I of the paper with uncertainty: one line per test and parameter.

    Quantiles bound the equal-tailed 95 % interval. A cell is empty where the value is not
    defined.
    """
    return csv_text(("test", "parameter", "unit", *_QUANTILES, "note"), map(_cells, rows))


def readings_csv(rows: Iterable[ReadingRow]) -> str:
    """Figures read off the loops, each beside the quantity that should agree with it."""
    head = ("test", "quantity", "unit", "read_off", "q2.5", "q50", "q97.5", "tolerance", "missed")
    return csv_text((*head, "largest"), map(dataclasses.astuple, rows))


def laws_csv(rows: Iterable[Row]) -> str:
    """Table II of the paper with uncertainty: slopes, shapes and scatter."""
    return csv_text(("group", "constant", "unit", *_QUANTILES, "note"), map(_cells, rows))


def checks_csv(checks: Iterable[Check]) -> str:
    """Every check: its value, its limit and its verdict."""
    head = ("subject", "check", "target", "value", "limit", "verdict", "size", "tolerance")
    return csv_text(head, map(dataclasses.astuple, checks))


def scores_csv(scores: Iterable[ScoreRow]) -> str:
    """Scores of each record's observation bands against its force."""
    return csv_text(("test", "role", *_SCORES), map(dataclasses.astuple, scores))


def crossvalidation_csv(found: LeftOutView) -> str:
    """Scores of each test, predicted without its part of the campaign, and their mean."""
    ratios = ("fitted_width_95_kip", "fitted_crps_kip", "width_ratio", "crps_ratio")
    head = ("part", "test", *_SCORES, *ratios, "whole_95")
    return csv_text(head, map(dataclasses.astuple, (*found.rows, found.mean)))


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


def bands_csv(trace: Trace, band: Band, actuation: str) -> str:
    """Band of a prediction at every sample, in s, in and kip, and of the whole history if any."""
    whole = [bound for bound in (band.whole_lower, band.whole_upper) if bound is not None]
    more = ",whole_lower_kip,whole_upper_kip" if whole else ""
    about = (
        f"# {band.interval} {percent(band.probability)} % band of kind {band.kind}, for each "
        f"sample by itself; from {band.source}\n"
        + ("# whole: band of the whole history, of the same probability\n" if whole else "")
        + "".join(f"# warning: {' '.join(remark.split())}\n" for remark in band.remarks)
        + f"# actuation {actuation}\n"
        f"time_s,displacement_in,lower_kip,median_kip,upper_kip{more}\n"
    )
    columns = (trace.time, trace.displacement, band.lower, band.median, band.upper, *whole)
    rows = zip(*columns, strict=True)
    return about + "".join(",".join(f"{value:.8g}" for value in row) + "\n" for row in rows)


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
