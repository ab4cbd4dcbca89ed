"""What a report says of a standard: conformity, requirement by requirement, and λ."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from mfd_bayes.applications.properties.conformity import (
    Conformity,
    ConformityRow,
    DeviceEvidence,
    conformity,
    predictions,
    summary,
)
from mfd_bayes.applications.properties.factors import PropertyFactors, property_factors
from mfd_bayes.applications.properties.harmonic import condition_words, harmonic_tests, levels_of
from mfd_bayes.campaign.schema import DesignTable
from mfd_bayes.campaign.standard import Standard
from mfd_bayes.errors import CampaignError
from mfd_bayes.records.cycles import quantities
from mfd_bayes.reporting.page import Addition
from mfd_bayes.reporting.tables import to_csv
from mfd_bayes.runs.run import Run

if TYPE_CHECKING:
    import pandas as pd

TABLES = ("conformity.csv", "factors.csv")
"""Of a standard, in a run folder."""

_MARKS = {
    Conformity.MEETS: "pass",
    Conformity.FAILS: "fail",
    Conformity.NOT_TESTED: "note",
}


@dataclass(frozen=True, eq=False)
class StandardView:
    """Conformity of a run with its standard, and its property factors."""

    standard: Standard
    design: DesignTable
    rows: tuple[ConformityRow, ...]
    factors: tuple[PropertyFactors, ...]
    run: Run

    @property
    def worst(self) -> list[dict[str, Any]]:
        """The worst row of each requirement and quantity, as a page shows it."""
        return [self._shown(row) for row in summary(self.rows)]

    def _shown(self, row: ConformityRow) -> dict[str, Any]:
        where = ", ".join(filter(None, (row.test, row.note)))
        has_value, has_limit = row.quantity and math.isfinite(row.value), math.isfinite(row.limit)
        return asdict(row) | {
            "subject": self.symbol(row.quantity, row.direction) if row.quantity else "",
            "where": where,
            "value_text": f"{100.0 * row.value:+.1f}\N{NO-BREAK SPACE}%" if has_value else "",
            "limit_text": f"±{100.0 * row.limit:g}\N{NO-BREAK SPACE}%" if has_limit else "",
            "mark": _MARKS[row.verdict],
        }

    def symbol(self, quantity: str, direction: str) -> str:
        """A quantity as the standard calls it, with its direction."""
        name = self.standard.symbols.get(quantity) or quantities()[quantity][0].label
        return f"{name} {direction}".strip()

    @property
    def sentence(self) -> str:
        """How many requirements are met, fail, and were not tested."""
        verdicts: dict[str, list[Conformity]] = {}
        for row in summary(self.rows):
            verdicts.setdefault(row.requirement, []).append(row.verdict)
        order = (Conformity.FAILS, Conformity.NOT_TESTED, Conformity.MEETS)
        worst = [next(v for v in order if v in of) for of in verdicts.values()]
        counts = (f"{worst.count(verdict)} {verdict}" for verdict in reversed(order))
        return f"Of {len(worst)} requirements of {self.standard.title}: {', '.join(counts)}."

    @property
    def levels(self) -> list[str]:
        """Levels of actuation in words, the smallest first."""
        return list(dict.fromkeys(self._level(row) for row in self.factors))

    def _level(self, row: PropertyFactors) -> str:
        system, unit = self.run.system, self.run.actuation_unit
        return system.words([row.actuation], unit, actuation=True) if system.axes.actuated else ""

    @property
    def by_quantity(self) -> dict[str, list[PropertyFactors]]:
        """Factors at each level of a quantity, as the standard calls it."""
        rows: dict[str, list[PropertyFactors]] = {}
        for row in self.factors:
            rows.setdefault(self.symbol(row.quantity, row.direction), []).append(row)
        return rows

    @property
    def composed(self) -> list[dict[str, Any]]:
        """Factors as a page shows them, a row for each level, quantity and direction."""
        return [
            {
                "level": self._level(row),
                "subject": self.symbol(row.quantity, row.direction),
                "row": row,
            }
            for row in self.factors
        ]

    @property
    def frame(self) -> pd.DataFrame:
        """A row for each verdict, by test and cycle."""
        import pandas as pd  # which takes long to import

        rows = pd.DataFrame([asdict(row) for row in self.rows])
        return rows.assign(standard=self.standard.title)

    def section(self) -> Addition:
        """Its part of a report."""
        return Addition("standard", self, self.tables())

    def tables(self) -> Mapping[str, str]:
        """The whole tables as CSV: a row for each verdict, by test and cycle, and for each λ."""
        import pandas as pd  # which takes long to import

        factor, unit = self.run.system.of_actuation(self.run.actuation_unit)
        factors = []
        for row in self.factors:
            flat: dict[str, Any] = {
                f"actuation_{unit}": row.actuation * factor,
                "quantity": row.quantity,
                "direction": row.direction,
            }
            for kind in ("cycles", "speed", "temperature"):
                measured = getattr(row, kind)
                for end in ("smallest", "largest"):
                    low, high = getattr(measured, f"{end}_interval")
                    flat |= {
                        f"lambda_{kind}_{end}": getattr(measured, end),
                        f"lambda_{kind}_{end}_q2.5": low,
                        f"lambda_{kind}_{end}_q97.5": high,
                    }
                flat[f"tests_{kind}"] = measured.tests
            flat |= {"lambda_test_min": row.test_min, "lambda_test_max": row.test_max}
            for name in ("composed_min", "composed_max", "lambda_min", "lambda_max"):
                flat[name] = getattr(row, name)
            factors.append(flat)
        design = self.design
        head = [
            f"{self.standard.title}; {self.standard.read}",
            f"lambda_ae {design.lambda_ae.min:g} to {design.lambda_ae.max:g}, lambda_spec "
            f"{design.lambda_spec.min:g} to {design.lambda_spec.max:g}",
        ]
        return {
            TABLES[0]: to_csv(self.frame, head[:1]),
            TABLES[1]: to_csv(pd.DataFrame(factors), head),
        }


def to_compare(run: Run, *, predicted: bool = True) -> DeviceEvidence:
    """What a run has to compare with a standard; without draws it is quick.

    The run must have a design.
    """
    tests, design = harmonic_tests(run), run.manifest.settings.design
    assert design is not None
    dependence = run.manifest.settings.dependence
    return DeviceEvidence(
        tests,
        design,
        predictions(run, tests) if predicted else {},
        lambda condition: condition_words(run, condition),
        any("temperature" in covariates for covariates in dependence.values()),
    )


def standard_view(run: Run) -> StandardView | None:
    """Conformity of a run with the standard of its campaign; None where it names none."""
    standard, design = run.manifest.standard, run.manifest.settings.design
    if standard is None or design is None:
        return None
    evidence = to_compare(run)
    factors = property_factors(standard, evidence, levels_of(evidence.tests))
    return StandardView(standard, design, conformity(standard, evidence), factors, run)


def conformity_table(run: Run) -> pd.DataFrame:
    """Verdicts of a run on its standard, a row for each requirement, quantity, test and cycle.

    Parameters
    ----------
    run : Run
        Of a campaign with a table `[design]`.

    Returns
    -------
    DataFrame
        Columns clause, requirement, verdict ("meets", "fails" or "not tested"), quantity,
        direction, test, cycle (0 for the test as a whole), value and limit (shares), probability
        that the device meets the limit, note, and standard.

    Raises
    ------
    CampaignError
        When the campaign of the run names no standard.
    """
    view = standard_view(run)
    if view is None:
        raise CampaignError(f"the campaign of {run.folder} has no [design] that names a standard")
    return view.frame
