"""The page and the tables of a building's response, and the best actuation of a sweep in words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mfd_bayes.errors import BuildingError
from mfd_bayes.population.settings import SAME_LEVEL
from mfd_bayes.reporting.page import Picture, Units, render_page
from mfd_bayes.reporting.symbols import unit_text
from mfd_bayes.reporting.tables import escape_tex, to_csv
from mfd_bayes.response.result import PROBABILITIES, Passing, Response, Row
from mfd_bayes.response.sweep import Sweep
from mfd_bayes.response.variance_shares import Shares
from mfd_bayes.runs.tested_range import Span
from mfd_bayes.runs.unit_system import SYSTEMS, System
from mfd_bayes.store.files import json_text
from mfd_bayes.units import GRAVITY, percent


@dataclass(frozen=True)
class ResponseView:
    """What the page shows.

    Attributes
    ----------
    title, about, headline : str
        Headline: the verdict in a few words.
    mark : {"pass", "care", "fail"}
    verdict, remarks : tuple of str
    rows : tuple of Row
    limits : tuple of Passing
    shares : tuple of Shares
        For each quantity and ground motion.
    sweep : str
        The best actuation in a sentence; empty without a sweep.

    Raises
    ------
    BuildingError
        When there is nothing to show: every draw ran away under every ground motion, and there is
        no sweep.
    """

    title: str
    about: str
    mark: str
    verdict: tuple[str, ...]
    remarks: tuple[str, ...]
    rows: tuple[Row, ...]
    limits: tuple[Passing, ...]
    shares: tuple[Shares, ...]
    sweep: str
    grounds: tuple[str, ...]
    dampers: int
    metric: bool
    provenance: Mapping[str, object]
    headline: str = ""

    def __post_init__(self) -> None:
        if not self.rows and not self.sweep:
            raise BuildingError(
                f"every draw diverged under {', '.join(self.grounds)}: there is no response to "
                "write; expected ground motions, and a building, that its dampers can bear"
            )

    @property
    def sources(self) -> list[str]:
        """All sources of variance, in their order."""
        return list(dict.fromkeys(name for share in self.shares for name in share.shares))


def render_response(view: ResponseView, images: Mapping[str, bytes]) -> str:
    """HTML of the page; `images` are PNGs by "profile_us", "profile_si" and so on."""
    units = Units(SYSTEMS, view.metric, _factor_and_name)
    pictures = {name: Picture.embedded(name, png) for name, png in images.items()}
    return render_page("response.html.j2", units, view=view, pictures=pictures)


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


def _factor_and_name(unit: str, system: System) -> tuple[float, str]:
    name, by = shown_unit(unit, system)
    return by, unit_text(name) or name


def peaks_csv(rows: Iterable[Row], system: System) -> str:
    """Peaks and bands as CSV."""
    lines = []
    for row in rows:
        unit, by = shown_unit(row.unit, system)
        line: dict[str, Any] = {"quantity": row.quantity, "ground": row.ground, "place": row.place}
        line |= {"unit": unit, "median": by * row.median, "mean": by * row.mean}
        for p, (low, high) in zip(PROBABILITIES, row.bands, strict=True):
            line |= {f"lower_{percent(p)}": by * low, f"upper_{percent(p)}": by * high}
        line |= {"without_dampers": by * row.bare, "plain_friction": by * row.plain}
        lines.append(
            line | {"all_at_lower_bound": by * row.lower, "all_at_upper_bound": by * row.upper}
        )
    return _csv(lines, ("quantity", "ground", "place", "unit", "median", "mean"))


def limits_csv(limits: Iterable[Passing], system: System) -> str:
    """Probabilities of passing limits as CSV."""
    lines = []
    for row in limits:
        unit, by = shown_unit(row.unit, system)
        line = {"quantity": row.quantity, "ground": row.ground, "limit": by * row.limit}
        line |= {"unit": unit, "probability": row.probability, "standard_error": row.error}
        lines.append(line)
    return _csv(lines, ("quantity", "ground", "limit", "unit", "probability", "standard_error"))


def shares_csv(shares: Iterable[Shares]) -> str:
    """Shares of variance as CSV."""
    names = ("quantity", "ground", "source", "share")
    lines = [
        dict(zip(names, (row.quantity, row.ground, source, share), strict=True))
        for row in shares
        for source, share in row.shares.items()
    ]
    return _csv(lines, names)


def _csv(lines: Sequence[Mapping[str, Any]], names: Sequence[str]) -> str:
    import pandas as pd

    return to_csv(pd.DataFrame(lines) if lines else pd.DataFrame(columns=list(names)))


def draws_csv(response: Response, system: System) -> str:
    """The largest of each quantity over the building, for each draw and ground motion."""
    import pandas as pd

    draw, ground = (at.ravel() for at in np.indices((response.draws, len(response.grounds))))
    names = np.array([motion.name for motion in response.grounds], dtype=object)
    columns = {
        "draw": draw,
        "ground": names[ground],
        f"drift_{system.length}": response.measure("drift") * system.factor("in"),
        "acceleration_g": response.measure("acceleration"),
        f"base_shear_{system.force}": response.measure("base_shear") * system.factor("kip"),
        "step_s": response.steps,
        "change": response.change,
        "unstable": response.unstable.astype(int),
        "settled": (~(response.unstable | response.unsettled)).astype(int),
    }
    frame = pd.DataFrame({name: np.ravel(values) for name, values in columns.items()})
    return to_csv(frame.replace([np.inf, -np.inf], np.nan))


def sweep_csv(sweep: Sweep, system: System) -> str:
    """Drift and acceleration against the actuation as CSV."""
    import pandas as pd

    unit, by_level = shown_unit(sweep.unit, system)
    shown = {"drift": (system.length, system.factor("in")), "acceleration": ("g", 1.0)}
    goal, by_score = f"{sweep.quantity}_{sweep.goal}", 1.0
    if sweep.goal != "passing":  # a probability
        of, by_score = shown[sweep.quantity]
        goal += f"_{of}"
    columns = {f"actuation_{unit}": by_level * sweep.levels, goal: by_score * sweep.scores}
    for name, (of, by) in shown.items():
        values = by * np.reshape(sweep.values[name], (len(sweep.levels), -1))
        low, middle, high = np.quantile(values, [0.025, 0.5, 0.975], axis=1)
        parts = {"median": middle, "mean": values.mean(axis=1), "lower_95": low, "upper_95": high}
        columns |= {f"{name}_{part}_{of}": numbers for part, numbers in parts.items()}
    return to_csv(pd.DataFrame(columns).replace([np.inf, -np.inf], np.nan))


def response_json(
    rows: Iterable[Row], limits: Iterable[Passing], about: dict[str, object], system: System
) -> str:
    """All rows and limits as JSON, in the units of the tables."""
    peaks = []
    for row in rows:
        unit, by = shown_unit(row.unit, system)
        pairs = zip(PROBABILITIES, row.bands, strict=True)
        peaks.append(
            {
                **{key: getattr(row, key) for key in ("quantity", "ground", "place")},
                "unit": unit,
                **{
                    key: by * getattr(row, key)
                    for key in ("median", "mean", "bare", "plain", "lower", "upper")
                },
                "bands": {percent(p): [by * end for end in band] for p, band in pairs},
            }
        )
    passing = []
    for limit in limits:
        unit, by = shown_unit(limit.unit, system)
        passing.append({**vars(limit), "limit": by * limit.limit, "unit": unit})
    return json_text({**about, "peaks": peaks, "limits": passing}, indent=2) + "\n"


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
        cells = map(escape_tex, (f"{row.quantity}, {unit}", row.ground, row.place))
        figures = f"{by * row.median:.3g} & {low:.3g} to {high:.3g} & {by * row.bare:.3g}"
        lines.append(" & ".join([*cells, figures]) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


_GOALS = {
    "mean": "The mean of the largest {}",
    "q90": "The 90 % quantile of the largest {}",
    "passing": "The probability that the largest {} exceeds its limit",
}


def sweep_sentence(sweep: Sweep, tested: Sequence[Span], system: System) -> str:
    """The best actuation with its interval, and what to do where it lies at an end.

    Where several levels are best alike, it says that none of them is better. `tested` is what the
    calibrated tests cover, with their actuation.
    """

    def words(*levels: float) -> str:
        return system.words(levels, sweep.unit, 3, actuation=True)

    what = _GOALS[sweep.goal].format(sweep.quantity)
    ties, place = sweep.lowest, f"smallest at {words(sweep.best)}"
    first = last = sweep.best
    if ties.size > 1:
        first, last = float(ties[0]), float(ties[-1])
        alike, none = f"{ties.size} levels", f"{words(first, last)}: none of them is better"
        if ties.size == np.isfinite(sweep.scores).sum():
            return f"{what} is the same at all {alike}, {none}."
        place = f"smallest at {alike} alike, {none}"
    text = f"{what} is {place} (90 % interval: {words(*sweep.interval)})."
    span = next(span for span in tested if span.name == "actuation")
    low, high = span.lowest * (1.0 - SAME_LEVEL), span.highest * (1.0 + SAME_LEVEL)
    if not low <= first <= last <= high:
        return (
            f"{text} No test was made there (tests: {span.words(system)}): make one before you "
            "use this actuation."
        )
    if sweep.best not in (sweep.levels[0], sweep.levels[-1]):
        return text
    lower = sweep.best == sweep.levels[0]
    end, side = ("lower", "below") if lower else ("upper", "above")
    margin = (1.0 - SAME_LEVEL) if lower else (1.0 + SAME_LEVEL)
    if low < margin * sweep.best if lower else high > margin * sweep.best:
        return f"{text} This is the {end} end of the sweep: sweep further."
    return (
        f"{text} This is the {end} end of the sweep and of the tests: make a test {side} it before "
        "you sweep further."
    )
