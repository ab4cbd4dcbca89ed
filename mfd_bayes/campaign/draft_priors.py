"""First prior files, wide: of a device that no shipped file knows, or of a user's own model."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from mfd_bayes.calibration.priors import SCALED, find_priors, load_priors
from mfd_bayes.friction.model import Model
from mfd_bayes.records.loops import Scales, middle
from mfd_bayes.store.files import commented, quoted, read_toml
from mfd_bayes.units import convert, in_digits, measures

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


def knows(priors: str, scales: Mapping[str, Scales]) -> bool:
    """Whether a shipped prior file expects slip forces and lengths such as these."""
    file, usual = load_priors(priors), middle(scales.values())
    slip = file.parameters["Fc_fwd"].figures
    away = abs(np.log(usual.force / slip["median"])) / slip["spread"]
    gap = file.gap or usual.length
    return bool(away < OTHER and usual.length < LONG * gap and usual.stroke > SHORT * gap)


def priors_text(scales: Mapping[str, Scales], force: str, length: str) -> str:
    """Prior file for records of known scales, by the names of their tests, in these units."""
    usual = middle(scales.values())
    sizes = {"force": usual.force, "length": usual.length, "speed": usual.speed}
    units = {
        "force": force,
        "length": length,
        "speed": f"{length}/s",
        "force/length": f"{force}/{length}",
        "force/speed": f"{force}*s/{length}",
        "length/speed": "s",
    }

    def quantity(value: float, kind: str) -> str:
        return f"{in_digits(value * convert(_INTERNAL[kind], units[kind]), 3)} {units[kind]}"

    def lognormal(value: float, kind: str, spread: float, reason: str) -> dict[str, object]:
        reason = f"{reason}; spread a factor of {np.exp(spread):.2g}"
        median = quantity(value, kind)
        return {"family": "lognormal", "median": median, "spread": spread, "reason": reason}

    forces = [own.force for own in scales.values()]
    ends = dict.fromkeys(quantity(f, "force") for f in (min(forces), max(forces)))
    spread = max(_WIDE, 0.5 * float(np.log(max(forces) / min(forces))) + 0.7)
    where = f"the plateau of {_names(scales)}, {' to '.join(ends)}"
    slip = lognormal(usual.force, "force", spread, where)
    build_up = "the slope at which the force comes back"
    slope = lognormal(usual.build_up, "force/length", 1.5, build_up)
    noise = (
        f"samples differ by {quantity(usual.noise, 'force')} from their neighbours; model error is "
        "some percent more"
    )
    noise_sd = max(3.0 * usual.noise, 0.03 * usual.force)
    offset = max(0.3 * usual.force, 2.0 * max(abs(own.offset) for own in scales.values()))
    read_off = {
        **dict.fromkeys(("Fc_fwd", "Fc_bwd", "Fy_fwd", "Fy_bwd"), slip),
        **dict.fromkeys(("k3", "k", "k_fwd", "k_bwd"), slope),
        "sigma0": lognormal(usual.unloading, "force/length", 1.5, "the slope after reversals"),
        "noise_sd": lognormal(noise_sd, "force", 1.2, noise),
        "offset": {
            "family": "normal",
            "mean": "0 force",
            "sd": quantity(offset, "force"),
            "reason": "a third of the slip force, or twice the middle of the loops if that is more",
        },
    }
    content, text = read_toml(find_priors("any")), f"{_HEAD}title = "
    text += quoted(f"{SCALED}: {_names(scales)}") + "\n"
    for section, own in (("parameters", read_off), ("scatter", {})):
        for name, table in (content[section] | own).items():
            text += f"\n[{section}.{name}]\n"
            for key, value in table.items():
                match = _MULTIPLE.fullmatch(value) if isinstance(value, str) else None
                if match is None:
                    text += f"{key} = {_toml(value)}\n"
                else:  # a multiple of scales
                    over, _, under = match[2].partition("/")
                    size = float(match[1]) * sizes[over] / sizes.get(under, 1.0)
                    text += f"{key} = {quoted(quantity(size, match[2]))}  {commented(value)}\n"
    return text


def _names(records: Iterable[str]) -> str:
    first, *others = records
    more = f" and {len(others)} more" if len(others) > 1 else f" and {others[0]}" if others else ""
    return f"{first}{more}"


def _toml(value: object) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    return quoted(value) if isinstance(value, str) else f"{value:.3g}"


_HEAD_OWN = """\
# Written by mfd-bayes init for a model of your own. Every size below is a guess: parameters in the
# units of the response, the motion or their ratio have the size of the records, all others 0.3.
# For a motion without a unit, such as strain, a stiffness looks like a response: give its size.
# A spread of 1.5 is a factor of 4.5 both ways. Replace each by what you know, and say why.
"""


def priors_of_model(model: Model, sizes: Sequence[tuple[float, float]]) -> str:
    """Prior file of a user's own model, wide, in the sizes of the records' motion and response."""
    x, f = model.axes.motion.unit, model.axes.response.unit
    motion, response = np.maximum(np.median(sizes, axis=0), 1e-12).tolist()
    ratio = response / motion
    known = {f: response, x: motion, f"({f})/({x})": ratio, f"({x})/s": motion}
    known[f"({f})*s/({x})"] = ratio
    lines = [_HEAD_OWN, f"title = {quoted(f'{model.name}, drafted')}\n", "[parameters]"]
    logs: list[str] = []
    scatter: list[tuple[str, list[str], str]] = []
    for quantity in model.quantities:
        name, unit = quantity.name, quantity.unit
        alike = next((u for u in known if unit != "1" and measures(u, unit)), "")
        size = known[alike] * convert(alike, unit) if alike else 0.3
        if quantity.least == -np.inf:
            prior = (
                f'family = "normal", mean = {_with_unit(0.0, unit)}, sd = {_with_unit(size, unit)}'
            )
            scatter.append((name, [name], _with_unit(0.1 * size, unit)))
        else:
            logs.append(name)
            prior = f'family = "lognormal", median = {_with_unit(size, unit)}, spread = 1.5'
            if quantity.most == 1.0:
                prior = 'family = "beta", a = 2, b = 2'
        reason = quoted(f"FIXME: a guess; {quantity.meaning}")
        lines.append(f"{name} = {{ {prior}, reason = {reason} }}")
    zero, offset, noise = (_with_unit(share * response, f) for share in (0.0, 0.02, 0.1))
    memory = '"0.1 s"' if model.axes.timed else "3"
    more = {
        "offset": f'family = "normal", mean = {zero}, sd = {offset}, reason = "zero of the sensor"',
        "noise_sd": f'family = "half_normal", sd = {noise}, reason = "what the model misses"',
        "noise_time": f'family = "lognormal", median = {memory}, spread = 1.0, reason = "FIXME"',
    }
    lines += [*(f"{name} = {{ {prior} }}" for name, prior in more.items()), "\n[scatter]"]
    scatter += [("parameters", logs, "0.2")] if logs else []
    scatter += [("noise", ["noise_sd", "noise_time"], "0.3"), ("offset_group", ["offset"], offset)]
    why = commented("from test to test: replace it by what you know")
    for name, names, sd in scatter:
        lines.append(f"{name} = {{ parameters = {_toml(names)}, sd = {sd} }}  {why}")
    return "\n".join(lines) + "\n"


def _with_unit(value: float, unit: str) -> str:
    """A figure in TOML: a number, or a text with its unit."""
    return f"{value:.3g}" if unit == "1" else quoted(f"{in_digits(value, 3)} {unit}")
