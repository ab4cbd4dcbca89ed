"""The data sheet: measured, nominal and bounding properties of each tested condition."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mfd_bayes.errors import CampaignError, MfdError
from mfd_bayes.evaluation.bounds import (
    ANOTHER,
    BASES,
    bounds,
    drawn_properties,
    places_of,
    sessions_of,
)
from mfd_bayes.evaluation.properties import Array, measured_of
from mfd_bayes.evaluation.views import Datasheet
from mfd_bayes.messages import Message
from mfd_bayes.records.cycles import PROPERTIES, RECORD, DeviceProperty, MeasuredCycles
from mfd_bayes.records.record import NO_ACTUATION
from mfd_bayes.records.trace import Harmonic, Trace, parse_sine
from mfd_bayes.runs.findings import Fitness
from mfd_bayes.runs.run import Run
from mfd_bayes.units import DAMPER, Axes, actuation_kind, parse_actuation

if TYPE_CHECKING:
    import pandas as pd


# --- the data sheet: measured values, nominal ones and bounds, at each condition

PROBABILITY = 0.95  # of the interval between lower and upper bound
BASIS = "observation"  # what the bounds are of: a measured value lies in them with PROBABILITY
CYCLES = 3  # cycles of which the energy is given one by one
HARMONIC = 0.2  # least share of the cycles at full stroke, by which a test counts as harmonic
_ON_SHEET = [quantity for quantity in PROPERTIES.values() if quantity.sheet]


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


def datasheet(run: Run, conditions: Sequence[Condition] = ()) -> Datasheet:
    """Data sheet of a run: every condition that was tested, and those of `conditions`."""
    tests = _harmonic_tests(run)
    table, lacking = [], []
    for condition in dict.fromkeys([*sorted({test[0] for test in tests}), *conditions]):
        matching = [test for test in tests if test[0] == condition]
        label = condition_words(run, condition)
        try:
            table += _rows(run, condition, label, matching)
        except MfdError as error:
            if condition in conditions:
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
            run.system.text(quantity.sheet): run.system.text(quantity.formula)
            for quantity in _ON_SHEET
            if quantity.applies(run.system.axes)
        },
    )


def condition_words(run: Run, condition: Condition) -> str:
    """A condition in the units of the run: "35 lbf, 1 in, 0.5 Hz"."""
    words, axes = run.system.words, run.system.axes
    fields = [words([condition.stroke], "in", 3)]
    if axes.actuated:
        fields.insert(0, words([condition.actuation], run.actuation_unit, actuation=True))
    if axes.timed:
        fields.append(f"{condition.frequency:.3g} Hz")
    return ", ".join(fields)


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
            level, factor = traces[name].reference_actuation, run.system.factor("in")
            condition = Condition(level, _rounded(amplitude * factor) / factor, _rounded(frequency))
            tests.append((condition, name, traces[name], cycles))
    return tests


def _rounded(value: float) -> float:
    """A value with two digits where they are right within 2 %, else with three."""
    two = float(f"{value:.2g}")
    return two if abs(value - two) <= 0.02 * value else float(f"{value:.3g}")


def _rows(
    run: Run, condition: Condition, label: str, tests: Sequence[Tested]
) -> list[dict[str, object]]:
    """Rows of one condition; `tests` are its tests."""
    axes = run.system.axes
    if tests:
        trace = tests[0][2]
    else:
        trace = Harmonic(*condition[1:], CYCLES, axes.timed).trace(condition.actuation)
    devices = run.manifest.settings.devices
    names = dict.fromkeys((run.session(n), devices[n]) for _, n, _, _ in tests) or places_of(run)
    draws = drawn_properties(run, trace, list(names))
    remarks = [] if tests else [d.sentence(run.system) for d in run.extrapolations(trace)]
    head = {
        "condition": label,
        "actuation": condition.actuation,
        "actuation_unit": run.actuation_unit,
        "stroke": condition.stroke,
        "frequency": condition.frequency,
        "tested": bool(tests),
        "of": BASES[BASIS],
        "note": "; ".join(remarks),
    }
    rows = []
    for quantity in _ON_SHEET:
        if not quantity.applies(axes):
            continue
        for cycle in range(CYCLES + 1 if quantity.sheet == "energy" else 1):
            values = {basis: _of_cycle(of, quantity, cycle) for basis, of in draws.items()}
            if cycle and not np.any(np.isfinite(values[BASIS])):
                continue
            row = bounds(values["mean"], values[BASIS], PROBABILITY)
            other_bounds = bounds(values["mean"], values.get(ANOTHER, np.empty(0)), PROBABILITY)
            rows.append(
                head
                | {
                    "quantity": quantity.sheet,
                    "direction": quantity.direction,
                    "unit": quantity.unit,
                }
                | {"cycle": cycle, **row}
                | _measured(quantity, cycle, [cycles for *_, cycles in tests], row)
                | {f"{key}_other": other_bounds[key] for key in ("lambda_min", "lambda_max")}
            )
    return rows


def _of_cycle(draws: Mapping[str, Array], quantity: DeviceProperty, cycle: int) -> Array:
    """Draws, (n,), of a property of a test, or of the energy of one of its cycles."""
    if cycle:
        return draws[quantity.key][:, cycle - 1 : cycle].ravel()
    return draws[quantity.name]


def _measured(
    quantity: DeviceProperty,
    cycle: int,
    tests: Sequence[MeasuredCycles],
    bounds: Mapping[str, float],
) -> dict[str, float]:
    """Measured value of tests, or of one cycle of them, with its smallest and largest cycle.

    The standard error is that of the mean of the cycles, of all tests.
    """
    window = slice(cycle - 1, cycle) if cycle else slice(None)
    of_cycles = [test.values[quantity.key][test.full_stroke][window] for test in tests]
    if cycle:
        values, errors = np.concatenate([np.empty(0), *of_cycles]), np.empty(0)
    else:
        values = np.array([test.of_test()[quantity.name] for test in tests])
        errors = np.array([test.standard_error(quantity.name) for test in tests])
    if quantity.extent == RECORD:  # the largest value is no mean
        errors = np.empty(0)
    per_cycle = np.concatenate([np.empty(0), *of_cycles])
    per_cycle, values = per_cycle[np.isfinite(per_cycle)], values[np.isfinite(values)]
    outliers = (values < bounds["lower"]) | (values > bounds["upper"])
    nan = float("nan")
    return {
        "measured_low": float(per_cycle.min()) if per_cycle.size else nan,
        "measured": float(values.mean()) if values.size else nan,
        "measured_high": float(per_cycle.max()) if per_cycle.size else nan,
        "standard_error": float(np.sqrt(np.sum(errors**2)) / errors.size) if errors.size else nan,
        "n_cycles": per_cycle.size,
        "n_tests": values.size,
        "n_outside": int(outliers.sum()),
    }


def _tested(run: Run) -> dict[str, Message]:
    """Ranges and numbers of what was tested."""
    suffixes = {"stroke": " from end to end"}
    ranges = {
        run.system.text(span.name): Message(
            f"{{range}}{suffixes.get(span.name, '')}", {"range": span.words(run.system)}
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
    fine = " All tests are reproduced within tolerance." if use == Fitness.USABLE else ""
    usability = Message(f"{{use}}: {count} calibrated tests.{fine}", {"use": use})
    tested = rows[(rows["cycle"] == 0) & rows["tested"].astype(bool)]
    values, outliers = int(tested["n_tests"].sum()), int(tested["n_outside"].sum())
    worst_text = ""
    if outliers:
        worst = tested.sort_values("n_outside").to_dict("records")[-1]
        quantity = worst["quantity"].replace("_", " ")
        worst_text = f", {worst['n_outside']} of them {quantity} at {worst['condition']}"
    comparison = Message("No test is harmonic: there are no measured cycles to compare.")
    if values:
        comparison = Message(
            f"{outliers} of {values} measured values ({100 * outliers / values:.1f} %) lie outside "
            "their 95 % bounds{most}.",
            {"most": worst_text},
        )
    spans = {span.name: span for span in run.tested}
    actuated = ("actuation",) if run.system.axes.actuated else ()
    ranges = [spans[name] for name in (*actuated, "stroke", "frequency") if name in spans]
    validity = Message(
        "Bounds and λ, which are bounds over the nominal value, are of {of}, the device tested "
        "again, within {where}; outside they rest on the form of the laws.",
        {"of": BASES[BASIS], "where": ", ".join(span.words(run.system) for span in ranges)},
    )
    if len(run.devices) < 2:
        return usability, comparison, validity
    slip = rows[(rows["cycle"] == 0) & (rows["quantity"] == "slip_force")]
    low, high = slip["lambda_min_other"].min(), slip["lambda_max_other"].max()
    spread = Message(
        f"Another device of the make, from {len(run.devices)} devices: slip force of "
        f"{low:.2f} to {high:.2f} times the nominal one."
    )
    return usability, comparison, validity, spread


def _not_known(run: Run) -> tuple[Message, ...]:
    """What ASCE/SEI 7 and EN 15129 ask of property factors and these tests cannot tell."""
    followed = {c for covariates in run.manifest.settings.dependence.values() for c in covariates}
    ageing = "Ageing, wear and contamination: all tests are of a few cycles of a new device."
    unknown = {
        "Other devices of the same make: all tests are of one device.": len(run.devices) < 2,
        ageing: not followed & {"date", "cycles"},
        "Temperature: no law of these tests follows one.": "temperature" not in followed,
    }
    return tuple(Message(text) for text, lacking in unknown.items() if lacking)
