"""Is this device like the others? Its records against the population of the calibrated tests.

A quantity q of the loop (slip force, energy, gap, …) of a record is

    ln q = ln (nominal value at this motion and actuation) + device + test

The nominal value and the scatter of tests have draws of the population: a new record has the
posterior predictive distribution, in which the variance of tests, known from few of them, is
integrated out. The posterior of the device's level under a flat prior is the measured value over
these draws. Against limits there are two one-sided tests (Schuirmann, 1987): a device is accepted
where the interval of its level lies within the limits. A difference is one that the scatter of
tests does not explain; its p-value is adjusted over the quantities by the distribution of the
largest one (Westfall and Young, 1993), and never below that of the quantity by itself: what lies
inside its 95 % interval, that of a measurement in the data sheet, does not differ. Over the devices
of a batch it is adjusted by Benjamini and Hochberg (1995). Where the calibrated tests themselves
scatter more than the population says, all scatter of that quantity is widened by the Birge ratio
(Birge, 1932).

A load cell that measured the tests and the record cancels. Where another one measured the record,
the nominal value is the one that it would read: its gain and that of the tests' load cell enter all
quantities of one draw alike (`evaluation.measurement`).

With the posterior probability p that the level is beyond its limit, a verdict is wrong with the
specific consumer's risk p of an acceptance and the specific producer's risk 1 − p of a rejection
(JCGM 106:2012, 9.3.2). With r the effect less its median, a level is accepted whose median effect
lies inside the limit L by the guard band

    max {L − exp[ln(1 + L) − r₀.₉₅] + 1,  L + exp[ln(1 − L) − r₀.₀₅] − 1}
"""

from __future__ import annotations

import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration.priors import MOST_UNCERTAIN
from mfd_bayes.errors import CampaignError, RecordError
from mfd_bayes.evaluation.measurement import EXACT, Gains, gains_of_another
from mfd_bayes.evaluation.properties import (
    applicable,
    measured_of,
    properties_of,
    without_noise,
)
from mfd_bayes.evaluation.scores import Interval, QuantileBand
from mfd_bayes.evaluation.views import DEFAULT_LIMITS
from mfd_bayes.population.bands import Band
from mfd_bayes.population.design import CONDITIONS
from mfd_bayes.population.peaks import NO_EXCESS, Peaks, certain
from mfd_bayes.records.cross_checks import UNITS as RECORD_UNITS
from mfd_bayes.records.cycles import (
    LIMITS,
    PROPERTIES,
    DeviceProperty,
    measured_cycles,
    properties_called,
)
from mfd_bayes.records.record import Record
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.run import Run, prediction_conditions
from mfd_bayes.runs.tested_range import extrapolation_messages
from mfd_bayes.units import DAMPER, Axes, factor

if TYPE_CHECKING:
    import pandas as pd


Array = NDArray[np.float64]
Row = dict[str, Any]

ALPHA = 0.05  # stated rate of false alarms, and of each of the two one-sided tests
DRAWS = 1000
FEW = 200  # draws of a prediction of each calibrated test
FINEST = 16  # most samples at which these are predicted, for each one of the trace

_LOOP = DeviceProperty("loop", "kip", "whole loop, rms from the nominal one")
QUANTITIES: Mapping[str, DeviceProperty] = {
    quantity.name: quantity
    for kind in LIMITS
    for quantity in PROPERTIES.values()
    if quantity.limit == kind
} | {_LOOP.name: _LOOP}
"""What is compared, in the order of tables."""


LARGE = np.log(2.0)  # a logarithm so far from the others' asks whether the unit is wrong
ALONE = 1.96  # size at which one quantity by itself differs, 5 %


