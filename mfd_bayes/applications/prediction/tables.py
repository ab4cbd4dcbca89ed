"""Tables of a prediction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from mfd_bayes.evaluation.scores import Rows
from mfd_bayes.population.bands import KIND_NAMES, Band
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.tables import _by_column, _csv
from mfd_bayes.runs.unit_system import UnitSystem
from mfd_bayes.units import percent

if TYPE_CHECKING:
    pass


def predicted_csv(rows: Rows, actuation: str, probability: float, force: str = "force") -> str:
    """Derived quantities of a prediction, with intervals of this probability."""
    head = (
        f"derived quantities of the device, without offset and noise, of kind {rows[0]['role']}: "
        f"equal-tailed {percent(probability)} % intervals",
        f"{actuation and f'actuation {actuation}; '}measured: of the {force} in the motion's file, "
        "as it is",
    )
    return _csv(head, _by_column("prediction", rows))


def design_csv(rows: Rows, actuation: str, probability: float) -> str:
    """Mean and bounding properties with their factors, by property, then by basis."""
    head = (
        "mean and bounding properties; each bound is exceeded with a probability of "
        f"{50.0 * (1.0 - probability):g} %",
        "lower_ratio, upper_ratio: bound over the nominal value, the mean of the mean property",
        *([f"actuation {actuation}"] if actuation else []),
    )
    return _csv(head, _by_column("design", rows))


def bands_csv(trace: Trace, band: Band, notes: Sequence[str], system: UnitSystem) -> str:
    """Band of a prediction at every sample, with the measured force of the trace if it has one.

    `notes` are lines of its head, besides what the band is; the columns are in the units of
    `system`.
    """
    forces = {"force": trace.force, "lower": band.lower, "median": band.median, "upper": band.upper}
    if band.shows_simultaneous:
        forces |= dict(
            zip(("simultaneous_lower", "simultaneous_upper"), band.simultaneous, strict=True)
        )
    columns: dict[str, Any] = {
        # may be seconds since 1970
        "time_s" if system.axes.timed else "sample": [f"{time:.15g}" for time in trace.time],
        system.column("displacement", "in"): trace.displacement * system.factor("in"),
    } | {
        system.column(name, "kip"): values * system.factor("kip")
        for name, values in forces.items()
        if values is not None
    }
    head = [
        f"{band.interval} {percent(band.probability)} % band of kind {band.kind} "
        f"({KIND_NAMES[band.kind]}), for each sample by itself; from {band.source}"
    ]
    if band.shows_simultaneous:
        head.append("simultaneous: band of the whole history, of the same probability")
    if band.conditioning is not None:
        columns["conditioned"] = band.conditioning.holds(trace.time).astype(int)
        head.append(system.text("conditioned: 1 where the force was given, 0 elsewhere"))
    head += [system.text(f"warning: {remark}") for remark in band.remarks] + list(notes)
    return _csv(head, columns, 8)
