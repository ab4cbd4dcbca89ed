"""Prior densities: their families, and the files that hold them."""

from __future__ import annotations

import re
import reprlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from mfd_bayes.calibration.noises import NOISES, Noise
from mfd_bayes.errors import PriorError, UnitError
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.models import MODELS
from mfd_bayes.friction.quantities import Quantity
from mfd_bayes.store.files import RENAMED, TomlError, read_toml
from mfd_bayes.units import DAMPER, parse_quantity

Array = NDArray[np.float64]
Figures = Mapping[str, Any]

RANGE = 1e15  # values beyond this, or as near to a bound, are out of support: no damper has them

# --- families -------------------------------------------------------------------------------------


# a family's numbers: places and widths have the quantity's unit, widths and shapes are positive
PLACE, WIDTH, SHAPE = "place", "width", "shape"
WHOLE_LINE = (-np.inf, np.inf)


@dataclass(frozen=True)
class Family:
    """A family of densities of a quantity x."""

    figures: Mapping[str, str]  # what a prior file gives for it; "upper" may be left out
    log_density: Callable[[Array, Figures], Array]  # normalised, inside the support
    draw: Callable[[np.random.Generator, int, Figures], Array]  # independent draws, (n,)
    median: Callable[[Figures], float]
    support: tuple[float, float] | None = (0.0, np.inf)  # None: the figures lower and upper


def _normal(x: Array, mean: float, sd: float) -> Array:
    return np.asarray(-0.5 * ((x - mean) / sd) ** 2 - np.log(sd) - 0.5 * np.log(2 * np.pi))


def _gamma(x: Array, f: Figures) -> Array:
    k, scale = f["shape"], f["scale"]
    return np.asarray(
        (k - 1) * np.log(x) - x / scale - scipy.special.gammaln(k) - k * np.log(scale)
    )


def _beta(x: Array, f: Figures) -> Array:
    powers = scipy.special.xlogy(f["a"] - 1, x) + scipy.special.xlog1py(f["b"] - 1, -x)
    return powers - scipy.special.betaln(f["a"], f["b"])


def _tail(f: Figures) -> tuple[float, float, float]:
    """Log probabilities below both bounds of a normal, in the tail where they keep their digits.

    The third figure is -1 where that is the upper tail.
    """
    a, b = ((bound - f["mean"]) / f["sd"] for bound in (f["lower"], f.get("upper", np.inf)))
    side = -1.0 if a > 0 else 1.0
    return float(scipy.special.log_ndtr(side * a)), float(scipy.special.log_ndtr(side * b)), side


def _truncated(x: Array, f: Figures) -> Array:
    low, high = sorted(_tail(f)[:2])
    return np.asarray(_normal(x, f["mean"], f["sd"]) - high - np.log1p(-np.exp(low - high)))


def _truncated_quantile(u: Any, f: Figures) -> Any:
    low, high, side = _tail(f)
    probability = np.logaddexp(low + np.log1p(-u), high + np.log(u))
    return f["mean"] + side * f["sd"] * scipy.special.ndtri_exp(probability)


