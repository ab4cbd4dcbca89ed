"""Figures that a person reads off the loop, beside the parameters that should agree with them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.campaign.schema import complete_tolerances
from mfd_bayes.evaluation.views import READING, Check, ReadingRow
from mfd_bayes.records.loop_features import read_off
from mfd_bayes.runs.verdict import Verdict

Array = NDArray[np.float64]


ABOVE = 0.01
"""Share by which static friction may lie above the largest measured force."""

FAR = 2.0
"""A slip force is far from its reading where it misses it and its median is above the reading times
this, or below it divided by this. The noise then stands in for the friction."""


def reading_rows(
    test: str,
    posterior: Posterior,
    values: Mapping[str, Array],
    tolerances: Mapping[str, float] | None = None,
) -> tuple[ReadingRow, ...]:
    """Readings of a fitted test, less its median offset, each beside its parameter.

    A parameter misses its reading where its 95 % interval, widened by the tolerance on both sides,
    does not hold it. Static friction misses where its median is above the largest measured force by
    more than `ABOVE`.
    """
    allowed = complete_tolerances(tolerances)
    offset = float(np.median(values["offset"]))
    return tuple(
        _row((test, name, unit), reading, values_of, allowed[kind], slips=kind == "slip_force")
        for name, unit, reading, values_of, kind in _pairs(posterior, values, offset)
        if np.isfinite(reading)
    ) + tuple(_static(test, posterior, values, offset, allowed["slip_force"]))


def _pairs(
    posterior: Posterior, values: Mapping[str, Array], offset: float
) -> Iterator[tuple[str, str, float, Array, str]]:
    """Name, unit, reading, draws and kind of tolerance of every quantity that can be read off."""
    read, model = read_off(posterior.trace, offset), posterior.model
    plateaus = (read.plateau_fwd, read.plateau_bwd)
    for name, plateau in zip(model.slip_forces, plateaus, strict=False):
        yield name, "kip", plateau, values[name], "slip_force"
    if "k3" in values:
        yield "k3", "kip/in", read.slope, values["k3"], "build_up"
    crossing = model.crossing(values)
    if crossing is not None:
        name = "crossing" if "gap" in values else "gap"
        yield name, "in", read.gap, crossing, "gap"


def _row(
    head: tuple[str, str, str], reading: float, draws: Array, tolerance: float, *, slips: bool
) -> ReadingRow:
    """A reading beside the draws of its quantity; `slips` says that this is a slip force."""
    low, middle, high = (float(q) for q in np.quantile(draws, [0.025, 0.5, 0.975]))
    room = tolerance * abs(reading)
    missed = not low - room <= reading <= high + room
    apart = middle < reading / FAR or middle > FAR * reading
    far = slips and missed and reading > 0 and apart
    return ReadingRow(*head, reading, low, middle, high, tolerance, missed, far=far)


def _static(
    test: str, posterior: Posterior, values: Mapping[str, Array], offset: float, tolerance: float
) -> Iterator[ReadingRow]:
    """Static friction beside the largest measured force of its direction."""
    force = np.asarray(posterior.trace.force)[posterior.first :] - offset
    for name, largest in (("Fs_fwd", force.max()), ("Fs_bwd", -force.min())):
        if name in values:
            low, middle, high = (float(q) for q in np.quantile(values[name], [0.025, 0.5, 0.975]))
            above = middle > (1.0 + ABOVE) * largest
            head = (test, name, "kip", float(largest))
            yield ReadingRow(*head, low, middle, high, tolerance, above, largest=True)


def reading_check(row: ReadingRow) -> Check:
    """A reading as a check: a note where the parameter misses it.

    It fails where a slip force is far from its reading: nobody can use such a parameter.
    """
    within = f"{row.name} ({row.median:.3g} [{row.lower:.3g}, {row.upper:.3g}] {row.unit})"
    target, limit = (
        f"{within}, read off {row.value:.3g} {row.unit}",
        "inside the interval and its tolerance",
    )
    if row.largest:
        limit = "median below the largest force"
        target = f"{within}, largest force {row.value:.3g} {row.unit}"
    size = (row.median - row.value) / abs(row.value) if row.value else float("nan")
    verdict = Verdict.FAIL if row.far else Verdict.noted(not row.missed)
    told = row.subject, READING, target, row.value, limit, verdict, size, row.tolerance
    return Check(*told, unit=row.unit)
