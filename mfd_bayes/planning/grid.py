"""What a campaign has tested, as harmonic tests, and candidates from its range and beyond."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np

from mfd_bayes.calibration.cycles import count_cycles
from mfd_bayes.planning.candidate import Candidate
from mfd_bayes.population.settings import SAME_LEVEL, same_level, setting_of
from mfd_bayes.records.loops import find_loops
from mfd_bayes.records.trace import Trace

BEYOND = 1.25
"""How far candidates go beyond the largest tested actuation, amplitude and frequency."""

LEVELS, VALUES = 9, 3
"""Most actuations, and most amplitudes and frequencies, of candidates."""

RANGE = 5
"""Actuations over which the campaign's range is averaged."""

ALIKE = 0.1
"""A candidate within this share of a test's amplitude and frequency, at its level, repeats it."""


NEAR, NEW = 0.005, 0.02
"""Shares of its value by which a figure of a test that was made, or of a new one, is rounded."""


@dataclass(frozen=True)
class Shown:
    """Factors from internal units to those in which a campaign shows and rounds its tests."""

    actuation: float = 1.0
    length: float = 1.0


def tested_of(trace: Trace, shown: Shown = Shown()) -> Candidate:  # noqa: PT028
    """The harmonic test with the actuation, half stroke and frequency of a record.

    One of which most loops are not at full stroke has that of the same peak speed instead.
    """
    setting = setting_of(trace)
    amplitude = setting.covariates["amplitude"]
    loops = find_loops(trace)
    if 2 * np.count_nonzero(loops.strong) > loops.period.size:
        frequency = float(1.0 / np.median(loops.period[loops.strong]))
    else:  # an earthquake
        frequency = setting.covariates["velocity"] / (2.0 * np.pi * amplitude)
    cycles = float(np.clip(count_cycles(trace), 1, 100))
    return Candidate(
        setting.actuation, _round(frequency, NEAR), _round(amplitude, NEAR, shown.length), cycles
    )


def typical_of(tests: Sequence[Candidate]) -> list[Candidate]:
    """The campaign's range: `RANGE` actuations, each with the tests' median motion."""
    levels = [test.actuation for test in tests]
    low, high = min(levels), max(levels)
    many = RANGE if high > low * (1.0 + SAME_LEVEL) else 1
    middle = (float(np.median([getattr(t, n) for t in tests])) for n in _MOTION)
    frequency, amplitude, cycles = middle
    return [
        Candidate(float(level), frequency, amplitude, max(1.0, round(cycles)))
        for level in np.linspace(low, high, many)
    ]


_MOTION = ("frequency", "amplitude", "cycles")


def grid_of(tests: Sequence[Candidate], shown: Shown = Shown()) -> list[Candidate]:
    """Every test once more, and candidates from the campaign's range and a little beyond it."""
    cycles = typical_of(tests)[0].cycles
    levels = _levels([test.actuation for test in tests], shown.actuation)
    frequencies = _values([test.frequency for test in tests])
    amplitudes = _values([test.amplitude for test in tests], shown.length)
    new = [Candidate(*three, cycles) for three in product(levels, frequencies, amplitudes)]
    again: list[Candidate] = []
    for test in tests:
        if test.actuation > 0.0 and not repeats(test, again, NEW):
            again.append(replace(test, cycles=cycles))
    return [*again, *(c for c in new if not repeats(c, again))]


def repeats(candidate: Candidate, tests: Iterable[Candidate], within: float = ALIKE) -> bool:
    """Whether a candidate is like a test that was made."""
    return any(
        same_level(candidate.actuation, test.actuation)
        and candidate.waveform == test.waveform
        and abs(candidate.frequency / test.frequency - 1.0) <= within
        and abs(candidate.amplitude / test.amplitude - 1.0) <= within
        for test in tests
    )


def _levels(tested: Sequence[float], scale: float) -> list[float]:
    """Tested levels, one in the middle of each gap between them, and one beyond."""
    own: list[float] = []
    for level in sorted(tested):
        if not own or not same_level(level, own[-1]):
            own.append(level)
    most = (LEVELS - 1) // 2
    if len(own) > most:
        own = [own[k] for k in np.unique(np.linspace(0, len(own) - 1, most).round().astype(int))]
    between = [_round(0.5 * (a + b), NEW, scale) for a, b in pairwise(own)]
    below = [_round(own[0] / BEYOND, NEW, scale)] if len(own) == 1 else []
    return sorted({*own, *between, *below, _round(BEYOND * own[-1], NEW, scale)} - {0.0})


def _values(tested: Sequence[float], scale: float = 1.0) -> list[float]:
    """Smallest and largest tested value, and one beyond."""
    low, high = min(tested), max(tested)
    near = [low] if low > 0.9 * high else [low, high]
    return [*near, _round(BEYOND * high, NEW, scale)][:VALUES]


def _round(value: float, within: float, scale: float = 1.0) -> float:
    """A value to two digits in the unit of a scale, as it is set on a frame; else to three.

    Three where two are off by more than a share of the value.
    """
    own = scale * value
    short = float(f"{own:.2g}")
    return (short if abs(short - own) <= within * abs(own) else float(f"{own:.3g}")) / scale
