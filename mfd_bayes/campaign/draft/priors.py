"""Priors of a device that no shipped file knows: scales read off the records, and wide."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mfd_bayes.calibration.prior_files import SCALED, find_priors, load_priors
from mfd_bayes.campaign.draft.toml import commented, quoted
from mfd_bayes.records.loop_features import Scales, middle
from mfd_bayes.store.toml import read_toml
from mfd_bayes.units import convert, in_digits

OTHER = 2.0
"""A slip force so many of the prior's standard deviations off is that of another device."""

LONG, SHORT = 5.0, 2.0
"""A length so many times the prior's gap, or a stroke that is not so many gaps, is of another."""

_HEAD = """\
# Written by mfd-bayes init. The scales below are read off the records of this folder, so the data
# are used for orders of magnitude here and once more in the calibration. That is harmless only
# because the priors are wide: a spread of 1.1 is a factor of 3 both ways. Replace what you know
# better. Families and keys: priors/mfd.toml of mfd_bayes.
"""
_WIDE = 1.1
_INTERNAL = {
    "force": "kip",
    "length": "in",
    "speed": "in/s",
    "force/length": "kip/in",
    "force/speed": "kip*s/in",
    "length/speed": "s",
}
_MULTIPLE = re.compile(rf"(\S+) ({'|'.join(_INTERNAL)})")


@dataclass(frozen=True)
class Units:
    """Units in which a file is written: of force and of length."""

    force: str
    length: str

    def quantity(self, value: float, kind: str) -> str:
        """Value of an internal unit, by its kind such as "force/length", in these units."""
        named = {"force": self.force, "length": self.length, "speed": f"{self.length}/s"}
        over, _, under = kind.partition("/")
        pairs = {"force/speed": f"{self.force}*s/{self.length}", "length/speed": "s"}
        unit = pairs.get(kind) or (f"{named[over]}/{named[under]}" if under else named[over])
        return f"{in_digits(value * convert(_INTERNAL[kind], unit), 3)} {unit}"


def knows(priors: str, found: Mapping[str, Scales]) -> bool:
    """Whether a shipped prior file expects slip forces and lengths such as these."""
    file, scales = load_priors(priors), middle(found.values())
    slip = file.parameters["Fc_fwd"].figures
    away = abs(np.log(scales.force / slip["median"])) / slip["spread"]
    gap = file.gap or scales.length
    return bool(away < OTHER and scales.length < LONG * gap and scales.stroke > SHORT * gap)


def priors_text(found: Mapping[str, Scales], units: Units) -> str:
    """Prior file for records whose scales are known, by the names of their tests or files."""
    whole = middle(found.values())
    content = read_toml(find_priors("any"))
    values = {"force": whole.force, "length": whole.length, "speed": whole.speed}
    own = _own(found, whole, units)
    tables = []
    for section in ("parameters", "scatter"):
        for name, table in content[section].items():
            table = own.get(name, table) if section == "parameters" else table
            tables.append(_table(f"{section}.{name}", table, values, units))
    title = f"{SCALED}: {_records(found)}"
    return f"{_HEAD}title = {quoted(title)}\n" + "".join(tables)


def _own(found: Mapping[str, Scales], whole: Scales, units: Units) -> dict[str, dict[str, object]]:
    """Priors that are read off the records themselves, by parameter."""
    forces = [scales.force for scales in found.values()]
    spread = max(_WIDE, 0.5 * float(np.log(max(forces) / min(forces))) + 0.7)
    slips = f"the plateau of {_records(found)}, {_range(forces, units)}"
    slip = _lognormal(whole.force, "force", spread, f"{slips}; {_factor(spread)}")
    noise = max(3.0 * whole.noise, 0.03 * whole.force)
    offset = max(0.3 * whole.force, 2.0 * max(abs(s.offset) for s in found.values()))
    figures = {
        "sigma0": (whole.unloading, "the slope after reversals"),
        "k3": (whole.build_up, "the slope at which the force comes back"),
        **dict.fromkeys(
            ("k", "k_fwd", "k_bwd"), (whole.build_up, "the slope at which the force comes back")
        ),
    }
    slopes = {
        name: _lognormal(value, "force/length", 1.5, f"{what}; {_factor(1.5)}")
        for name, (value, what) in figures.items()
    }
    shown = units.quantity(whole.noise, "force")
    read = f"samples differ by {shown} from their neighbours; model error is some percent more"
    return {
        **dict.fromkeys(("Fc_fwd", "Fc_bwd", "Fy_fwd", "Fy_bwd"), slip),
        **slopes,
        "noise_sd": _lognormal(noise, "force", 1.2, f"{read}; {_factor(1.2)}"),
        "offset": {
            "family": "normal",
            "mean": "0 force",
            "sd": (offset, "force"),
            "reason": "a third of the slip force, or twice the middle of the loops if that is more",
        },
    }


def _lognormal(value: float, kind: str, spread: float, reason: str) -> dict[str, object]:
    return {"family": "lognormal", "median": (value, kind), "spread": spread, "reason": reason}


def _table(
    name: str, table: Mapping[str, object], values: Mapping[str, float], units: Units
) -> str:
    """A table in TOML, with multiples of scales in units."""
    lines = [f"\n[{name}]"]
    for key, given in table.items():
        value, note = given, ""
        match = _MULTIPLE.fullmatch(given) if isinstance(given, str) else None
        if isinstance(given, tuple):
            value = units.quantity(*given)
        elif match is not None:
            over, _, under = match[2].partition("/")
            size = float(match[1]) * values[over] / values.get(under, 1.0)
            value, note = units.quantity(size, match[2]), f"  {commented(str(given))}"
        lines.append(f"{key} = {_toml(value)}{note}")
    return "\n".join(lines) + "\n"


def _toml(value: object) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    return quoted(value) if isinstance(value, str) else f"{value:.3g}"


def _records(found: Mapping[str, Scales]) -> str:
    first, *others = found
    more = f" and {len(others)} more" if len(others) > 1 else f" and {others[0]}" if others else ""
    return f"{first}{more}"


def _range(values: list[float], units: Units) -> str:
    low, high = (units.quantity(value, "force") for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def _factor(spread: float) -> str:
    return f"spread a factor of {np.exp(spread):.2g}"
