"""Is this device like the others? Its records against the population of the calibrated tests.

A quantity q of the loop (slip force, energy, gap, …) of a record is

    ln q = ln (nominal value at this motion and actuation) + device + test

The nominal value and the scatter of tests have draws of the population. The posterior of the
device's level under a flat prior is the measured value over these draws. Against limits there are
two one-sided tests (Schuirmann, 1987): a device is accepted where the interval of its level lies
within the limits. A difference is one that the scatter of tests does not explain; its p-value is
adjusted over the quantities by the distribution of the largest one (Westfall and Young, 1993), and
over the devices of a batch by Benjamini and Hochberg (1995).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.errors import CampaignError, RecordError
from mfd_bayes.evaluation.properties import Peaks, measured_properties, peaks_of, properties_of
from mfd_bayes.evaluation.views import Fan, Interval
from mfd_bayes.population.bands import Band
from mfd_bayes.records.measured import UNITS, measured_cycles
from mfd_bayes.records.record import Record
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.run import Run
from mfd_bayes.runs.tested_range import far_sentences

Array = NDArray[np.float64]

ALPHA = 0.05  # stated rate of false alarms, and of each of the two one-sided tests
DRAWS = 1000
DEFAULT_LIMITS: Mapping[str, float] = {"all": 0.15}
"""Of ASCE/SEI 7 for the properties of a single device against their nominal values (18.2.4.5)."""

QUANTITIES: Mapping[str, tuple[str, str, str, str]] = {
    "slip_fwd": ("slip", "slip force", "forward", UNITS["slip_fwd"]),
    "slip_bwd": ("slip", "slip force", "backward", UNITS["slip_bwd"]),
    "build_up_slope": ("build_up", "stiffness of the build-up", "", UNITS["build_up_slope"]),
    "gap": ("gap", "gap", "", UNITS["gap"]),
    "peak_fwd": ("peak", "peak force", "forward", UNITS["peak_fwd"]),
    "peak_bwd": ("peak", "peak force", "backward", UNITS["peak_bwd"]),
    "energy_per_cycle": ("energy", "energy of a cycle", "", UNITS["energy"]),
    "effective_stiffness": ("stiffness", "effective stiffness", "", UNITS["effective_stiffness"]),
    "effective_damping": ("damping", "effective damping", "", UNITS["effective_damping"]),
    "loop": ("loop", "whole loop, rms from the nominal one", "", "kip"),
}
"""Name of the limit, words, direction and unit of each quantity, in the order of tables."""

LIMITS = tuple(dict.fromkeys(name for name, *_ in QUANTITIES.values() if name != "loop"))
CAUSES = ("slip_fwd", "slip_bwd", "build_up_slope", "gap")
"""Quantities that make the others differ: one of them is named where one differs."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """One record against the population.

    Attributes
    ----------
    record : Record
    trace : Trace
        With its force, at the rate of the calibrated tests.
    measured : mapping of str to float
        Value of each quantity that the record shows.
    nominal : mapping of str to (n,)
        Draws of the nominal value.
    device, among : mapping of str to (n,)
        Draws of a record of a device at the nominal value, and of any device. They are the same
        where tests of one device are all that is known.
    fan : Fan
        Band of a record of any device.
    remarks : tuple of str
    """

    record: Record
    trace: Trace
    measured: Mapping[str, float]
    nominal: Mapping[str, Array]
    device: Mapping[str, Array]
    among: Mapping[str, Array]
    fan: Fan
    remarks: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Acceptance:
    """A device, compared with the others.

    Attributes
    ----------
    device : str
    verdict : {"accepted", "rejected", "cannot tell"}
    sentence : str
        The verdict with its reason, and the power.
    p_value, p_batch : float
        That tests of one device scatter so much, over all quantities; and over the whole batch.
    named : str
        The quantity that differs most; "" where none does.
    rows : DataFrame
        A row for each quantity.
    comparisons : tuple of Comparison
        One for each record.
    """

    device: str
    verdict: str
    sentence: str
    p_value: float
    p_batch: float
    named: str
    rows: pd.DataFrame
    comparisons: tuple[Comparison, ...]

    @property
    def remarks(self) -> tuple[str, ...]:
        """Reasons to trust the answer less."""
        return tuple(dict.fromkeys(r for c in self.comparisons for r in c.remarks))


def accept(
    run: Run,
    records: Record | Sequence[Record],
    *,
    device: str | Sequence[str] = "",
    limits: Mapping[str, float] | None = None,
    session: str = "",
    draws: int = DRAWS,
    seed: int = 0,
) -> tuple[Acceptance, ...]:
    """Whether devices are like the others, from a record or several of each.

    Parameters
    ----------
    run : Run
    records : Record or sequence of Record
        With force and actuation.
    device : str or sequence of str, optional
        Device of all records, or of each. By default every record is one of another device, named
        by its file. A device that the run knows is compared with itself.
    limits : mapping of str to float, optional
        Largest deviation from the nominal value, as a share, by a name of `LIMITS` or "all". By
        default those of the campaign, else 15 % of all.
    session : str, optional
        Session in which the records were made.
    draws, seed : int

    Raises
    ------
    MfdError
        When a record has no force or no actuation, or lies far outside of what was tested, or a
        limit is unknown.
    """
    records = [records] if isinstance(records, Record) else list(records)
    if not records:
        raise CampaignError("accept needs one record or more")
    if isinstance(device, str):
        names = [device or record.path.stem for record in records]
    else:
        names = list(device)
    if len(names) != len(records):
        raise CampaignError(
            f"give one device for all records, or one for each: there are {len(records)} records "
            f"and {len(names)} devices"
        )
    allowed = complete_limits(limits or run.manifest.settings.limits or DEFAULT_LIMITS)
    peaks, groups = peaks_of(run), dict[str, list[Comparison]]()
    for name, record in zip(names, records, strict=True):
        how = {"session": session, "draws": draws, "seed": seed}
        groups.setdefault(name, []).append(compare_record(run, record, name, peaks, **how))
    independent = not any(run.manifest.settings.sessions.values())
    levels = [Level.of(group, independent=independent) for group in groups.values()]
    batch = false_discovery([level.p_value for level in levels])
    return tuple(
        judge(name, tuple(group), level, p, allowed)
        for (name, group), level, p in zip(groups.items(), levels, batch, strict=True)
    )


def complete_limits(given: Mapping[str, float]) -> dict[str, float]:
    """Limit of each quantity that has one, by the quantity's name."""
    for name, value in given.items():
        if name not in (*LIMITS, "all"):
            raise CampaignError(f"no limit {name!r}: there are {', '.join(LIMITS)} and all")
        if not 0.0 < value < 1.0:
            raise CampaignError(f"the limit of {name} must be above 0 and below 100 %, got {value}")
    each = {name: given.get(kind, given.get("all")) for name, (kind, *_) in QUANTITIES.items()}
    return {name: value for name, value in each.items() if value is not None and name != "loop"}


