"""Whether ranks of true values are uniform, judged for many quantities at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mfd_bayes.applications.rehearsal.uniformity import Uniformity

LEVEL = 0.01
"""Chance that any of the quantities fails although all ranks are uniform (familywise)."""


def failures(ranks: Mapping[str, Sequence[int]], uniformity: Uniformity) -> dict[str, float]:
    """p-values of the quantities that are not uniform, familywise at `LEVEL` by Bonferroni."""
    p_values = {name: uniformity.p_value(values) for name, values in ranks.items()}
    return {name: p for name, p in p_values.items() if p < LEVEL / len(p_values)}
