"""Prior files: one TOML per device family, found by name or path."""

from __future__ import annotations

import re
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from mfd_bayes.calibration import noise as noises
from mfd_bayes.calibration import priors
from mfd_bayes.calibration.noise import Noise
from mfd_bayes.calibration.priors import Prior
from mfd_bayes.errors import PriorError, UnitError
from mfd_bayes.friction import models
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.quantity import Quantity
from mfd_bayes.store.toml import TomlError, read_toml
from mfd_bayes.units import parse_quantity

# beginning of the title of a prior file that was made of a campaign's own records
SCALED = "scales read off the records"

WRITTEN = "priors.toml"  # name of the prior file that ``mfd-bayes init`` writes beside a campaign

# the device's own scales that a prior file may state, and what each measures
SCALES = MappingProxyType({"force": "force", "length": "displacement", "speed": "velocity"})

# largest length of an error message, in characters, however long the names in the file
_LONGEST = 1000

_MULTIPLES = MappingProxyType(
    {
        "force": ("force", "", "kip"),
        "length": ("length", "", "in"),
        "speed": ("speed", "", "in/s"),
        "force/length": ("force", "length", "kip/in"),
        "force/speed": ("force", "speed", "kip*s/in"),
        "length/speed": ("length", "speed", "s"),
    }
)
_MULTIPLE = re.compile(
    rf"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s+({'|'.join(_MULTIPLES)})\s*"
)


# what a record has, whatever the model and the noise
OF_RECORDS = (
    Quantity(
        "start",
        "dimensionless",
        "w_0",
        "w<sub>0</sub>",
        "place in the gap at the first sample",
        pooled=False,
    ),
    Quantity("offset", "force", "F_0", "F<sub>0</sub>", "offset of the load cell", least=-np.inf),
)


def known_quantities(model: Model | None = None) -> dict[str, Quantity]:
    """Quantities of the package's models, of records and of all noises, by name.

    Those of a given `model` stand in place of others of the same name.
    """
    parts = [m.quantities for m in models.MODELS.values()]
    parts += [OF_RECORDS, *(noise.quantities for noise in noises.NOISES.values())]
    parts += [model.quantities] if model else []
    return {quantity.name: quantity for part in parts for quantity in part}


def quantities_of_fit(model: Model, noise: Noise, *, sampled_start: bool) -> list[Quantity]:
    """Quantities of a fit that have priors, in the order in which they are sampled."""
    has_start = model.has_gap and sampled_start
    record = [quantity for quantity in OF_RECORDS if quantity.name != "start" or has_start]
    return [q for q in (*model.quantities, *record, *noise.quantities) if q.sampled]


def sampled_quantities(model: Model | None = None) -> dict[str, Quantity]:
    """Those that may have a prior, by name."""
    return {name: q for name, q in known_quantities(model).items() if q.sampled}


def units(model: Model | None = None) -> dict[str, str]:
    """Internal unit of every quantity, by name; those of `model` first."""
    return {name: quantity.unit for name, quantity in known_quantities(model).items()}


@dataclass(frozen=True)
class Scatter:
    """Prior of the test-to-test scatter of a group of parameters.

    Half-normal of scale `sd`, or, where it prefers none (`sparse`), exponential of mean `sd`
    (penalised complexity: Simpson et al., 2017). The scatter is of the logarithm, or in internal
    units for a quantity that may be negative.
    """

    parameters: tuple[str, ...]
    sd: float
    reason: str = ""
    sparse: bool = False


@dataclass(frozen=True)
class PriorFile:
    """Priors of one device family, by parameter and by group."""

    path: Path
    title: str
    parameters: Mapping[str, Prior]
    scatter: Mapping[str, Scatter]

    @property
    def gap(self) -> float | None:
        """Typical width of the gap, in: the median of its prior; None without.

        With priors of d2 and d3 it is the sum of their medians.
        """
        for names in (("d2", "d3"), ("gap",)):
            if all(name in self.parameters for name in names):
                return sum(self.parameters[name].typical for name in names)
        return None


