"""Properties of a device from its force: by the same rules as they are measured, and for design."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.posterior import derive_from_parameters
from mfd_bayes.calibration.result import TestResult
from mfd_bayes.campaign.schema import TOLERANCES, CampaignFile
from mfd_bayes.evaluation.scores import spread_of
from mfd_bayes.evaluation.views import Rows
from mfd_bayes.friction.model import Model
from mfd_bayes.population.bands import Band
from mfd_bayes.population.design import LEVELS
from mfd_bayes.population.settings import KIND_NAMES, levels_of, setting_of, with_zeros
from mfd_bayes.records.loops import (
    MeasuredCycles,
    cycle_values,
    find_loops,
    mean_of,
    measured_cycles,
)
from mfd_bayes.records.record import Record
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.manifest import Manifest
from mfd_bayes.runs.run import ModelAverage, Run
from mfd_bayes.units import Axes

Array = NDArray[np.float64]

UNITS: Mapping[str, str] = {
    **dict.fromkeys(("slip_fwd", "slip_bwd", "peak_fwd", "peak_bwd"), "kip"),
    "effective_stiffness": "kip/in",
    "effective_damping": "1",
    **dict.fromkeys(("energy_per_cycle", "energy_of_ramps", "energy_in_all"), "kip*in"),
    "c_eq": "kip*s/in",
    "build_up_slope": "kip/in",
    **dict.fromkeys(("gap", "gap_width"), "in"),
    **dict.fromkeys(("C_fwd", "C_bwd"), "1"),
}
"""Internal unit of every property of a test, in the order of tables."""

EXTREME = 0.005
"""Share of draws on one side of a measured value at which the value is extreme among them."""

TOLERANCE_OF: Mapping[str, str] = {
    **dict.fromkeys(("peak_fwd", "peak_bwd"), "peak"),
    **dict.fromkeys(("slip_fwd", "slip_bwd"), "slip_force"),
    "build_up_slope": "build_up",
    "gap": "gap",
}
"""Kind of the tolerance of a property; of others that of an energy."""

_MEANS = (
    *("energy_per_cycle", "energy_of_ramps", "effective_stiffness", "effective_damping", "c_eq"),
)
_SIGNS = {"fwd": 1.0, "bwd": -1.0}
_OF_CYCLES = (
    *("slip_fwd", "slip_bwd", "effective_stiffness", "effective_damping", "c_eq"),
    *("build_up_slope", "gap"),
)


def measured_of(manifest: Manifest, name: str) -> MeasuredCycles:
    """Measured cycles of a test, as recorded."""
    return MeasuredCycles.from_content(manifest.tests[name].measured)


def measured_properties(cycles: MeasuredCycles) -> dict[str, float]:
    """Measured value of each property: the largest peak, of others the mean at full stroke."""
    own, ramps = cycles.of_test(), cycles.energy[~cycles.full_stroke]
    return {name: own[name] for name in (*_OF_CYCLES, "peak_fwd", "peak_bwd")} | {
        "energy_per_cycle": own["energy"],
        "energy_of_ramps": float(ramps.mean()) if ramps.size else float("nan"),
        "energy_in_all": cycles.total_energy,
    }


@dataclass(frozen=True)
class PeakFactor:
    """Measured peak of a cycle over the peak of the model's force in it, of one direction.

    A record is low-passed and thinned before the fit, and the model has no chatter: a load cell
    sees higher peaks. The factor is log-normal, ln f = mean + t_j + c_jk, with scatter from test to
    test and from cycle to cycle.

    Attributes
    ----------
    mean : float
        Of ln f.
    between, within : float
        Standard deviations of ln f from test to test and from cycle to cycle.
    tests : int
        From which it was learned; 0 where it is 1 for want of any.
    """

    mean: float = 0.0
    between: float = 0.0
    within: float = 0.0
    tests: int = 0

    @property
    def expected(self) -> float:
        """Mean of the factor."""
        return float(np.exp(self.mean + 0.5 * (self.between**2 + self.within**2)))

    def draw(self, rng: np.random.Generator, n: int, cycles: int) -> Array:
        """Factors of the cycles of n new tests, (n, cycles): the mean is uncertain too."""
        if not self.tests:
            return np.ones((n, cycles))
        t = rng.standard_t(max(self.tests - 1, 3), (n, 1))
        away = self.between * np.sqrt(1.0 + 1.0 / self.tests) * t
        within = self.within * rng.standard_normal((n, cycles))
        return np.asarray(np.exp(self.mean + away + within))

    @classmethod
    def of(cls, ratios: Iterable[Array]) -> PeakFactor:
        """Factor of the ratios of the cycles of each test, by analysis of variance."""
        logs = [np.log(ratio) for ratio in ratios if ratio.size]
        if not logs:
            return cls()
        means = np.array([values.mean() for values in logs])
        freedom = sum(values.size - 1 for values in logs)
        squares = sum(float(np.sum((values - values.mean()) ** 2)) for values in logs)
        within = squares / freedom if freedom else 0.0
        size = float(np.mean([1.0 / values.size for values in logs]))
        between = max(float(means.var(ddof=1)) - within * size, 0.0) if means.size > 1 else within
        return cls(float(means.mean()), float(np.sqrt(between)), float(np.sqrt(within)), means.size)


Peaks = Mapping[str, PeakFactor]
"""By direction, "fwd" and "bwd"."""
NO_FACTOR: Peaks = {"fwd": PeakFactor(), "bwd": PeakFactor()}


def peak_factors(manifest: Manifest, tests: Mapping[str, TestResult]) -> Peaks:
    """Factor by direction from the model's peak of a cycle to the measured one.

    The model's force is that of each test's posterior medians, with its offset.
    """
    ratios: dict[str, list[Array]] = {"fwd": [], "bwd": []}
    for name, test in tests.items():
        cycles = measured_of(manifest, name)
        if find_loops(test.trace).strong.size != cycles.full_stroke.size:
            continue  # noise that the filter took away made other cycles
        medians = {name: np.atleast_1d(bounds[0]) for name, bounds in test.intervals.items()}
        force = test.posterior.force(medians) + medians["offset"][:, None]
        values = cycle_values(test.trace, force)
        for side, side_ratios in ratios.items():
            measured, model = getattr(cycles, f"peak_{side}"), values[f"peak_{side}"][0]
            kept = cycles.full_stroke & (measured > 0.0) & (model > 0.0)
            side_ratios.append(measured[kept] / model[kept])
    return {side: PeakFactor.of(side_ratios) for side, side_ratios in ratios.items()}


def peaks_of(run: Run) -> Peaks:
    """The factors of a run's calibrated tests, as its report has stored them, else computed."""
    stored = run.manifest.peak_factors
    if stored:
        return {
            side: PeakFactor(mean, between, within, int(tests))
            for side, (mean, between, within, tests) in stored.items()
        }
    return peak_factors(run.manifest, run.tests)


