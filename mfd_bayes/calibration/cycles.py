"""Derived quantities for design, from draws of a damper's force (model.md section 7).

The force is the damper's own: without the load cell's offset, and without noise.

A **full cycle** runs from one turn of the whole motion (`Trace.cycle_turns`) to the second one
after it. Cycles follow each other from the first turn; the motion before it and after the last
full cycle is left out.
Where the amplitude changes, a cycle does not close exactly; the next one starts where it ends.
Cycles **at full stroke** have at least `STRONG` of the largest amplitude; the energy of a cycle is
their mean, here as in every table, check and inspection. The others ramp in or out, or are the
small ones of an earthquake, and have a mean of their own. A record with fewer than three turning
points has no full cycle, and its cycle quantities are NaN; the energy in all it always has.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.friction.model import Model
from mfd_bayes.records.loops import STRONG
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]


def derive_from_parameters(
    model: Model,
    values: Mapping[str, Array],
    pressure: float = float("nan"),
    area: float | None = None,
) -> dict[str, Array]:
    """Gap width, in, and self-energizing factors C = F_c/(p A) by name, (n,) each.

    Those that are unknown, as without a pressure (ksi) or an area of the actuator (in²), are left
    out.
    """
    width = model.gap_width(values)
    derived = {} if width is None else {"gap_width": width}
    if area is not None and pressure > 0.0:
        thrust = pressure * area
        sides = zip(("C_fwd", "C_bwd"), model.slip_forces, strict=False)
        derived |= {name: values[force] / thrust for name, force in sides}
    return derived


def cycle_energies(force: ArrayLike, trace: Trace, *, first: int = 0) -> Array:
    """Energy dissipated in each of the L full cycles, E = ∮ F dx, (n, L), kip·in.

    By the trapezoidal rule between the samples of `trace`, to which force, (n, T), belongs.
    """
    draws, bounds = _of_motion(force, trace), _bounds(trace, first)
    if bounds.size < 2:
        return np.empty((len(draws), 0))
    draws = draws[:, bounds[0] : bounds[-1] + 1]
    steps = np.diff(trace.displacement[bounds[0] : bounds[-1] + 1])
    work = 0.5 * (draws[:, 1:] + draws[:, :-1]) * steps
    return np.add.reduceat(work, bounds[:-1] - bounds[0], axis=1)


def total_energy(force: ArrayLike, trace: Trace, *, first: int = 0) -> Array:
    """Energy dissipated from sample `first` to the end, ∫ F dx, (n,), kip·in."""
    draws = _of_motion(force, trace)
    return np.asarray(np.trapezoid(draws[:, first:], trace.displacement[first:], axis=1))


def full_strokes(trace: Trace, *, first: int = 0) -> NDArray[np.bool_]:
    """Whether each of the full cycles from sample `first` on is at full stroke, (L,)."""
    bounds = _bounds(trace, first)
    if bounds.size < 2:
        return np.empty(0, dtype=bool)
    x, begins = trace.displacement[bounds[0] : bounds[-1] + 1], bounds[:-1] - bounds[0]
    stroke = np.maximum.reduceat(x, begins) - np.minimum.reduceat(x, begins)
    return np.asarray(stroke >= STRONG * stroke.max())


def count_cycles(trace: Trace, *, first: int = 0) -> int:
    """Number of full cycles L from sample `first` on."""
    return max(_bounds(trace, first).size - 1, 0)


def _bounds(trace: Trace, first: int) -> NDArray[np.intp]:
    """Samples at which full cycles begin, and at which the last ends, (L + 1,)."""
    turns = trace.cycle_turns
    return turns[turns >= first][::2]


def _of_motion(force: ArrayLike, trace: Trace) -> Array:
    draws = np.asarray(force, dtype=np.float64)
    if draws.ndim != 2 or draws.shape[1] != trace.samples:
        raise FitError(f"force must have shape (n, {trace.samples}), got {draws.shape}")
    return draws