def compare_record(
    run: Run, record: Record, device: str, peaks: Peaks, *, session: str, draws: int, seed: int
) -> Comparison:
    """One record against the population."""
    cycles = measured_cycles(record)
    if cycles is None:
        raise RecordError(f"{record.path} has no force, which must be compared")
    gap = run.priors.gap if run.model.has_gap else None
    trace = record.trace(run.manifest.settings.campaign.rate, gap=gap)
    departures = run.departures(trace)
    if far := far_sentences(departures, run.system):
        raise RecordError(f"{record.path}: {far}")
    motion, measured = replace(trace, force=None), measured_properties(cycles)

    def drawn(kind: str, of: str) -> Band:
        how: dict[str, Any] = {"session": session, "device": of, "draws": draws, "seed": seed}
        return run.predict(motion, kind, 1.0 - ALPHA, **how)

    known = [name for name in run.devices if name]
    one = device if device in known else known[0] if len(known) > 1 else ""
    nominal = _quantities(motion, drawn("device", device), drawn("device", device), {})
    for side, factor in peaks.items():
        nominal[f"peak_{side}"] = nominal[f"peak_{side}"] * factor.expected
    seen = drawn("observation", device)
    among = _quantities(motion, seen, drawn("new_test", device), peaks)
    if one and one != device:  # tests of a device that is known scatter about its own values
        itself = _quantities(motion, drawn("device", one), drawn("device", one), {})
        for side, factor in peaks.items():
            itself[f"peak_{side}"] = itself[f"peak_{side}"] * factor.expected
        tests = _quantities(motion, drawn("observation", one), drawn("new_test", one), peaks)
        same = {name: nominal[name] * tests[name] / itself[name] for name in tests}
    else:
        same = dict(among)
    middle = np.median(seen.draws, axis=0)
    same["loop"] = among["loop"] = np.sqrt(np.mean((seen.draws - middle) ** 2, axis=1))
    measured["loop"] = float(np.sqrt(np.mean((np.asarray(trace.force) - middle) ** 2)))
    shown = {
        name: measured[name]
        for name in QUANTITIES
        if np.isfinite(measured.get(name, np.nan)) and np.isfinite(among[name]).mean() > 0.5
    }
    if wrong := [name for name, value in shown.items() if not value > 0.0]:
        words = " ".join(QUANTITIES[wrong[0]][1:3]).strip()
        raise RecordError(
            f"{record.path}: the {words} is {shown[wrong[0]]:.3g}, and must be above zero: see "
            "mfd-bayes inspect; is a sign swapped?"
        )
    fan = Fan("observation", middle, (Interval(1.0 - ALPHA, seen.lower, seen.upper),))
    return Comparison(record, trace, shown, nominal, same, among, fan, seen.remarks)


