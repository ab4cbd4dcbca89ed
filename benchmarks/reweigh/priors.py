"""Six other prior files, made of one: wider, narrower, shifted, of other families, one changed."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mfd_bayes.calibration.priors import Prior, PriorFile

MOVED = ("Fc_fwd", "Fc_bwd", "sigma0", "k3", "d2", "d3")  # what is shifted
Change = Callable[[str, Prior], Prior]


def scaled(factor: float) -> Change:
    """Priors whose logarithms have another standard deviation."""

    def change(_: str, prior: Prior) -> Prior:
        if prior.family != "lognormal":
            return prior
        return Prior("lognormal", {**prior.figures, "sigma": factor * prior.figures["sigma"]})

    return change


def shifted(sds: float) -> Change:
    """Priors whose medians are some standard deviations of the logarithm higher."""

    def change(name: str, prior: Prior) -> Prior:
        if name not in MOVED or prior.family != "lognormal":
            return prior
        median = prior.figures["median"] * math.exp(sds * prior.figures["sigma"])
        return Prior("lognormal", {**prior.figures, "median": median})

    return change


def another_family(_: str, prior: Prior) -> Prior:
    """A gamma density with the mean and the standard deviation of a lognormal one."""
    if prior.family != "lognormal":
        return prior
    ratio = math.expm1(prior.figures["sigma"] ** 2)  # variance over the squared mean
    mean = prior.figures["median"] * math.exp(0.5 * prior.figures["sigma"] ** 2)
    return Prior("gamma", {"shape": 1.0 / ratio, "scale": mean * ratio})


def one_parameter(name: str, prior: Prior) -> Prior:
    """Three times the damping of the bristles, which no slow test knows."""
    if name != "sigma1":
        return prior
    return Prior("lognormal", {**prior.figures, "median": 3.0 * prior.figures["median"]})


CHANGES: dict[str, tuple[Change, float]] = {
    "wider": (scaled(1.5), 1.5),
    "narrower": (scaled(0.7), 0.7),
    "shifted by 1 sd": (shifted(1.0), 1.0),
    "shifted by 3 sd": (shifted(3.0), 1.0),
    "gamma": (another_family, 1.0),
    "one parameter": (one_parameter, 1.0),
}
"""Change of each prior, and factor of the scales of scatter."""


def write_priors(file: PriorFile, label: str, path: Path) -> Path:
    """The changed prior file as TOML; the figures that have units keep these of the original."""
    change, spread = CHANGES[label]
    content = tomllib.loads(file.path.read_text("utf-8"))
    tables: dict[str, Any] = content["parameters"]
    for name, table in tables.items():
        old, new = file.parameters[name], change(name, file.parameters[name])
        if new == old:
            continue
        # a figure with a unit: the old one times a ratio; without: as it is
        unit = table["median"]
        figures = {
            key: value if key in ("sigma", "shape") else _times(unit, value / old.figures["median"])
            for key, value in new.figures.items()
        }
        tables[name] = {"family": new.family, **figures, "reason": label}
    for table in content.get("scatter", {}).values():
        if "sd" in table:
            table["sd"] = _times(table["sd"], spread)
    lines = [f"title = {json.dumps(label)}"]
    for section in ("scales", "measurement"):
        if section in content:
            lines += ["", f"[{section}]", *_pairs(content[section])]
    for section in ("parameters", "scatter"):
        for name, table in content[section].items():
            lines += ["", f"[{section}.{name}]", *_pairs(table)]
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return path


def _times(figure: Any, factor: float) -> Any:
    """A number, or a text such as "80 kip/in" or "1.2 force", times a factor."""
    if not isinstance(figure, str):
        return figure * factor
    number, _, unit = figure.partition(" ")
    return f"{float(number) * factor!r} {unit}"


def _pairs(table: dict[str, Any]) -> list[str]:
    return [f"{key} = {json.dumps(value)}" for key, value in table.items()]
