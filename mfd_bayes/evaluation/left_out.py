"""Cross-validation: every test predicted without its part of the campaign."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from mfd_bayes.evaluation.views import LeftOutRow, LeftOutView
from mfd_bayes.runs.scores import CampaignCrossValidation, Prediction


def left_out_view(found: CampaignCrossValidation | None) -> LeftOutView | None:
    """Scores of a cross-validation that the manifest holds; None without one."""
    if found is None:
        return None
    rows = tuple(map(_row, found.predictions))
    mean = _mean(rows)
    by = found.by
    others = "the others" if by == "test" else f"those of the other {by}s"
    sentence = (
        f"Of {len(rows)} tests, each predicted from {others}, the 95 % bands hold "
        f"{100 * mean.coverage_95:.1f} % of the force, the 50 % bands "
        f"{100 * mean.coverage_50:.1f} %; they are on average {mean.width_ratio:.1f} times as "
        f"wide as those of the fitted tests.{_whole(rows)}"
    )
    return LeftOutView(by, rows, mean, sentence)


def _row(prediction: Prediction) -> LeftOutRow:
    found, fitted = prediction.score, prediction.fitted
    half, most, nearly = found.coverage
    return LeftOutRow(
        part=prediction.part,
        subject=prediction.test,
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
        whole_95=float("nan") if prediction.whole is None else float(prediction.whole),
    )


def _whole(rows: tuple[LeftOutRow, ...]) -> str:
    """How often the bands of whole histories held; empty where they were not computed."""
    held = [row.whole_95 for row in rows]
    if not np.all(np.isfinite(held)):
        return ""
    return (
        " The 95 % bands of whole histories hold the whole force of "
        f"{sum(held):.0f} of {len(held)} tests."
    )


def _ratio(predicted: float, fitted: float) -> float:
    return predicted / fitted if fitted > 0 else float("nan")


def _mean(rows: tuple[LeftOutRow, ...]) -> LeftOutRow:
    """Mean of each column."""
    names = [field.name for field in fields(LeftOutRow)][2:]
    columns = {name: float(np.mean([getattr(row, name) for row in rows])) for name in names}
    return LeftOutRow("", "mean", **columns)