# every family by its name in prior files: a new one is registered here, by one entry
FAMILIES: Mapping[str, Family] = MappingProxyType(
    {
        "lognormal": Family(
            {"median": WIDTH, "sigma": SHAPE},
            lambda x, f: _normal(np.log(x), np.log(f["median"]), f["sigma"]) - np.log(x),
            lambda rng, n, f: rng.lognormal(np.log(f["median"]), f["sigma"], n),
            lambda f: f["median"],
        ),
        "normal": Family(
            {"mean": PLACE, "sd": WIDTH},
            lambda x, f: _normal(x, f["mean"], f["sd"]),
            lambda rng, n, f: rng.normal(f["mean"], f["sd"], n),
            lambda f: f["mean"],
            WHOLE_LINE,
        ),
        "truncated_normal": Family(
            {"mean": PLACE, "sd": WIDTH, "lower": PLACE, "upper": PLACE},
            _truncated,
            lambda rng, n, f: np.asarray(_truncated_quantile(1.0 - rng.random(n), f)),
            lambda f: float(_truncated_quantile(0.5, f)),
            None,
        ),
        "half_normal": Family(
            {"sd": WIDTH},
            lambda x, f: _normal(x, 0.0, f["sd"]) + np.log(2.0),
            lambda rng, n, f: np.abs(rng.normal(0.0, f["sd"], n)),
            lambda f: float(f["sd"] * scipy.special.ndtri(0.75)),
        ),
        "uniform": Family(
            {"lower": PLACE, "upper": PLACE},
            lambda x, f: np.full_like(x, -np.log(f["upper"] - f["lower"])),
            lambda rng, n, f: rng.uniform(f["lower"], f["upper"], n),
            lambda f: 0.5 * (f["lower"] + f["upper"]),
            None,
        ),
        "gamma": Family(
            {"shape": SHAPE, "scale": WIDTH},
            _gamma,
            lambda rng, n, f: rng.gamma(f["shape"], f["scale"], n),
            lambda f: float(f["scale"] * scipy.special.gammaincinv(f["shape"], 0.5)),
        ),
        "beta": Family(
            {"a": SHAPE, "b": SHAPE},
            _beta,
            lambda rng, n, f: np.asarray(rng.beta(f["a"], f["b"], n)),
            lambda f: float(scipy.special.betaincinv(f["a"], f["b"], 0.5)),
            (0.0, 1.0),
        ),
        "fixed": Family(
            {"value": PLACE},
            lambda x, _: np.zeros_like(x),
            lambda _, n, f: np.full(n, f["value"]),
            lambda f: f["value"],
            WHOLE_LINE,
        ),
    }
)


@dataclass(frozen=True)
class Prior:
    """Density of one quantity x, and its unconstrained coordinate q.

    q is x itself on the whole line, log(x − lower) on a half line, and the logit of the place
    between two bounds. Figures are in internal units.
    """

    family: str
    figures: Mapping[str, float]
    reason: str = ""
    lower: float = field(init=False)
    upper: float = field(init=False)

    def __post_init__(self) -> None:
        family, figures = FAMILIES[self.family], self.figures
        required = set(family.figures) - ({"upper"} if self.family == "truncated_normal" else set())
        if not required <= set(figures) <= set(family.figures):
            got = f"{', '.join(sorted(figures)):.200}"
            got += "".join(f": {key} is {RENAMED[key]} now" for key in figures if key in RENAMED)
            raise PriorError(f"{self.family} needs {' and '.join(sorted(required))}, got {got}")
        for key, value in figures.items():
            if family.figures[key] != PLACE and not value > 0:
                raise PriorError(f"{key} must be positive, got {value:g}")
        if "upper" in figures and not figures["upper"] > figures.get("lower", -np.inf):
            raise PriorError("upper must be above lower")
        lower, upper = family.support or (figures["lower"], figures.get("upper", np.inf))
        object.__setattr__(self, "lower", float(lower))
        object.__setattr__(self, "upper", float(upper))

    @property
    def on_half_line(self) -> bool:
        """Whether the quantity may be any positive value, so that its logarithm is sampled."""
        return self.lower == 0.0 and self.upper == np.inf

    @property
    def fixed(self) -> bool:
        """Whether the quantity has one value and is not sampled."""
        return self.family == "fixed"

    @property
    def median(self) -> float:
        """Median of x."""
        return float(FAMILIES[self.family].median(self.figures))

    def value(self, q: Array) -> Array:
        """Quantity x at coordinate q, same shape; inf where q is beyond all range."""
        if self.lower == -np.inf:
            return q
        if self.upper == np.inf:
            return self.lower + np.exp(np.minimum(q, 700.0))
        return self.lower + (self.upper - self.lower) * scipy.special.expit(q)

    def coordinate(self, x: Array) -> Array:
        """Coordinate q of quantity x, the inverse of `value`."""
        if self.lower == -np.inf:
            return x
        if self.upper == np.inf:
            return np.log(x - self.lower)
        return scipy.special.logit((x - self.lower) / (self.upper - self.lower))

    def log_density(self, q: Array) -> Array:
        """Log density of q, with the Jacobian; −inf where x is out of range, same shape."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            x = self.value(q)
            density = FAMILIES[self.family].log_density(x, self.figures)
            if self.upper < np.inf:
                width = np.log(self.upper - self.lower)
                density = density + width + scipy.special.log_expit(q) + scipy.special.log_expit(-q)
            elif self.lower > -np.inf:
                density = density + q
            in_range = (np.abs(x) < RANGE) & (x - self.lower > 1.0 / RANGE)
        return np.where(in_range & np.isfinite(density), density, -np.inf)

    def log_density_of(self, x: Array) -> Array:
        """Log density of x itself, without a Jacobian; −inf outside its support, same shape."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            density = FAMILIES[self.family].log_density(x, self.figures)
        in_support = (x >= self.lower) & (x <= self.upper) & np.isfinite(density)
        return np.where(in_support, density, -np.inf)

    def draw(self, rng: np.random.Generator, n: int) -> Array:
        """Independent draws of x, (n,)."""
        return FAMILIES[self.family].draw(rng, n, self.figures)


