"""Properties of a device from its force: measured, for design, and on its data sheet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import derive_from_parameters
from mfd_bayes.campaign.schema import TOLERANCES, CampaignFile
from mfd_bayes.errors import CampaignError, MfdError
from mfd_bayes.evaluation.views import Datasheet, Rows, spread_of
from mfd_bayes.friction.model import Model
from mfd_bayes.messages import Message
from mfd_bayes.population.bands import KIND_NAMES, Band
from mfd_bayes.population.design import LEVELS, levels_of, setting_of, with_zeros
from mfd_bayes.population.peaks import NO_EXCESS, SIDES, Peaks, certain, largest_speed
from mfd_bayes.records.loops import (
    FORMULAS,
    MeasuredCycles,
    cycle_values,
    find_loops,
    mean_of,
    measured_cycles,
)
from mfd_bayes.records.loops import UNITS as CYCLE_UNITS
from mfd_bayes.records.record import NO_ACTUATION, Record
from mfd_bayes.records.trace import Harmonic, Trace, parse_sine
from mfd_bayes.runs.folder import Manifest, Use
from mfd_bayes.runs.run import ModelAverage, Run
from mfd_bayes.runs.tested_range import PARTIAL, partial_strokes
from mfd_bayes.units import DAMPER, Axes, actuation_kind, parse_actuation

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

UNITS: Mapping[str, str] = {
    **dict.fromkeys(("slip_fwd", "slip_bwd", "peak_fwd", "peak_bwd"), "kip"),
    "effective_stiffness": "kip/in",
    "effective_damping": "1",
    **dict.fromkeys(("energy_per_cycle", "energy_of_ramps", "energy_in_all"), "kip*in"),
    "c_eq": "kip*s/in",
    "build_up_slope": "kip/in",
    **dict.fromkeys(("gap", "slip_to_slip"), "in"),
    **dict.fromkeys(("C_fwd", "C_bwd"), "1"),
}
"""Internal unit of every property of a test, in the order of tables."""

EXTREME = 0.005
"""Share of draws on one side of a measured value at which the value is extreme among them."""

TOLERANCE_OF: Mapping[str, str] = {
    **dict.fromkeys(("peak_fwd", "peak_bwd"), "peak"),
    **dict.fromkeys(("slip_fwd", "slip_bwd"), "slip_force"),
    "build_up_slope": "build_up",
    "gap": "gap",
}
"""Kind of the tolerance of a property; of others that of an energy."""

_MEANS = (
    *("energy_per_cycle", "energy_of_ramps", "effective_stiffness", "effective_damping", "c_eq"),
)
_OF_CYCLES = (
    *("slip_fwd", "slip_bwd", "effective_stiffness", "effective_damping", "c_eq"),
    *("build_up_slope", "gap"),
)


def measured_of(manifest: Manifest, name: str) -> MeasuredCycles:
    """Measured cycles of a test, as recorded."""
    return MeasuredCycles.from_content(manifest.tests[name].measured)


def measured_properties(cycles: MeasuredCycles) -> dict[str, float]:
    """Measured value of each property: `MeasuredCycles.of_test`, and energies of all."""
    own, ramps = cycles.of_test(), cycles.energy[~cycles.full_stroke]
    return {name: own[name] for name in (*_OF_CYCLES, "peak_fwd", "peak_bwd")} | {
        "energy_per_cycle": own["energy"],
        "energy_of_ramps": float(ramps.mean()) if ramps.size else float("nan"),
        "energy_in_all": cycles.total_energy,
    }


def without_noise(band: Band, test: Band) -> Array:
    """Forces whose peaks count, (n, T): of `test`, the same motion as a band's without noise.

    Those of a measurement have its offset.
    """
    if band.kind == "observation" and "offset" in test.values:
        return test.draws + np.asarray(test.values["offset"])[:, None]
    return test.draws


def properties_of(
    trace: Trace, force: Array, peaks: Peaks = NO_EXCESS, *, smooth: Array | None = None
) -> dict[str, Array]:
    """Properties under a motion of forces (n, T), kip, by name, (n,) each, in `UNITS`.

    Peaks are those that a load cell would see, by the excess `peaks` over those of the forces
    without noise, `smooth`, by default the same forces.
    """
    full, values = find_loops(trace).strong, cycle_values(trace, force)
    properties = {name: mean_of(values[name], full) for name in _OF_CYCLES}
    properties["energy_per_cycle"] = mean_of(values["energy"], full)
    properties["energy_of_ramps"] = mean_of(values["energy"], ~full)
    properties["energy_in_all"] = np.asarray(np.trapezoid(force, trace.displacement, axis=1))
    if partial_strokes(trace) > PARTIAL:  # what a cycle at full stroke has, such a motion has not
        of_cycles = (*_OF_CYCLES, "energy_per_cycle", "energy_of_ramps")
        properties |= {name: np.full(len(force), np.nan) for name in of_cycles}
    rng, speed = np.random.default_rng(0), largest_speed(trace)
    quiet = force if smooth is None else smooth
    for side, sign in SIDES.items():
        largest, excess = np.max(sign * quiet, axis=1), peaks[side]
        scores = excess.scores(rng, largest.shape)
        peak = excess.seen(largest, speed, properties[f"slip_{side}"], scores)
        properties[f"peak_{side}"] = peak
    return properties


def cycle_energies(trace: Trace, force: Array) -> Array:
    """Energy of each full cycle at full stroke under forces (n, T), kip: (n, L), kip*in."""
    return cycle_values(trace, force)["energy"][:, find_loops(trace).strong]


def of_parameters(
    model: Model, values: Mapping[str, Array], level: float, settings: CampaignFile
) -> dict[str, Array]:
    """Travel from slip to slip; with the actuator's area self-energizing factors; (n,) each."""
    area = settings.area if settings.actuation_unit == "ksi" else None
    return derive_from_parameters(model, values, level, area)


