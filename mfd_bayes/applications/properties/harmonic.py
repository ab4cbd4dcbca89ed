"""The harmonic tests of a run: their conditions, and what their cycles measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import CampaignError
from mfd_bayes.evaluation.properties import measured_of
from mfd_bayes.population.design import same_level
from mfd_bayes.records.cycles import DeviceProperty, MeasuredCycles
from mfd_bayes.records.loops import cycles_made
from mfd_bayes.records.record import NO_ACTUATION
from mfd_bayes.records.trace import Trace, parse_sine
from mfd_bayes.runs.run import Run
from mfd_bayes.units import DAMPER, Axes, actuation_kind, parse_actuation

Array = NDArray[np.float64]

CYCLES = 3  # cycles at a displacement of which a nominal value is the mean
HARMONIC = 0.2  # least share of the cycles at full stroke, by which a test counts as harmonic
SAME = 0.05  # amplitudes and frequencies that differ by less than this share are the same


class Condition(NamedTuple):
    """An actuation, ksi or kip, an amplitude, in, and a frequency, Hz, of harmonic motion."""

    actuation: float
    stroke: float
    frequency: float

    @property
    def speed(self) -> float:
        """Largest speed of a sine, in/s."""
        return 2.0 * np.pi * self.frequency * self.stroke


@dataclass(frozen=True, eq=False)
class HarmonicTest:
    """A test of harmonic motion, with the measured values of its cycles."""

    name: str
    condition: Condition
    cycles: MeasuredCycles
    trace: Trace | None = None
    device: str = ""
    session: str = ""
    temperature: float = float("nan")  # °C
    made: float = 0.0  # number of cycles that were made, as `cycles_made` counts them

    def values(self, item: DeviceProperty) -> Array:
        """Measured values of the cycles at full stroke, (L,)."""
        return np.asarray(self.cycles.values[item.key][self.cycles.full_stroke])

    def nominal(self, item: DeviceProperty) -> float:
        """Mean of the first `CYCLES` cycles at full stroke; NaN where one is not seen."""
        return float(self.values(item)[:CYCLES].mean()) if self.count else float("nan")

    @property
    def count(self) -> int:
        """Number of cycles at full stroke."""
        return int(np.count_nonzero(self.cycles.full_stroke))


def same(value: float, other: float) -> bool:
    """Whether two amplitudes or frequencies are the same."""
    return abs(value - other) <= SAME * max(abs(value), abs(other))


def levels_of(tests: Sequence[HarmonicTest]) -> list[float]:
    """Levels of actuation of tests, ksi or kip, the smallest first."""
    levels: list[float] = []
    for level in sorted(test.condition.actuation for test in tests):
        if not levels or not same_level(level, levels[-1]):
            levels.append(level)
    return levels


def parse_condition(text: str, actuation_unit: str, axes: Axes = DAMPER) -> Condition:
    """Condition of a text such as "35 lbf, 1 in, 0.5 Hz": actuation, amplitude, frequency."""
    if not axes.actuated:
        text = f"{NO_ACTUATION}, {text}"
    level, _, motion = text.partition(",")
    if text.count(",") != (2 if axes.timed else 1):
        raise CampaignError(f"a condition reads '35 lbf, 1 in, 0.5 Hz', got {text!r}")
    actuation, unit = parse_actuation(level.strip(), of=f"the actuation of {text!r}")
    if unit != actuation_unit:
        raise CampaignError(
            f"the actuation of {text!r} must be {actuation_kind(actuation_unit)}, as in the tests"
        )
    harmonic = parse_sine(f"{motion}, {CYCLES} cycles", axes)
    return Condition(actuation, harmonic.amplitude, harmonic.frequency)


def condition_words(run: Run, condition: Condition) -> str:
    """A condition in the units of the run: "35 lbf, 1 in, 0.5 Hz"."""
    words, axes = run.system.words, run.system.axes
    fields = [words([condition.stroke], "in", 3)]
    if axes.actuated:
        fields.insert(0, words([condition.actuation], run.actuation_unit, actuation=True))
    if axes.timed and np.isfinite(condition.frequency):
        fields.append(f"{condition.frequency:.3g} Hz")
    return ", ".join(fields)


def harmonic_tests(run: Run) -> list[HarmonicTest]:
    """Every harmonic test of a run, also those held out."""
    traces: Mapping[str, Trace] = {name: test.trace for name, test in run.tests.items()} | dict(
        run.held_out
    )
    settings, tests = run.manifest.settings, []
    for name in run.manifest.tests:
        if name not in traces:
            continue
        cycles = measured_of(run.manifest, name)
        timed, factor = run.system.axes.timed, run.system.factor("in")
        condition = condition_of(cycles, traces[name].reference_actuation, factor, timed=timed)
        if condition is not None:
            temperature = settings.conditions[name].get("temperature", float("nan"))
            place = settings.devices[name], run.session(name), temperature
            made = cycles_made(traces[name])
            tests.append(HarmonicTest(name, condition, cycles, traces[name], *place, made))
    return tests


def condition_of(
    cycles: MeasuredCycles, actuation: float, length: float = 1.0, *, timed: bool = True
) -> Condition | None:
    """Condition of a test's cycles; None if they are not harmonic.

    The amplitude is rounded in a unit of which an inch has `length`; without time the frequency
    is 1.
    """
    full = cycles.full_stroke
    if not (full.size and full.mean() >= HARMONIC):
        return None
    amplitude = 0.5 * float(np.median(cycles.stroke[full]))
    frequency = float(np.median(cycles.frequency[full])) if timed else 1.0
    return Condition(actuation, _rounded(amplitude * length) / length, _rounded(frequency))


def _rounded(value: float) -> float:
    """A value with two digits where they are right within 2 %, else with three."""
    two = float(f"{value:.2g}")
    return two if abs(value - two) <= 0.02 * value else float(f"{value:.3g}")
