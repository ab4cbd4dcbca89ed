"""The files of a response of a building: a page, tables and pictures in a folder of their own."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from mfd_bayes.reporting.response import (
    ResponseView,
    draws_csv,
    limits_csv,
    peaks_csv,
    peaks_tex,
    render_response,
    response_json,
    shares_csv,
    sweep_csv,
)
from mfd_bayes.response.result import Response
from mfd_bayes.response.sweep import Sweep
from mfd_bayes.runs.unit_system import SYSTEMS, US, System
from mfd_bayes.store.files import remove_file, write_bytes, write_text

MARKER = "response.json"
"""What the response is of, for other programs."""

_SOMETIMES = re.compile(r"sweep\.(csv|png)|(history|loops)_\d+\.png")
"""Names of the files that not every response has."""


def write_response(
    folder: Path, response: Response, sweep: Sweep | None, view: ResponseView, system: System
) -> None:
    """Write page, tables and pictures; what an earlier response left beside them is removed.

    Raises
    ------
    StoreError
        When something cannot be written or removed.
    """
    from mfd_bayes.reporting.figures import to_png
    from mfd_bayes.reporting.figures.response import figures_of

    _remove_earlier(folder)
    about = {"title": view.title, "verdict": list(view.verdict), "remarks": list(view.remarks)}
    write_text(folder / MARKER, response_json(view.rows, view.limits, dict(about), system))
    write_text(folder / "peaks.csv", peaks_csv(view.rows, system))
    write_text(folder / "peaks.tex", peaks_tex(view.rows, system))
    write_text(folder / "limits.csv", limits_csv(view.limits, system))
    write_text(folder / "shares.csv", shares_csv(view.shares))
    write_text(folder / "draws.csv", draws_csv(response, system))
    if sweep is not None:
        write_text(folder / "sweep.csv", sweep_csv(sweep, system))
    images = {}
    for of in SYSTEMS:
        for name, figure in figures_of(response, sweep, of):
            images[f"{name}_{of.name}"] = to_png(figure)
            if of is system:
                write_bytes(folder / f"{name}.png", images[f"{name}_{of.name}"])
    write_text(
        folder / "report.html", render_response(replace(view, metric=system is not US), images)
    )


def _remove_earlier(folder: Path) -> None:
    """Remove files of an earlier response that the next one may not have."""
    for path in sorted(folder.glob("*")):
        if _SOMETIMES.fullmatch(path.name):
            remove_file(path)