def find_priors(name: str, folder: Path | None = None) -> Path:
    """Path of a prior file named "mfd", "brfd", … or given by its path.

    With a `folder`, the path is relative to it and, with links resolved, must lie in it.
    """
    package = Path(__file__).parents[1]
    home = next(p for p in (package / "priors", package.parent / "priors") if p.is_dir())
    known = sorted(path.stem for path in home.glob("*.toml"))
    if name in known:
        return home / f"{name}.toml"
    path = (folder or Path()) / name
    try:
        if path.is_file():
            if folder is not None and not path.resolve().is_relative_to(folder.resolve()):
                raise PriorError(
                    f"prior file {name!r} lies outside the campaign's folder, {folder}"
                )
            return path
    except (OSError, RuntimeError, ValueError) as error:
        raise PriorError(f"prior file {name!r} cannot be found: {error}") from error
    hint = "; mfd-bayes init CAMPAIGN.TOML writes it once the units are there"
    raise PriorError(
        f"no prior file {name!r}: expected one of {', '.join(known)}, or the path of a TOML file"
        f"{hint if name == WRITTEN else ''}"
    )


def load_priors(
    name: str,
    folder: Path | None = None,
    model: Model | None = None,
    *,
    of_others: bool = False,
) -> PriorFile:
    """Priors of a file, checked; a user's own model makes its parameters known.

    With `of_others`, what `model` does not have may be of another model, whose parameters are not
    known here: what cannot be read of it is left out.
    """
    path = find_priors(name, folder)
    try:
        content = read_toml(path)
    except OSError as error:
        raise PriorError(f"cannot read the prior file {path}: {error.strerror or error}") from error
    except TomlError as error:
        raise PriorError(f"prior file {path.name} {error}") from error
    try:
        known = sampled_quantities(model)
        return _read(path, content, known, model if of_others else None)
    except PriorError as error:
        if len(str(error)) <= _LONGEST:
            raise
        raise PriorError(f"{str(error)[:_LONGEST]}…") from None


def _read(
    path: Path, content: dict[str, Any], known: Mapping[str, Quantity], only: Model | None
) -> PriorFile:
    """Priors of a file; with `only`, without those of other models that cannot be read."""
    scales = _scales(path.name, content["scales"]) if "scales" in content else None
    unknown = set(content) - {"title", "scales", "parameters", "scatter"}
    if unknown:
        raise PriorError(
            f"unknown key '{min(unknown)[:60]}' in prior file {path.name}; "
            "it may hold title, scales, parameters and scatter"
        )
    sections: list[dict[str, dict[str, Any]]] = []
    for key in ("parameters", "scatter"):
        tables = content.get(key, {})
        if not isinstance(tables, dict) or not all(isinstance(t, dict) for t in tables.values()):
            raise PriorError(f"[{key}] of prior file {path.name} must hold tables")
        sections.append(
            {
                name: {k: _in_units(path.name, v, scales) for k, v in table.items()}
                for name, table in tables.items()
            }
        )
    needed = {*(q.name for q in only.quantities), *known.keys() - _of_models()} if only else None
    parameters = {}
    for key, table in sections[0].items():
        try:
            parameters[key] = _prior(path, key, table, known)
        except PriorError:
            if needed is None or key in needed:
                raise
    groups = sections[1]
    if needed is not None:
        for key, table in list(groups.items()):
            members = table.get("parameters")
            if isinstance(members, list):
                table["parameters"] = [name for name in members if name in needed]
                if not table["parameters"]:
                    del groups[key]
    return PriorFile(
        path=path,
        title=str(content.get("title", path.stem)),
        parameters=parameters,
        scatter={key: _scatter(path, key, table, known) for key, table in groups.items()},
    )


def _of_models() -> set[str]:
    """Names of the quantities of the package's models."""
    return {quantity.name for model in models.MODELS.values() for quantity in model.quantities}


def _scales(name: str, given: Any) -> dict[str, float]:
    """The device's own force, length and speed, internal units."""
    if not isinstance(given, dict) or set(given) != set(SCALES):
        raise PriorError(f"[scales] of prior file {name} must hold force, length and speed")
    found = {}
    for key, measured in SCALES.items():
        where = f"{key} in [scales] of prior file {name}"
        if not isinstance(given[key], str):
            raise PriorError(f"{where}: expected a quantity such as '7 N', got {given[key]!r:.60}")
        try:
            found[key] = parse_quantity(given[key], measured, of=where)
        except UnitError as error:
            raise PriorError(str(error)) from error
        if not found[key] > 0.0:
            raise PriorError(f"{where}: expected more than 0, got {given[key]!r}")
    return found


def _in_units(name: str, value: Any, scales: Mapping[str, float] | None) -> Any:
    """A figure, or, where it is a multiple of the device's scales, its quantity."""
    match = _MULTIPLE.fullmatch(value) if isinstance(value, str) and len(value) < 100 else None
    if match is None:
        return value
    if scales is None:
        raise PriorError(
            f"prior file {name} holds multiples of a force, a length and a speed, and does not "
            "state them: copy it beside the campaign and complete [scales] in it, or let "
            "mfd-bayes init campaign.toml write a priors.toml from your records"
        )
    over, under, unit = _MULTIPLES[match[2]]
    return f"{float(match[1]) * scales[over] / scales.get(under, 1.0)!r} {unit}"


