"""A run under two priors side by side: one table, and a page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mfd_bayes.applications.properties import sheet_values
from mfd_bayes.applications.reweighing.reweighing import JOINT, Reweighing
from mfd_bayes.evaluation.laws import law_rows
from mfd_bayes.evaluation.scores import Row, Rows
from mfd_bayes.evaluation.summary import assess, verdicts
from mfd_bayes.messages import counted
from mfd_bayes.reporting.page import Units, render_page
from mfd_bayes.reporting.symbols import Symbols
from mfd_bayes.reporting.tables import to_csv, to_units
from mfd_bayes.runs.run import Run, prediction_conditions
from mfd_bayes.runs.unit_system import SI, both_systems

if TYPE_CHECKING:
    import pandas as pd

SHEET, LAWS, BANDS = "data sheet", "laws", "bands"
NOMINAL = "nominal"


@dataclass(frozen=True, eq=False)
class SideBySide:
    """A run under two priors.

    `rows` have `part`, `where`, `quantity`, `of`, `unit` and the values `before` and `after`.
    """

    reweighing: Reweighing
    rows: Rows
    verdicts: tuple[Mapping[str, str], Mapping[str, str]]  # of campaign and tests, by name

    @property
    def uses(self) -> dict[str, tuple[str, str]]:
        """What each test may be used for under either prior."""
        original, reweighed = self.verdicts
        return {
            n: (original.get(n, ""), reweighed.get(n, "")) for n in self.reweighing.original.tests
        }

    @property
    def largest_change(self) -> Row | None:
        """The nominal value of the data sheet that changes most, over its size."""
        rows = [r for r in self.section(SHEET) if r["of"] == NOMINAL and np.isfinite(r["change"])]
        return max(rows, key=lambda row: abs(row["change"]), default=None)

    def section(self, name: str) -> Rows:
        """Rows of a part."""
        return tuple(row for row in self.rows if row["part"] == name)

    def groups(self, section: str) -> dict[tuple[str, str, str], dict[str, Row]]:
        """Rows of a part by what they are of, for each place, quantity and unit."""
        groups: dict[tuple[str, str, str], dict[str, Row]] = {}
        for row in self.section(section):
            key = row["where"], row["quantity"], row["unit"]
            groups.setdefault(key, {})[row["of"]] = row
        return groups

    @property
    def sentence(self) -> str:
        """What was sampled, and what changes most."""
        weights, sampled = self.reweighing.weights, self.reweighing.sampled
        tests = len([name for name in sampled if name != JOINT])
        joint = "was sampled again" if JOINT in sampled else "was weighted"
        text = (
            f"Of {counted(len(weights) - 1, 'test')}, {tests or 'none'} had to be sampled again; "
            f"the population {joint}."
        )
        if (row := self.largest_change) is not None:
            where = f"{row['quantity']} at {row['where']}"
            text += f" The nominal value that changes most is {where}: {row['change']:+.1f} %."
        return text

    def table(self) -> pd.DataFrame:
        """All rows in the units of the run."""
        import pandas as pd

        frame = pd.DataFrame(list(self.rows)).rename(columns={"change": "change_percent"})
        return to_units(frame, self.reweighing.original.system)

    def csv(self) -> str:
        """The table as CSV, below how the draws were made."""
        weights = (f"{name}: {w.words}" for name, w in self.reweighing.weights.items())
        return to_csv(self.table(), weights)

    def page(self) -> str:
        """HTML of the page."""
        run = self.reweighing.original
        systems = both_systems(run.system)
        units = Units(systems, run.system.name == SI.name, words=Symbols(run.model))
        return render_page("reweighed.html.j2", units, view=self)


def side_by_side(reweighing: Reweighing, jobs: int = 0) -> SideBySide:
    """Data sheet, laws, bands and verdicts of a run under both priors."""
    runs = reweighing.original, reweighing.reweighed
    values = [dict(_values(run)) for run in runs]
    rows = []
    for key, value in values[0].items():
        reweighed = values[1].get(key, np.nan)
        change = 100.0 * (reweighed / value - 1.0) if value else np.nan
        names = dict(zip(("part", "where", "quantity", "of", "unit"), key, strict=True))
        rows.append(names | {"before": value, "after": reweighed, "change": change})
    uses = [run.manifest.verdicts or verdicts(assess(run.with_peaks(), jobs)) for run in runs]
    return SideBySide(reweighing, tuple(rows), (uses[0], uses[1]))


def _values(run: Run) -> Iterator[tuple[tuple[str, str, str, str, str], float]]:
    """Value of each part, place, quantity, what it is of, and unit."""
    for key, value in sheet_values(run).items():
        yield (SHEET, *key), value
    for law in law_rows(run):
        for of in ("lower", "median", "upper"):
            yield (LAWS, law["note"], law["name"], of, law["unit"]), law[of]
    for name, test in run.tests.items():
        motion = replace(test.trace, force=None)
        band = run.predict(motion, "new_test", **prediction_conditions(run, name))
        width = float(np.mean(band.upper - band.lower))
        yield (BANDS, name, "95 % band of this device tested again", "mean width", "kip"), width
        size = float(np.mean(np.abs(band.median)))
        yield (BANDS, name, "95 % band of this device tested again", "mean |median|", "kip"), size
