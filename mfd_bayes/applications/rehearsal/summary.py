"""What rehearsals say: table, sentences on the data sheet, picture and page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from mfd_bayes.applications.rehearsal.rehearsal import ANOTHER_TEST, MEAN, StoredRehearsal
from mfd_bayes.applications.rehearsal.uniformity import Uniformity
from mfd_bayes.errors import FitError
from mfd_bayes.messages import counted
from mfd_bayes.reporting.figures import new_figure, style
from mfd_bayes.reporting.page import environment, picture, policy_of
from mfd_bayes.reporting.symbols import BANDS, ORANGE, plain

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

INTERVALS = (50, 80, 95)  # %, equal-tailed; the last is that of the sheet's bounds
LEVEL = 0.05  # chance that any quantity of a group deviates although the posterior is right
KEYS = ["of", "quantity", "condition"]
SHEET = (ANOTHER_TEST, MEAN)
_SHIFT = 2.6  # standard errors from which the middle of ranks is off

NOT_TESTED = (
    "The model itself is not tested: it has made the records, and a force that it cannot make is "
    "not among them. For that, mfd-bayes crossvalidate predicts tests that were left out."
)
PRIORS_TWICE = (
    "Each truth is a draw of this run's posterior, and each calibration begins from the same "
    "priors. Ranks are even only for what the records determine: a quantity that follows its prior "
    "may deviate, and nothing is wrong."
)


@dataclass(frozen=True, eq=False)
class RehearsalSummary:
    """Results of all rehearsals of a run."""

    results: Sequence[StoredRehearsal]

    def __post_init__(self) -> None:
        if not self.runs:
            raise FitError(f"no rehearsal could be calibrated: {self.errors[0]}")

    @property
    def errors(self) -> list[str]:
        """Why rehearsals have no result, a sentence each."""
        return [result.error for result in self.results if result.error]

    @property
    def runs(self) -> int:
        """Number of rehearsals with a result."""
        return len(self.results) - len(self.errors)

    @cached_property
    def ranks(self) -> dict[tuple[str, str, str], Array]:
        """Ranks of each quantity, (n,), by what it is of, its name and its condition."""
        return {key: group["rank"].to_numpy() for key, group in self._groups}

    @property
    def _groups(self) -> Iterator[tuple[Any, pd.DataFrame]]:
        import pandas as pd

        rows = [position.model_dump() for r in self.results for position in r.positions]
        yield from pd.DataFrame(rows).groupby(KEYS, sort=False)

    @cached_property
    def table(self) -> pd.DataFrame:
        """A row for each quantity: how often intervals held the truth, and p of uniform ranks.

        `p_family` is p times the number of quantities in the same group, at most 1 (Bonferroni):
        all of the data sheet are a group.
        """
        import pandas as pd

        rows = []
        for key, group in self._groups:
            distance = np.abs(group["pit"].to_numpy() - 0.5)
            counts = {f"held_{p}": int(np.sum(distance <= p / 200.0)) for p in INTERVALS}
            row = dict(zip(KEYS, key, strict=True)) | {"runs": len(group)} | counts
            rows.append(row | {"p_value": p_uniform(group["rank"].to_numpy())})
        table = pd.DataFrame(rows)
        family = table["of"].where(~table["of"].isin(SHEET), "sheet")
        size = table.groupby(family)["of"].transform("size")
        return table.assign(p_family=np.minimum(table["p_value"] * size, 1.0))

    @property
    def sheet(self) -> pd.DataFrame:
        """Rows of the data sheet."""
        return self.table[self.table["of"].isin(SHEET)]

    @property
    def deviating(self) -> pd.DataFrame:
        """Rows of which chance does not explain the ranks."""
        return self.table[self.table["p_family"] < LEVEL]

    @property
    def verdict(self) -> str:
        """Whether the data sheet's bounds are right, in a sentence."""
        sheet, deviating = self.sheet, self.deviating["of"].isin(SHEET).sum()
        if sheet.empty:
            return "No test of this run is harmonic: it has no data sheet to rehearse."
        smallest, size = float(sheet["p_value"].min()), len(sheet)
        figures = f"the smallest of {size} p-values is {smallest:.2g}"
        if deviating:
            return f"{deviating} of {size} bounds of the data sheet are not right: {figures}."
        product = min(size * smallest, 1.0)
        return (
            f"Nothing speaks against the bounds of the data sheet: {figures}, and times {size} "
            f"that is {product:.2g}, so that chance explains it."
        )

    @property
    def sentences(self) -> list[str]:
        """One for each quantity of the data sheet."""
        return [
            self._sentence(str(quantity), rows)
            for quantity, rows in self.sheet.groupby("quantity", sort=False)
        ]

    def _sentence(self, quantity: str, rows: pd.DataFrame) -> str:
        """How often bounds of a quantity held the truth, over the conditions of the sheet."""
        counts = {}
        for of in SHEET:
            ends = rows.loc[rows["of"] == of, "held_95"]
            counts[of] = " to ".join(dict.fromkeys(map(str, (ends.min(), ends.max()))))
        conditions = rows["condition"].nunique()
        places = f" at each of {conditions} conditions" if conditions > 1 else ""
        sentence = (
            f"Bounds of {quantity} held {ANOTHER_TEST} in {counts[ANOTHER_TEST]} of "
            f"{rows['runs'].max()} rehearsals{places}, and those of its mean the true mean in "
            f"{counts[MEAN]}"
        )
        faults = dict.fromkeys(
            f"{self.fault(row)} ({row['of']})"
            for _, row in rows[rows["p_family"] < LEVEL].iterrows()
        )
        return f"{sentence}{': ' if faults else ''}{'; '.join(faults)}."

    def fault(self, row: Any) -> str:
        """How the ranks of a row deviate, in words."""
        ranks = self.ranks[row["of"], row["quantity"], row["condition"]]
        shift = (ranks.mean() - 0.5) * np.sqrt(12.0 * ranks.size)
        if abs(shift) > _SHIFT:
            return f"the truth lies mostly {'above' if shift > 0 else 'below'} the middle"
        return "too narrow" if ranks.var() > 1.0 / 12.0 else "too wide"

    @property
    def expected(self) -> str:
        """How often bounds that are right hold the truth, in a sentence."""
        low, high = np.asarray(stats.binom.ppf([0.005, 0.995], self.runs, INTERVALS[-1] / 100.0))
        return (
            f"Of {self.runs} truths right bounds hold {INTERVALS[-1] / 100.0 * self.runs:.3g} on "
            f"average, and by chance {low:.0f} to {high:.0f} (99 % of cases)."
        )

    @property
    def parameters(self) -> list[str]:
        """What of the run's parameters deviates, a sentence for each group."""
        sentences = []
        for of, rows in self.table[~self.table["of"].isin(SHEET)].groupby("of", sort=False):
            deviating = rows[rows["p_family"] < LEVEL]
            names = []
            for name, group in deviating.groupby("quantity", sort=False):
                faults = ", ".join(dict.fromkeys(self.fault(row) for _, row in group.iterrows()))
                times = f" in {counted(len(group), 'test')}" if group["condition"].any() else ""
                names.append(f"{name} {faults}{times}")
            words = "; ".join(names) or "none deviates by more than chance"
            sentences.append(f"Of {of}, {len(rows)} quantities: {words}.")
        return sentences


