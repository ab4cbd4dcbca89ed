"""Materials of OpenSees that come closest to the loops of a device."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mfd_bayes.friction.bouc_wen import BoucWen
from mfd_bayes.friction.model import Model
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

SAMPLES = 400
CYCLES = (0.25, 0.5, 1.0, 1.0)
"""Amplitudes of the cycles to which materials are fitted, over the largest."""

PERIOD = 4.0  # of a cycle, s


@dataclass(frozen=True, eq=False)
class Equivalent:
    """A material fitted to n draws.

    Attributes
    ----------
    commands : tuple of str
        Lines for OpenSees, one of each draw.
    misfit : (n,)
        Root mean square of the difference over that of the predicted force.
    """

    commands: tuple[str, ...]
    misfit: Array


def equivalents(
    model: Model, theta: Array, start: Array, amplitude: float
) -> dict[str, Equivalent]:
    """BoucWen and ElasticPP of OpenSees, fitted to the loops of each draw (n, p) by least squares.

    The motion is four cycles of growing amplitude, up to this one, in.
    """
    time = np.linspace(0.0, PERIOD * len(CYCLES), SAMPLES + 1)
    cycle = np.minimum((time / PERIOD).astype(int), len(CYCLES) - 1)
    x = amplitude * np.array(CYCLES)[cycle] * np.sin(2.0 * np.pi / PERIOD * time)
    trace = Trace.from_arrays(time, x)
    force = model.force(theta, trace, start) if model.has_gap else model.force(theta, trace)
    found = {}
    for name, fit in (("BoucWen", _bouc_wen), ("ElasticPP", _elastic_plastic)):
        commands, misfit = [], []
        for tag, own in enumerate(force, start=1):
            slip = float(np.quantile(np.abs(own), 0.8))
            stiffness = slip / (0.1 * float(np.ptp(x)))
            command, fitted = fit(tag, trace, own, np.log([stiffness, slip]))
            commands.append(command)
            misfit.append(np.sqrt(np.mean((fitted - own) ** 2) / np.mean(own**2)))
        found[name] = Equivalent(tuple(commands), np.array(misfit))
    return found


def _bouc_wen(tag: int, trace: Trace, force: Array, begin: Array) -> tuple[str, Array]:
    """BoucWen: F = α k x + (1 − α) k z, ż = ẋ [A − (γ + β sgn(ẋ z)) |z|ⁿ] with A = 1."""
    model = BoucWen()

    def unpacked(q: Array) -> Array:
        """Stiffness, α, slip force, share of β, exponent."""
        return np.array([np.exp(q[0]), q[3], np.exp(q[1]), 0.5 + 0.5 * q[4], 1.0 + np.exp(q[2])])

    def fitted(q: Array) -> Array:
        k, alpha, slip, beta, power = unpacked(q)
        row = np.array([[k, alpha, slip, slip, beta, power, 0.0]])
        return np.asarray(model.force(row, trace)[0])

    bounds = ([-20, -20, -6, 0.0, 0.0], [20, 20, 2.5, 0.9, 1.0])
    first = np.array([*begin, 0.0, 0.01, 0.2])

    def off(q: Array) -> Array:
        return np.asarray(fitted(q) - force)

    q = least_squares(off, first, bounds=bounds, max_nfev=40).x
    k, alpha, slip, beta, power = unpacked(q)
    scale = (k / slip) ** power  # our z is a force, in slip forces; theirs is a displacement
    line = (
        f"uniaxialMaterial BoucWen {tag} {alpha:.6g} {k:.6g} {power:.6g} "
        f"{(1.0 - beta) * scale:.6g} {beta * scale:.6g} 1.0 0.0 0.0 0.0"
    )
    return line, fitted(q)


def _elastic_plastic(tag: int, trace: Trace, force: Array, begin: Array) -> tuple[str, Array]:
    """ElasticPP: elastic until it slips."""

    def fitted(q: Array) -> Array:
        k, slip = np.exp(q)
        spring, found, before = 0.0, [], 0.0
        for x in trace.displacement.tolist():
            spring = min(max(spring + k * (x - before), -slip), slip)
            before = x
            found.append(spring)
        return np.array(found)

    def off(q: Array) -> Array:
        return np.asarray(fitted(q) - force)

    q = least_squares(off, begin, max_nfev=30).x
    k, slip = np.exp(q)
    return f"uniaxialMaterial ElasticPP {tag} {k:.6g} {slip / k:.6g}", fitted(q)