def device_properties(run: Run, trace: Trace, band: Band, test: Band) -> dict[str, Array]:
    """Properties of a band's draws; `test` has the same motion without noise, for its peaks."""
    drawn = properties_of(trace, band.draws, run.peaks, smooth=without_noise(band, test))
    model, level = run.predictor.model, trace.reference_actuation
    return drawn | of_parameters(model, band.values, level, run.manifest.settings)


def predicted_rows(
    source: Run | ModelAverage,
    trace: Trace,
    band: Band,
    record: Record | None = None,
    after: str = "",
    given: Trace | None = None,
    device: str = "",
    session: str = "",
) -> Rows:
    """Properties of a prediction, with intervals of the band's probability.

    Those of a band of kind "observation" have offset and noise, as a measured record has them. The
    measured values of a `record` stand beside them. `after` is the test that the motion follows
    without a reset, `given` the trace with the force of the part that was given, `device` and
    `session` those that were predicted.
    """
    test = band
    if band.kind == "observation":
        window = band.given.window if band.given else None
        how: dict[str, Any] = {"given": window, "after": after, "draws": len(band.draws)}
        how |= {"session": session} | ({"device": device} if device else {})
        test = source.predict(given or trace, "new_test", band.probability, **how)
    if isinstance(source, ModelAverage):
        first, n = source.runs[0], len(source.runs)
        forces = (np.array_split(of.draws, n) for of in (band, test))  # of one run after another
        parts = [
            properties_of(trace, force, run.peaks, smooth=smooth)
            for run, force, smooth in zip(source.runs, *forces, strict=True)
        ]
        drawn = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    else:
        first, drawn = source, device_properties(source, trace, band, test)
    cycles = None if record is None else measured_cycles(record.trace())
    measured = {} if cycles is None else measured_properties(cycles)
    drawn = kept(drawn, first.system.axes)
    return property_rows("", band.kind, trace, drawn, measured, band.probability)


def kept(properties: Mapping[str, Array], axes: Axes) -> dict[str, Array]:
    """Those of the properties that make sense for a model's motion and response."""
    return {name: values for name, values in properties.items() if axes.has(name)}


