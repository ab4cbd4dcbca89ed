"""How well the gains of the instruments are known, and what that makes of a property.

An instrument reads the true value over its gain g, which its calibration knows to a standard
uncertainty u (JCGM 100:2008, 4.3):

    ln g ~ N(0, u²), one draw for each instrument

All tests that were measured by it share the deviation, so the tests cannot show it: neither their
scatter nor their number has a part in it. The run is calibrated in what the instruments read, and
a property of the unit kip^a in^b is the device's when it is multiplied by

    g_force^a g_displacement^b

An arm is an instrument too: travel is the angle times the arm, and force the torque over it. With
several instruments the calibrated device has the geometric mean of their gains, weighted by the
numbers of calibrated tests, as the laws are means of logarithms. The motion of a prediction is one
as the tests' instruments read it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration.priors import MEASURED
from mfd_bayes.campaign.schema import DisplacementColumn, Instrument
from mfd_bayes.records.cycles import PROPERTIES
from mfd_bayes.runs.run import Run
from mfd_bayes.units import force_and_length

Array = NDArray[np.float64]

_SEED = 100  # draws of gains are the same wherever there are as many of them
_UNITS = {
    **{name: p.unit for p in PROPERTIES.values() for name in (p.name, p.key)},
    "force": "kip",
    # a force over that of the actuator, which no load cell measured
    **dict.fromkeys(("C_fwd", "C_bwd"), "kip"),
}


@dataclass(frozen=True, eq=False)
class Gains:
    """Draws of the gains of a load cell and of a displacement transducer, (n,) each.

    Draw i is of the same instruments for every property. `None` is a gain of exactly 1.
    """

    force: Array | None = None
    displacement: Array | None = None

    @property
    def exact(self) -> bool:
        """Whether both gains are 1."""
        return self.force is None and self.displacement is None

    def factor(self, name: str) -> Array | float:
        """Factor of a property of that name, (n,), or 1."""
        if self.exact:
            return 1.0
        product: Array | float = 1.0
        gains = self.force, self.displacement
        for gain, power in zip(gains, force_and_length(_UNITS[name]), strict=True):
            product = product if gain is None else product * gain**power
        return product

    def applied(self, properties: Mapping[str, Array]) -> dict[str, Array]:
        """Properties (n, …) by name, times their factors."""
        if self.exact:
            return dict(properties)
        return {name: (values.T * self.factor(name)).T for name, values in properties.items()}


EXACT = Gains()
"""Instruments whose gains are known."""


def gains_of(run: Run, n: int) -> Gains:
    """Gains, n draws, of the instruments of a run's calibrated tests.

    Their uncertainties are those of the campaign, else of the prior file.
    """
    powers, defaults = _powers(run), run.priors.measurement
    stated = {i: u for _, i, u in run.manifest.settings.stated_uncertainties()}
    rng, logs = np.random.default_rng(_SEED), dict[str, Array]()
    for instrument in dict.fromkeys(i for by_instrument in powers.values() for i in by_instrument):
        uncertainty = stated.get(instrument, defaults.get(instrument.role, 0.0))
        if uncertainty > 0.0:
            scores = uncertainty * normal_scores(rng, n)
            for role in MEASURED:
                if power := powers[role][instrument]:
                    logs[role] = logs.get(role, 0.0) + power * scores
    return Gains(**{role: np.exp(log) for role, log in logs.items()})


def gains_of_another(run: Run, uncertainty: float, n: int) -> Gains:
    """Gains, n draws, of the tests' load cell over that of another, of a standard uncertainty.

    They take what the tests' load cell reads to what the other one reads. The transducer of the
    displacement is the same.
    """
    tests_gain = gains_of(run, n).force
    scores = normal_scores(np.random.default_rng([_SEED, 1]), n)
    force = np.exp(uncertainty * scores)
    return Gains(force if tests_gain is None else force * tests_gain)


def normal_scores(rng: np.random.Generator, n: int) -> Array:
    """Quantiles of the standard normal distribution in random order, (n,): their mean is 0."""
    return np.asarray(special.ndtri((rng.permutation(n) + 0.5) / n))


def _powers(run: Run) -> dict[str, defaultdict[Instrument, float]]:
    """Power of each instrument's gain in the mean gain of the tests, by role."""
    powers = {role: defaultdict[Instrument, float](float) for role in MEASURED}
    for name in run.tests:
        columns = run.manifest.settings.columns_of(run.manifest.settings.tests[name])
        for role, sign in zip(MEASURED, (-1.0, 1.0), strict=True):
            column = columns.get(role)
            arm = column.arm if isinstance(column, DisplacementColumn) else ""
            label = column.instrument if isinstance(column, DisplacementColumn) else ""
            powers[role][Instrument(role, label)] += 1.0 / len(run.tests)
            if arm:
                powers[role][Instrument("arm", arm)] += sign / len(run.tests)
    return powers
