"""How quantities, units and numbers are written in figures, on the page and in tables."""

from __future__ import annotations

import math
import unicodedata

from markupsafe import Markup, escape

# name: (mathtext, HTML, what it is)
_SYMBOLS = {
    "sigma0": (r"\sigma_0", "σ<sub>0</sub>", "aggregate bristle stiffness"),
    "sigma1": (r"\sigma_1", "σ<sub>1</sub>", "micro-damping"),
    "sigma2": (r"\sigma_2", "σ<sub>2</sub>", "viscous friction"),
    "Fs_fwd": (r"F_{s,\mathrm{fwd}}", "F<sub>s,fwd</sub>", "static friction, forward"),
    "Fc_fwd": (r"F_{c,\mathrm{fwd}}", "F<sub>c,fwd</sub>", "kinetic friction, forward"),
    "Fs_bwd": (r"F_{s,\mathrm{bwd}}", "F<sub>s,bwd</sub>", "static friction, backward"),
    "Fc_bwd": (r"F_{c,\mathrm{bwd}}", "F<sub>c,bwd</sub>", "kinetic friction, backward"),
    "static_excess_fwd": (
        r"F_s/F_c - 1,\ \mathrm{fwd}",
        "(F<sub>s</sub>/F<sub>c</sub> − 1)<sub>fwd</sub>",
        "excess of static over kinetic friction, forward",
    ),
    "static_excess_bwd": (
        r"F_s/F_c - 1,\ \mathrm{bwd}",
        "(F<sub>s</sub>/F<sub>c</sub> − 1)<sub>bwd</sub>",
        "excess of static over kinetic friction, backward",
    ),
    "k2": ("k_2", "k<sub>2</sub>", "stiffness of stage 2"),
    "k3": ("k_3", "k<sub>3</sub>", "stiffness of stage 3"),
    "d2": ("d_2", "d<sub>2</sub>", "drum travel of stage 2"),
    "d3": ("d_3", "d<sub>3</sub>", "drum travel of stage 3"),
    "gap": ("D", "D", "width of the gap, d2 + d3"),
    "gamma1": (r"\gamma_1", "γ<sub>1</sub>", "transition constant"),
    "gamma2": (r"\gamma_2", "γ<sub>2</sub>", "transition constant"),
    "ell": (r"\ell = \gamma_2/\gamma_1", "ℓ = γ<sub>2</sub>/γ<sub>1</sub>", "transition length"),
    "v_s": (r"\dot x_s", "ẋ<sub>s</sub>", "Stribeck velocity"),
    "k": ("k", "k", "stiffness of Bouc-Wen hysteresis"),
    "alpha": (r"\alpha", "α", "share of the stiffness that remains in slip"),
    "Fy_fwd": (r"F_{y,\mathrm{fwd}}", "F<sub>y,fwd</sub>", "yield force, forward"),
    "Fy_bwd": (r"F_{y,\mathrm{bwd}}", "F<sub>y,bwd</sub>", "yield force, backward"),
    "beta": (r"\beta", "β", "shape of the unloading"),
    "exponent": ("n", "n", "sharpness of the knee"),
    "c": ("c", "c", "viscous damping of Bouc-Wen hysteresis"),
    "offset": ("F_0", "F<sub>0</sub>", "offset of the load cell"),
    "start": ("w_0", "w<sub>0</sub>", "place in the gap at the first sample"),
    "noise_sd": ("s", "s", "standard deviation of the noise"),
    "noise_time": (r"\tau_c", "τ<sub>c</sub>", "correlation time of the noise"),
    "noise_dof": (r"\nu", "ν", "degrees of freedom of the noise"),
    "noise_build": ("s_b", "s<sub>b</sub>", "added noise where the force builds up"),
    "noise_fade": (r"\lambda", "λ", "slip over which the added noise fades"),
    "noise_build_time": (r"\tau_b", "τ<sub>b</sub>", "correlation time of the added noise"),
    "K_c_fwd": (r"K_{c,\mathrm{fwd}}", "K<sub>c,fwd</sub>", "kinetic friction per actuation"),
    "K_c_bwd": (r"K_{c,\mathrm{bwd}}", "K<sub>c,bwd</sub>", "kinetic friction per actuation"),
    "K_s_fwd": (r"K_{s,\mathrm{fwd}}", "K<sub>s,fwd</sub>", "static friction per actuation"),
    "K_s_bwd": (r"K_{s,\mathrm{bwd}}", "K<sub>s,bwd</sub>", "static friction per actuation"),
    "alpha_sigma0": (r"\alpha_{\sigma_0}", "α<sub>σ0</sub>", "bristle stiffness per actuation"),
    "energy_per_cycle": ("E", "E", "energy dissipated per full cycle"),
    "c_eq": (r"c_\mathrm{eq}", "c<sub>eq</sub>", "equivalent viscous damping coefficient"),
    "peak_fwd": (r"F_{\max,\mathrm{fwd}}", "F<sub>max,fwd</sub>", "peak force, forward"),
    "peak_bwd": (r"F_{\max,\mathrm{bwd}}", "F<sub>max,bwd</sub>", "peak force, backward"),
    "C_fwd": (r"C_\mathrm{fwd}", "C<sub>fwd</sub>", "self-energizing factor, forward"),
    "C_bwd": (r"C_\mathrm{bwd}", "C<sub>bwd</sub>", "self-energizing factor, backward"),
    "sigma0_0": (r"\sigma_0|_{p=0}", "σ<sub>0</sub>|<sub>p=0</sub>", "bristle stiffness at p = 0"),
}
_LONGEST = 60

