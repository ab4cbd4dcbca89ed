"""The page and the tables of a building's response, and the best actuation of a sweep in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mfd_bayes.errors import BuildingError
from mfd_bayes.population.settings import SAME_LEVEL
from mfd_bayes.reporting.page import Picture, Units, render_page
from mfd_bayes.reporting.symbols import unit_text
from mfd_bayes.reporting.tables import escape_tex
from mfd_bayes.response.result import PROBABILITIES, Passing, Response, Row, Shares, Sweep
from mfd_bayes.runs.unit_system import SYSTEMS, System
from mfd_bayes.store.files import json_text
from mfd_bayes.units import GRAVITY, percent

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    import pandas as pd

    from mfd_bayes.runs.tested_range import Span


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
    pictures = {name: Picture.of(name, png) for name, png in images.items()}
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


def _in_system(row: Row | Passing, system: System, names: Iterable[str]) -> dict[str, Any]:
    """Fields of a row, those of `names` in the unit in which a system shows them."""
    unit, by = shown_unit(row.unit, system)
    return {**vars(row), "unit": unit} | {name: by * getattr(row, name) for name in names}


def _peaks(rows: Iterable[Row], system: System) -> list[dict[str, Any]]:
    peaks = []
    for row in rows:
        figures = ("median", "mean", "bare", "plain", "lower", "upper")
        peak = _in_system(row, system, figures)
        by = shown_unit(row.unit, system)[1]
        pairs = zip(PROBABILITIES, row.bands, strict=True)
        bands = {percent(p): [by * end for end in band] for p, band in pairs}
        peaks.append(peak | {"bands": bands})
    return peaks


def peaks_frame(rows: Iterable[Row], system: System) -> pd.DataFrame:
    """Peaks and bands, a line each."""
    import pandas as pd

    names = {"bare": "without_dampers", "plain": "plain_friction"}
    names |= {"lower": "all_at_lower_bound", "upper": "all_at_upper_bound"}
    lines = []
    for peak in _peaks(rows, system):
        bands = {
            f"{end}_{share}": value
            for share, band in peak.pop("bands").items()
            for end, value in zip(("lower", "upper"), band, strict=True)
        }
        others = {name: peak.pop(key) for key, name in names.items()}
        lines.append(peak | bands | others)
    return pd.DataFrame(lines, columns=None if lines else ["quantity", "ground", "place", "unit"])


def limits_frame(limits: Iterable[Passing], system: System) -> pd.DataFrame:
    """Probabilities of passing limits."""
    import pandas as pd

    lines = [_in_system(row, system, ["limit"]) for row in limits]
    names = ["quantity", "ground", "limit", "unit", "probability", "error"]
    return pd.DataFrame(lines, columns=names).rename(columns={"error": "standard_error"})


def shares_frame(shares: Iterable[Shares]) -> pd.DataFrame:
    """Shares of variance."""
    import pandas as pd

    lines = [(r.quantity, r.ground, source, v) for r in shares for source, v in r.shares.items()]
    return pd.DataFrame(lines, columns=["quantity", "ground", "source", "share"])


def draws_frame(response: Response, system: System) -> pd.DataFrame:
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
    return pd.DataFrame({name: np.ravel(values) for name, values in columns.items()})


def sweep_frame(sweep: Sweep, system: System) -> pd.DataFrame:
    """Drift and acceleration against the actuation."""
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
    return pd.DataFrame(columns)


def response_json(
    rows: Iterable[Row], limits: Iterable[Passing], about: dict[str, object], system: System
) -> str:
    """All rows and limits as JSON, in the units of the tables."""
    passing = [_in_system(limit, system, ["limit"]) for limit in limits]
    return json_text({**about, "peaks": _peaks(rows, system), "limits": passing}, indent=2) + "\n"


def peaks_tex(rows: Iterable[Row], system: System) -> str:
    """Peaks of the storeys as a LaTeX table in the manner of booktabs."""
    import pandas as pd

    lines = []
    for row in _peaks(rows, system):
        if not row["quantity"].startswith("damper"):
            low, high = row["bands"]["95"]
            quantity = f"{row['quantity']}, {row['unit']}"
            names = map(escape_tex, (quantity, row["ground"], row["place"]))
            figures = f"{row['median']:.3g}", f"{low:.3g} to {high:.3g}", f"{row['bare']:.3g}"
            lines.append((*names, *figures))
    heads = ["Quantity", "Ground", "Place", "Median", r"95\,\% band", "Without dampers"]
    table = pd.DataFrame(lines, columns=heads).style.hide(axis="index")
    text = table.to_latex(hrules=True, column_format="lllrrr")
    return f"% Peaks of the response: median and equal-tailed 95 % band.\n{text}"


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