def property_rows(
    test: str,
    role: str,
    trace: Trace,
    drawn: Mapping[str, Array],
    measured: Mapping[str, float],
    probability: float = 0.95,
) -> Rows:
    """Rows of properties, in the order of `UNITS`, from draws (n,) by name.

    `role` is a test's, or the kind of a prediction.
    """
    full, tail = find_loops(trace).strong, 0.5 * (1.0 - probability)
    strong, ramps = int(np.count_nonzero(full)), int(np.count_nonzero(~full))
    rows = []
    for name, unit in UNITS.items():
        if name not in drawn or (name == "energy_of_ramps" and not ramps):
            continue
        if not np.any(np.isfinite(drawn[name])):  # the motion does not have it
            continue
        note = ""
        if name in _MEANS:
            of_ramps = name == "energy_of_ramps"
            which, count = ("of smaller", ramps) if of_ramps else ("at full", strong)
            cycles = f"{count} full cycle{'' if count == 1 else 's'}"
            note = f"over {cycles} {which} stroke" if count else "the motion has no full cycle"
        value = measured.get(name, float("nan"))
        rows.append(
            {"test": test, "role": role, "name": name, "unit": unit}
            | spread_of(drawn[name], tail)
            | {"measured": value, "note": note, "missed": is_missed(drawn[name], value, name)}
        )
    return tuple(rows)


def is_missed(values: Array, measured: float, name: str) -> bool:
    """Whether a measured property is extreme among draws (n,), and beyond its tolerance."""
    tolerance, _ = TOLERANCES[TOLERANCE_OF.get(name, "energy")]
    finite = values[np.isfinite(values)]
    if not finite.size or not np.isfinite(measured):
        return False
    beyond = abs(float(np.median(finite)) - measured) > tolerance * abs(measured)
    return beyond and not EXTREME <= share_above(finite, measured) <= 1.0 - EXTREME


def share_above(values: Array, measured: float) -> float:
    """Share of draws (n,) above a measured value: a p-value, to which ties count half."""
    return float(np.mean(values > measured) + 0.5 * np.mean(values == measured))


# --- for design

ANOTHER = "another_device"
"""Another device of the same make: known where the calibrated tests are of several devices."""

BASES: Mapping[str, str] = {
    "device": KIND_NAMES["device"],
    "new_test": KIND_NAMES["new_test"],
    ANOTHER: "another device of the same make",
    "observation": KIND_NAMES["observation"],
}
"""What bounds are about, in the order of tables; kinds of prediction but for `ANOTHER`."""

DESIGN_DRAWS = 1000  # draws of each basis: few would leave the bounds to chance
NOT_KNOWN = "not known: the calibrated tests are of one device"

DESIGN_PROPERTIES = (
    *("slip_fwd", "slip_bwd", "energy_per_cycle", "effective_stiffness", "effective_damping"),
    *("c_eq", "peak_fwd", "peak_bwd", "gap"),
)
NEW = "\x00another"  # a session or a device that no campaign can declare


def design_rows(run: Run, trace: Trace, probability: float = 0.95) -> Rows:
    """Mean and bounding properties under a motion and an actuation, by property, then by basis.

    "This device tested again" is a test of one of the calibrated devices in one of the declared
    sessions, "another device" a test of a new one, in a new session where there are several. With
    one device the latter is not known.
    """
    drawn = drawn_properties(run, trace, places_of(run))
    return bounds_of(drawn, probability, f"from {len(run.devices)} devices")


