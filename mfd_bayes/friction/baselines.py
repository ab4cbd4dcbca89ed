"""Models to compare the three-stage model with, behind the same `force(theta, trace)`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.friction.lugre import Friction, slip_force
from mfd_bayes.friction.model import actuate, check_theta
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LuGre:
    """LuGre friction alone: the device without its gap (paper Eqs. 3 and 4)."""

    name: str = "lugre"
    parameters: tuple[str, ...] = (
        "sigma0",
        "sigma1",
        "sigma2",
        "Fs_fwd",
        "Fc_fwd",
        "Fs_bwd",
        "Fc_bwd",
        "v_s",
    )
    has_gap: bool = False

    def force(
        self,
        theta: ArrayLike,
        trace: Trace,
        start: ArrayLike | None = None,
        *,
        scales: Mapping[str, Array] | None = None,
    ) -> Array:
        """Force of every parameter vector, (n, T), kip; see `ThreeStage.force`.

        theta holds this model's own parameters, (n, 8), or all of the paper's, (n, 14).
        """
        columns = actuate(check_theta(self, theta), trace, scales)
        friction = Friction(**{f.name: columns[f.name] for f in fields(Friction)})
        return slip_force(friction, trace.path)[trace.path.samples].T
