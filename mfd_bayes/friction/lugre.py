"""LuGre friction without a gap, to compare the three-stage model with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.friction.bristles import friction_of, slip_force
from mfd_bayes.friction.evaluation import check_start
from mfd_bayes.friction.paper import actuate, check_theta, quantities_of
from mfd_bayes.friction.quantity import Quantity
from mfd_bayes.friction.stepping import Damper, State, Stepped
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

_PARAMETERS = ("sigma0", "sigma1", "sigma2", "Fs_fwd", "Fc_fwd", "Fs_bwd", "Fc_bwd", "v_s")


@dataclass(frozen=True)
class LuGre(Stepped):
    """LuGre friction alone: the device without its gap (paper Eqs. 3 and 4)."""

    name: ClassVar[str] = "lugre"
    parameters: ClassVar[tuple[str, ...]] = _PARAMETERS
    quantities: ClassVar[tuple[Quantity, ...]] = quantities_of(_PARAMETERS)

    def force(
        self,
        theta: ArrayLike,
        trace: Trace,
        start: ArrayLike | None = None,
        *,
        scales: Mapping[str, Array] | None = None,
    ) -> Array:
        """Force of every parameter vector, (n, T), kip; see `Model.force`.

        theta holds this model's own parameters, (n, 8), or all of the paper's, (n, 14).
        """
        columns = check_theta(self, theta)
        if start is not None:
            check_start(start, columns["v_s"].shape[1])
        return slip_force(friction_of(actuate(columns, trace, scales)), trace.path)[0].T

    def start(
        self,
        theta: ArrayLike,
        start: ArrayLike | None = None,
        *,
        direction: int | None = None,
        reference_actuation: float | None = None,
    ) -> State:
        """State before the first sample of a motion; see `ThreeStage.start`."""
        columns = check_theta(self, theta)
        check_start(start, columns["v_s"].shape[1])
        friction = friction_of(columns)
        damper = Damper(friction, direction=direction, reference=reference_actuation)
        return State.at_rest(damper)