def _prior(path: Path, name: str, table: dict[str, Any], known: Mapping[str, Quantity]) -> Prior:
    where = f"prior of {name[:60]} in {path.name}"
    if name not in known:
        raise PriorError(f"{where}: unknown parameter; expected one of {', '.join(known)}")
    family = priors.FAMILIES.get(str(table.get("family")))
    if family is None:
        raise PriorError(
            f"{where}: family must be one of {', '.join(priors.FAMILIES)}, "
            f"got {table.get('family')!r}"
        )
    figures = {}
    for key, value in table.items():
        figure = family.figures.get(key)
        if figure is not None:
            kind = known[name].kind if figure.dimensional else None
            figures[key] = _figure(f"{where}, {key}", value, kind)
        elif key not in ("family", "reason"):
            figures[key] = np.nan  # the family refuses unknown keys
    try:
        return Prior(str(table["family"]), figures, str(table.get("reason", "")))
    except PriorError as error:
        raise PriorError(f"{where}: {error}") from error


def _scatter(
    path: Path, name: str, table: dict[str, Any], known: Mapping[str, Quantity]
) -> Scatter:
    where = f"scatter {name[:60]} in {path.name}"
    members, keys = table.get("parameters"), set(table) - {"parameters", "reason"}
    if keys not in ({"sd"}, {"above", "probability"}) or not isinstance(members, list):
        raise PriorError(
            f"{where}: expected the keys parameters (a list), reason, and sd; or above and "
            "probability in place of sd, for a scatter that is likely none"
        )
    if unknown := [member for member in members if member not in known]:
        raise PriorError(f"{where}: unknown parameter {unknown[0]!r}")
    key = "sd" if "sd" in keys else "above"
    kinds = {known[member].kind for member in members}
    negative = bool(members) and all(known[member].least < 0.0 for member in members)
    size = _figure(
        f"{where}, {key}", table[key], kinds.pop() if negative and len(kinds) == 1 else None
    )
    if not size > 0:
        raise PriorError(f"{where}: {key} must be positive, got {size:g}")
    if key == "above":
        share = _figure(f"{where}, probability", table["probability"], None)
        if not 0.0 < share < 1.0:
            raise PriorError(f"{where}: probability must lie between 0 and 1, got {share:g}")
        size /= -float(np.log(share))  # the mean of an exponential with this share above `above`
    return Scatter(tuple(members), size, str(table.get("reason", "")), sparse=key == "above")


def _figure(where: str, value: Any, kind: str | None) -> float:
    """A number of a prior file in internal units; `kind` is what a quantity with unit measures."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise PriorError(
            f"{where}: expected a number or a quantity such as '2 kip', got {reprlib.repr(value)}"
        )
    if isinstance(value, str):
        try:
            number = parse_quantity(value, kind or "dimensionless")
        except UnitError as error:
            raise PriorError(f"{where}: {error}") from error
    elif kind in (None, "dimensionless"):
        try:
            number = float(value)
        except OverflowError:
            number = np.inf
    else:
        raise PriorError(
            f"{where}: expected a quantity with its unit ({kind}), got {reprlib.repr(value)}"
        )
    if not np.isfinite(number):
        raise PriorError(f"{where}: must be finite, got {reprlib.repr(value)}")
    return number


def priors_of(file: PriorFile, wanted: list[Quantity]) -> dict[str, Prior]:
    """Priors of quantities by name; none may be missing or allow what no damper has."""
    if missing := [q.name for q in wanted if q.name not in file.parameters]:
        raise PriorError(f"prior file {file.path.name} has no prior for {', '.join(missing)}")
    found = {q.name: file.parameters[q.name] for q in wanted}
    for q, prior in zip(wanted, found.values(), strict=True):
        value = prior.figures.get("value", np.nan)
        lowest, highest = (value, value) if prior.fixed else (prior.lower, prior.upper)
        if q.least <= lowest <= highest <= q.most:
            continue
        beyond = f"values above {q.most:g}" if lowest >= q.least else f"values below {q.least:g}"
        raise PriorError(
            f"prior of {q.name} in {file.path.name}: {prior.family} allows "
            f"{'negative values' if lowest < 0 <= q.least else beyond}, which {q.name} cannot have"
        )
    return found