# Prefix of a population's quantity: the words for it, and its meaning.
_PREFIXES = {
    "scatter": ("scatter of", "scatter from test to test, of the logarithm"),
    "deviation_level": (
        "deviation by level,",
        "smooth departure from the law that all tests of a level share, standard deviation",
    ),
    "deviation_session": (
        "deviation by session,",
        "departure that all tests of a session share, standard deviation",
    ),
    "exponent": ("exponent of", "exponent of the power law"),
    "share": ("share of", "share of the value at the reference that grows with the actuation"),
    "dependence": ("dependence of", "change of the logarithm where a covariate grows e-fold"),
}
# Scatter of these is not that of the quantity itself, but of another one that is pooled for it.
_POOLED = {
    "Fc_fwd": "slip force at a common speed, forward",
    "Fc_bwd": "slip force at a common speed, backward",
    "d2": "width of the gap, d2 + d3",
    "d3": "ratio d3/d2",
}


def maths(name: str) -> str:
    """Symbol of a quantity in the maths that LaTeX and matplotlib share, "" if there is none."""
    return _SYMBOLS[name][0] if name in _SYMBOLS else ""


def in_figure(name: str) -> str:
    """Symbol of a quantity as matplotlib writes it; an unknown name as plain text."""
    if name in _SYMBOLS:
        return f"${_SYMBOLS[name][0]}$"
    word, of, more = of_population(name)
    return f"{word} {in_figure(of)}{more}" if word else plain(name.replace("_", " "))


def in_html(name: str) -> Markup:
    """Symbol of a quantity as HTML; an unknown name escaped."""
    if name in _SYMBOLS:
        return Markup(_SYMBOLS[name][1])
    shown = printable(name)
    word, of, more = of_population(shown)
    return escape(word + " ") + in_html(of) + more if word else escape(shown.replace("_", " "))


def meaning(name: str) -> str:
    """What a quantity is, "" where that is not known."""
    if name in _SYMBOLS:
        return _SYMBOLS[name][2]
    prefix, of, more = _parts(name)
    if not prefix:
        return ""
    text = _PREFIXES[prefix][1]
    if name in ("scatter_offset", "scatter_start"):
        text = "scatter from test to test"
    what = _POOLED.get(of) if prefix == "scatter" else None
    return f"{text}: {what or meaning(of) or of.replace('_', ' ')}{more}"


def of_population(name: str) -> tuple[str, str, str]:
    """Prefix in words, quantity and covariate of a population's quantity; else empty."""
    prefix, of, more = _parts(name)
    if not prefix:
        return "", "", ""
    if prefix == "scatter" and of in _POOLED:
        short = {"d2": "gap", "d3": "d3/d2"}
        of = short.get(of, f"slip force {of.removeprefix('Fc_')}")
    return _PREFIXES[prefix][0], of, more


def _parts(name: str) -> tuple[str, str, str]:
    """Prefix, quantity and covariate of a population's quantity; else empty."""
    for prefix in _PREFIXES:
        of = name.removeprefix(f"{prefix}_")
        if of == name:
            continue
        if prefix == "dependence":
            of, _, covariate = of.rpartition("_")
            return prefix, of, f" on {covariate}"
        return prefix, of, ""
    return "", "", ""


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


def label(name: str, unit: str) -> str:
    """Axis label of a quantity with its unit."""
    written = plain(unit_text(unit))
    return f"{in_figure(name)}, {written}" if written else in_figure(name)


def number(value: float, digits: int = 4) -> str:
    """A number for reading, with that many significant digits; a dash for NaN."""
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    text = f"{value:#.{digits}g}".replace("e-0", "e-").replace("e+0", "e").replace("e+", "e")
    return text.replace(".e", "e").removesuffix(".").replace("-", "−")


def count(value: float) -> str:
    """A number of draws, as a whole number with thin spaces."""
    return f"{value:,.0f}".replace(",", "\u202f") if math.isfinite(value) else "–"


def percent(value: float, decimals: int = 1) -> str:
    """A share in percent; the space before the sign does not break."""
    return "–" if math.isnan(value) else f"{100 * value:.{decimals}f}\u00a0%"