@cache
def _uniformity(runs: int) -> Uniformity:
    return Uniformity(runs, max(runs, 20) - 1)


def p_uniform(ranks: Array) -> float:
    """Probability that uniform ranks in (0, 1), (n,), deviate at least as far as these."""
    return _uniformity(ranks.size).p_value(_binned(ranks))


def _binned(ranks: Array) -> list[int]:
    """Ranks as the test takes them, from 0."""
    return [int(rank) for rank in ranks * (_uniformity(ranks.size).z.size + 1)]


# --- picture and page

_COLUMNS = 4
_OTHERS = "#4d4d4d"


@style()
def draw_rehearsals(summary: RehearsalSummary) -> Figure:
    """ECDF of the ranks less that of uniform ones, with the band that holds 95 % of such curves.

    A panel for each quantity of the data sheet, with a line for each condition, and for each group
    of parameters.
    """
    colours = {ANOTHER_TEST: BANDS["new_test"][2], MEAN: ORANGE}
    panels: dict[str, list[tuple[str, Array]]] = {}
    for (of, quantity, _), ranks in summary.ranks.items():
        panels.setdefault(quantity if of in SHEET else of, []).append((of, ranks))
    rows = -(-len(panels) // _COLUMNS)
    figure = new_figure(10.0, 1.7 * rows + 0.6)
    grid = figure.subplots(rows, _COLUMNS, sharex=True, sharey=True, squeeze=False).ravel()
    uniformity = _uniformity(summary.runs)
    lower, upper = uniformity.band(LEVEL)
    for axes in grid[len(panels) :]:
        axes.set_axis_off()
    for axes, (title, lines) in zip(grid, panels.items(), strict=False):
        axes.fill_between(uniformity.z, lower, upper, color="#dddddd", lw=0)
        thin = {"lw": 0.6, "alpha": 0.7} if len(lines) > len(SHEET) else {}
        for of, ranks in lines:
            test = _uniformity(ranks.size)
            deviation = test.deviation(_binned(ranks))
            axes.plot(test.z, deviation, color=colours.get(of, _OTHERS), **thin)
        axes.set_title(plain(title), fontsize=7)
    for of, colour in colours.items():
        grid[0].plot([], [], color=colour, label=of)
    grid[0].legend(loc="upper right", fontsize=6)
    grid[0].set_xlim(0.0, 1.0)
    figure.supxlabel("rank of the truth among the draws, as a share", fontsize=8)
    figure.supylabel("share of ranks below, less the expected", fontsize=8)
    return figure


def rehearsal_page(summary: RehearsalSummary, title: str, facts: dict[str, str], png: bytes) -> str:
    """HTML of the page."""
    sheet, fault = summary.sheet, summary.fault
    rows = [
        {**row, "fault": fault(row) if row["p_family"] < LEVEL else ""}
        for _, row in sheet.iterrows()
    ]
    template = environment().get_template("rehearsal.html.j2")
    return template.render(
        title=title,
        about=facts,
        summary=summary,
        rows=rows,
        intervals=INTERVALS,
        picture=picture("rehearsal", png)["uri"],
        remarks=(PRIORS_TWICE, NOT_TESTED),
        policy=policy_of(),
    )