def drawn_properties(
    run: Run, trace: Trace, places: Sequence[tuple[str, str]]
) -> dict[str, dict[str, Array]]:
    """Draws of the properties of a motion by basis of `BASES`, then by name, (n,) each.

    `places` are session and device of the tests. The mean property has the mean excess of
    measured peaks, the others its scatter too. Energies of the
    cycles at full stroke, "energy", are (n, L).
    """
    peaks, axes, drawn = run.peaks, run.manifest.axes, {}

    def draw(kind: str, session: str, device: str, draws: int) -> Band:
        how: dict[str, Any] = {"session": session, "device": device, "draws": draws}
        return run.predict(trace, kind, **how)

    n = n_draws(places)
    bands = {k: [draw(k, *place, n) for place in places] for k in KIND_NAMES if k in BASES}
    if len(run.devices) > 1:
        session = NEW if len(sessions_of(run)) > 1 else sessions_of(run)[0]
        bands[ANOTHER] = [draw("new_test", session, NEW, DESIGN_DRAWS)]
    for basis, several in bands.items():
        excess = certain(peaks) if basis == "device" else peaks
        quiet = bands["new_test"] if basis == "observation" else several
        parts = [
            properties_of(trace, band.draws, excess, smooth=without_noise(band, test))
            | {"energy": cycle_energies(trace, band.draws)}
            for band, test in zip(several, quiet, strict=True)
        ]
        drawn[basis] = {
            name: np.concatenate([part[name] for part in parts])
            for name in (*DESIGN_PROPERTIES, "energy")
            if axes.has(name)
        }
    return drawn


def bounds_of(drawn: Mapping[str, Mapping[str, Array]], probability: float, note: str = "") -> Rows:
    """Bounds of draws (n,) by basis and property; "device" has the nominal values.

    A basis of `BASES` that is missing is not known, and its bounds are NaN. The `note` is of
    another device.
    """
    rows = []
    for name in DESIGN_PROPERTIES:
        mean = drawn["device"].get(name, np.empty(0))
        if not np.any(np.isfinite(mean)):  # the motion has no full cycle
            continue
        for basis in BASES:
            values = drawn.get(basis, {}).get(name, np.empty(0))
            if basis in drawn and not np.any(np.isfinite(values)):
                continue
            about = note if basis == ANOTHER else ""
            rows.append(
                {"name": name, "unit": UNITS[name], "basis": basis, "of": BASES[basis]}
                | bounds(mean, values, probability)
                | {"note": about if basis in drawn else NOT_KNOWN}
            )
    return tuple(rows)


def bounds(mean: Array, drawn: Array, probability: float) -> dict[str, float]:
    """Nominal value, the mean of draws of any shape; equal-tailed bounds of others, and factors.

    `lambda_min` and `lambda_max` are the bounds over the nominal value. What is not finite is left
    out, and NaN where nothing remains.
    """
    mean, drawn = mean[np.isfinite(mean)], drawn[np.isfinite(drawn)]
    tail, nan = 0.5 * (1.0 - probability), float("nan")
    nominal = float(mean.mean()) if mean.size else nan
    lower, upper = np.quantile(drawn, [tail, 1.0 - tail]).tolist() if drawn.size else (nan, nan)
    factors = [bound / nominal if nominal else nan for bound in (lower, upper)]
    names = ("nominal", "lower", "upper", "lambda_min", "lambda_max")
    return dict(zip(names, (nominal, lower, upper, *factors), strict=True))


def design_warnings(run: Run) -> tuple[str, ...]:
    """Why bounds may be too narrow, in sentences."""
    settings = with_zeros([setting_of(test.trace) for test in run.tests.values()])
    count = len(levels_of(settings))
    if count >= LEVELS:
        return ()
    return (
        f"the calibrated tests have {count} level{'' if count == 1 else 's'} of actuation, and "
        f"fewer than {LEVELS} do not show how far levels lie from a law: bounds at an actuation "
        "that was not tested are too narrow",
    )


def n_draws(places: Sequence[tuple[str, str]]) -> int:
    """Draws of the bands behind the bounds, for each session and device.

    A band with as many, of one session and device, has the same draws as the bounds.
    """
    return DESIGN_DRAWS // len(places) + 10


def places_of(run: Run) -> tuple[tuple[str, str], ...]:
    """Session and device of the calibrated tests, each pair once."""
    devices = run.manifest.settings.devices
    return tuple(dict.fromkeys((run.session(name), devices[name]) for name in run.tests))


def sessions_of(run: Run) -> tuple[str, ...]:
    """Sessions of the calibrated tests; "" where none are declared."""
    return tuple(dict.fromkeys(run.session(name) for name in run.tests))


