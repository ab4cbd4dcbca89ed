"""How much the samples of a given part count: by their travel, as in the calibrated tests.

Records are fitted at a rate that resolves their motion. Neighbours are then as much correlated in
slow tests as in fast ones: what the model leaves over changes with the travel, not with time. So
samples count in proportion to the travel, and a device at rest shows its force once, however long
one looks at it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.residual import Residual
from mfd_bayes.population.setting import setting_of
from mfd_bayes.population.strokes import strokes_of
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

WINDOW = 64
"""Samples over which the travel is averaged, about a half-cycle of the tests."""

QUIET = 0.25
"""Share of the slip force below which a device is taken to be in its gap."""


SLIPS = 0.6
"""Share of the slip force above which a device is taken to slip."""

KNOWN = 0.99
"""Sum of the functions of travel below which the stroke before the turn was too short."""


@dataclass(frozen=True, eq=False)
class Pace:
    """Rates at which J tests were fitted, (J,) each.

    Attributes
    ----------
    steps : s
        Time between samples.
    speeds : in/s
        Peak speed.
    travels : in
        Mean travel between samples.
    """

    steps: Array
    speeds: Array
    travels: Array

    @classmethod
    def of(cls, traces: Iterable[Trace]) -> Pace:
        """That of calibrated tests."""
        found = [
            (
                float(np.median(np.diff(trace.time))),
                setting_of(trace).covariates["velocity"],
                float(np.mean(np.abs(np.diff(trace.displacement)))),
            )
            for trace in traces
        ]
        return cls(*np.transpose(found))

    def step(self, speed: float) -> float:
        """Time between samples, s, at which a motion of this peak speed, in/s, would be fitted."""
        travel = float(np.median(self.steps * self.speeds))
        usual = travel / speed if speed > 0 else np.inf
        return float(np.clip(usual, self.steps.min(), self.steps.max()))

    def share(self, trace: Trace, information: float, usual: float) -> Array:
        """Share of an independent sample that each sample of a trace counts for, (T,).

        Parameters
        ----------
        trace : Trace
        information : float
            Share of independent samples in the tests.
        usual : float, s
            Time between samples as the tests have it at such speeds.
        """
        step = np.diff(trace.time, prepend=2.0 * trace.time[0] - trace.time[1])
        path = np.cumsum(np.abs(np.diff(trace.displacement, prepend=trace.displacement[0])))
        before = np.maximum(np.arange(trace.samples) - WINDOW, 0)
        speed = (path - path[before]) / np.maximum(trace.time - trace.time[before], step)
        moving = np.minimum(speed * usual / self.travels.min(), 1.0)
        # neighbours that are `usual` apart are correlated by φ = (1 − i)/(1 + i)
        phi = ((1.0 - information) / (1.0 + information)) ** (step / usual)
        return np.asarray(moving * (1.0 - phi) / (1.0 + phi))


@dataclass(frozen=True, eq=False)
class Counted:
    """The counted samples of a given part, T of them.

    Attributes
    ----------
    functions : (T, K)
        Of the discrepancy.
    shape : (T,)
        g of the noise's standard deviation.
    share : (T,)
        Share of an independent sample.
    common : (T,)
        h, the share of the noise that a stroke has in common.
    strokes : (T,) int
        Number of the stroke.
    """

    functions: Array
    shape: Array
    share: Array
    common: Array
    strokes: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Counting:
    """How samples are counted.

    Attributes
    ----------
    residual : Residual
    pace : Pace
    usual : float, s
        Time between samples at this motion's speed, as the tests have it.
    slip_force : float, kip
        Expected of the test.
    """

    residual: Residual
    pace: Pace
    usual: float
    slip_force: float

    def counted(self, trace: Trace, inside: NDArray[np.bool_]) -> Counted:
        """The samples of a trace with a force that are inside (T,) a given part.

        Before a full stroke the tests say nothing of the noise by its travel. While the force is
        far below slip, the device is in its gap, and the noise is as even as it is there.
        """
        functions = self.residual.basis.values(trace)
        shape = np.exp(functions @ self.residual.log_shape)
        unknown = ~np.any(functions, axis=1)
        force = np.abs(np.asarray(trace.force)) / self.slip_force
        shape[unknown & (force < QUIET)] = min(float(np.exp(self.residual.log_shape.min())), 1.0)
        share = self.pace.share(trace, self.residual.information, self.usual)
        common = self._common(trace, functions.sum(axis=1) < KNOWN, force)
        strokes = strokes_of(trace)[inside]
        return Counted(functions[inside], shape[inside], share[inside], common[inside], strokes)

    def _common(self, trace: Trace, unknown: NDArray[np.bool_], force: Array) -> Array:
        """Share of the noise that strokes have in common, (T,).

        In strokes of which the travel says nothing, slip may begin sooner: there the force, over
        that of slip, tells whether the device slips or is in its gap.
        """
        common = self.residual.share(trace)
        common[unknown & (force > SLIPS)] = self.residual.levels.share.max()
        common[unknown & (force < QUIET)] = 0.0
        return common

    def first(self, counted: Counted) -> Counted:
        """The same where the first sample is the first of all: it counts once, also at rest."""
        share = counted.share.copy()
        share[0] = max(share[0], 1.0 - min(share[0] / self.residual.information, 1.0))
        return replace(counted, share=share)