def _quantities(trace: Trace, band: Band, smooth: Band, peaks: Peaks) -> dict[str, Array]:
    """Draws of the quantities of a band; `smooth` is the same without noise, for its peaks."""
    force = smooth.draws
    if band.kind == "observation":
        force = force + np.asarray(smooth.values["offset"])[:, None]
    how: dict[str, Any] = {"peaks": peaks} if peaks else {}
    values = properties_of(trace, band.draws, smooth=force, **how)
    with np.errstate(invalid="ignore"):
        return {n: np.where(values[n] > 0.0, values[n], np.nan) for n in QUANTITIES if n in values}


@dataclass(frozen=True, eq=False)
class Level:
    """Level of one device over its records, in logarithms, of K quantities.

    Attributes
    ----------
    names : tuple of str
    measured : (K,)
        Mean over the records.
    device, among : (n, K)
        Draws of this mean for a device at the nominal value, and for any device.
    p_values : (K,)
        Two-sided, adjusted over the quantities; of the loop for a larger distance.
    critical : float
        Number of standard deviations that counts as a difference.
    """

    names: tuple[str, ...]
    measured: Array
    device: Array
    among: Array
    p_values: Array
    critical: float

    @property
    def p_value(self) -> float:
        """Of the device: the smallest of its quantities."""
        return float(self.p_values.min())

    @classmethod
    def of(cls, group: Sequence[Comparison], *, independent: bool) -> Level:
        """From the records of one device; the scatter of their tests is `independent` or shared."""
        names = tuple(name for name in QUANTITIES if all(name in c.measured for c in group))
        if not names:
            raise RecordError(f"{group[0].record.path} shows no quantity that can be compared")
        rng = np.random.default_rng(0)
        measured = np.mean([[np.log(c.measured[n]) for n in names] for c in group], axis=0)
        device, among = (
            np.mean(
                [
                    _logs(c, draws, names, rng if i and independent else None)
                    for i, (c, draws) in enumerate(zip(group, each, strict=True))
                ],
                axis=0,
            )
            for each in ([c.device for c in group], [c.among for c in group])
        )
        size, own = _standard(device, measured, names)
        largest = size.max(axis=1)
        p = (1.0 + np.sum(largest[:, None] >= own, axis=0)) / (1.0 + len(largest))
        critical = float(np.quantile(largest, 1.0 - ALPHA))
        return cls(names, measured, device, among, p, critical)


def _logs(
    comparison: Comparison,
    draws: Mapping[str, Array],
    names: Sequence[str],
    rng: np.random.Generator | None,
) -> Array:
    """Logarithms of draws, (n, K); with `rng`, of tests that scatter by themselves."""
    found = []
    for name in names:
        log, nominal = np.log(draws[name]), comparison.nominal.get(name)
        middle = np.zeros(log.size) if nominal is None else np.log(nominal)
        middle = np.where(np.isfinite(middle), middle, np.nanmean(middle))
        left = log - middle
        found.append((middle, np.where(np.isfinite(left), left, np.nanmean(left))))
    order = slice(None) if rng is None else rng.permutation(found[0][0].size)
    return np.stack([middle + left[order] for middle, left in found], axis=1)


def _standard(draws: Array, measured: Array, names: Sequence[str]) -> tuple[Array, Array]:
    """Sizes of standardised draws (n, K) and measured values (K,); a near loop is none."""
    mean, sd = draws.mean(axis=0), np.maximum(draws.std(axis=0), 1e-9)
    size, own = (draws - mean) / sd, (measured - mean) / sd
    two = np.array([name != "loop" for name in names])
    return np.where(two, np.abs(size), size), np.where(two, np.abs(own), own)


def false_discovery(p_values: Sequence[float]) -> Array:
    """P-values of a batch, adjusted by Benjamini and Hochberg."""
    from scipy import stats  # which takes long to import

    return np.asarray(stats.false_discovery_control(np.clip(p_values, 0.0, 1.0)))


