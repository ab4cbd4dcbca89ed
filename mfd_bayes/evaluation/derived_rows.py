"""Derived quantities of tests and predictions, each beside the measured value."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.cycles import (
    UNITS,
    derive_from_force,
    derive_from_parameters,
    full_strokes,
)
from mfd_bayes.calibration.predictive import Replicas
from mfd_bayes.calibration.result import TestResult
from mfd_bayes.evaluation.bands import spread_of
from mfd_bayes.evaluation.views import DerivedRow
from mfd_bayes.population.bands import Band
from mfd_bayes.records.loop_features import read_off
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.manifest import Manifest
from mfd_bayes.runs.model_average import ModelAverage
from mfd_bayes.runs.run import Run

Array = NDArray[np.float64]

NO_CYCLE = "the motion has no full cycle"


def _basis(count: int, which: str) -> str:
    """Over how many cycles a quantity is a mean."""
    return f"over {count} full cycle{'' if count == 1 else 's'} {which}" if count else NO_CYCLE


def calibrated_rows(
    manifest: Manifest, test: TestResult, replicas: Replicas
) -> tuple[DerivedRow, ...]:
    """Derived quantities of a fitted test; the record's are less the posterior median offset."""
    trace, first, values = test.trace, test.posterior.first, replicas.values
    force = replicas.force - values["offset"][:, None]
    drawn = derive_from_force(force, trace, first=first)
    level, model = trace.reference_actuation, test.posterior.model
    drawn |= derive_from_parameters(model, values, level, _area(manifest))
    offset = float(np.median(values["offset"]))
    known = _measured(trace, offset, first) | dict.fromkeys(
        ("gap", "crossing"), read_off(trace, offset).gap
    )
    cycles = full_strokes(trace, first=first)
    return _rows((test.id, "calibrate"), drawn, known, cycles)


def held_out_rows(run: Run, name: str, trace: Trace, damper: Band) -> tuple[DerivedRow, ...]:
    """Derived quantities of a predicted test.

    Its own offset is unknown, so the record's are less the median offset of the fitted tests.

    Parameters
    ----------
    run : Run
    name : str
    trace : Trace
        With its measured force.
    damper : Band
        Of kind "new_test": the force without offset and noise.
    """
    known = _measured(trace, run.offset)
    drawn = _drawn(run, trace, damper)
    return _rows((name, "validate"), drawn, known, full_strokes(trace))


def predicted_rows(
    source: Run | ModelAverage,
    trace: Trace,
    band: Band,
    told: Trace | None = None,
    after: str = "",
) -> tuple[DerivedRow, ...]:
    """Derived quantities of a prediction, with intervals of the band's probability.

    A band of kind "observation" holds offset and noise, which are not the damper's; its
    derived quantities are those of kind "new_test". `trace` is the band's, with a force
    where one was measured; `told` has the force of a given part. `after` is the test that the
    motion follows without a reset. What derives from parameters is not told of several models.
    """
    if band.kind == "observation":
        window = band.given.window if band.given else None
        asked = told or trace, "new_test", band.probability
        band = source.predict(*asked, given=window, after=after)
    if isinstance(source, ModelAverage):
        drawn = derive_from_force(band.draws, trace)
    else:
        drawn = _drawn(source, trace, band)
    known = _measured(trace)
    return _rows(("", band.kind), drawn, known, full_strokes(trace), band.probability)


def measured_rows(trace: Trace, band: Band, rows: tuple[DerivedRow, ...]) -> tuple[DerivedRow, ...]:
    """Derived quantities to which those of the measured force can be held.

    Noise and offset raise the peaks of a measurement: a band of kind "observation" has both, and
    of the other kinds the peaks of the damper alone are left out.
    """
    if band.kind != "observation":
        return tuple(row for row in rows if row.name not in ("peak_fwd", "peak_bwd"))
    drawn, cycles = derive_from_force(band.draws, trace), full_strokes(trace)
    return _rows(("", band.kind), drawn, _measured(trace), cycles, band.probability)


def _drawn(run: Run, trace: Trace, band: Band) -> dict[str, Array]:
    """Derived quantities of a band's draws."""
    level, model = trace.reference_actuation, next(iter(run.tests.values())).posterior.model
    of_parameters = derive_from_parameters(model, band.values, level, _area(run.manifest))
    return derive_from_force(band.draws, trace) | of_parameters


def _area(manifest: Manifest) -> float | None:
    """The actuator's area, in², where it is given and the actuation is a pressure."""
    settings = manifest.settings
    return settings.area if settings.actuation_unit == "ksi" else None


def _measured(trace: Trace, offset: float = 0.0, first: int = 0) -> dict[str, float]:
    """Values of the record itself, less its offset (kip), by name; empty without a force."""
    if trace.force is None:
        return {}
    found = derive_from_force((trace.force - offset)[None, :], trace, first=first)
    return {name: float(value[0]) for name, value in found.items()}


def _rows(
    head: tuple[str, str],
    drawn: Mapping[str, Array],
    known: Mapping[str, float],
    cycles: NDArray[np.bool_],
    probability: float = 0.95,
) -> tuple[DerivedRow, ...]:
    """Rows of derived quantities, in the order of `UNITS`.

    Parameters
    ----------
    head : (str, str)
        Subject and role of each row.
    drawn : mapping of str to (n,)
        Draws by name.
    known : mapping of str to float
        Values of the record itself.
    cycles : (L,) bool
        Full cycles of the motion, whether at full stroke.
    probability : float
        Of the equal-tailed interval.
    """
    subject, role = head
    strong = int(np.count_nonzero(cycles))
    basis = {
        "energy_per_cycle": _basis(strong, "at full stroke"),
        "energy_of_ramps": _basis(cycles.size - strong, "of smaller stroke"),
        "c_eq": _basis(cycles.size, "in all"),
    }
    return tuple(
        DerivedRow(
            subject=subject,
            role=role,
            name=name,
            unit=unit,
            **spread_of(drawn[name], 0.5 * (1.0 - probability)),
            measured=known.get(name, float("nan")),
            note=basis.get(name, ""),
        )
        for name, unit in UNITS.items()
        if name in drawn and not (name == "energy_of_ramps" and cycles.all())
    )