# --- quantities that have priors ------------------------------------------------------------------

# what a record has, whatever the model and the noise
OF_RECORDS = (
    Quantity("start", "dimensionless", "w_0", "place in the gap at the first sample", pooled=False),
    Quantity("offset", "force", "F_0", "offset of the load cell", lower=-np.inf),
)


def known_quantities(model: Model | None = None) -> dict[str, Quantity]:
    """Quantities of the package's models, of records and of all noises, by name.

    Those of a given `model` stand in place of others of the same name.
    """
    groups = [packaged.quantities for packaged in MODELS.values()]
    groups += [OF_RECORDS, *(noise.quantities for noise in NOISES.values())]
    groups += [model.quantities] if model else []
    return {quantity.name: quantity for group in groups for quantity in group}


def units(model: Model | None = None) -> dict[str, str]:
    """Internal unit of every quantity, by name; those of `model` first."""
    return {name: quantity.unit for name, quantity in known_quantities(model).items()}


def priors_of_fit(
    file: PriorFile, model: Model, noise: Noise, *, sampled_start: bool
) -> dict[str, Prior]:
    """Priors of a fit's quantities; none may be missing or allow what no damper has."""
    record = OF_RECORDS if model.has_gap and sampled_start else OF_RECORDS[1:]
    quantities = [q for q in (*model.quantities, *record, *noise.quantities) if q.sampled]
    if missing := [q.name for q in quantities if q.name not in file.parameters]:
        raise PriorError(f"prior file {file.path.name} has no prior for {', '.join(missing)}")
    for q in quantities:
        prior = file.parameters[q.name]
        value = prior.figures.get("value", np.nan)
        lowest, highest = (value, value) if prior.fixed else (prior.lower, prior.upper)
        if not q.lower <= lowest <= highest <= q.upper:
            bound = f"above {q.upper:g}" if lowest >= q.lower else f"below {q.lower:g}"
            raise PriorError(
                f"prior of {q.name} in {file.path.name}: {prior.family} allows values {bound}, "
                f"which {q.name} cannot have"
            )
    return {q.name: file.parameters[q.name] for q in quantities}


# --- prior files ----------------------------------------------------------------------------------

# beginning of the title of a prior file that was made of a campaign's own records
SCALED = "scales read off the records"
WRITTEN = "priors.toml"  # the prior file that `mfd-bayes init` writes beside a campaign
# the device's own scales that a prior file may state: what each measures, and its internal unit
SCALES = MappingProxyType(
    {"force": ("force", "kip"), "length": ("displacement", "in"), "speed": ("velocity", "in/s")}
)
MEASURED = ("force", "displacement")  # a prior file may state how well their gains are known
MOST_UNCERTAIN = 0.2  # standard uncertainties of gains lie below this share
# a multiple of one of them, or of one over another
_MULTIPLE = re.compile(
    r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s+(force|length|speed)(?:/(length|speed))?\s*"
)


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
    measurement: Mapping[str, float] = field(default_factory=dict)
    """Standard uncertainties, shares, of `MEASURED` where a campaign states none."""

    @property
    def gap(self) -> float | None:
        """Median width of the gap, in, of d2 and d3 or of gap; None without their priors."""
        for names in (("d2", "d3"), ("gap",)):
            if all(name in self.parameters for name in names):
                return sum(self.parameters[name].median for name in names)
        return None


