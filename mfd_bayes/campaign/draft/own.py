"""A first campaign and prior file for a user's own model: its motion, response and parameters."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.axes import Axis, check_unit
from mfd_bayes.campaign.draft.draft import new_id, read_foreign, table_of_column
from mfd_bayes.campaign.draft.guesses import (
    Guess,
    TestFile,
    actuation_of,
    guess_columns,
    level_in_header,
    levels_in,
    numbers_of,
    prevailing_unit,
    rate_in_header,
    timed_by_rate,
)
from mfd_bayes.errors import RecordError, UnitError
from mfd_bayes.friction.model import Model
from mfd_bayes.records.channels import header_unit
from mfd_bayes.records.readers import Table
from mfd_bayes.store.toml import commented, quoted
from mfd_bayes.units import convert, in_digits, measures

Array = NDArray[np.float64]

_HEAD = """\
# Written by mfd-bayes init for a model of your own. Every size below is a guess: parameters in the
# units of the response, the motion or their ratio have the size of the records, all others 0.3.
# For a motion without a unit, such as strain, a stiffness looks like a response: give its size.
# A spread of 1.5 is a factor of 4.5 both ways. Replace each by what you know, and say why.
"""


def read_own(path: Path, folder: Path, model: Model) -> TestFile:
    """Columns of a file for a model; refused where one is missing."""
    axes, table = model.axes, read_foreign(path, folder)
    guesses = guess_columns(table)
    column = guesses.pop("actuation", None) if model.actuated else None
    roles = {"displacement": axes.motion, "force": axes.response}
    if not axes.of_damper:
        own = {role: _column(table, axis) for role, axis in roles.items()}
        time = {"time": guesses["time"]} if "time" in guesses else {}
        guesses = time | {role: guess for role, guess in own.items() if guess}
    if axes.timed:
        guesses = timed_by_rate(guesses, *rate_in_header(table.head))
    else:
        guesses.pop("time", None)
    needed = ("time", "displacement", "force") if axes.timed else ("displacement", "force")
    if missing := [axes.name(role) for role in needed if role not in guesses]:
        raise RecordError(f"no column for {' and '.join(missing)} among {', '.join(table.names)}")
    header, named = level_in_header(table.head, table.names), levels_in(path.stem)
    return TestFile(path, table, guesses, column, header, named if model.actuated else ())


def campaign_of_own(
    folder: Path, source: str, model: Model, files: Sequence[TestFile]
) -> tuple[str, list[str]]:
    """Campaign file of a user's own model, and sentences on what it does not know yet."""
    axes, unit = model.axes, prevailing_unit(files)
    lines = [
        "# Written by mfd-bayes init. Next: complete what is marked FIXME or unsure here and in",
        "# priors.toml, then: mfd-bayes calibrate campaign.toml -o out --dry-run",
        "[campaign]",
        f"title = {quoted(folder.resolve().name)}",
        f"model = {quoted(source)}",
        'priors = "priors.toml"',
    ]
    ids: list[str] = []
    missing: list[str] = []
    for file in files:
        ids.append(new_id(file.path.stem, ids))
        lines += ["", "[[test]]", f"id = {quoted(ids[-1])}", f"file = {quoted(file.path.name)}"]
        level, where, _ = actuation_of(file, unit) if model.actuated else (None, "", ())
        if isinstance(level, str):
            lines.append(f"actuation = {quoted(level)}  {commented(where)}")
        elif level is not None:
            lines.append(f"actuation = {table_of_column(level)}  {commented(where)}")
        elif model.actuated:
            lines.append('# FIXME: actuation = "500 psi"')
            missing.append(f"{ids[-1]}: add actuation")
        for role, guess in file.columns.items():
            unsure = f"  {commented('; '.join(guess.doubts))}" if guess.doubts else ""
            if not guess.name and not guess.rate:
                lines.append('# FIXME: columns.time = { rate = "100 Hz" }')
                missing.append(f"{ids[-1]}: add the rate of its samples")
            else:
                lines.append(f"columns.{axes.name(role)} = {table_of_column(guess)}{unsure}")
    return "\n".join(lines) + "\n", missing


