"""Materials of OpenSees that come closest to the loops of a device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mfd_bayes.friction.banks import PlasticBank
from mfd_bayes.friction.bouc_wen import BoucWen
from mfd_bayes.friction.model import Model
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

SAMPLES = 400
CYCLES = (0.25, 0.5, 1.0, 1.0)
"""Amplitudes of the cycles to which materials are fitted, over the largest."""


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

    The motion is four cycles of growing amplitude at 0.25 Hz.
    """
    trace = cycles(amplitude)
    force = model.force(theta, trace, start) if model.has_gap else model.force(theta, trace)
    fits = {"BoucWen": _bouc_wen, "ElasticPP": _elastic_plastic}
    return {name: _each(fit, trace, force) for name, fit in fits.items()}


def cycles(amplitude: float) -> Trace:
    """Four cycles of growing amplitude, in."""
    time = np.linspace(0.0, 4.0 * len(CYCLES), SAMPLES + 1)
    envelope = np.array(CYCLES)[np.minimum((time / 4.0).astype(int), len(CYCLES) - 1)]
    x = amplitude * envelope * np.sin(0.5 * np.pi * time)
    return Trace.from_arrays(time, x)


def _each(
    fit: Callable[[int, Trace, Array], tuple[str, Array]], trace: Trace, force: Array
) -> Equivalent:
    commands, misfit = [], []
    for i, own in enumerate(force):
        command, found = fit(i + 1, trace, own)
        commands.append(command)
        misfit.append(np.sqrt(np.mean((found - own) ** 2) / np.mean(own**2)))
    return Equivalent(tuple(commands), np.array(misfit))


def _guess(trace: Trace, force: Array) -> tuple[float, float]:
    """Slip force, kip, and stiffness, kip/in, to begin with."""
    slip = float(np.quantile(np.abs(force), 0.8))
    return slip, slip / (0.1 * float(np.ptp(trace.displacement)))


def _bouc_wen(tag: int, trace: Trace, force: Array) -> tuple[str, Array]:
    """BoucWen: F = α k x + (1 − α) k z, ż = ẋ [A − (γ + β sgn(ẋ z)) |z|ⁿ] with A = 1."""
    slip, stiffness = _guess(trace, force)
    model = BoucWen()

    def predicted(q: Array) -> Array:
        k, fy, n = np.exp(q[:3])
        alpha, beta = q[3], 0.5 + 0.5 * q[4]
        row = np.array([[k, alpha, fy, fy, beta, 1.0 + n, 0.0]])
        return np.asarray(model.force(row, trace)[0])

    begin = np.array([np.log(stiffness), np.log(slip), 0.0, 0.01, 0.2])
    bounds = ([-20, -20, -6, 0.0, 0.0], [20, 20, 2.5, 0.9, 1.0])

    def off(q: Array) -> Array:
        return np.asarray(predicted(q) - force)

    found = least_squares(off, begin, bounds=bounds, max_nfev=40).x
    k, fy, n = np.exp(found[:3])
    alpha, beta, power = found[3], 0.5 + 0.5 * found[4], 1.0 + n
    # our z is a force and is compared with F_y; theirs is a displacement
    scale = (k / fy) ** power
    line = (
        f"uniaxialMaterial BoucWen {tag} {alpha:.6g} {k:.6g} {power:.6g} "
        f"{(1.0 - beta) * scale:.6g} {beta * scale:.6g} 1.0 0.0 0.0 0.0"
    )
    return line, predicted(found)


def _elastic_plastic(tag: int, trace: Trace, force: Array) -> tuple[str, Array]:
    """ElasticPP: elastic until it slips."""
    slip, stiffness = _guess(trace, force)

    def predicted(q: Array) -> Array:
        k, fy = np.exp(q)
        bank = PlasticBank.at_rest(np.array([k]), np.array([fy]))
        forces = []
        for x in trace.displacement:
            bank = bank.step(np.array([x]), np.zeros(1), 1.0)
            forces.append(float(bank.force[0]))
        return np.array(forces)

    begin = np.log([stiffness, slip])

    def off(q: Array) -> Array:
        return np.asarray(predicted(q) - force)

    found = least_squares(off, begin, max_nfev=30).x
    k, fy = np.exp(found)
    return f"uniaxialMaterial ElasticPP {tag} {k:.6g} {fy / k:.6g}", predicted(found)
