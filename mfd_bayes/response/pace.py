"""Where a history needs short steps: where the dampers' forces bend."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from mfd_bayes.response.building import Building
from mfd_bayes.response.devices import Dampers
from mfd_bayes.response.ground import Ground
from mfd_bayes.response.integration import integrate

PILOT = 6
"""Draws that are computed first with one step a sample, to see where forces bend."""

QUIET = (1 / 4, 1 / 16)
"""Bends, over the largest, below which a step may be twice and four times as long: the error of
a step grows with its square."""

AROUND = 5
"""Samples around an interval whose bends count: other draws bend a little earlier or later."""


def spare_halvings(building: Building, ground: Ground, dampers: Dampers) -> NDArray[np.intp]:
    """Halvings that each interval of a ground motion of T samples can do without, (T - 1,).

    The only error of a step is that forces are taken as linear in time within it. So the change of
    the forces' slope from sample to sample, in slip forces, tells where it is large. Storeys that
    yield are not seen by it: with them, nothing is spared.
    """
    none = np.zeros(ground.acceleration.size - 1, dtype=np.intp)
    if not dampers.count or np.isfinite(building.yields).any() or none.size < AROUND:
        return none
    some = dampers.chosen(np.arange(min(PILOT, dampers.draws)))
    forces = integrate(building, ground, some, 1, kept=some.draws).forces.astype(np.float64)
    bends = np.abs(np.diff(forces, n=2, axis=1) / some.slip[:, None]).max(axis=(0, 2))
    if not np.all(np.isfinite(bends)) or not bends.any():
        return none
    # a bend at sample k belongs to the intervals on both its sides
    bends = np.concatenate([bends[:1], bends])
    near = maximum_filter1d(bends, AROUND)
    return np.asarray(sum(near < share * bends.max() for share in QUIET), dtype=np.intp)