def stored_peaks(run: Run) -> dict[str, tuple[float, ...]]:
    """The factors of a run's calibrated tests as its manifest keeps them."""
    return {side: astuple(factor) for side, factor in peak_factors(run.manifest, run.tests).items()}


def _seen_peaks(force: Array, spans: Sequence[tuple[int, int]], peaks: Peaks) -> dict[str, Array]:
    """Peaks of forces (n, T) that a load cell would see in each span, (n, spans), by direction."""
    rng, shape = np.random.default_rng(0), (len(force), len(spans))
    seen: dict[str, Array] = {}
    for side, sign in _SIGNS.items():
        largest = np.transpose([np.max(sign * force[:, a:b], axis=1) for a, b in spans])
        seen[f"peak_{side}"] = largest.reshape(shape) * peaks[side].draw(rng, *shape)
    return seen


def properties_of(
    trace: Trace, force: Array, peaks: Peaks = NO_FACTOR, *, smooth: Array | None = None
) -> dict[str, Array]:
    """Properties under a motion of forces (n, T), kip, by name, (n,) each, in `UNITS`.

    Peaks are those that a load cell would see: `peaks` times those of the forces without noise,
    `smooth`, by default the same forces.
    """
    loops, values = find_loops(trace), cycle_values(trace, force)
    full = loops.strong
    properties = {name: mean_of(values[name], full) for name in _OF_CYCLES}
    properties["energy_per_cycle"] = mean_of(values["energy"], full)
    properties["energy_of_ramps"] = mean_of(values["energy"], ~full)
    properties["energy_in_all"] = np.asarray(np.trapezoid(force, trace.displacement, axis=1))
    ends = [0, *loops.bounds[loops.bounds > 0].tolist(), trace.samples]
    spans = [(a, b) for a, b in pairwise(ends) if b > a]
    seen = _seen_peaks(force if smooth is None else smooth, spans, peaks)
    return properties | {name: values.max(axis=1) for name, values in seen.items()}


