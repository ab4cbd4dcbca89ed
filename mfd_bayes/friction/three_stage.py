"""The three-stage model: slip, stick and build-up, joined by smooth transitions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.friction.gap import Crossing, Gap, blend, fade, follow
from mfd_bayes.friction.lugre import Friction, slip_force
from mfd_bayes.friction.model import UNITS, actuate, check_theta
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

SATURATED = 40.0
"""Transition lengths after which a transition is complete: exp(−40) is below double precision."""

CHUNK = 96
"""Parameter vectors that are worked on together, so that a record's arrays stay in the cache."""


@dataclass(frozen=True)
class ThreeStage:
    """Friction damper with a gap (Cao et al., Eqs. 1 to 4; model.md sections 2 to 4)."""

    name: str = "three_stage"
    parameters: tuple[str, ...] = tuple(UNITS)
    has_gap: bool = True

    def force(
        self,
        theta: ArrayLike,
        trace: Trace,
        start: ArrayLike | None = None,
        *,
        scales: Mapping[str, Array] | None = None,
    ) -> Array:
        """Force of every parameter vector.

        Parameters
        ----------
        theta : (n, 14)
            Columns as in `parameters`, in internal units.
        trace : Trace
        start : (n,) or scalar, 1, optional
            Travel in the gap at the first sample over the gap's width; ½ when left out.
        scales : mapping of (n, T) or (1, T), optional
            Factors along the record of the parameters that follow the actuation; by default
            friction in proportion to a varying actuation.

        Returns
        -------
        (n, T), kip

        Raises
        ------
        FitError
            When theta does not fit or holds values that no damper has.
        """
        columns = check_theta(self, theta)
        n = columns["k2"].shape[1]
        w0 = _check_start(start, n)
        columns = actuate(columns, trace, scales)
        force = np.empty((trace.samples, n))
        parts = -(-n // CHUNK)
        for i in range(parts):
            part = slice(i * n // parts, (i + 1) * n // parts)
            chunk = {name: np.broadcast_to(c, (len(c), n))[:, part] for name, c in columns.items()}
            force[:, part] = _force(chunk, trace, w0[part])
        return force.T


def _check_start(start: ArrayLike | None, n: int) -> Array:
    w0 = np.full(n, 0.5) if start is None else np.asarray(start, dtype=np.float64)
    if w0.shape not in ((), (n,)) or not np.all((w0 >= 0) & (w0 <= 1)):
        raise FitError(f"start must be a fraction of the gap in [0, 1] with shape ({n},)")
    return np.broadcast_to(w0, (n,))


def _force(columns: dict[str, Array], trace: Trace, start: Array) -> Array:
    """Force with time first, (T, n), kip."""
    path = trace.path
    slip = slip_force(Friction(**{f.name: columns[f.name] for f in fields(Friction)}), path)
    k2, k3, d2, d3 = (columns[name][0] for name in ("k2", "k3", "d2", "d3"))
    gap = Gap(k2, k3, d2, d3, (columns["gamma2"] / columns["gamma1"])[0])
    crossing = follow(gap, path, start, lambda sample: slip[sample])
    stretch = np.zeros(path.time.size, dtype=np.intp)
    stretch[path.turning_points + 1] = 1  # a turning point ends its stretch
    np.cumsum(stretch, out=stretch)
    near = np.flatnonzero(_crossing(gap, crossing, path.displacement, stretch))
    stretch = stretch[near]
    side = crossing.side[stretch]
    u = side * path.displacement[near, None]
    u += crossing.offset[stretch]
    force = blend(gap, u, side, slip[near])
    carry = crossing.carry[stretch]
    carry *= fade(gap, u)
    force += carry
    slip[near] = force
    return slip[path.samples]


def _crossing(
    gap: Gap, crossing: Crossing, displacement: Array, stretch: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Samples at which a transition of any vector is not yet 0 or 1 to double precision, (P,).

    Elsewhere the force is F1: the carried force has faded, and the gap is crossed.
    """
    margin = SATURATED * gap.transition
    ends = np.stack([-margin, gap.width + margin])[:, None]  # of the travel u
    at = (ends - crossing.offset) * crossing.side  # of the displacement, (2, K + 1, n)
    low, high = at.min(axis=(0, 2)), at.max(axis=(0, 2))
    inside: NDArray[np.bool_] = (displacement >= low[stretch]) & (displacement <= high[stretch])
    return inside