def find_priors(name: str, folder: Path | None = None) -> Path:
    """Path of a prior file named "mfd", "brfd", … or given by its path.

    With a `folder`, the path is relative to it and, with links resolved, must lie in it.
    """
    package = Path(__file__).parents[1]
    directory = next(p for p in (package / "priors", package.parent / "priors") if p.is_dir())
    shipped = sorted(path.stem for path in directory.glob("*.toml"))
    if name in shipped:
        return directory / f"{name}.toml"
    path = (folder or Path()) / name
    try:
        is_file = path.is_file()
        is_outside = folder and is_file and not path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError) as error:
        raise PriorError(f"prior file {name!r} cannot be found: {error}") from error
    if is_outside:
        raise PriorError(f"prior file {name!r} lies outside the campaign's folder, {folder}")
    if is_file:
        return path
    hint = "; mfd-bayes init CAMPAIGN.TOML writes it once the units are there"
    raise PriorError(
        f"no prior file {name!r}: expected one of {', '.join(shipped)}, or the path of a TOML file"
        f"{hint if name == WRITTEN else ''}"
    )


@contextmanager
def _in(location: str) -> Iterator[None]:
    """Say where in a prior file an error is."""
    try:
        yield
    except (PriorError, UnitError) as error:
        raise PriorError(f"{location}: {error}") from error