def cycles_of(
    trace: Trace, force: Array, peaks: Peaks = NO_FACTOR, *, smooth: Array | None = None
) -> dict[str, Array]:
    """Values of each full cycle at full stroke, (n, L) each, by name, as `properties_of`."""
    loops = find_loops(trace)
    values = {name: cycles[:, loops.strong] for name, cycles in cycle_values(trace, force).items()}
    pairs = zip(pairwise(loops.bounds.tolist()), loops.strong, strict=True)
    spans = [(a, b + 1) for (a, b), full in pairs if full]
    return values | _seen_peaks(force if smooth is None else smooth, spans, peaks)


def of_parameters(
    model: Model, values: Mapping[str, Array], level: float, settings: CampaignFile
) -> dict[str, Array]:
    """Width of the gap and, where the actuator's area is given, self-energizing factors, (n,)."""
    area = settings.area if settings.actuation_unit == "ksi" else None
    return derive_from_parameters(model, values, level, area)


def device_properties(run: Run, trace: Trace, band: Band, test: Band) -> dict[str, Array]:
    """Properties of a band's draws; `test` has the same motion without noise, for its peaks."""
    smooth = test.draws
    if band.kind == "observation" and "offset" in test.values:
        smooth = smooth + np.asarray(test.values["offset"])[:, None]
    drawn = properties_of(trace, band.draws, peaks_of(run), smooth=smooth)
    model, level = run.predictor.model, trace.reference_actuation
    return drawn | of_parameters(model, band.values, level, run.manifest.settings)


def predicted_rows(
    source: Run | ModelAverage,
    trace: Trace,
    band: Band,
    record: Record | None = None,
    after: str = "",
    given: Trace | None = None,
    device: str = "",
) -> Rows:
    """Properties of a prediction, with intervals of the band's probability.

    Those of a band of kind "observation" have offset and noise, as a measured record has them.

    Parameters
    ----------
    source : Run or ModelAverage
    trace, band : Trace and Band
        The motion with its actuation, and its prediction.
    record : Record, optional
        Whose measured values stand beside them.
    after : str
        Test that the motion follows without a reset.
    given : Trace, optional
        With the force of the part that was given.
    device : str
        That was predicted.
    """
    test = band
    if band.kind == "observation":
        window = band.given.window if band.given else None
        how: dict[str, Any] = {"given": window, "after": after, "draws": len(band.draws)}
        how |= {"device": device} if device else {}
        test = source.predict(given or trace, "new_test", band.probability, **how)
    if isinstance(source, ModelAverage):
        drawn = properties_of(trace, band.draws, peaks_of(source.runs[0]), smooth=test.draws)
    else:
        drawn = device_properties(source, trace, band, test)
    cycles = None if record is None else measured_cycles(record)
    measured = {} if cycles is None else measured_properties(cycles)
    first = source.runs[0] if isinstance(source, ModelAverage) else source
    drawn = kept(drawn, first.system.axes)
    return property_rows("", band.kind, trace, drawn, measured, band.probability)