def accept(
    run: Run,
    records: Record | Sequence[Record],
    *,
    device: str | Sequence[str] = "",
    limits: Mapping[str, float] | None = None,
    session: str = "",
    conditions: Mapping[str, float] | None = None,
    draws: int = DRAWS,
    seed: int = 0,
    uncertainty: float = 0.0,
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
        default those of `default_limits`.
    session : str, optional
        Session in which the records were made.
    conditions : mapping of str to float, optional
        "date" in decimal years, "cycles", "temperature" in °C of the records: needed where a
        quantity of the run follows them.
    draws : int
    seed : int
    uncertainty : float
        Standard uncertainty, a share, of the gain of the load cell that measured the records, where
        it is another than that of the tests; 0 for the same one, whose gain cancels.

    Raises
    ------
    MfdError
        When a record has no force or no actuation, or lies far outside of what was tested, or a
        limit is unknown; when a date, a count or a temperature is needed and missing.
    """
    if not isinstance(run, Run):
        raise CampaignError(f"run must be a Run, as open_run returns it, got {run!r}")
    measured: list[Any] = [*records] if isinstance(records, list | tuple) else [records]
    if not measured:
        raise CampaignError("accept needs one record or more")
    for record in measured:
        if not isinstance(record, Record):
            raise CampaignError(
                "records must be one Record or several, as read_record returns them, got "
                f"{reprlib.repr(record)}"
            )
    devices = device if isinstance(device, list | tuple) else [device]
    if not all(isinstance(name, str) for name in devices):
        raise CampaignError(f"device must be a name, or one of each record, got {device!r}")
    if limits is not None and not isinstance(limits, Mapping):
        raise CampaignError(f"limits must be shares by name, such as all=0.15, got {limits!r}")
    if not isinstance(uncertainty, int | float) or not 0.0 <= uncertainty < MOST_UNCERTAIN:
        raise CampaignError(
            f"uncertainty must be a share from 0 to below {MOST_UNCERTAIN:g}, got {uncertainty!r}"
        )
    names = [device or r.path.stem for r in measured] if isinstance(device, str) else [*devices]
    if len(names) != len(measured):
        raise CampaignError(
            f"give one device for all records, or one for each: there are {len(measured)} records "
            f"and {len(names)} devices"
        )
    allowed = complete_limits(limits or default_limits(run)[0])
    for quantity, covariates in run.population.design.dependence.items():
        for name in {*covariates} & {*CONDITIONS} - {*(conditions or {})}:
            raise CampaignError(
                f"{quantity} of this run follows the {name}: say the {name} of the records"
            )
    groups: dict[str, list[ComparedRecord]] = {}
    ratios = birge_ratios(run)
    how: dict[str, Any] = {"ratios": ratios, "draws": draws, "seed": seed}
    how["gains"] = gains_of_another(run, uncertainty, draws) if uncertainty else EXACT
    how["place"] = {"session": session, "conditions": conditions}
    for name, record in zip(names, measured, strict=True):
        trace = trace_of(run, record)
        expected = expect(run, trace, name, rate=record.rate, **how)
        groups.setdefault(name, []).append(compare_record(record, trace, expected))
    independent = not any(run.manifest.settings.sessions.values())
    levels = [Level.of(group, independent=independent) for group in groups.values()]
    batch = false_discovery([level.p_value for level in levels])
    return tuple(
        judge(name, tuple(group), level, p, allowed, run.system.axes)
        for (name, group), level, p in zip(groups.items(), levels, batch, strict=True)
    )


def default_limits(run: Run) -> tuple[Mapping[str, float], str]:
    """Limits of a run, as shares by a name of `LIMITS` or "all", and whose they are.

    Those of the campaign, else its λ_spec (of both sides the smaller), else what its standard
    allows a device of a supply, else 15 % of all, which no standard states.
    """
    settings, standard = run.manifest.settings, run.manifest.standard
    if settings.limits:
        return settings.limits, "the campaign's [limits]"
    if settings.design is not None:
        spec = settings.design.lambda_spec
        sides = [side for side in (1.0 - spec.min, spec.max - 1.0) if side > 0.0]
        if sides:
            return {"all": min(sides)}, "lambda_spec of the campaign"
    by_name = {
        item.limit: share
        for requirement in (standard.requirement if standard is not None else ())
        if requirement.statistic == "supply"
        for quantity, share in requirement.limits.items()
        for item in properties_called(quantity)
        if item.limit
    }
    if standard is not None and by_name:
        return by_name, standard.title
    return DEFAULT_LIMITS, "15 % of all, which no standard states"


def complete_limits(limits: Mapping[str, float]) -> dict[str, float]:
    """Limit of each quantity that has one, by the quantity's name."""
    for name, value in limits.items():
        if name not in (*LIMITS, "all"):
            raise CampaignError(f"no limit {name!r}: there are {', '.join(LIMITS)} and all")
        if not 0.0 < value < 1.0:
            raise CampaignError(f"the limit of {name} must be above 0 and below 100 %, got {value}")
    by_name = {n: limits.get(p.limit, limits.get("all")) for n, p in QUANTITIES.items()}
    return {name: value for name, value in by_name.items() if value is not None and name != "loop"}


def trace_of(run: Run, record: Record) -> Trace:
    """Trace of a record at the rate of the calibrated tests."""
    if record.force is None:
        raise RecordError(f"{record.path} has no force, which is to be compared")
    if np.ptp(record.force) == 0.0:
        raise RecordError(
            f"{record.path}: the force is the same throughout: was the load cell connected, and "
            "is it the right column?"
        )
    gap = run.priors.gap if run.model.has_gap else None
    trace = record.trace(run.manifest.settings.campaign.rate, gap=gap)
    if not np.isfinite(trace.reference_actuation):
        raise RecordError(f"{record.path} needs an actuation")
    if far := extrapolation_messages(run.extrapolations(trace), run.system):
        raise RecordError(f"{record.path}: {far}")
    return trace


def expect(
    run: Run,
    trace: Trace,
    device: str,
    place: Mapping[str, Any] | None = None,
    *,
    rate: float,
    ratios: Mapping[str, float],
    draws: int = DRAWS,
    seed: int = 0,
    gains: Gains = EXACT,
) -> Expected:
    """What the population expects of a record of a device under a motion and an actuation.

    `place` has the session and the conditions of the record, `rate` is that of its samples, Hz, and
    `ratios` are those of `birge_ratios`, `gains` those of the tests' instruments over those of the
    record's, of as many draws.
    """
    motion, peaks, place = replace(trace, force=None), run.peaks, dict(place or {})
    resolution = at_rate(run, motion, {**place, "device": device}, rate)
    place |= {"draws": draws, "seed": seed}

    def predict(kind: str, of: str) -> Band:
        return run.predict(motion, kind, 1.0 - ALPHA, device=of, **place)

    def quantities(band: Band, smooth: Band, excess: Peaks) -> dict[str, Array]:
        values = applicable(_quantities(motion, band, smooth, excess, gains), run.system.axes)
        return {name: value * resolution.get(name, 1.0) for name, value in values.items()}

    def nominal_of(of: str) -> dict[str, Array]:
        band = predict("mean", of)
        return quantities(band, band, certain(peaks))

    devices = [name for name in run.devices if name]
    nominal, observed = nominal_of(device), predict("observation", device)
    any_device = this_device = quantities(observed, predict("new_test", device), peaks)
    if device not in devices and len(run.devices) > 1:  # tests of a known one scatter as its own do
        reference, reference_nominal = devices[0], nominal_of(devices[0])
        this_device = quantities(
            predict("observation", reference), predict("new_test", reference), peaks
        )
        this_device = {
            n: v * nominal[n] / reference_nominal[n] if n in nominal else v
            for n, v in this_device.items()
        }
    remarks = list(observed.remarks)
    for name, ratio in ratios.items():
        if name in nominal and ratio > 1.0:
            this_device, any_device = (
                {**of, name: nominal[name] * (of[name] / nominal[name]) ** ratio}
                for of in (this_device, any_device)
            )
            remarks.append(
                f"the {run.system.axes.text(_words(name))} of the calibrated tests scatters "
                f"{ratio:.1f} times as much as the population says: its intervals are widened by "
                "that"
            )
    force = gains.applied({"force": observed.draws})["force"]
    lower, upper = np.quantile(force, [0.5 * ALPHA, 1.0 - 0.5 * ALPHA], axis=0)
    band = Interval(1.0 - ALPHA, lower, upper)
    fan = QuantileBand("observation", observed.median, (band,))
    return Expected(nominal, this_device, any_device, fan, tuple(dict.fromkeys(remarks)))


def _words(name: str) -> str:
    quantity = QUANTITIES[name]
    return f"{quantity.accept_label or quantity.label} {quantity.direction}".strip()


def at_rate(run: Run, motion: Trace, options: Mapping[str, Any], rate: float) -> dict[str, float]:
    """Factor of what is read off few samples: at the rate of a record over that of a motion.

    A record has more samples than the traces of calibrated tests.
    """
    from scipy import interpolate  # which takes long to import

    step = float(np.median(np.diff(motion.time)))
    refinement = int(np.clip(round(rate * step), 1, FINEST))
    if refinement == 1:
        return {}
    time = np.linspace(motion.time[0], motion.time[-1], refinement * (motion.samples - 1) + 1)
    path = interpolate.CubicSpline(motion.time, motion.displacement)(time)
    actuation = motion.actuation
    if motion.varying:
        actuation = np.interp(time, motion.time, actuation)
    finer = replace(Trace.from_arrays(time, path, actuation), timed=motion.timed)
    values = []
    for trace in (finer, motion):
        band = run.predict(trace, "new_test", **{**options, "draws": FEW // 2})
        values.append(_quantities(trace, band, band, NO_EXCESS))
    fine, coarse = values
    with np.errstate(all="ignore"):
        quotients = {n: fine[n] / coarse[n] for n in fine if QUANTITIES[n].rate_dependent}
    resolved = {name: q for name, q in quotients.items() if not np.all(np.isnan(q))}
    ratios = {name: float(np.nanmedian(q)) for name, q in resolved.items()}
    return {name: ratio for name, ratio in ratios.items() if np.isfinite(ratio)}


def birge_ratios(run: Run) -> dict[str, float]:
    """Scatter of the calibrated tests' measured quantities over that which is predicted, by name.

    1 where chance explains it, by a chi-squared test at 5 %.
    """
    peaks, sizes = run.peaks, dict[str, list[float]]()
    for name, test in run.tests.items():
        trace, options = test.trace, {**prediction_conditions(run, name), "draws": FEW}
        motion = replace(trace, force=None)
        observed, smooth = (
            run.predict(motion, kind, **options) for kind in ("observation", "new_test")
        )
        measured = measured_of(run.manifest, name).of_test()
        resolution = at_rate(
            run, motion, prediction_conditions(run, name), run.manifest.tests[name].record_rate
        )
        for quantity, values in _quantities(motion, observed, smooth, peaks).items():
            logs = np.log(values[np.isfinite(values)]) + np.log(resolution.get(quantity, 1.0))
            value = measured.get(quantity, np.nan)
            if logs.size > 0.5 * FEW and value > 0.0:
                sizes.setdefault(quantity, []).append((np.log(value) - logs.mean()) / logs.std())
    ratios = {}
    for quantity, deviations in sizes.items():
        squares = float(np.sum(np.square(deviations)))
        chance = special.chdtrc(len(deviations), squares) >= ALPHA
        ratios[quantity] = 1.0 if chance else float(np.sqrt(squares / len(deviations)))
    return ratios


def compare_record(record: Record, trace: Trace, expected: Expected) -> ComparedRecord:
    """A record with what was expected of it; its values are those of its own samples."""
    cycles = measured_cycles(record.trace())
    assert cycles is not None  # a trace with a force has them
    residual = np.asarray(trace.force) - expected.fan.median
    measured = cycles.of_test() | {"loop": float(np.sqrt(np.mean(residual**2)))}
    values = {
        name: measured[name]
        for name in QUANTITIES
        if name in expected.device
        and np.isfinite(measured.get(name, np.nan))
        and np.isfinite(expected.device[name]).mean() >= 1.0 - ALPHA  # else it may be zero
    }
    if wrong := [name for name, value in values.items() if not value > 0.0]:
        raise RecordError(
            f"{record.path}: the {_words(wrong[0])} is {values[wrong[0]]:.3g}, and must be above "
            "zero; is a sign swapped? See mfd-bayes inspect"
        )
    return ComparedRecord(record, trace, values, expected)


def _quantities(
    trace: Trace, band: Band, smooth: Band, peaks: Peaks, gains: Gains = EXACT
) -> dict[str, Array]:
    """Draws of the quantities of a band; `smooth` is the same without noise, for its peaks."""
    values = properties_of(trace, band.draws, peaks, smooth=without_noise(band, smooth))
    values = gains.applied(values)
    if band.kind == "observation":
        force = gains.applied({"force": band.draws})["force"]
        values["loop"] = np.sqrt(np.mean((force - band.median) ** 2, axis=1))
    with np.errstate(invalid="ignore"):
        return {n: np.where(values[n] > 0.0, values[n], np.nan) for n in QUANTITIES if n in values}


@dataclass(frozen=True, eq=False)
class Level:
    """Level of one device over its records, in logarithms, of K quantities."""

    names: tuple[str, ...]
    measured: Array  # (K,), mean over the records
    device: Array  # (n, K), draws of this mean for a device at the nominal value
    among: Array  # (n, K), and for any device
    p_values: Array  # (K,), two-sided, adjusted over the quantities; of the loop for a larger one
    sizes: Array  # (K,), differences in standard deviations
    critical: float  # number of standard deviations that counts as a difference

    @property
    def p_value(self) -> float:
        """Of the device: the smallest of its quantities."""
        return float(self.p_values.min())

    @classmethod
    def of(cls, group: Sequence[ComparedRecord], *, independent: bool) -> Level:
        """From the records of one device; the scatter of their tests is `independent` or shared."""
        names = tuple(name for name in QUANTITIES if all(name in c.measured for c in group))
        if not names:
            raise RecordError(f"{group[0].record.path} shows no quantity that can be compared")
        rng = np.random.default_rng(0)
        measured = np.mean([[np.log(c.measured[n]) for n in names] for c in group], axis=0)

        def level(kind: str) -> Array:
            logs = [
                _logs(c.expected, kind, names, rng if i and independent else None)
                for i, c in enumerate(group)
            ]
            return np.asarray(np.mean(logs, axis=0))

        device, any_device = level("device"), level("among")
        mean, sd = device.mean(axis=0), np.maximum(device.std(axis=0), 1e-9)
        two_sided = np.array([name != "loop" for name in names])  # a near loop is no difference
        size, measured_size = (
            np.where(two_sided, np.abs(z), z)
            for z in ((device - mean) / sd, (measured - mean) / sd)
        )
        largest = size.max(axis=1)
        n_above, n_below = (
            1.0 + np.sum(s, axis=0) for s in (device >= measured, device <= measured)
        )
        single = np.where(two_sided, 2.0 * np.minimum(n_above, n_below), n_above) / (
            1.0 + len(device)
        )
        p = (1.0 + np.sum(largest[:, None] >= measured_size, axis=0)) / (1.0 + len(largest))
        p = np.minimum(np.maximum(p, single), 1.0)
        critical = float(np.quantile(largest, 1.0 - ALPHA))
        return cls(names, measured, device, any_device, p, measured_size, critical)


def _logs(
    expected: Expected, kind: str, names: Sequence[str], rng: np.random.Generator | None
) -> Array:
    """Logarithms of draws, (n, K); with `rng`, of tests that scatter by themselves."""
    columns, draws = [], getattr(expected, kind)
    order = None if rng is None else rng.permutation(len(draws["loop"]))
    for name in names:
        nominal = np.log(expected.nominal.get(name, np.ones(len(draws[name]))))
        nominal = np.where(np.isfinite(nominal), nominal, np.nanmean(nominal))
        scatter = np.log(draws[name]) - nominal
        scatter = np.where(np.isfinite(scatter), scatter, np.nanmean(scatter))
        columns.append(nominal + (scatter if order is None else scatter[order]))
    return np.stack(columns, axis=1)


def false_discovery(p_values: Sequence[float]) -> Array:
    """P-values of a batch, adjusted by Benjamini and Hochberg."""
    from scipy import stats  # which takes long to import

    return np.asarray(stats.false_discovery_control(np.clip(p_values, 0.0, 1.0)))


def judge(
    device: str,
    group: tuple[ComparedRecord, ...],
    level: Level,
    p_batch: float,
    limits: Mapping[str, float],
    axes: Axes = DAMPER,
) -> Acceptance:
    """Verdict of a device: two one-sided tests against limits, and what tests scatter."""
    import pandas as pd  # which takes long to import

    rows: dict[str, Row] = {}
    for k, name in enumerate(level.names):
        quantity = QUANTITIES[name]
        effect, p_value = level.measured[k] - level.device[:, k], float(level.p_values[k])
        any_device, sd = np.exp(level.among[:, k]), float(effect.std())
        low, middle, high = 100.0 * np.expm1(np.quantile(effect, [ALPHA, 0.5, 1.0 - ALPHA]))
        detectable = 100.0 * float(np.expm1((level.critical + special.ndtri(0.8)) * sd))
        if name == "loop":
            low = middle = high = detectable = np.nan
        differs = p_value < ALPHA and p_batch < ALPHA
        limit, p_beyond, power, guard = limits.get(name, np.nan), np.nan, np.nan, np.nan
        verdict = "differs" if differs else "like the others"
        if name in limits:
            p_beyond = float(np.mean(np.abs(np.expm1(effect)) > limit))
            guard = guard_band(effect, limit)
            power = float(special.ndtr(np.log1p(limit) / sd - level.critical))
            verdict = "beyond the limit" if p_beyond > 0.5 and differs else "cannot tell"
            verdict = "within the limit" if p_beyond <= ALPHA else verdict
        rows[name] = {
            "quantity": axes.text(quantity.accept_label or quantity.label),
            "direction": quantity.direction,
            "unit": quantity.unit,
            "measured": float(np.exp(level.measured[k])),
            "nominal": float(np.exp(np.median(level.device[:, k]))),
            "lower": float(np.quantile(any_device, 0.5 * ALPHA)),
            "upper": float(np.quantile(any_device, 1.0 - 0.5 * ALPHA)),
            "percentile": 100.0 * float(np.mean(level.among[:, k] < level.measured[k])),
            "effect": float(middle),
            "effect_lower": float(low),
            "effect_upper": float(high),
            "limit": 100.0 * limit,
            "beyond_limit": p_beyond,
            "guard_band": 100.0 * guard,
            "p_wrong_acceptance": p_beyond if verdict == "within the limit" else np.nan,
            "p_wrong_rejection": 1.0 - p_beyond if verdict == "beyond the limit" else np.nan,
            "p_value": p_value,
            "detectable": detectable,
            "power": power,
            "verdict": verdict,
        }
    differing = [name for name, row in rows.items() if row["p_value"] < ALPHA and p_batch < ALPHA]
    size = dict(zip(level.names, level.sizes, strict=True))
    # where something differs, slip forces are named before what is read off at shares of them
    slips = [n for n in size if differing and n.startswith("slip") and size[n] > ALONE]
    resolved = [n for n in differing if QUANTITIES[n].rate_dependent]
    candidates = slips or resolved or differing
    named = max(candidates, key=lambda name: size[name], default="")
    verdicts = {row["verdict"] for row in rows.values() if np.isfinite(row["limit"])}
    verdict = "accepted" if verdicts == {"within the limit"} else "cannot tell"
    verdict = "rejected" if "beyond the limit" in verdicts else verdict
    table = pd.DataFrame(list(rows.values()), index=pd.Index(level.names, name="name"))
    sentence = _sentence(verdict, rows, named)
    if axes.of_damper and (hint := _wrong_unit(rows, group)):
        sentence += f" {hint}"
    return Acceptance(device, verdict, sentence, level.p_value, p_batch, named, table, group)


def guard_band(effect: Array, limit: float) -> float:
    """How far inside a limit, a share, the median effect must lie to be within it, a share.

    `effect` are draws of its logarithm, (n,). A median effect so far inside has a probability of
    `ALPHA` to be beyond the nearer limit; the larger band of both sides.
    """
    residual = effect - np.median(effect)
    lower, upper = np.quantile(residual, [ALPHA, 1.0 - ALPHA])
    upper_guard = limit - np.expm1(np.log1p(limit) - upper)
    lower_guard = limit + np.expm1(np.log1p(-limit) - lower)
    return float(max(upper_guard, lower_guard))


def _wrong_unit(rows: Mapping[str, Row], group: Sequence[ComparedRecord]) -> str:
    """Whether slip forces or gap are as far off as another unit of the record would make them."""
    for role, names in (("force", ("slip_fwd", "slip_bwd")), ("displacement", ("gap",))):
        ratios = [rows[n]["measured"] / rows[n]["nominal"] for n in names if n in rows]
        read, mean = group[0].record.columns[role][1], float(np.log(ratios or [1.0]).mean())
        shift = {u: np.log(factor(read, role) / factor(u, role)) - mean for u in RECORD_UNITS[role]}
        unit = min(shift, key=lambda unit: abs(shift[unit]))
        if abs(mean) > LARGE and unit != read and abs(shift[unit]) < 0.5 * abs(mean):
            return (
                f"The {role} is {np.exp(mean):.3g} times that of the others: is its unit wrong? It "
                f"was read in {read}, and in {unit} it would be {np.exp(-shift[unit]):.2f} times."
            )
    return ""


def _sentence(verdict: str, rows: Mapping[str, Row], named: str) -> str:
    """The verdict with its reason, and the power of the records."""
    limited = {name: row for name, row in rows.items() if np.isfinite(row["limit"])}
    if not limited:
        return "Cannot tell: the record shows no quantity that has a limit."

    def words(row: Row) -> str:
        return f"{row['quantity']} {row['direction']}".strip()

    def those(verdict: str) -> str:
        return ", ".join(words(row) for row in limited.values() if row["verdict"] == verdict)

    conclusion = {
        "accepted": f"Accepted: all {len(limited)} quantities with a limit lie within it.",
        "rejected": f"Rejected: beyond the limit: {those('beyond the limit')}.",
        "cannot tell": f"Cannot tell with this record: {those('cannot tell')}.",
    }[verdict]
    detail, row = "", rows.get(named)
    if row is not None:
        quantity = words(row)
        if named != "loop":
            quantity += (
                f", {row['effect']:+.0f} % ({100 - 200 * ALPHA:.0f} % interval "
                f"{row['effect_lower']:+.0f} to {row['effect_upper']:+.0f} %)"
            )
        detail = f" It differs from the others, most in {quantity}."
        if row["p_value"] >= ALPHA:
            detail = (
                f" It differs from the others; look first at the {quantity}: what is read off at "
                "shares of it follows it."
            )
    worst = min(limited.values(), key=lambda row: row["power"])
    return (
        f"{conclusion}{detail} Power: if the {words(worst)} were off by its limit of "
        f"{worst['limit']:.0f} %, such a record would show it with a probability of "
        f"{worst['power']:.2f}, and a fault of any other quantity more surely. A deviation of "
        f"{worst['detectable']:.0f} % would be shown in four cases of five."
    )


@dataclass(frozen=True, eq=False)
class Expected:
    """What the population expects of a record of a device under a motion.

    Where tests of one device are all that is known, `device` and `among` are the same.
    """

    nominal: Mapping[str, Array]  # draws (n,) of the nominal value of each quantity
    device: Mapping[str, Array]  # of a record of a device at the nominal value
    among: Mapping[str, Array]  # of a record of any device
    fan: QuantileBand  # band of a record of any device
    remarks: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class ComparedRecord:
    """One record, with its trace at the rate of the calibrated tests, and what was expected."""

    record: Record
    trace: Trace
    measured: Mapping[str, float]  # value of each quantity that the record shows
    expected: Expected


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
    comparisons : tuple of ComparedRecord
        One for each record.
    """

    device: str
    verdict: str
    sentence: str
    p_value: float
    p_batch: float
    named: str
    rows: pd.DataFrame
    comparisons: tuple[ComparedRecord, ...]

    @property
    def remarks(self) -> tuple[str, ...]:
        """Reasons to trust the answer less."""
        return tuple(dict.fromkeys(r for c in self.comparisons for r in c.expected.remarks))