# --- the data sheet: measured values, nominal ones and bounds, at each condition

PROBABILITY = 0.95  # of the interval between lower and upper bound
BASIS = "observation"  # what the bounds are of: a measured value lies in them with PROBABILITY
CYCLES = 3  # cycles of which the energy is given one by one
HARMONIC = 0.2  # least share of the cycles at full stroke, by which a test counts as harmonic
_QUANTITIES = (
    ("slip_force", "forward", "slip_fwd"),
    ("slip_force", "backward", "slip_bwd"),
    ("peak_force", "forward", "peak_fwd"),
    ("peak_force", "backward", "peak_bwd"),
    ("effective_stiffness", "", "effective_stiffness"),
    ("effective_damping", "", "effective_damping"),
    ("energy", "", "energy"),
    ("gap", "", "gap"),
)


_COLUMNS = [
    *("condition", "actuation", "actuation_unit", "stroke", "frequency", "tested"),
    *("quantity", "direction", "unit", "cycle", "measured_low", "measured", "measured_high"),
    *("standard_error", "n_cycles", "n_tests", "n_outside", "of"),
    *("nominal", "lower", "upper", "lambda_min", "lambda_max"),
    *("lambda_min_other", "lambda_max_other", "note"),
]
"""Of `Datasheet.rows`, there even where no test is harmonic."""


class Condition(NamedTuple):
    """An actuation, ksi or kip, an amplitude, in, and a frequency, Hz, of harmonic motion."""

    actuation: float
    stroke: float
    frequency: float


def parse_condition(text: str, actuation_unit: str, axes: Axes = DAMPER) -> Condition:
    """Condition of a text such as "35 lbf, 1 in, 0.5 Hz": actuation, amplitude, frequency."""
    if not axes.actuated:
        text = f"{NO_ACTUATION}, {text}"
    level, _, motion = text.partition(",")
    if text.count(",") != (2 if axes.timed else 1):
        raise CampaignError(f"a condition reads '35 lbf, 1 in, 0.5 Hz', got {text!r}")
    actuation, unit = parse_actuation(level.strip(), of=f"the actuation of {text!r}")
    if unit != actuation_unit:
        raise CampaignError(
            f"the actuation of {text!r} must be {actuation_kind(actuation_unit)}, as in the tests"
        )
    harmonic = parse_sine(f"{motion}, {CYCLES} cycles", axes)
    return Condition(actuation, harmonic.amplitude, harmonic.frequency)


def datasheet(run: Run, at: Sequence[Condition] = ()) -> Datasheet:
    """Data sheet of a run: every condition that was tested, and those of `at`."""
    tests = _harmonic_tests(run)
    table, lacking = [], []
    for condition in dict.fromkeys([*sorted({test[0] for test in tests}), *at]):
        own = [test for test in tests if test[0] == condition]
        label = condition_words(run, condition)
        try:
            table += _rows(run, condition, label, own)
        except MfdError as error:
            if condition in at:
                raise
            lacking.append(Message("{label}: {error}.", {"label": label, "error": str(error)}))
    import pandas as pd  # which takes long to import

    rows = pd.DataFrame(table, columns=_COLUMNS)
    return Datasheet(
        rows=rows,
        tested=_tested(run),
        verdict=_verdict(run, rows),
        not_known=(*lacking, *_not_known(run)),
        formulas={
            run.system.text(quantity): run.system.text(FORMULAS[quantity])
            for quantity, _, name in _QUANTITIES
            if run.system.axes.has(name)
        },
    )


def condition_words(run: Run, condition: Condition) -> str:
    """A condition in the units of the run: "35 lbf, 1 in, 0.5 Hz"."""
    words, axes = run.system.words, run.system.axes
    parts = [words([condition.stroke], "in", 3)]
    if axes.actuated:
        parts.insert(0, words([condition.actuation], run.actuation_unit, actuation=True))
    if axes.timed:
        parts.append(f"{condition.frequency:.3g} Hz")
    return ", ".join(parts)