def kept(properties: Mapping[str, Array], axes: Axes) -> dict[str, Array]:
    """Those of the properties that make sense for a model's motion and response."""
    return {name: values for name, values in properties.items() if axes.has(name)}


def property_rows(
    test: str,
    role: str,
    trace: Trace,
    drawn: Mapping[str, Array],
    measured: Mapping[str, float],
    probability: float = 0.95,
) -> Rows:
    """Rows of properties, in the order of `UNITS`, from draws (n,) by name.

    `role` is a test's, or the kind of a prediction.
    """
    full, tail = find_loops(trace).strong, 0.5 * (1.0 - probability)
    strong, ramps = int(np.count_nonzero(full)), int(np.count_nonzero(~full))
    rows = []
    for name, unit in UNITS.items():
        if name not in drawn or (name == "energy_of_ramps" and not ramps):
            continue
        note = ""
        if name in _MEANS:
            of_ramps = name == "energy_of_ramps"
            which, count = ("of smaller", ramps) if of_ramps else ("at full", strong)
            cycles = f"{count} full cycle{'' if count == 1 else 's'}"
            note = f"over {cycles} {which} stroke" if count else "the motion has no full cycle"
        value = measured.get(name, float("nan"))
        rows.append(
            {"test": test, "role": role, "name": name, "unit": unit}
            | spread_of(drawn[name], tail)
            | {"measured": value, "note": note, "missed": is_missed(drawn[name], value, name)}
        )
    return tuple(rows)


def is_missed(values: Array, measured: float, name: str) -> bool:
    """Whether a measured property is extreme among draws (n,), and beyond its tolerance."""
    tolerance, _ = TOLERANCES[TOLERANCE_OF.get(name, "energy")]
    finite = values[np.isfinite(values)]
    if not finite.size or not np.isfinite(measured):
        return False
    share = float(np.mean(finite > measured) + 0.5 * np.mean(finite == measured))
    beyond = abs(float(np.median(finite)) - measured) > tolerance * abs(measured)
    return beyond and not EXTREME <= share <= 1.0 - EXTREME


# --- for design

ANOTHER = "another_device"
"""Another device of the same make: known where the calibrated tests are of several devices."""

BASES: Mapping[str, str] = {
    "device": KIND_NAMES["device"],
    "new_test": KIND_NAMES["new_test"],
    ANOTHER: "another device of the same make",
    "observation": KIND_NAMES["observation"],
}
"""What bounds are about, in the order of tables; kinds of prediction but for `ANOTHER`."""

DESIGN_DRAWS = 1000
"""Draws of each basis: few would leave the bounds to chance."""

NOT_KNOWN = "not known: the calibrated tests are of one device"

DESIGN_PROPERTIES = (
    *("slip_fwd", "slip_bwd", "energy_per_cycle", "effective_stiffness", "effective_damping"),
    *("c_eq", "peak_fwd", "peak_bwd", "gap"),
)
NEW = "\x00another"  # a session or a device that no campaign can declare


