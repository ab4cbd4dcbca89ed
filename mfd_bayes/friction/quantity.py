"""A quantity that has a prior or a posterior: what it measures, how it is written, its columns."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from html import escape
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.records.inputs import real_numbers
from mfd_bayes.units import DIMENSIONS, dimension_of

Array = NDArray[np.float64]

LAW_NAMES = ("proportional", "affine", "power", "compare")
"""Laws by which a parameter may follow the actuation."""

LIMITS = {"positive": (0.0, np.inf), "real": (-np.inf, np.inf), "fraction": (0.0, 1.0)}
"""Values that a parameter of each kind of prior can have."""


@dataclass(frozen=True)
class Quantity:
    """One quantity of a model, of a noise or of the record.

    Attributes
    ----------
    name : str
        In prior files, tables and stored draws.
    kind : str
        What it measures, a key of `units.DIMENSIONS`; or, for any other, its unit.
    maths, html : str
        Its symbol in LaTeX's mathematics and in HTML; "" where `html_of` makes it of the first.
    meaning : str
        What it is, in a few words.
    least, most : float, in its unit
        Values that it can have; a prior must not allow others.
    sampled : bool
        Whether it has a prior of its own; if not, it is computed from others that have.
    pooled : bool
        Whether one test tells something about its value in another.
    """

    name: str
    kind: str
    maths: str
    html: str
    meaning: str
    least: float = 0.0
    most: float = np.inf
    sampled: bool = True
    pooled: bool = True

    @property
    def unit(self) -> str:
        """Internal unit."""
        return dimension_of(self.kind).unit


@dataclass(frozen=True)
class Parameter:
    """A parameter of a user's own model.

    Attributes
    ----------
    name : str
        In prior files and tables, such as "c".
    unit : str
        In which the model gets it, such as "kip/in" or "MPa"; "1" for none.
    symbol : str
        In LaTeX's mathematics; the name by default.
    prior : {"positive", "real", "fraction"}
        Values that it can have: 0 or more, any, or from 0 to 1. A drafted prior file has a
        lognormal, normal or beta prior of it.
    follows_actuation : bool or str
        Whether it follows the actuation, and by which law: "proportional" (that of True),
        "affine", "power" or "compare".
    meaning : str
        What it is, in a few words.
    """

    name: str
    unit: str = "1"
    symbol: str = ""
    prior: str = "positive"
    follows_actuation: bool | str = False
    meaning: str = ""

    @property
    def law(self) -> str:
        """Law by which it follows the actuation; empty where it does not."""
        given = self.follows_actuation
        return "proportional" if given is True else str(given or "")

    @property
    def quantity(self) -> Quantity:
        """The quantity that it is; theta holds it in the unit that is given here."""
        least, most = LIMITS[self.prior]
        kinds = {dimension.unit: kind for kind, dimension in DIMENSIONS.items()}
        maths = self.symbol or (self.name if len(self.name) == 1 else rf"\mathrm{{{self.name}}}")
        return Quantity(
            self.name,
            kinds.get(self.unit, self.unit),
            maths,
            html_of(self.symbol or self.name),
            self.meaning or self.name,
            least,
            most,
        )


def html_of(symbol: str) -> str:
    r"""HTML of a simple symbol in LaTeX: ``\alpha_\mathrm{max}`` is ``α<sub>max</sub>``."""

    def greek(match: re.Match[str]) -> str:
        case = "CAPITAL" if match[1][0].isupper() else "SMALL"
        letter = "LAMDA" if match[1].lower() == "lambda" else match[1].upper()
        try:
            return unicodedata.lookup(f"GREEK {case} LETTER {letter}")
        except KeyError:
            return match[1]

    text = re.sub(r"\\(?:mathrm|text)\{([^{}]*)\}", r"{\1}", escape(symbol))
    text = re.sub(r"\\dot\s*(\w)", "\\1\N{COMBINING DOT ABOVE}", text).replace(r"\ell", "ℓ")
    text = re.sub(r"\\([A-Za-z]+)", greek, text)
    text = re.sub(
        r"_(?:\{((?:[^{}]|\{[^{}]*\})*)\}|(\w))", lambda m: f"<sub>{m[1] or m[2]}</sub>", text
    )
    return unicodedata.normalize("NFC", re.sub(r"[{}]", "", text))


STATIC = MappingProxyType(
    {"Fs_fwd": ("Fc_fwd", "static_excess_fwd"), "Fs_bwd": ("Fc_bwd", "static_excess_bwd")}
)
"""F_s = F_c (1 + excess), so that F_s ≥ F_c holds: kinetic friction and excess of each F_s."""

# name, kind, symbol, HTML, meaning, in the order of sampling; @ is one side, and then the other
_TABLE: tuple[tuple[str, str, str, str, str], ...] = (
    ("sigma0", "stiffness", r"\sigma_0", "", "aggregate bristle stiffness"),
    ("sigma1", "damping", r"\sigma_1", "", "micro-damping"),
    ("sigma2", "damping", r"\sigma_2", "", "viscous friction"),
    ("Fc_@", "force", r"F_{c,\mathrm{@}}", "", "kinetic friction, @"),
    (
        "static_excess_@",
        "dimensionless",
        r"F_s/F_c - 1,\ \mathrm{@}",
        "(F<sub>s</sub>/F<sub>c</sub> − 1)<sub>@</sub>",
        "excess of static over kinetic friction, @",
    ),
    ("k2", "stiffness", "k_2", "", "stiffness of stage 2"),
    ("k3", "stiffness", "k_3", "", "stiffness of stage 3"),
    ("d2", "displacement", "d_2", "", "drum travel of stage 2"),
    ("d3", "displacement", "d_3", "", "drum travel of stage 3"),
    ("ell", "displacement", r"\ell", "", "transition length, γ2/γ1 of the three stages"),
    ("gamma1", "dimensionless", r"\gamma_1", "", "transition constant"),
    ("v_s", "velocity", r"\dot x_s", "", "Stribeck velocity"),
    ("Fs_@", "force", r"F_{s,\mathrm{@}}", "", "static friction, @"),
    ("gamma2", "displacement", r"\gamma_2", "", "transition constant"),
    ("k_@", "stiffness", r"k_\mathrm{@}", "", "stiffness beyond the gap, @"),
    ("gap", "displacement", "D", "", "width of the gap"),
    ("k_0", "stiffness", "k_0", "", "stiffness inside the gap"),
    ("n", "dimensionless", "n", "", "how sharply slip sets in"),
    ("k", "stiffness", "k", "", "stiffness of Bouc-Wen hysteresis"),
    ("alpha", "dimensionless", r"\alpha", "", "share of the stiffness that remains in slip"),
    ("Fy_@", "force", r"F_{y,\mathrm{@}}", "", "yield force, @"),
    ("beta", "dimensionless", r"\beta", "", "shape of the unloading"),
    ("exponent", "dimensionless", "n", "", "sharpness of the knee"),
    ("c", "damping", "c", "", "viscous damping of Bouc-Wen hysteresis"),
)
_LIMITS = {"n": (1.0, np.inf), "alpha": (0.0, 1.0), "beta": (0.5, 1.0), "exponent": (1.0, np.inf)}


def _packaged() -> dict[str, Quantity]:
    """Quantities of the package's models by name."""
    found = {}
    for template, kind, *words, meaning in _TABLE:
        sides = {"fwd": "forward", "bwd": "backward"} if "@" in template else {"": ""}
        for side, direction in sides.items():
            name, maths, html = (text.replace("@", side) for text in (template, *words))
            about = meaning.replace("@", direction)
            sampled = name not in (*STATIC, "gamma2")
            limits = _LIMITS.get(name, LIMITS["positive"])
            found[name] = Quantity(name, kind, maths, html, about, *limits, sampled=sampled)
    return found