Tested = tuple[Condition, str, Trace, MeasuredCycles]


def _harmonic_tests(run: Run) -> list[Tested]:
    """Condition and measured cycles of every harmonic test, also of those held out."""
    traces = {name: test.trace for name, test in run.tests.items()} | dict(run.held_out)
    tests = []
    for name in run.manifest.tests:
        if name not in traces:
            continue
        cycles = measured_of(run.manifest, name)
        full = cycles.full_stroke
        if full.size and full.mean() >= HARMONIC:
            amplitude = 0.5 * float(np.median(cycles.stroke[full]))
            timed = run.system.axes.timed
            frequency = float(np.median(cycles.frequency[full])) if timed else 1.0
            level, by = traces[name].reference_actuation, run.system.factor("in")
            condition = Condition(level, _rounded(amplitude * by) / by, _rounded(frequency))
            tests.append((condition, name, traces[name], cycles))
    return tests


def _rounded(value: float) -> float:
    """A value with two digits where they are right within 2 %, else with three."""
    two = float(f"{value:.2g}")
    return two if abs(value - two) <= 0.02 * value else float(f"{value:.3g}")


def _rows(
    run: Run, condition: Condition, label: str, own: Sequence[Tested]
) -> list[dict[str, object]]:
    """Rows of one condition; `own` are its tests."""
    axes = run.system.axes
    if own:
        trace = own[0][2]
    else:
        trace = Harmonic(*condition[1:], CYCLES, axes.timed).trace(condition.actuation)
    devices = run.manifest.settings.devices
    names = dict.fromkeys((run.session(n), devices[n]) for _, n, _, _ in own) or places_of(run)
    drawn = drawn_properties(run, trace, list(names))
    remarks = [] if own else [d.sentence(run.system) for d in run.departures(trace)]
    head = {
        "condition": label,
        "actuation": condition.actuation,
        "actuation_unit": run.actuation_unit,
        "stroke": condition.stroke,
        "frequency": condition.frequency,
        "tested": bool(own),
        "of": BASES[BASIS],
        "note": "; ".join(remarks),
    }
    rows = []
    for quantity, direction, name in _QUANTITIES:
        if not axes.has(name):
            continue
        for cycle in range(CYCLES + 1 if name == "energy" else 1):
            values = {basis: _of_cycle(of, name, cycle) for basis, of in drawn.items()}
            if cycle and not np.any(np.isfinite(values[BASIS])):
                continue
            row = bounds(values["device"], values[BASIS], PROBABILITY)
            other = bounds(values["device"], values.get(ANOTHER, np.empty(0)), PROBABILITY)
            rows.append(
                head
                | {"quantity": quantity, "direction": direction, "unit": CYCLE_UNITS[name]}
                | {"cycle": cycle, **row}
                | _measured(name, cycle, [cycles for *_, cycles in own], row)
                | {f"{key}_other": other[key] for key in ("lambda_min", "lambda_max")}
            )
    return rows


def _of_cycle(drawn: Mapping[str, Array], name: str, cycle: int) -> Array:
    """Draws, (n,), of a property of a test, or of the energy of one of its cycles."""
    if cycle:
        return drawn["energy"][:, cycle - 1 : cycle].ravel()
    return drawn["energy_per_cycle" if name == "energy" else name]


def _measured(
    name: str, cycle: int, tests: Sequence[MeasuredCycles], bounds: Mapping[str, float]
) -> dict[str, float]:
    """Measured value of tests, or of one cycle of them, with its smallest and largest cycle.

    The standard error is that of the mean of the cycles, of all tests.
    """
    kept = slice(cycle - 1, cycle) if cycle else slice(None)
    of_cycles = [getattr(test, name)[test.full_stroke][kept] for test in tests]
    if cycle:
        values, errors = np.concatenate([np.empty(0), *of_cycles]), np.empty(0)
    else:
        values = np.array([test.of_test()[name] for test in tests])
        errors = np.array([test.standard_error(name) for test in tests])
    if name.startswith("peak"):  # the largest value is no mean
        errors = np.empty(0)
    each = np.concatenate([np.empty(0), *of_cycles])
    each, values = each[np.isfinite(each)], values[np.isfinite(values)]
    outside = (values < bounds["lower"]) | (values > bounds["upper"])
    nan = float("nan")
    return {
        "measured_low": float(each.min()) if each.size else nan,
        "measured": float(values.mean()) if values.size else nan,
        "measured_high": float(each.max()) if each.size else nan,
        "standard_error": float(np.sqrt(np.sum(errors**2)) / errors.size) if errors.size else nan,
        "n_cycles": each.size,
        "n_tests": values.size,
        "n_outside": int(outside.sum()),
    }


