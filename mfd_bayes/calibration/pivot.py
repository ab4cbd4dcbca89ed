"""The coordinate of kinetic friction: friction at the usual speed of a record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.priors import Prior
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Pivot:
    """Friction at the record's usual speed, sampled in place of kinetic friction.

    A slow test tells F_s, a fast one F_c; F_c (1 + c e), with c the mean of exp(−(v/v_s)²)
    over the motion and e the excess of static friction, is what either knows best. The
    logarithms of both differ by log(1 + c e), which depends on e alone: the Jacobian is 1.

    Attributes
    ----------
    kinetic, excess : int
        Columns of q.
    share : float
        c.
    prior : Prior
        Of the excess.
    """

    kinetic: int
    excess: int
    share: float
    prior: Prior

    def shift(self, points: Array) -> Array:
        """Difference between the sampled coordinate and log F_c, log(1 + c e), (n,)."""
        shift: Array = np.log1p(self.share * self.prior.value(points[:, self.excess]))
        return shift


def find_pivots(
    trace: Trace, names: tuple[str, ...], priors: Mapping[str, Prior]
) -> tuple[Pivot, ...]:
    """Pivots of the directions in which F_c, on its log scale, and its excess are sampled."""
    if "v_s" not in priors:
        return ()
    velocity = trace.velocity
    moving = np.abs(velocity) > 0.01 * np.max(np.abs(velocity))
    stribeck = np.exp(-((velocity / priors["v_s"].typical) ** 2))
    pivots = []
    for side, there in (("fwd", velocity > 0), ("bwd", velocity < 0)):
        kinetic, excess = f"Fc_{side}", f"static_excess_{side}"
        if not (kinetic in names and excess in names and np.any(moving & there)):
            continue
        if priors[kinetic].on_half_line:
            share = float(np.mean(stribeck[moving & there]))
            at = names.index(kinetic), names.index(excess)
            pivots.append(Pivot(*at, share, priors[excess]))
    return tuple(pivots)
