"""Properties of a device, measured and computed: of cycles, and of a posterior."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import derive_from_parameters
from mfd_bayes.campaign.schema import CampaignFile
from mfd_bayes.evaluation.measurement import EXACT, Gains, gains_of
from mfd_bayes.evaluation.scores import Rows, spread_of
from mfd_bayes.friction.model import Model
from mfd_bayes.messages import counted
from mfd_bayes.population.bands import Band
from mfd_bayes.population.peaks import NO_EXCESS, SIDES, Peaks, largest_speed
from mfd_bayes.records.cycles import (
    PROPERTIES,
    RECORD,
    SMALLER,
    TOLERANCES,
    MeasuredCycles,
    cycle_values,
    means_of_test,
    measured_cycles,
)
from mfd_bayes.records.loops import find_loops
from mfd_bayes.records.record import Record
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.manifest import Manifest
from mfd_bayes.runs.model_average import ModelAverage
from mfd_bayes.runs.run import Run
from mfd_bayes.runs.tested_range import PARTIAL, partial_strokes
from mfd_bayes.units import Axes

Array = NDArray[np.float64]

EXTREME = 0.005
"""Share of draws on one side of a measured value at which the value is extreme among them."""


def measured_of(manifest: Manifest, name: str) -> MeasuredCycles:
    """Measured cycles of a test, as recorded."""
    return MeasuredCycles.from_content(manifest.tests[name].measured)


def without_noise(band: Band, test: Band) -> Array:
    """Forces whose peaks count, (n, T): of `test`, the same motion as a band's without noise.

    Those of a measurement have its offset.
    """
    if band.kind == "observation" and "offset" in test.values:
        return test.draws + np.asarray(test.values["offset"])[:, None]
    return test.draws


def properties_of(
    trace: Trace,
    force: Array,
    peaks: Peaks = NO_EXCESS,
    *,
    smooth: Array | None = None,
    cycles: Mapping[str, Array] | None = None,
) -> dict[str, Array]:
    """Properties under a motion of forces (n, T), kip, by name, (n,) each.

    Peaks are those that a load cell would see, by the excess `peaks` over those of the forces
    without noise, `smooth`, by default the same forces. `cycles` are the forces' `cycle_values`,
    where they have been computed.
    """
    cycles = cycle_values(trace, force) if cycles is None else cycles
    properties = means_of_test(cycles, find_loops(trace).strong)
    if partial_strokes(trace) > PARTIAL:  # what a cycle at full stroke has, such a motion has not
        properties = {name: np.full(len(force), np.nan) for name in properties}
    properties["total_energy"] = np.asarray(np.trapezoid(force, trace.displacement, axis=1))
    rng, speed = np.random.default_rng(0), largest_speed(trace)
    quiet = force if smooth is None else smooth
    for side, sign in SIDES.items():
        largest, excess = np.max(sign * quiet, axis=1), peaks[side]
        scores = excess.scores(rng, largest.shape)
        peak = excess.seen(largest, speed, properties[f"slip_{side}"], scores)
        properties[f"peak_{side}"] = peak
    return properties


def of_parameters(
    model: Model, values: Mapping[str, Array], level: float, settings: CampaignFile
) -> dict[str, Array]:
    """Travel from slip to slip; with the actuator's area self-energizing factors; (n,) each."""
    area = settings.area if settings.actuation_unit == "ksi" else None
    return derive_from_parameters(model, values, level, area)


def device_properties(run: Run, trace: Trace, band: Band, test: Band) -> dict[str, Array]:
    """Properties of a band's draws; `test` has the same motion without noise, for its peaks."""
    draws = properties_of(trace, band.draws, run.peaks, smooth=without_noise(band, test))
    model, level = run.predictor.model, trace.reference_actuation
    return draws | of_parameters(model, band.values, level, run.manifest.settings)