def _tested(run: Run) -> dict[str, Message]:
    """Ranges and numbers of what was tested."""
    more = {"stroke": " from end to end"}
    ranges = {
        run.system.text(span.name): Message(
            f"{{range}}{more.get(span.name, '')}", {"range": span.words(run.system)}
        )
        for span in run.tested
        if run.system.axes.actuated or span.name != "actuation"
    }
    sessions = [session for session in sessions_of(run) if session]
    return ranges | {
        "devices": Message(f"{len(run.devices)}"),
        "sessions": Message(f"{len(sessions)}" if sessions else "1 (none declared)"),
        "tests": Message(f"{len(run.tests)} calibrated, {len(run.held_out)} held out"),
    }


def _verdict(run: Run, rows: pd.DataFrame) -> tuple[Message, ...]:
    """What the run may be used for, how many measured values its bounds hold, and where."""
    use = run.manifest.verdicts.get("campaign", "") or "not yet judged"
    count = len(run.tests)
    fine = " All tests are reproduced within tolerance." if use == Use.USABLE else ""
    first = Message(f"{{use}}: {count} calibrated tests.{fine}", {"use": use})
    tested = rows[(rows["cycle"] == 0) & rows["tested"].astype(bool)]
    values, outside = int(tested["n_tests"].sum()), int(tested["n_outside"].sum())
    most = ""
    if outside:
        worst = tested.sort_values("n_outside").to_dict("records")[-1]
        quantity = worst["quantity"].replace("_", " ")
        most = f", {worst['n_outside']} of them {quantity} at {worst['condition']}"
    second = Message("No test is harmonic: there are no measured cycles to compare.")
    if values:
        second = Message(
            f"{outside} of {values} measured values ({100 * outside / values:.1f} %) lie outside "
            "their 95 % bounds{most}.",
            {"most": most},
        )
    spans = {span.name: span for span in run.tested}
    actuated = ("actuation",) if run.system.axes.actuated else ()
    where = [spans[name] for name in (*actuated, "stroke", "frequency") if name in spans]
    third = Message(
        "Bounds and λ, which are bounds over the nominal value, are of {of}, the device tested "
        "again, within {where}; outside they rest on the form of the laws.",
        {"of": BASES[BASIS], "where": ", ".join(span.words(run.system) for span in where)},
    )
    if len(run.devices) < 2:
        return first, second, third
    slip = rows[(rows["cycle"] == 0) & (rows["quantity"] == "slip_force")]
    low, high = slip["lambda_min_other"].min(), slip["lambda_max_other"].max()
    fourth = Message(
        f"Another device of the make, from {len(run.devices)} devices: slip force of "
        f"{low:.2f} to {high:.2f} times the nominal one."
    )
    return first, second, third, fourth


def _not_known(run: Run) -> tuple[Message, ...]:
    """What ASCE/SEI 7 and EN 15129 ask of property factors and these tests cannot tell."""
    followed = {c for those in run.manifest.settings.dependence.values() for c in those}
    ageing = "Ageing, wear and contamination: all tests are of a few cycles of a new device."
    unknown = {
        "Other devices of the same make: all tests are of one device.": len(run.devices) < 2,
        ageing: not followed & {"date", "cycles"},
        "Temperature: no law of these tests follows one.": "temperature" not in followed,
    }
    return tuple(Message(text) for text, lacking in unknown.items() if lacking)
