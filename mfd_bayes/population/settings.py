"""The conditions of a test, and the kinds of bands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.records.inputs import real_number
from mfd_bayes.records.trace import Trace, check_trace

Array = NDArray[np.float64]

THIS_TEST = "this_test"  # one calibrated test by itself: what is known of its own parameters
# what each kind of band is about, in the words of design: the law with its level's effect; plus
# test-to-test scatter; plus a record's offset and noise
KIND_NAMES: Mapping[str, str] = MappingProxyType(
    {
        "device": "mean property",
        "new_test": "this device tested again",
        "observation": "a measurement of it",
        THIS_TEST: "this very test",
    }
)
KINDS = tuple(KIND_NAMES)

SAME_LEVEL = 0.01  # tests whose actuation differs by less than this share are at one level
ZERO = 1e-3  # share of the largest actuation below which one is zero: what an idle gauge shows
# what a test may say of the state of its device: decimal years, number of cycles, °C
CONDITIONS = ("date", "cycles", "temperature")
FULL = 0.8  # share of the largest stroke from which one is a full stroke


@dataclass(frozen=True)
class Setting:
    """Conditions of a test."""

    actuation: float  # ksi or kip
    session: str = ""  # tests of one session were made together; "" where none is declared
    # velocity (in/s, its peak; if timed), amplitude (in, half the stroke), full_strokes (share of
    # the path that lies in full strokes: 1 for a sine, 0.2 for an earthquake), and `CONDITIONS`
    covariates: Mapping[str, float] = field(default_factory=dict)
    device: str = ""


def setting_of(
    trace: Trace,
    session: str = "",
    device: str = "",
    conditions: Mapping[str, float] | None = None,
) -> Setting:
    """Setting under which a trace was made, or is to be predicted."""
    check_trace("trace", trace, FitError)
    if not np.isfinite(trace.reference_actuation):
        raise FitError("a prediction needs the trace's actuation, in ksi (pressure) or kip (force)")
    x = trace.displacement
    strokes = np.abs(np.diff(x[np.unique([0, *trace.turning_points, trace.samples - 1])]))
    full = strokes[strokes >= FULL * strokes.max(initial=0.0)].sum()
    speed = {"velocity": float(np.quantile(np.abs(trace.velocity), 0.98))} if trace.timed else {}
    covariates = speed | {
        "amplitude": 0.5 * float(np.ptp(x)),
        "full_strokes": float(full / max(strokes.sum(), 1e-300)),
    }
    covariates |= conditions or {}
    return Setting(trace.reference_actuation, session, covariates, device)


def planned_setting(
    tested: Sequence[Setting],
    actuation: float,
    session: str,
    planned: Mapping[str, float | None],
) -> Setting:
    """Setting of a test before it is made."""
    units = {"velocity": "in/s", "amplitude": "in"}
    level = real_number("the planned actuation", actuation, FitError, (0.0, np.inf))
    covariates = {}
    for name, value in planned.items():
        if value is None:
            found = [s.covariates[name] for s in tested if s.covariates.get(name, 0.0) > 0.0]
            covariates[name] = geometric_mean(found) if found else 1.0
        else:
            what = f"the planned {name} ({units.get(name, '1')})"
            covariates[name] = real_number(what, value, FitError, (0.0, np.inf), inside=True)
    return Setting(level, session, covariates)


def same_level(actuation: float, other: float) -> bool:
    """Whether two actuations are at one level."""
    return abs(actuation - other) <= SAME_LEVEL * max(actuation, other)


def levels_of(settings: Sequence[Setting]) -> list[list[int]]:
    """Indices of the tests at each level of actuation, lowest level first."""
    levels: list[list[int]] = []
    for j in np.argsort([setting.actuation for setting in settings]).tolist():
        if levels and same_level(settings[levels[-1][0]].actuation, settings[j].actuation):
            levels[-1].append(j)
        else:
            levels.append([j])
    return levels


def with_zeros(settings: Sequence[Setting]) -> tuple[Setting, ...]:
    """The settings with an actuation of zero where it is next to nothing."""
    actuation = np.array([setting.actuation for setting in settings])
    if not (np.all(actuation >= 0) and np.max(actuation) > 0):
        raise FitError(
            "the laws need an actuation above zero in at least one calibrated test, and none that "
            "is negative"
        )
    zero = actuation < ZERO * actuation.max()
    return tuple(replace(s, actuation=0.0) if z else s for s, z in zip(settings, zero, strict=True))


def varies(settings: Sequence[Setting], covariate: str) -> bool:
    """Whether a covariate varies between settings by more than a fifth."""
    values = [setting.covariates.get(covariate, 0.0) for setting in settings]
    return min(values) > 0.0 and max(values) > 1.2 * min(values)


def geometric_mean(values: Sequence[float]) -> float:
    """Geometric mean of numbers above zero."""
    return float(np.exp(np.mean(np.log(values))))


def folds_beyond(setting: Setting, tested: Sequence[Setting]) -> tuple[float, float]:
    """E-folds by which the stroke, and speed or frequency, lie outside those of the tests.

    Of speed and frequency the one that lies farther outside counts.
    """

    def logs(s: Setting) -> Array:
        stroke, speed = (np.log(s.covariates.get(n) or np.nan) for n in ("amplitude", "velocity"))
        return np.array([stroke, speed, speed - stroke])

    tests = np.array([logs(s) for s in tested])
    timed = "velocity" in setting.covariates and bool(np.any(np.isfinite(tests[:, 1])))
    kept = slice(None) if timed else slice(1)
    tests = tests[np.all(np.isfinite(tests[:, kept]), axis=1)]
    here = logs(setting)
    if not len(tests) or not np.all(np.isfinite(here[kept])):
        return 0.0, 0.0
    outside = np.maximum(np.maximum(here - tests.max(axis=0), tests.min(axis=0) - here), 0.0)
    if not timed:
        return float(outside[0]), 0.0
    return float(outside[0]), float(outside[1:].max())