def load_priors(
    name: str, folder: Path | None = None, model: Model | None = None, *, of_others: bool = False
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
    with _in(f"[scales] of prior file {path.name}"):
        scales = _scales(content["scales"]) if "scales" in content else None
    if unknown := set(content) - {"title", "scales", "measurement", "parameters", "scatter"}:
        raise PriorError(
            f"unknown key '{min(unknown)[:60]}' in prior file {path.name}; "
            "it may hold title, scales, measurement, parameters and scatter"
        )
    with _in(f"[measurement] of prior file {path.name}"):
        measurement = _measurement(content.get("measurement", {}))
    quantities = {n: _in_model(q, model) for n, q in known_quantities(model).items() if q.sampled}
    required = set(quantities)
    if model is not None and of_others:
        required -= {q.name for packaged in MODELS.values() for q in packaged.quantities}
        required |= {q.name for q in model.quantities}
    parameters, groups = {}, {}
    for key, table in _tables(path, content, "parameters", scales).items():
        try:
            with _in(f"prior of {key[:60]} in {path.name}"):
                parameters[key] = _prior(key, table, quantities)
        except PriorError:
            if not of_others or key in required:
                raise
    for key, table in _tables(path, content, "scatter", scales).items():
        members = table.get("parameters")
        if of_others and isinstance(members, list):
            members = [m for m in members if not isinstance(m, str) or m in required]
            if not members:
                continue
        with _in(f"scatter {key[:60]} in {path.name}"):
            groups[key] = _scatter(table | {"parameters": members}, quantities)
    title = str(content.get("title", path.stem))
    return PriorFile(path, title, parameters, groups, measurement)


def _in_model(quantity: Quantity, model: Model | None) -> Quantity:
    """A quantity as a prior file gives it: in units of what the model's force and motion are."""
    if model is None or model.axes == DAMPER:
        return quantity
    if quantity.kind == "time" and model.rate_independent:
        return replace(quantity, kind="dimensionless")  # in samples
    unit = model.axes.unit(quantity.unit)
    return quantity if unit == quantity.unit else replace(quantity, kind=unit)


def _scales(table: Any) -> dict[str, float]:
    """The device's own force, length and speed, internal units."""
    if not isinstance(table, dict) or set(table) != set(SCALES):
        raise PriorError("it must hold force, length and speed")
    return {k: _figure(k, table[k], kind, positive=True) for k, (kind, _) in SCALES.items()}


def _measurement(table: Any) -> dict[str, float]:
    """Standard uncertainties of the calibrations of instruments, as shares."""
    if not isinstance(table, dict) or not set(table) <= set(MEASURED):
        raise PriorError('it may hold force and displacement alone, such as force = "0.5 %"')
    shares = {k: _figure(k, table[k], "dimensionless", positive=True) for k in table}
    for key, share in shares.items():
        if not share < MOST_UNCERTAIN:
            raise PriorError(f"{key} must be below {MOST_UNCERTAIN:.0%}, got {table[key]!r:.60}")
    return shares


def _tables(
    path: Path, content: dict[str, Any], section: str, scales: Mapping[str, float] | None
) -> dict[str, dict[str, Any]]:
    """Tables of a section; multiples of the device's scales become quantities."""
    tables = content.get(section, {})
    if not isinstance(tables, dict) or not all(isinstance(t, dict) for t in tables.values()):
        raise PriorError(f"[{section}] of prior file {path.name} must hold tables")

    def in_units(value: Any) -> Any:
        match = _MULTIPLE.fullmatch(value) if isinstance(value, str) and len(value) < 100 else None
        if match is None:
            return value
        if scales is None:
            raise PriorError(
                f"prior file {path.name} holds multiples of a force, a length and a speed, and "
                "does not state them: copy it beside the campaign and complete [scales] in it, or "
                "let mfd-bayes init campaign.toml write a priors.toml from your records"
            )
        number, numerator, denominator = match.groups()
        size, unit = float(number) * scales[numerator], SCALES[numerator][1]
        if denominator:
            size, unit = size / scales[denominator], f"{unit}/({SCALES[denominator][1]})"
        return f"{size!r} {unit}"

    return {name: {k: in_units(v) for k, v in table.items()} for name, table in tables.items()}


def _prior(name: str, table: dict[str, Any], quantities: Mapping[str, Quantity]) -> Prior:
    if name not in quantities:
        raise PriorError(f"unknown parameter; expected one of {', '.join(quantities)}")
    family_name = table.get("family")
    if not isinstance(family_name, str) or family_name not in FAMILIES:
        raise PriorError(f"family must be one of {', '.join(FAMILIES)}, got {family_name!r:.60}")
    family, figures = FAMILIES[family_name], {}
    for key, value in table.items():
        if key in family.figures:
            kind = None if family.figures[key] == SHAPE else quantities[name].kind
            figures[key] = _figure(key, value, kind)
        elif key not in ("family", "reason"):
            figures[key] = np.nan  # the family refuses unknown keys
    return Prior(family_name, figures, str(table.get("reason", "")))


def _scatter(table: dict[str, Any], quantities: Mapping[str, Quantity]) -> Scatter:
    members, keys = table["parameters"], table.keys() - {"parameters", "reason"}
    if keys not in ({"sd"}, {"above", "probability"}) or not isinstance(members, list):
        raise PriorError(
            "expected the keys parameters (a list), reason, and sd; or above and "
            "probability in place of sd, for a scatter that is likely none"
        )
    if unknown := [m for m in members if not isinstance(m, str) or m not in quantities]:
        raise PriorError(f"unknown parameter {unknown[0]!r:.60}")
    sparse = "above" in keys
    key = "above" if sparse else "sd"
    kinds = {quantities[member].kind for member in members}
    negative = bool(members) and all(quantities[member].lower < 0.0 for member in members)
    kind = kinds.pop() if negative and len(kinds) == 1 else None
    size = _figure(key, table[key], kind, positive=True)
    if sparse:
        share = _figure("probability", table["probability"], None)
        if not 0.0 < share < 1.0:
            raise PriorError(f"probability must lie between 0 and 1, got {share:g}")
        size /= -float(np.log(share))  # the mean of an exponential with this share above `above`
    return Scatter(tuple(members), size, str(table.get("reason", "")), sparse)


def _figure(key: str, value: Any, kind: str | None, *, positive: bool = False) -> float:
    """A number of a prior file in internal units; `kind` is what a quantity with unit measures."""
    got = reprlib.repr(value)
    if isinstance(value, str):
        with _in(key):
            number = parse_quantity(value, kind or "dimensionless")
    elif isinstance(value, bool) or not isinstance(value, int | float):
        raise PriorError(f"{key} must be a number or a quantity such as '2 kip', got {got}")
    elif kind not in (None, "dimensionless", "1"):
        raise PriorError(f"{key} must be a quantity with its unit ({kind}), got {got}")
    else:
        number = float(value) if abs(value) < 1e300 else np.inf
    if not np.isfinite(number):
        raise PriorError(f"{key} must be finite, got {got}")
    if positive and not number > 0.0:
        raise PriorError(f"{key} must be positive, got {got}")
    return number