def design_rows(run: Run, trace: Trace, probability: float = 0.95) -> Rows:
    """Mean and bounding properties under a motion and an actuation, by property, then by basis.

    "This device tested again" is a test of one of the calibrated devices in one of the declared
    sessions, "another device" a test of a new one, in a new session where there are several. With
    one device the latter is not known. The mean property has the mean of the factor between the
    model's peak and the measured one, the others its scatter too.
    """
    places, n, peaks = places_of(run), n_draws(run), peaks_of(run)

    def draw(kind: str, session: str, device: str, draws: int = n) -> Band:
        how: dict[str, Any] = {"session": session, "device": device, "draws": draws}
        return run.predict(trace, kind, probability, **how)

    bands = {kind: [draw(kind, *place) for place in places] for kind in KIND_NAMES if kind in BASES}
    if len(run.devices) > 1:
        session = NEW if len(sessions_of(run)) > 1 else sessions_of(run)[0]
        bands[ANOTHER] = [draw("new_test", session, NEW, DESIGN_DRAWS)]
    drawn = {}
    for basis, several in bands.items():
        parts = []
        for number, band in enumerate(several):
            smooth = band.draws
            if basis == "observation":
                test = bands["new_test"][number]
                smooth = test.draws + np.asarray(test.values["offset"])[:, None]
            factor = NO_FACTOR if basis == "device" else peaks
            parts.append(properties_of(trace, band.draws, factor, smooth=smooth))
        drawn[basis] = {
            name: np.concatenate([p[name] for p in parts]) for name in DESIGN_PROPERTIES
        }
    for side, factor_of in peaks.items():
        drawn["device"][f"peak_{side}"] *= factor_of.expected
    drawn = {basis: kept(of, run.manifest.axes) for basis, of in drawn.items()}
    return bounds_of(drawn, probability, f"from {len(run.devices)} devices")


def bounds_of(drawn: Mapping[str, Mapping[str, Array]], probability: float, note: str = "") -> Rows:
    """Bounds of draws (n,) by basis and property; "device" has the nominal values.

    A basis of `BASES` that is missing is not known, and its bounds are NaN. The `note` is of
    another device.
    """
    rows = []
    for name, mean in drawn["device"].items():
        if not np.any(np.isfinite(mean)):  # the motion has no full cycle
            continue
        for basis in BASES:
            values = drawn.get(basis, {}).get(name, np.empty(0))
            if basis in drawn and not np.any(np.isfinite(values)):
                continue
            about = note if basis == ANOTHER else ""
            rows.append(
                {"name": name, "unit": UNITS[name], "basis": basis, "of": BASES[basis]}
                | bounds(mean, values, probability)
                | {"note": about if basis in drawn else NOT_KNOWN}
            )
    return tuple(rows)


def bounds(mean: Array, drawn: Array, probability: float) -> dict[str, float]:
    """Nominal value, the mean of draws of any shape; equal-tailed bounds of others, and factors.

    `lambda_min` and `lambda_max` are the bounds over the nominal value. What is not finite is left
    out, and NaN where nothing remains.
    """
    mean, drawn = mean[np.isfinite(mean)], drawn[np.isfinite(drawn)]
    tail, nan = 0.5 * (1.0 - probability), float("nan")
    nominal = float(mean.mean()) if mean.size else nan
    lower, upper = np.quantile(drawn, [tail, 1.0 - tail]).tolist() if drawn.size else (nan, nan)
    factors = [bound / nominal if nominal else nan for bound in (lower, upper)]
    names = ("nominal", "lower", "upper", "lambda_min", "lambda_max")
    return dict(zip(names, (nominal, lower, upper, *factors), strict=True))


def design_warnings(run: Run) -> tuple[str, ...]:
    """Why bounds may be too narrow, in sentences."""
    settings = with_zeros([setting_of(test.trace) for test in run.tests.values()])
    count = len(levels_of(settings))
    if count >= LEVELS:
        return ()
    return (
        f"the calibrated tests have {count} level{'' if count == 1 else 's'} of actuation, and "
        f"fewer than {LEVELS} do not show how far levels lie from a law: bounds at an actuation "
        "that was not tested are too narrow",
    )


def n_draws(run: Run) -> int:
    """Draws of the bands behind the bounds, for each session and device.

    A band with as many, of one session and device, has the same draws as the bounds.
    """
    return DESIGN_DRAWS // len(places_of(run)) + 10


def places_of(run: Run) -> tuple[tuple[str, str], ...]:
    """Session and device of the calibrated tests, each pair once."""
    devices = run.manifest.settings.devices
    return tuple(dict.fromkeys((run.session(name), devices[name]) for name in run.tests))


def sessions_of(run: Run) -> tuple[str, ...]:
    """Sessions of the calibrated tests; "" where none are declared."""
    return tuple(dict.fromkeys(run.session(name) for name in run.tests))
