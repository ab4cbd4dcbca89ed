"""The data sheet: measured, nominal and bounding properties of each tested condition."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mfd_bayes.applications.properties.factors import nominal_of_tests
from mfd_bayes.applications.properties.harmonic import (
    CYCLES,
    Condition,
    HarmonicTest,
    condition_words,
    harmonic_tests,
)
from mfd_bayes.errors import MfdError
from mfd_bayes.evaluation.bounds import (
    ANOTHER,
    BASES,
    bounds,
    draw_index,
    drawn_properties,
    places_of,
    sessions_of,
    with_gains,
)
from mfd_bayes.evaluation.properties import Array
from mfd_bayes.evaluation.scores import Row, Rows
from mfd_bayes.evaluation.sensitivity import JointDensity, design_rows
from mfd_bayes.evaluation.views import Datasheet
from mfd_bayes.messages import Message
from mfd_bayes.records.cycles import PROPERTIES, RECORD, DeviceProperty
from mfd_bayes.records.trace import Harmonic, Trace
from mfd_bayes.runs.findings import Fitness
from mfd_bayes.runs.run import Run

if TYPE_CHECKING:
    import pandas as pd


# --- the data sheet: measured values, nominal ones and bounds, at each condition

PROBABILITY = 0.95  # of the interval between lower and upper bound
BASIS = "observation"  # what the bounds are of: a measured value lies in them with PROBABILITY
_ON_SHEET = [quantity for quantity in PROPERTIES.values() if quantity.sheet]


_COLUMNS = [
    *("condition", "actuation", "actuation_unit", "stroke", "frequency", "speed", "tested"),
    *("quantity", "direction", "unit", "cycle", "measured_low", "measured", "measured_high"),
    *("first_three", "standard_error", "n_cycles", "n_tests", "n_outside", "of"),
    *("nominal", "lower", "upper", "lower_ratio", "upper_ratio"),
    *("lower_ratio_other", "upper_ratio_other", "note"),
]
"""Of `Datasheet.rows`, there even where no test is harmonic."""

_CYCLES = [
    *("test", "condition", "stroke", "frequency", "speed", "cycle"),
    *("quantity", "direction", "unit", "value", "over_first_three"),
]
"""Of `Datasheet.cycles`."""


def datasheet(
    run: Run, conditions: Sequence[Condition] = (), joint: JointDensity | None = None
) -> Datasheet:
    """Data sheet of a run: every condition that was tested, and those of `conditions`.

    With the run's `joint` density it says what follows the prior.
    """
    tests = harmonic_tests(run)
    scaled: list[Row] = []
    table, lacking = [], []
    for condition in dict.fromkeys([*sorted({test.condition for test in tests}), *conditions]):
        matching = [test for test in tests if test.condition == condition]
        label = condition_words(run, condition)
        try:
            rows_of, sensitivities = _rows(run, condition, label, matching, joint)
            table += rows_of
            scaled += sensitivities
        except MfdError as error:
            if condition in conditions:
                raise
            lacking.append(Message("{label}: {error}.", {"label": label, "error": str(error)}))
    import pandas as pd  # which takes long to import

    rows = pd.DataFrame(table, columns=_COLUMNS)
    return Datasheet(
        rows=rows,
        sensitivity=tuple(scaled),
        cycles=pd.DataFrame(_cycles(run, tests), columns=_CYCLES),
        tested=_tested(run),
        verdict=_verdict(run, rows),
        not_known=(*lacking, *_not_known(run)),
        formulas={
            run.system.text(quantity.sheet): run.system.text(quantity.formula)
            for quantity in _ON_SHEET
            if quantity.applies(run.system.axes)
        },
    )


def sheet_conditions(run: Run) -> Iterator[tuple[str, Trace, list[tuple[str, str]]]]:
    """Each tested condition of the sheet in words, its motion, and its sessions and devices."""
    tests = harmonic_tests(run)
    for condition in sorted({test.condition for test in tests}):
        matching = [test for test in tests if test.condition == condition]
        trace = matching[0].trace
        assert trace is not None  # a run has the motion of each of its tests
        places = dict.fromkeys((test.session, test.device) for test in matching)
        yield condition_words(run, condition), trace, list(places)


def sheet_values(run: Run) -> dict[tuple[str, str, str, str], float]:
    """Nominal value and bounds of each condition, quantity and unit; the third word is which."""
    rows: list[Row] = datasheet(run).rows.to_dict("records")  # type: ignore[assignment]
    values = {}
    for row in rows:
        if not row["cycle"]:
            name = run.system.text(_words(row["quantity"], row["direction"]))
            for which in ("nominal", "lower", "upper"):
                values[row["condition"], name, which, row["unit"]] = row[which]
    return values


def _words(quantity: str, direction: str) -> str:
    return f"{quantity.replace('_', ' ')} {direction}".strip()


def _rows(
    run: Run,
    condition: Condition,
    label: str,
    tests: Sequence[HarmonicTest],
    joint: JointDensity | None,
) -> tuple[list[dict[str, object]], Rows]:
    """Rows of one condition, and their sensitivities; `tests` are its tests."""
    axes = run.system.axes
    if tests:
        trace = tests[0].trace
    else:
        trace = Harmonic(*condition[1:], CYCLES, axes.timed).trace(condition.actuation)
    assert trace is not None  # a run has the motion of each of its tests
    places = dict.fromkeys((test.session, test.device) for test in tests) or places_of(run)
    as_read = drawn_properties(run, trace, list(places))
    draws = with_gains(run, as_read)
    remarks = [] if tests else [d.sentence(run.system) for d in run.extrapolations(trace)]
    head = {
        "condition": label,
        "actuation": condition.actuation,
        "actuation_unit": run.actuation_unit,
        "stroke": condition.stroke,
        "frequency": condition.frequency,
        "speed": condition.speed if axes.timed else float("nan"),
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
            # what was measured is compared with what the same instruments would read
            read_again = _of_cycle(as_read[BASIS], quantity, cycle)
            read = bounds(values["mean"], read_again, PROBABILITY)
            other_bounds = bounds(values["mean"], values.get(ANOTHER, np.empty(0)), PROBABILITY)
            rows.append(
                head
                | {
                    "quantity": quantity.sheet,
                    "direction": quantity.direction,
                    "unit": quantity.unit,
                }
                | {"cycle": cycle, **row}
                | _measured(quantity, cycle, tests, read)
                | {f"{key}_other": other_bounds[key] for key in ("lower_ratio", "upper_ratio")}
            )
    properties = {
        (axes.text(_words(quantity.sheet, quantity.direction)), of): draws[basis][name]
        for name, quantity in ((q.name, q) for q in _ON_SHEET if q.applies(axes))
        for basis, of in (("mean", "nominal value"), (BASIS, "bounds"))
    }
    index = draw_index(run, trace, list(places))
    return rows, design_rows(joint, index, label, properties)


def _cycles(run: Run, tests: Sequence[HarmonicTest]) -> list[dict[str, object]]:
    """Measured values of every cycle at full stroke of the harmonic tests."""
    rows: list[dict[str, object]] = []
    for test in tests:
        condition = test.condition
        for quantity in _ON_SHEET:
            if not quantity.applies(run.system.axes) or not quantity.of_cycle:
                continue
            nominal = test.nominal(quantity)
            rows += [
                {
                    "test": test.name,
                    "condition": condition_words(run, condition),
                    "stroke": condition.stroke,
                    "frequency": condition.frequency,
                    "speed": condition.speed if run.system.axes.timed else float("nan"),
                    "cycle": cycle,
                    "quantity": quantity.sheet,
                    "direction": quantity.direction,
                    "unit": quantity.unit,
                    "value": value,
                    "over_first_three": value / nominal if nominal else float("nan"),
                }
                for cycle, value in enumerate(test.values(quantity).tolist(), start=1)
            ]
    return rows


def _of_cycle(draws: Mapping[str, Array], quantity: DeviceProperty, cycle: int) -> Array:
    """Draws, (n,), of a property of a test, or of the energy of one of its cycles."""
    if cycle:
        return draws[quantity.key][:, cycle - 1 : cycle].ravel()
    return draws[quantity.name]


def _measured(
    quantity: DeviceProperty,
    cycle: int,
    tests: Sequence[HarmonicTest],
    bounds: Mapping[str, float],
) -> dict[str, float]:
    """Measured value of tests, or of one cycle of them, with its smallest and largest cycle.

    The standard error is that of the mean of the cycles, of all tests. "first_three" is the mean of
    the first three cycles of each test, and of these.
    """
    window = slice(cycle - 1, cycle) if cycle else slice(None)
    of_cycles = [test.values(quantity)[window] for test in tests]
    if cycle:
        values, errors = np.concatenate([np.empty(0), *of_cycles]), np.empty(0)
    else:
        values = np.array([test.cycles.of_test()[quantity.name] for test in tests])
        errors = np.array([test.cycles.standard_error(quantity.name) for test in tests])
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
        "first_three": nan if cycle else nominal_of_tests(tests, quantity),
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
        "Bounds are of {of}, the device tested again, within {where}; outside they rest on the "
        "form of the laws.",
        {"of": BASES[BASIS], "where": ", ".join(span.words(run.system) for span in ranges)},
    )
    if len(run.devices) < 2:
        return usability, comparison, validity
    slip = rows[(rows["cycle"] == 0) & (rows["quantity"] == "slip_force")]
    low, high = slip["lower_ratio_other"].min(), slip["upper_ratio_other"].max()
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
