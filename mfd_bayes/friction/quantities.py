"""Quantities and parameters of a model: names, symbols, units and ranges."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from html import escape
from types import MappingProxyType

import numpy as np

from mfd_bayes.units import DIMENSIONS, dimension_of

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
    maths : str
        Its symbol in LaTeX's mathematics.
    meaning : str
        What it is, in a few words.
    lower, upper : float, in its unit
        Values that it can have; a prior must not allow others.
    sampled : bool
        Whether it has a prior of its own; if not, it is computed from others that have.
    pooled : bool
        Whether one test tells something about its value in another.
    """

    name: str
    kind: str
    maths: str
    meaning: str
    lower: float = 0.0
    upper: float = np.inf
    sampled: bool = True
    pooled: bool = True

    @property
    def unit(self) -> str:
        """Internal unit."""
        return dimension_of(self.kind).unit

    @property
    def html(self) -> str:
        """Its symbol in HTML."""
        return html_of(self.maths)


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
        option = self.follows_actuation
        return "proportional" if option is True else str(option or "")

    @property
    def quantity(self) -> Quantity:
        """The quantity that it is; theta holds it in the unit that is given here."""
        lower, upper = LIMITS[self.prior]
        kinds = {dimension.unit: kind for kind, dimension in DIMENSIONS.items()}
        maths = self.symbol or (self.name if len(self.name) == 1 else rf"\mathrm{{{self.name}}}")
        return Quantity(
            self.name,
            kinds.get(self.unit, self.unit),
            maths,
            self.meaning or self.name,
            lower,
            upper,
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
    return unicodedata.normalize("NFC", re.sub(r"[{}]", "", text)).replace(" - ", " − ")


STATIC = MappingProxyType(
    {"Fs_fwd": ("Fc_fwd", "static_excess_fwd"), "Fs_bwd": ("Fc_bwd", "static_excess_bwd")}
)
"""F_s = F_c (1 + excess), so that F_s ≥ F_c holds: kinetic friction and excess of each F_s."""

_QUANTITIES = (
    Quantity("sigma0", "stiffness", r"\sigma_0", "aggregate bristle stiffness"),
    Quantity("sigma1", "damping", r"\sigma_1", "micro-damping"),
    Quantity("sigma2", "damping", r"\sigma_2", "viscous friction"),
    Quantity("Fc_fwd", "force", r"F_{c,\mathrm{fwd}}", "kinetic friction, forward"),
    Quantity("Fc_bwd", "force", r"F_{c,\mathrm{bwd}}", "kinetic friction, backward"),
    Quantity(
        "static_excess_fwd",
        "dimensionless",
        r"(F_s/F_c - 1)_\mathrm{fwd}",
        "excess of static over kinetic friction, forward",
    ),
    Quantity(
        "static_excess_bwd",
        "dimensionless",
        r"(F_s/F_c - 1)_\mathrm{bwd}",
        "excess of static over kinetic friction, backward",
    ),
    Quantity("k2", "stiffness", "k_2", "stiffness of stage 2"),
    Quantity("k3", "stiffness", "k_3", "stiffness of stage 3"),
    Quantity("d2", "displacement", "d_2", "drum travel of stage 2"),
    Quantity("d3", "displacement", "d_3", "drum travel of stage 3"),
    Quantity("ell", "displacement", r"\ell", "transition length, γ2/γ1 of the three stages"),
    Quantity("gamma1", "dimensionless", r"\gamma_1", "transition constant"),
    Quantity("v_s", "velocity", r"\dot x_s", "Stribeck velocity"),
    Quantity("Fs_fwd", "force", r"F_{s,\mathrm{fwd}}", "static friction, forward", sampled=False),
    Quantity("Fs_bwd", "force", r"F_{s,\mathrm{bwd}}", "static friction, backward", sampled=False),
    Quantity("gamma2", "displacement", r"\gamma_2", "transition constant", sampled=False),
    Quantity("k_fwd", "stiffness", r"k_\mathrm{fwd}", "stiffness beyond the gap, forward"),
    Quantity("k_bwd", "stiffness", r"k_\mathrm{bwd}", "stiffness beyond the gap, backward"),
    Quantity("gap", "displacement", "D", "width of the gap"),
    Quantity("k_0", "stiffness", "k_0", "stiffness inside the gap"),
    Quantity("n", "dimensionless", "n", "how sharply slip sets in", lower=1.0),
    Quantity("k", "stiffness", "k", "stiffness of Bouc-Wen hysteresis"),
    Quantity(
        "alpha",
        "dimensionless",
        r"\alpha",
        "share of the stiffness that remains in slip",
        upper=1.0,
    ),
    Quantity("Fy_fwd", "force", r"F_{y,\mathrm{fwd}}", "yield force, forward"),
    Quantity("Fy_bwd", "force", r"F_{y,\mathrm{bwd}}", "yield force, backward"),
    Quantity("beta", "dimensionless", r"\beta", "shape of the unloading", lower=0.5, upper=1.0),
    Quantity("exponent", "dimensionless", "n", "sharpness of the knee", lower=1.0),
    Quantity("c", "damping", "c", "viscous damping of Bouc-Wen hysteresis"),
)
QUANTITIES: Mapping[str, Quantity] = MappingProxyType({q.name: q for q in _QUANTITIES})
"""Quantities of the package's models by name, in the order in which they are sampled."""


def sampled_for(parameters: Iterable[str]) -> tuple[Quantity, ...]:
    """Quantities of some of the paper's parameters, and what is sampled in their place."""
    names = {*parameters, *(name for p in parameters for name in STATIC.get(p, ()))}
    names |= {"ell"} if "gamma2" in names else set()
    return tuple(quantity for name, quantity in QUANTITIES.items() if name in names)