def predicted_rows(
    source: Run | ModelAverage,
    trace: Trace,
    band: Band,
    record: Record | None = None,
    previous: str = "",
    given_trace: Trace | None = None,
    device: str = "",
    session: str = "",
) -> Rows:
    """Properties of a prediction, with intervals of the band's probability.

    Those of a band of kind "observation" have offset and noise, as a measured record has them. The
    measured values of a `record` stand beside them. They were read by the tests' instruments: the
    uncertainty of the gains, which the intervals have, excuses no miss. `previous` is the test that
    the motion follows without a reset, `given_trace` the trace with the force of the part that was
    given, `device` and `session` those that were predicted.
    """
    test = band
    if band.kind == "observation":
        window = band.conditioning.window if band.conditioning else None
        how: dict[str, Any] = {"condition_on": window, "after": previous, "draws": len(band.draws)}
        how |= {"session": session} | ({"device": device} if device else {})
        test = source.predict(given_trace or trace, "new_test", band.probability, **how)
    if isinstance(source, ModelAverage):
        first_run, n = source.runs[0], len(source.runs)
        forces = (np.array_split(of.draws, n) for of in (band, test))  # of one run after another
        run_draws = [
            properties_of(trace, force, run.peaks, smooth=smooth)
            for run, force, smooth in zip(source.runs, *forces, strict=True)
        ]
        draws = {
            name: np.concatenate([values[name] for values in run_draws]) for name in run_draws[0]
        }
    else:
        first_run, draws = source, device_properties(source, trace, band, test)
    cycles = None if record is None else measured_cycles(record.trace())
    measured = {} if cycles is None else cycles.of_test()
    draws = applicable(draws, first_run.system.axes)
    gains = gains_of(first_run, len(band.draws))
    return property_rows("", band.kind, trace, draws, measured, band.probability, gains)


def applicable(properties: Mapping[str, Array], axes: Axes) -> dict[str, Array]:
    """Those of the properties that make sense for a model's motion and response."""
    return {
        name: values
        for name, values in properties.items()
        if name not in PROPERTIES or PROPERTIES[name].applies(axes)
    }


def property_rows(
    test: str,
    role: str,
    trace: Trace,
    draws: Mapping[str, Array],
    measured: Mapping[str, float],
    probability: float = 0.95,
    gains: Gains = EXACT,
) -> Rows:
    """Rows of properties, in the order of `PROPERTIES`, from draws (n,) by name.

    `role` is a test's, or the kind of a prediction. Draws and measured values are as the
    instruments read them, whose `gains` widen the intervals.
    """
    full, tail = find_loops(trace).strong, 0.5 * (1.0 - probability)
    strong, ramps = int(np.count_nonzero(full)), int(np.count_nonzero(~full))
    rows = []
    for name, quantity in PROPERTIES.items():
        of_ramps = quantity.extent == SMALLER
        if name not in draws or (of_ramps and not ramps):
            continue
        if not np.any(np.isfinite(draws[name])):  # the motion does not have it
            continue
        note = ""
        if quantity.of_cycle and not (quantity.estimate or quantity.extent == RECORD):
            extent, count = ("of smaller", ramps) if of_ramps else ("at full", strong)
            note = (
                f"over {counted(count, 'full cycle')} {extent} stroke"
                if count
                else "the motion has no full cycle"
            )
        value = measured.get(name, float("nan"))
        rows.append(
            {"test": test, "role": role, "name": name, "unit": quantity.unit}
            | spread_of(draws[name] * gains.factor(name), tail)
            | {"measured": value, "note": note, "missed": is_missed(draws[name], value, name)}
        )
    return tuple(rows)


def is_missed(values: Array, measured: float, name: str) -> bool:
    """Whether a measured property is extreme among draws (n,), and beyond its tolerance."""
    tolerance, _ = TOLERANCES[PROPERTIES[name].tolerance or "energy"]
    finite = values[np.isfinite(values)]
    if not finite.size or not np.isfinite(measured):
        return False
    exceeds = abs(float(np.median(finite)) - measured) > tolerance * abs(measured)
    return exceeds and not EXTREME <= share_above(finite, measured) <= 1.0 - EXTREME


def share_above(values: Array, measured: float) -> float:
    """Share of draws (n,) above a measured value: a p-value, to which ties count half."""
    return float(np.mean(values > measured) + 0.5 * np.mean(values == measured))
