"""A quantity's values under other noises, in words."""

from __future__ import annotations

from mfd_bayes.evaluation.views import Row
from mfd_bayes.reporting.symbols import number


def others_text(row: Row) -> str:
    """Median and interval under each noise that decides a value: "staged: 42.2 [39.0, 45.6]"."""
    return "; ".join(
        f"{other.other}: {number(other.other_median, 3)} "
        f"[{number(other.other_lower, 3)}, {number(other.other_upper, 3)}]"
        for other in row.others
    )


def noted(row: Row) -> str:
    """The note of a row, and its values under the noises that decide it."""
    others = f"the noise model decides: {others_text(row)}" if row.others else ""
    return "; ".join(filter(None, (row.note, others)))