def _column(table: Table, axis: Axis) -> Guess | None:
    """The first column that is called as an axis, with its unit."""
    for name in table.names:
        if re.match(axis.name, re.sub(r"^[^a-z]+", "", name.lower())):
            for unit in (table.units.get(name), header_unit(name), axis.unit):
                if unit and _fits(unit, axis):
                    doubt = f"no unit is given: that of the model, {unit}, is taken"
                    guessed = unit == axis.unit != "1" and unit not in name
                    return Guess(name, unit, (doubt,) if guessed else ())
    return None


def _fits(unit: str, axis: Axis) -> bool:
    try:
        check_unit(unit, axis, "")
    except UnitError:
        return False
    return True


def sizes(files: Sequence[TestFile], model: Model) -> dict[str, float]:
    """Sizes of the records by unit: the model's motion, response, their ratio and rates."""
    axes, found = model.axes, []
    for file in files:
        parts = []
        for role, axis in (("displacement", axes.motion), ("force", axes.response)):
            guess = file.columns[role]
            values = numbers_of(file.table, guess.name)
            if values is None:
                raise RecordError(f"{file.path.name}: column {guess.name!r} holds no numbers")
            factor = convert(guess.unit, axis.unit) if guess.unit else 1.0
            parts.append(factor * 0.5 * float(np.ptp(values[np.isfinite(values)])))
        found.append(parts)
    motion, response = np.maximum(np.median(found, axis=0), 1e-12).tolist()
    return {
        axes.response.unit: response,
        axes.motion.unit: motion,
        f"({axes.response.unit})/({axes.motion.unit})": response / motion,
        f"({axes.motion.unit})/s": motion,
        f"({axes.response.unit})*s/({axes.motion.unit})": response / motion,
    }


def priors_of_own(model: Model, size: Mapping[str, float], *, timed: bool) -> str:
    """Prior file of a model's parameters, wide, in the sizes of the records."""
    response = model.axes.response.unit
    lines = [_HEAD, f"title = {quoted(f'{model.name}, drafted')}\n", "[parameters]"]
    logs: list[str] = []
    scatter: list[tuple[str, list[str], str]] = []
    for quantity in model.quantities:
        alike = next((u for u in size if quantity.unit != "1" and measures(u, quantity.unit)), "")
        value = size[alike] * convert(alike, quantity.unit) if alike else 0.3
        text, reason = _with_unit(value, quantity.unit), f"FIXME: a guess; {quantity.meaning}"
        if quantity.least == -np.inf:
            zero = _with_unit(0.0, quantity.unit)
            prior = f'family = "normal", mean = {zero}, sd = {text}'
            sd = _with_unit(0.1 * value, quantity.unit)
            scatter.append((quantity.name, [quantity.name], sd))
        elif quantity.most == 1.0:
            prior = 'family = "beta", a = 2, b = 2'
            logs.append(quantity.name)
        else:
            prior = f'family = "lognormal", median = {text}, spread = 1.5'
            logs.append(quantity.name)
        lines.append(f"{quantity.name} = {{ {prior}, reason = {quoted(reason)} }}")
    spread, zero = size[response], _with_unit(0.0, response)
    offset, noise = _with_unit(0.02 * spread, response), _with_unit(0.1 * spread, response)
    memory = '"0.1 s"' if timed else "3"
    more = {
        "offset": f'family = "normal", mean = {zero}, sd = {offset}, reason = "zero of the sensor"',
        "noise_sd": f'family = "half_normal", sd = {noise}, reason = "what the model misses"',
        "noise_time": f'family = "lognormal", median = {memory}, spread = 1.0, reason = "FIXME"',
    }
    lines += [*(f"{name} = {{ {prior} }}" for name, prior in more.items()), "\n[scatter]"]
    scatter += [("parameters", logs, "0.2")] if logs else []
    scatter += [("noise", ["noise_sd", "noise_time"], "0.3"), ("offset_group", ["offset"], offset)]
    for name, names, sd in scatter:
        listed = ", ".join(map(quoted, names))
        why = commented("from test to test: replace it by what you know")
        lines.append(f"{name} = {{ parameters = [{listed}], sd = {sd} }}  {why}")
    return "\n".join(lines) + "\n"


def _with_unit(value: float, unit: str) -> str:
    """A figure in TOML: a number, or a text with its unit."""
    return f"{value:.3g}" if unit == "1" else quoted(f"{in_digits(value, 3)} {unit}")