QUANTITIES = MappingProxyType(_packaged())
"""Quantities of the package's models by name, in the order in which they are sampled."""


def sampled_for(parameters: Iterable[str]) -> tuple[Quantity, ...]:
    """Quantities of some of the paper's parameters, and what is sampled in their place."""
    names = {*parameters, *(name for p in parameters for name in STATIC.get(p, ()))}
    names |= {"ell"} if "gamma2" in names else set()
    return tuple(quantity for name, quantity in QUANTITIES.items() if name in names)


def named_columns(values: Mapping[str, ArrayLike], names: Iterable[str]) -> dict[str, Array]:
    """Some of the quantities that are given by name, as numbers."""
    if isinstance(values, type) or not hasattr(values, "keys"):
        kind = type(values).__name__
        raise FitError(f"values must be a mapping from names of quantities to numbers, got {kind}")
    needed = tuple(names)
    if missing := [name for name in needed if name not in values]:
        raise FitError(f"values by name lack {', '.join(missing)}")
    return {name: real_numbers(name, values[name], FitError) for name in needed}


def named_vectors(values: Mapping[str, ArrayLike], names: Iterable[str]) -> dict[str, Array]:
    """As `named_columns`, each (n,), of the same n."""
    columns = named_columns(values, names)
    size = max((column.size for column in columns.values()), default=0)
    for name, column in columns.items():
        if column.shape != (size,):
            raise FitError(f"values of {name} must have shape ({size},), got {column.shape}")
    return columns


def columns_in_order(name: str, table: ArrayLike, names: tuple[str, ...]) -> Array:
    """Numbers of an array as they are; of a table with named columns those of `names`, (n, p)."""
    by_name: Any = table
    if not hasattr(table, "columns"):
        return real_numbers(name, table, FitError)
    if missing := [column for column in names if column not in by_name.columns]:
        raise FitError(
            f"{name} is a table, whose columns are taken by their names: it lacks "
            f"{', '.join(missing)}"
        )
    columns = [real_numbers(f"column {c} of {name}", by_name[c], FitError) for c in names]
    return np.column_stack(columns)
