"""A quantity that has a prior or a posterior: what it measures and how it is written."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass
from html import escape

import numpy as np

from mfd_bayes.units import DIMENSIONS, dimension_of

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