def judge(
    device: str,
    group: tuple[Comparison, ...],
    level: Level,
    p_batch: float,
    limits: Mapping[str, float],
) -> Acceptance:
    """Verdict of a device: two one-sided tests against limits, and what tests scatter."""
    rows = []
    for k, name in enumerate(level.names):
        _, words, direction, unit = QUANTITIES[name]
        effect = level.measured[k] - level.device[:, k]
        among, sd = np.exp(level.among[:, k]), float(effect.std())
        nominal = float(np.exp(np.median(level.device[:, k])))
        low, middle, high = np.expm1(np.quantile(effect, [ALPHA, 0.5, 1.0 - ALPHA]))
        row = {
            "quantity": words,
            "direction": direction,
            "unit": unit,
            "measured": float(np.exp(level.measured[k])),
            "nominal": nominal,
            "lower": float(np.quantile(among, 0.5 * ALPHA)),
            "upper": float(np.quantile(among, 1.0 - 0.5 * ALPHA)),
            "percentile": 100.0 * float(np.mean(level.among[:, k] < level.measured[k])),
            "effect": 100.0 * float(middle),
            "effect_lower": 100.0 * float(low),
            "effect_upper": 100.0 * float(high),
            "limit": np.nan,
            "beyond_limit": np.nan,
            "p_value": float(level.p_values[k]),
            "detectable": 100.0 * float(np.expm1((level.critical + special.ndtri(0.8)) * sd)),
            "power": np.nan,
            "verdict": "differs" if _differs(level.p_values[k], p_batch) else "like the others",
        }
        if name == "loop":
            row |= dict.fromkeys(("effect", "effect_lower", "effect_upper", "detectable"), np.nan)
        limit = limits.get(name)
        if limit is not None:
            beyond = float(np.mean(np.abs(np.expm1(effect)) > limit))
            row |= {"limit": 100.0 * limit, "beyond_limit": beyond}
            row["power"] = float(special.ndtr(np.log1p(limit) / sd - level.critical))
            if beyond <= ALPHA:
                row["verdict"] = "within the limit"
            elif beyond > 0.5 and _differs(level.p_values[k], p_batch):
                row["verdict"] = "beyond the limit"
            else:
                row["verdict"] = "cannot tell"
        rows.append(row)
    table = pd.DataFrame(rows, index=pd.Index(level.names, name="name"))
    differing = table.index[(table["p_value"] < ALPHA) & (p_batch < ALPHA)]
    named = _most(table, [n for n in differing if n in CAUSES] or list(differing), level)
    verdict = _verdict(table)
    sentence = _sentence(verdict, table, named)
    return Acceptance(device, verdict, sentence, level.p_value, p_batch, named, table, group)


def _differs(p_value: float, p_batch: float) -> bool:
    return p_value < ALPHA and p_batch < ALPHA


def _most(table: pd.DataFrame, among: Iterable[str], level: Level) -> str:
    """Quantity whose difference is the largest in standard deviations; "" of none."""
    own = dict(
        zip(level.names, _standard(level.device, level.measured, level.names)[1], strict=True)
    )
    return max(among, key=lambda name: own[name], default="")


def _verdict(table: pd.DataFrame) -> str:
    limited = table[table["limit"].notna()]
    if (limited["verdict"] == "beyond the limit").any():
        return "rejected"
    if limited.empty or not (limited["verdict"] == "within the limit").all():
        return "cannot tell"
    return "accepted"


def _sentence(verdict: str, table: pd.DataFrame, named: str) -> str:
    """The verdict with its reason, and the power of the records."""
    limited = table[table["limit"].notna()]

    def words(name: str) -> str:
        row = table.loc[name]
        return f"{row['quantity']} {row['direction']}".strip()

    def shown(name: str) -> str:
        row = table.loc[name]
        low, high = row["effect_lower"], row["effect_upper"]
        return (
            f"{words(name)} {row['effect']:+.0f} % ({100 * (1 - 2 * ALPHA):.0f} % interval "
            f"{low:+.0f} to {high:+.0f} %)"
        )

    about = ""
    if named:
        what = "the whole loop" if named == "loop" else shown(named)
        about = f" It differs from the others, most in {what}."
    if verdict == "accepted":
        first = f"Accepted: all {len(limited)} quantities lie within their limits."
    elif verdict == "rejected":
        beyond = limited.index[limited["verdict"] == "beyond the limit"]
        first = f"Rejected: beyond the limit: {', '.join(map(words, beyond))}."
    else:
        open_ = limited.index[limited["verdict"] == "cannot tell"]
        first = f"Cannot tell with this record: {', '.join(map(words, open_))}."
    worst = limited["power"].idxmin()
    row = limited.loc[worst]
    return (
        f"{first}{about} A deviation of {row['limit']:.0f} % would be found in every quantity with "
        f"a probability of {row['power']:.2f} or more; least in {words(worst)}, where "
        f"{row['detectable']:.0f} % would be found with 0.80."
    )
