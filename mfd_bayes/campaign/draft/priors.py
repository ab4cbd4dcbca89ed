"""Priors of a device that no shipped file knows: scales read off the records, and wide."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from mfd_bayes.calibration.priors import SCALED, find_priors, load_priors
from mfd_bayes.records.loops import Scales, middle
from mfd_bayes.store.toml import commented, quoted, read_toml
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
        unit = {
            "force": self.force,
            "length": self.length,
            "speed": f"{self.length}/s",
            "force/length": f"{self.force}/{self.length}",
            "force/speed": f"{self.force}*s/{self.length}",
            "length/speed": "s",
        }[kind]
        return f"{in_digits(value * convert(_INTERNAL[kind], unit), 3)} {unit}"


def knows(priors: str, scales: Mapping[str, Scales]) -> bool:
    """Whether a shipped prior file expects slip forces and lengths such as these."""
    file, usual = load_priors(priors), middle(scales.values())
    slip = file.parameters["Fc_fwd"].figures
    away = abs(np.log(usual.force / slip["median"])) / slip["spread"]
    gap = file.gap or usual.length
    return bool(away < OTHER and usual.length < LONG * gap and usual.stroke > SHORT * gap)


def priors_text(scales: Mapping[str, Scales], units: Units) -> str:
    """Prior file for records whose scales are known, by the names of their tests or files."""
    usual = middle(scales.values())
    sizes = {"force": usual.force, "length": usual.length, "speed": usual.speed}
    content, own = read_toml(find_priors("any")), _own_priors(scales, usual, units)
    tables = []
    for section in ("parameters", "scatter"):
        for name, table in content[section].items():
            lines = [f"\n[{section}.{name}]"]
            for key, value in (own.get(name, table) if section == "parameters" else table).items():
                note, match = "", _MULTIPLE.fullmatch(value) if isinstance(value, str) else None
                if isinstance(value, tuple):
                    value = units.quantity(*value)
                elif match is not None:  # a multiple of scales
                    over, _, under = match[2].partition("/")
                    size = float(match[1]) * sizes[over] / sizes.get(under, 1.0)
                    note = f"  {commented(value)}"
                    value = units.quantity(size, match[2])
                lines.append(f"{key} = {_toml(value)}{note}")
            tables.append("\n".join(lines) + "\n")
    return f"{_HEAD}title = {quoted(f'{SCALED}: {_names(scales)}')}\n" + "".join(tables)


def _own_priors(
    scales: Mapping[str, Scales], usual: Scales, units: Units
) -> dict[str, dict[str, object]]:
    """Priors that are read off the records themselves, by parameter."""

    def lognormal(value: float, kind: str, spread: float, reason: str) -> dict[str, object]:
        reason = f"{reason}; spread a factor of {np.exp(spread):.2g}"
        return {"family": "lognormal", "median": (value, kind), "spread": spread, "reason": reason}

    forces = [own.force for own in scales.values()]
    ends = dict.fromkeys(units.quantity(f, "force") for f in (min(forces), max(forces)))
    spread = max(_WIDE, 0.5 * float(np.log(max(forces) / min(forces))) + 0.7)
    where = f"the plateau of {_names(scales)}, {' to '.join(ends)}"
    slip = lognormal(usual.force, "force", spread, where)
    build_up = "the slope at which the force comes back"
    slope = lognormal(usual.build_up, "force/length", 1.5, build_up)
    unloading = lognormal(usual.unloading, "force/length", 1.5, "the slope after reversals")
    noise = (
        f"samples differ by {units.quantity(usual.noise, 'force')} from their neighbours; model "
        "error is some percent more"
    )
    noise_sd = max(3.0 * usual.noise, 0.03 * usual.force)
    offset = max(0.3 * usual.force, 2.0 * max(abs(own.offset) for own in scales.values()))
    return {
        **dict.fromkeys(("Fc_fwd", "Fc_bwd", "Fy_fwd", "Fy_bwd"), slip),
        **dict.fromkeys(("k3", "k", "k_fwd", "k_bwd"), slope),
        "sigma0": unloading,
        "noise_sd": lognormal(noise_sd, "force", 1.2, noise),
        "offset": {
            "family": "normal",
            "mean": "0 force",
            "sd": (offset, "force"),
            "reason": "a third of the slip force, or twice the middle of the loops if that is more",
        },
    }


def _names(records: Iterable[str]) -> str:
    first, *others = records
    more = f" and {len(others)} more" if len(others) > 1 else f" and {others[0]}" if others else ""
    return f"{first}{more}"


def _toml(value: object) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    return quoted(value) if isinstance(value, str) else f"{value:.3g}"
