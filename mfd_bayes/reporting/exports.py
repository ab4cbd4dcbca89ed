"""Tables for other programs and for papers: JSON and LaTeX."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from typing import Any

from mfd_bayes.evaluation.views import CampaignView, NoiseRow, Row
from mfd_bayes.reporting.latex import laws_tex, parameters_tex

INTERVAL = {"kind": "equal-tailed", "probability": 0.95}
_FIGURES = (
    *("mean", "sd", "lower", "median", "upper"),
    *("ess_bulk", "ess_tail", "r_hat", "contraction"),
)


def export_tables(view: CampaignView) -> dict[str, str]:
    """Tables of parameters and laws as JSON and LaTeX, by the name of the file."""
    rows = [row for test in view.tests for row in test.rows]
    return {
        "parameters.json": _json(view, "parameters", "test", "parameter", rows),
        "laws.json": _json(view, "laws", "group", "constant", view.law_rows),
        "parameters.tex": parameters_tex(view),
        "laws.tex": laws_tex(view),
    }


def _json(view: CampaignView, what: str, subject: str, name: str, rows: Iterable[Row]) -> str:
    """JSON of rows with the meaning of their figures; null where one is not finite."""
    content = {
        "title": view.title,
        "table": what,
        "interval": INTERVAL | {"bounds": ["lower", "upper"]},
        "null": "not defined, or not finite",
        "rows": [
            {subject: row.subject, name: row.name, "unit": row.unit, **_figures(row)}
            | {"note": row.note}
            | {"other_noises": [_other(other) for other in row.others]}
            for row in rows
        ],
    }
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def _other(row: NoiseRow) -> dict[str, Any]:
    """A value under another noise, where that choice decides it."""
    figures = {"lower": row.other_lower, "median": row.other_median, "upper": row.other_upper}
    return {"noise": row.other} | {k: float(f"{v:.6g}") for k, v in figures.items()}


def _figures(row: Row) -> dict[str, Any]:
    """Figures with six digits, as in the CSV tables."""
    values = {figure: float(getattr(row, figure)) for figure in _FIGURES}
    return {k: float(f"{v:.6g}") if math.isfinite(v) else None for k, v in values.items()}
