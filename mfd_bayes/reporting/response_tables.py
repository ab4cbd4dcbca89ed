"""Tables of a building's response: CSV, JSON and LaTeX."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from mfd_bayes.reporting.latex import escape
from mfd_bayes.reporting.tables import csv_text
from mfd_bayes.response.result import PROBABILITIES, Passing, Response, Row
from mfd_bayes.response.sweep import Sweep
from mfd_bayes.response.variance_shares import Shares
from mfd_bayes.runs.systems import System
from mfd_bayes.store.files import json_text
from mfd_bayes.units import GRAVITY, percent


def shown_unit(unit: str, system: System) -> tuple[str, float]:
    """Unit in which a quantity is shown, and the factor to it: accelerations in g."""
    if unit == "in/s^2":
        return "g", 1.0 / GRAVITY
    if unit == "1":
        return "%", 100.0
    if unit == "kip*in":
        name = "kip*in" if system.name == "us" else "kN*mm"
        return name, system.factor("kip") * system.factor("in")
    return system.unit(unit), system.factor(unit)


def peaks_csv(rows: Iterable[Row], system: System) -> str:
    """Peaks and bands as CSV."""
    head = ["quantity", "ground", "place", "unit", "median", "mean"]
    for p in PROBABILITIES:
        head += [f"lower_{percent(p)}", f"upper_{percent(p)}"]
    lines: list[Sequence[str | float]] = []
    for row in rows:
        unit, by = shown_unit(row.unit, system)
        ends = [end for band in row.bands for end in band]
        figures = [row.median, row.mean, *ends, row.bare, row.plain, row.lower, row.upper]
        lines.append([row.quantity, row.ground, row.place, unit, *(by * f for f in figures)])
    head += ["without_dampers", "plain_friction", "all_at_lower_bound", "all_at_upper_bound"]
    return csv_text(head, lines)


def limits_csv(found: Iterable[Passing], system: System) -> str:
    """Probabilities of passing limits as CSV."""
    lines: list[Sequence[str | float]] = []
    for one in found:
        unit, by = shown_unit(one.unit, system)
        figures = one.probability, one.error
        lines.append([one.quantity, one.ground, by * one.limit, unit, *figures])
    return csv_text(["quantity", "ground", "limit", "unit", "probability", "standard_error"], lines)


def shares_csv(shares: Iterable[Shares]) -> str:
    """Shares of variance as CSV."""
    lines: list[Sequence[str | float]] = [
        [one.quantity, one.ground, source, share]
        for one in shares
        for source, share in one.shares.items()
    ]
    return csv_text(["quantity", "ground", "source", "share"], lines)


def draws_csv(response: Response, system: System) -> str:
    """The largest of each quantity over the building, for each draw and ground motion."""
    head = [
        *("draw", "ground", f"drift_{system.length}", "acceleration_g"),
        *(f"base_shear_{system.force}", "step_s", "change", "unstable", "settled"),
    ]
    lines: list[Sequence[str | float]] = []
    drift, shear = response.measure("drift"), response.measure("base_shear")
    acceleration = response.measure("acceleration")
    for i in range(response.draws):
        for g, ground in enumerate(response.grounds):
            figures = (
                drift[i, g] * system.factor("in"),
                acceleration[i, g],
                shear[i, g] * system.factor("kip"),
                response.steps[i, g],
                response.change[i, g],
            )
            away = bool(response.unstable[i, g])
            flags = away, not (away or response.unsettled[i, g])
            lines.append([i, ground.name, *map(_finite, figures), *map(int, flags)])
    return csv_text(head, lines)


def sweep_csv(sweep: Sweep, system: System) -> str:
    """Drift and acceleration against the actuation as CSV."""
    unit, by_level = shown_unit(sweep.unit, system)
    shown = {"drift": (system.length, system.factor("in")), "acceleration": ("g", 1.0)}
    head, by_score = [f"actuation_{unit}", f"{sweep.quantity}_{sweep.goal}"], 1.0
    if sweep.goal != "passing":  # a probability
        of, by_score = shown[sweep.quantity]
        head[1] += f"_{of}"
    for name, (of, _) in shown.items():
        head += [f"{name}_{part}_{of}" for part in ("median", "mean", "lower_95", "upper_95")]
    lines: list[Sequence[str | float]] = []
    for i, level in enumerate(sweep.levels):
        cells = [by_level * float(level), _finite(by_score * sweep.scores[i])]
        for name, (_, by) in shown.items():
            flat = by * sweep.values[name][i].ravel()
            low, middle, high = np.quantile(flat, [0.025, 0.5, 0.975])
            cells += [float(v) for v in (middle, flat.mean(), low, high)]
        lines.append(cells)
    return csv_text(head, lines)


def response_json(
    rows: Iterable[Row], found: Iterable[Passing], about: dict[str, object], system: System
) -> str:
    """All rows and limits as JSON, in the units of the tables."""
    peaks = []
    for row in rows:
        unit, by = shown_unit(row.unit, system)
        peaks.append(
            {
                **{key: getattr(row, key) for key in ("quantity", "ground", "place")},
                "unit": unit,
                **{
                    key: by * getattr(row, key)
                    for key in ("median", "mean", "bare", "plain", "lower", "upper")
                },
                "bands": {
                    percent(p): [by * end for end in band]
                    for p, band in zip(PROBABILITIES, row.bands, strict=True)
                },
            }
        )
    limits = []
    for one in found:
        unit, by = shown_unit(one.unit, system)
        limits.append({**vars(one), "limit": by * one.limit, "unit": unit})
    return json_text({**about, "peaks": peaks, "limits": limits}, indent=2) + "\n"


def peaks_tex(rows: Iterable[Row], system: System) -> str:
    """Peaks of the storeys as a LaTeX table in the manner of booktabs."""
    lines = [
        "% Peaks of the response: median and equal-tailed 95 % band.",
        r"\begin{tabular}{lllrrr}",
        r"\toprule",
        r"Quantity & Ground & Place & Median & 95\,\% band & Without dampers \\",
        r"\midrule",
    ]
    for row in rows:
        if row.quantity.startswith("damper"):
            continue
        unit, by = shown_unit(row.unit, system)
        low, high = (by * end for end in row.bands[-1])
        cells = [escape(f"{row.quantity}, {unit}"), escape(row.ground), escape(row.place)]
        cells += [f"{by * row.median:.3g}", f"{low:.3g} to {high:.3g}", f"{by * row.bare:.3g}"]
        lines.append(" & ".join(cells) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def _finite(value: float) -> float:
    """A number; NaN, which is an empty cell, where it is infinite."""
    return float(value) if np.isfinite(value) else np.nan
