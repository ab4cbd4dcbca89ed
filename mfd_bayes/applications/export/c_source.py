"""The step in C as a folder of sources: the package's own, and a device's parameter sets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.applications.export.sets import PROBABILITY, ParameterSets
from mfd_bayes.runs.run import Run
from mfd_bayes.store.files import write_text
from mfd_bayes.units import percent

Array = NDArray[np.float64]

SOURCES = Path(__file__).with_name("c")
KINDS = {"ksi": "DAMPER_PRESSURE", "kip": "DAMPER_FORCE", "": "DAMPER_NO_ACTUATION"}
SAMPLES, STEP = 96, 0.05  # of the motion of the self-test, and its mean step, s


def source(name: str) -> str:
    """Text of a file of C that the package brings."""
    return (SOURCES / name).read_text(encoding="utf-8")


def numbers(values: ArrayLike) -> str:
    """Numbers as C and Python read them back, exactly."""
    return ", ".join(repr(float(value)) for value in np.ravel(values))


def table(sets: ParameterSets) -> str:
    """damper_sets.c: the device and its parameter sets as a table of C."""
    kind = KINDS.get(sets.unit, "DAMPER_OTHER")
    grid = sets.grid if sets.unit and sets.grid.size > 1 else np.empty(0)
    logs = f"{{{numbers(np.log(grid))}}}" if grid.size else "{0.0}"
    lines = [
        f"/* {len(sets.names)} parameter sets of {sets.model.name}; in kip, in, s"
        f"{f' and {sets.unit}' if sets.unit else ''}. */",
        '#include "damper.h"\n',
        "static const damper_device device = {",
        f"    DAMPER_{sets.model.name.upper()}, {kind}, {numbers([sets.level, sets.reference])},",
        f"    {{{numbers(sets.tested)}}}, {{{numbers(sets.reach)}}}, {grid.size}, {logs}}};\n",
        "const damper_set damper_sets[] = {",
    ]
    for row, name in enumerate(sets.names):
        columns = zip(*(values[row] for values in sets.laws), strict=True)
        laws = ",\n      ".join(
            f"{{{numbers([share, exponent])}, {{{numbers(deviation) if grid.size else '0.0'}}}}}"
            for share, exponent, deviation in columns
        )
        lines.append(
            f'    {{"{name}", &device,\n     {{{numbers(sets.theta[row])}}},\n'
            f"     {numbers(sets.start[row])},\n     {{{laws}}}}},"
        )
    return "\n".join([*lines, f"}};\nconst int damper_set_count = {len(sets.names)};\n"])


def selftest_data(sets: ParameterSets, stroke: float) -> str:
    """selftest_data.h: a motion of a stroke, in, and the forces of `Model.step` of each set."""
    model, low, high = sets.model, *sets.tested
    k = np.arange(SAMPLES)
    dt = STEP * (1.0 + 0.5 * np.sin(k))
    t = np.cumsum(dt) - dt[0]
    x = 0.5 * stroke * (0.8 * np.sin(2.0 * t) + 0.3 * np.sin(7.3 * t))
    v = 0.5 * stroke * (1.6 * np.cos(2.0 * t) + 2.19 * np.cos(7.3 * t))
    p = low + (high - low) * (0.5 - 0.5 * np.cos(1.1 * t))
    state, forces = model.start(sets.theta, sets.start), np.empty((len(sets.names), SAMPLES))
    for i in range(SAMPLES):
        scales = sets.factors(p[i])
        forces[:, i], state = model.step(state, x[i], v[i], dt[i], scales=scales or None)
    lines = [f"#define SELFTEST_SAMPLES {SAMPLES}"]
    for name, values in (("dt", dt), ("x", x), ("v", v), ("p", p)):
        lines.append(f"static const double selftest_{name}[] = {{{numbers(values)}}};")
    rows = ",\n".join(f"    {{{numbers(row)}}}" for row in forces)
    return "\n".join(
        [*lines, f"static const double selftest_force[][{SAMPLES}] = {{", rows, "};", ""]
    )


def parameters_csv(sets: ParameterSets) -> str:
    """The sets as a table: parameters, start, and the laws with their deviations."""
    units = {quantity.name: quantity.unit for quantity in sets.model.quantities}
    head = ["set"]
    for name in sets.model.parameters:
        unit = units.get(name, "1").replace("*", "_").replace("/", "_per_")
        head.append(name if unit == "1" else f"{name}_{unit}")
    head.append("start")
    levels = sets.grid if sets.grid.size > 1 else np.empty(0)
    for law in sets.model.laws:
        head += [f"{law}_share", f"{law}_exponent"]
        head += [f"{law}_deviation_at_{level:.6g}" for level in levels]
    lines = [",".join(head)]
    for row, name in enumerate(sets.names):
        cells = [*sets.theta[row], sets.start[row]]
        for share, exponent, deviation in zip(*(a[row] for a in sets.laws), strict=True):
            cells += [share, exponent, *(deviation if levels.size else ())]
        lines.append(",".join([name, *(repr(float(cell)) for cell in cells)]))
    return "\n".join(lines) + "\n"


def readme(run: Run, sets: ParameterSets) -> str:
    """README.txt of the folder."""
    words, system = run.system.words, run.system
    slip = [
        f"{name}: {words([fwd], 'kip')} forward, {words([bwd], 'kip')} backward"
        for name, (fwd, bwd) in zip(sets.names, sets.slip, strict=False)
    ]
    level = words([sets.level], sets.unit, actuation=True) if sets.unit else ""
    residual = run.population.residual
    leftover = float(np.sqrt(np.mean(residual.mean**2)) / residual.slip_force)
    laws = ""
    if sets.unit:
        tested = next(span for span in run.tested if span.name == "actuation")
        laws = (
            f"Friction follows the actuation by the laws; tested: {tested.words(system)}. Beyond, "
            "the step returns 1; far beyond, it refuses.\n"
        )
    return (
        f"{run.manifest.title}: {sets.model.name}, step by step in C99\n\n"
        "cc -std=c99 -O2 damper.c damper_sets.c selftest.c -lm -o selftest && ./selftest\n\n"
        "damper.h says how to call it; DAMPER_UNITS there chooses your units. parameters.csv: kip, "
        f"in, s{f', {sets.unit}' if sets.unit else ''}. Equations: the documents' page "
        '"The model".\n\n'
        f"The sets{f' stand at {level}' if level else ''}.\n"
        f"1 to {len(sets.names) - len(sets.slip)}: draws of this device tested again.\n"
        "nominal, lower, upper: medians of the mean property; friction multiplied until the slip "
        f"force is that of the data sheet (nominal; {percent(PROBABILITY)} % bounds of a "
        f"measurement) in {sets.condition}:\n"
        + "".join(f"  {line}\n" for line in slip)
        + "They bound slip forces. Gap and stiffness are nominal: take draws where these matter.\n"
        + system.text(laws)
        + "Not in it: noise, and what the model leaves over "
        f"({100 * leftover:.2g} % of the slip force).\n"
    )


def write_source(run: Run, sets: ParameterSets, folder: Path) -> list[str]:
    """Write the step and its sets into a folder; what was written, in sentences."""
    stroke = max((span.highest for span in run.tested if span.name == "stroke"), default=2.0)
    for name in ("damper.h", "damper.c", "shared.c", "selftest.c"):
        write_text(folder / name, source(name))
    write_text(folder / "damper_sets.c", table(sets))
    write_text(folder / "selftest_data.h", selftest_data(sets, stroke))
    write_text(folder / "parameters.csv", parameters_csv(sets))
    write_text(folder / "README.txt", readme(run, sets))
    return [
        f"the step of {sets.model.name} in C99: {folder / 'damper.c'}; {len(sets.names)} parameter "
        f"sets: {folder / 'damper_sets.c'}, {folder / 'parameters.csv'}",
        f"how to compile and test it, and what the bounds stand for: {folder / 'README.txt'}",
    ]
