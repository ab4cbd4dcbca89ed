"""How quantities, units and numbers are written, and the colours of figures."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Callable, Mapping
from html import unescape
from types import MappingProxyType
from typing import Any

from markupsafe import Markup, escape

from mfd_bayes.calibration.priors import known_quantities
from mfd_bayes.errors import FitError
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.quantities import html_of
from mfd_bayes.population.bands import KIND_NAMES
from mfd_bayes.records.cycles import PROPERTIES

_SYMBOLS = {
    **{
        name: (quantity.symbol, quantity.meaning)
        for name, quantity in PROPERTIES.items()
        if quantity.symbol
    },
    "alpha_sigma0": (r"\alpha_{\sigma0}", "bristle stiffness per actuation"),
    "sigma0_0": (r"\sigma_0|_{p=0}", "bristle stiffness at p = 0"),
}
for _side in ("fwd", "bwd"):
    _SYMBOLS |= {
        f"K_c_{_side}": (rf"K_{{c,\mathrm{{{_side}}}}}", "kinetic friction per actuation"),
        f"K_s_{_side}": (rf"K_{{s,\mathrm{{{_side}}}}}", "static friction per actuation"),
    } | {
        f"{force}_{_side}_0": (
            rf"F_{{{force[1]},\mathrm{{{_side}}}}}|_{{p=0}}",
            f"residual friction at p = 0, {_side}",
        )
        for force in ("Fc", "Fy")
    }
"""Of what is no quantity of a test: symbol in mathtext, and what it is."""

_LONGEST = 60

# Prefix of a population's quantity: the words for it, and its meaning.
_PREFIXES = {
    "scatter": ("scatter of", "scatter from test to test, standard deviation of the logarithm"),
    **{
        f"deviation_{of}": (
            f"deviation by {of},",
            f"deviation from the law that all tests of a {of} have in common, standard deviation",
        )
        for of in ("level", "session", "device")
    },
    "exponent": ("exponent of", "exponent of the power law"),
    "share": ("share of", "share of the value at the reference that grows with the actuation"),
    "dependence": (
        "dependence of",
        "change of the logarithm when speed or stroke grows by a factor e, or over the span of the "
        "tests' dates, cycles or temperatures",
    ),
}
# Scatter of these is not that of the quantity itself, but of another one that is pooled for it:
# its short name, and what it is.
_POOLED = {
    "Fc_fwd": ("slip force fwd", "slip force at a common speed, forward"),
    "Fc_bwd": ("slip force bwd", "slip force at a common speed, backward"),
    "d2": ("gap", "width of the gap, d2 + d3"),
    "d3": ("d3/d2", "ratio d3/d2"),
}
_CODE_NAME = re.compile(r"(?<![\w.\-/])[A-Za-z]+(?:\d\w*|_\w+)(?![\w\-/=]|\.\w| =)")
_PART = re.compile(r"<sub>(.*?)</sub>|<[^>]+>|([^<]+)")


class Symbols:
    """Symbols and meanings of quantities; those of a `model` stand before others of their name."""

    def __init__(self, model: Model | None = None) -> None:
        standard = model.standard_names if model else _POOLED.keys()
        self.pooled = {name: words for name, words in _POOLED.items() if name in standard}
        self.written = {
            n: (maths, html_of(maths), meaning) for n, (maths, meaning) in _SYMBOLS.items()
        }
        for name, quantity in known_quantities(model).items():
            html = quantity.html
            self.written[name] = quantity.maths, html, quantity.meaning

    def written_as(
        self, name: str, symbol: Callable[[str, str], Any], text: Callable[[str], Any]
    ) -> Any:
        """A quantity, or one of a population, by its symbol (mathtext and HTML) or in words."""
        if name in self.written:
            maths, html, _ = self.written[name]
            return symbol(maths, html)
        prefix, of, suffix = _split(name)
        if prefix == "scatter" and of in self.pooled:
            of = self.pooled[of][0]
        if not prefix:
            return text(name.replace("_", " "))
        return text(_PREFIXES[prefix][0]) + " " + self.written_as(of, symbol, text) + suffix

    def in_figure(self, name: str) -> str:
        """Symbol as matplotlib writes it; an unknown name as plain text."""
        return str(self.written_as(name, lambda maths, _: f"${maths}$", plain))

    def label(self, name: str, unit: str) -> str:
        """Axis label of a quantity with its unit."""
        unit_label = plain(unit_text(unit))
        return f"{self.in_figure(name)}, {unit_label}" if unit_label else self.in_figure(name)

    def in_html(self, name: str) -> Markup:
        """Symbol as HTML; an unknown name escaped."""
        words = self.written_as(name, lambda _, html: Markup(html), lambda t: escape(printable(t)))
        return Markup(words)

    def sentence(self, text: str) -> Markup:
        """A sentence as HTML, with symbols for the code names of quantities in it."""
        pieces, end = [], 0
        for match in _CODE_NAME.finditer(text := printable(text)):
            if match[0] in self.written:
                pieces += [escape(text[end : match.start()]), Markup(self.written[match[0]][1])]
                end = match.end()
        return Markup("").join([*pieces, escape(text[end:])])

    def parts(self, name: str) -> list[tuple[str, bool]]:
        """Symbol as parts of text, each with whether it is a subscript."""
        matches = _PART.finditer(self.in_html(name))
        pieces = ((unescape(m[1] or m[2] or ""), m[1] is not None) for m in matches)
        return [piece for piece in pieces if piece[0]]

    def meaning(self, name: str) -> str:
        """What a quantity is, "" where that is not known."""
        if name in self.written:
            return self.written[name][2]
        prefix, of, suffix = _split(name)
        if not prefix:
            return ""
        text = _PREFIXES[prefix][1]
        if name in ("scatter_offset", "scatter_start"):
            text = "scatter from test to test"
        pooled = self.pooled.get(of) if prefix == "scatter" else None
        description = pooled[1] if pooled else self.meaning(of) or of.replace("_", " ")
        return f"{text}: {description}{suffix}"


def check_symbols(model: Model) -> None:
    """Refuse a symbol of a user's own model that cannot be drawn in a figure."""
    from matplotlib.mathtext import MathTextParser

    for quantity in model.quantities:
        try:
            MathTextParser("path").parse(f"${quantity.maths}$")
        except ValueError:
            raise FitError(
                f"{model.where}, parameter {quantity.name!r}: the symbol {quantity.maths!r} is no "
                r"mathematics in LaTeX, such as r'\alpha' or r'k_\mathrm{up}'"
            ) from None


