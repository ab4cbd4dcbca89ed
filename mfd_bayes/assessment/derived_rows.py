"""Rows of derived quantities: draws of them beside what was measured."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.assessment.views import DerivedRow
from mfd_bayes.calibration.derived import (
    UNITS,
    count_cycles,
    derive_from_force,
    derive_from_parameters,
)
from mfd_bayes.calibration.predictive import Replicas
from mfd_bayes.calibration.result import TestResult
from mfd_bayes.population.predict import Band
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.run import Run

Array = NDArray[np.float64]

NO_CYCLE = "the motion has no full cycle"
_OF_CYCLES = ("energy_per_cycle", "c_eq")


def calibrated_rows(run: Run, test: TestResult, replicas: Replicas) -> tuple[DerivedRow, ...]:
    """Derived quantities of a test that was fitted; its own offset is taken off the record."""
    trace, first, values = test.trace, test.posterior.first, replicas.values
    force = replicas.force - values["offset"][:, None]
    drawn = derive_from_force(force, trace, first=first)
    drawn |= derive_from_parameters(values, trace.reference_actuation, _area(run))
    known = measured(trace, float(np.median(values["offset"])), first)
    cycles = count_cycles(trace, first=first)
    return derived_rows(test.id, "calibrate", drawn, known, cycles)


def held_out_rows(run: Run, name: str, trace: Trace, damper: Band) -> tuple[DerivedRow, ...]:
    """Derived quantities of a test that was predicted.

    Its own offset is unknown: the calibrated tests' median is taken off the record.

    Parameters
    ----------
    run : Run
    name : str
    trace : Trace
        With its measured force.
    damper : Band
        Of kind "new_test": the force without offset and noise.
    """
    offsets = [np.median(test.stored.values()["offset"]) for test in run.tests.values()]
    known = measured(trace, float(np.median(offsets)))
    return derived_rows(name, "validate", _drawn(run, trace, damper), known, count_cycles(trace))


def predicted_rows(run: Run, trace: Trace, band: Band) -> tuple[DerivedRow, ...]:
    """Derived quantities of a prediction, with intervals of the band's probability.

    They are the damper's: of a band of kind "observation", those of its kind "new_test".
    `trace` is the band's, with a force where one was measured.
    """
    if band.kind == "observation":
        band = run.predict(trace, "new_test", band.probability)
    drawn, known = _drawn(run, trace, band), measured(trace)
    cycles, probability = count_cycles(trace), band.probability
    return derived_rows("", band.kind, drawn, known, cycles, probability=probability)


def _drawn(run: Run, trace: Trace, band: Band) -> dict[str, Array]:
    """Derived quantities of a band's draws."""
    of_parameters = derive_from_parameters(band.values, trace.reference_actuation, _area(run))
    return derive_from_force(band.draws, trace) | of_parameters


def _area(run: Run) -> float | None:
    """The actuator's area, in², where it is given and the actuation is a pressure."""
    return run.manifest["settings"].get("area") if run.actuation_unit == "ksi" else None


def measured(trace: Trace, offset: float = 0.0, first: int = 0) -> dict[str, float]:
    """What the record itself says, its offset (kip) taken off; empty without a force."""
    if trace.force is None:
        return {}
    found = derive_from_force((trace.force - offset)[None, :], trace, first=first)
    return {name: float(value[0]) for name, value in found.items()}


def derived_rows(
    subject: str,
    role: str,
    drawn: Mapping[str, Array],
    known: Mapping[str, float],
    cycles: int,
    *,
    probability: float = 0.95,
) -> tuple[DerivedRow, ...]:
    """Mean, sd and equal-tailed interval of draws (n,) by name, in the order of `UNITS`."""
    basis = f"over {cycles} full cycle{'' if cycles == 1 else 's'}" if cycles else NO_CYCLE
    tail = 0.5 * (1.0 - probability)
    rows = []
    for name in (name for name in UNITS if name in drawn):
        draws = drawn[name]
        lower, median, upper = np.quantile(draws, [tail, 0.5, 1.0 - tail])
        rows.append(
            DerivedRow(
                subject=subject,
                role=role,
                name=name,
                unit=UNITS[name],
                mean=float(draws.mean()),
                sd=float(draws.std()),
                lower=float(lower),
                median=float(median),
                upper=float(upper),
                measured=known.get(name, float("nan")),
                note=basis if name in _OF_CYCLES else "",
            )
        )
    return tuple(rows)
