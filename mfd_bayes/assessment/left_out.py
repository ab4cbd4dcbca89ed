"""Cross-validation: every test predicted without its part of the campaign."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from mfd_bayes.assessment.views import LeftOutRow, LeftOutView
from mfd_bayes.validation.scores import Score


def left_out_view(stored: Mapping[str, Any] | None) -> LeftOutView | None:
    """Scores of the cross-validation that a manifest holds; None without one."""
    if not stored:
        return None
    rows = tuple(_row(entry) for entry in stored["predictions"])
    mean = _mean(rows)
    by = stored["by"]
    others = "the others" if by == "test" else f"those of the other {by}s"
    sentence = (
        f"Of {len(rows)} tests, each predicted from {others}, the 95 % bands hold "
        f"{100 * mean.coverage_95:.1f} % of the force, the 50 % bands "
        f"{100 * mean.coverage_50:.1f} %; they are on average {mean.width_ratio:.1f} times as "
        "wide as those of the fitted tests."
    )
    return LeftOutView(by, rows, mean, sentence)


def _row(entry: Mapping[str, Any]) -> LeftOutRow:
    found, fitted = Score.of(entry["score"]), Score.of(entry["fitted"])
    half, most, nearly = found.coverage
    return LeftOutRow(
        part=entry["part"],
        subject=entry["test"],
        coverage_50=half,
        coverage_90=most,
        coverage_95=nearly,
        width_95=found.width,
        interval_score=found.interval_score,
        crps=found.crps,
        rrse=found.rrse,
        fitted_width=fitted.width,
        fitted_crps=fitted.crps,
        width_ratio=_ratio(found.width, fitted.width),
        crps_ratio=_ratio(found.crps, fitted.crps),
    )


def _ratio(predicted: float, fitted: float) -> float:
    return predicted / fitted if fitted > 0 else float("nan")


def _mean(rows: tuple[LeftOutRow, ...]) -> LeftOutRow:
    """Mean of each column."""
    names = [field.name for field in fields(LeftOutRow)][2:]
    columns = {name: float(np.mean([getattr(row, name) for row in rows])) for name in names}
    return LeftOutRow("", "mean", **columns)