def _split(name: str) -> tuple[str, str, str]:
    """Prefix, quantity and covariate of a population's quantity; else empty."""
    prefix = next((prefix for prefix in _PREFIXES if name.startswith(f"{prefix}_")), "")
    of = name.removeprefix(f"{prefix}_") if prefix else ""
    if prefix != "dependence":
        return prefix, of, ""
    of, _, covariate = of.rpartition("_")
    return prefix, of, f" on {covariate}"


def printable(text: str) -> str:
    """Text from a file without controls and marks that reverse the direction of text."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or unicodedata.category(c) == "Zs" else " " for c in text)


def plain(text: str) -> str:
    """Text from a file for matplotlib: one line of at most 60 letters, without mathtext."""
    line = printable(text).strip()
    if len(line) > _LONGEST:
        line = f"{line[: _LONGEST - 1]}…"
    return line.replace("\\", "\\\\").replace("$", r"\$") if "$" in line else line


def unit_text(unit: str) -> str:
    """Unit for reading, "" for none: ``kip*s/in**2`` becomes ``kip·s/in²``."""
    if unit in ("", "1", "dimensionless"):
        return ""
    powers = unit.replace("**", "^").replace("^2", "²").replace("^3", "³")
    return powers.replace("*", "·")


def number(value: float, digits: int = 4) -> str:
    """A number for reading, with that many significant digits; a dash for NaN.

    It has no exponent from 0.0001 to a million. The page's script writes numbers alike.
    """
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    size = abs(float(f"{value:.{digits - 1}e}"))
    if 10**digits <= size < 1e6:
        text = f"{float(f'{value:.{digits}g}'):.0f}"
    else:
        text = f"{value:#.{digits}g}".replace("e-0", "e-").replace("e+0", "e").replace("e+", "e")
    return text.replace(".e", "e").removesuffix(".").replace("-", "−")


def count(value: float) -> str:
    """A number of draws, as a whole number with thin spaces."""
    return f"{value:,.0f}".replace(",", "\u202f") if math.isfinite(value) else "–"


def percent(value: float, decimals: int = 1) -> str:
    """A share in percent; the space before the sign does not break."""
    return "–" if math.isnan(value) else f"{100 * value:.{decimals}f}\u00a0%"


# Palette of Okabe and Ito, which colour-blind readers can tell apart.
DATA = "#1b1b1b"
ORANGE = "#E69F00"
BLUE = "#0072B2"
GREEN = "#009E73"
VERMILLION = "#D55E00"
PURPLE = "#CC79A7"
SKY = "#56B4E9"
PRIOR = "#9a9a9a"
POSTERIOR = BLUE
TRUTH = VERMILLION
VALIDATE = "#a3457c"
CHAINS = (BLUE, ORANGE, GREEN, PURPLE, SKY, VERMILLION, "#555555", "#b8a600")

# For each kind of band: wide band, narrow band, median. They are opaque, so that overlapping
# branches of a loop do not make a darker shade.
BANDS = {
    "observation": ("#d5e7f4", "#a5cce8", BLUE),
    "new_test": ("#cdeae0", "#93d2bd", GREEN),
    "mean": ("#f3e3ed", "#e0bcd3", PURPLE),
    "this_test": ("#f6c877", "#e08f1f", VERMILLION),
    "prior": ("#e6e6e6", "#c6c6c6", "#6f6f6f"),
}
BAND_NAMES: Mapping[str, str] = MappingProxyType({**KIND_NAMES, "prior": "what the priors allow"})
