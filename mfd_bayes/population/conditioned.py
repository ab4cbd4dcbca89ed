"""How a prediction knows a first part of its record, in figures and in words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FEW_MOVES = 0.02
"""Share of accepted steps below which the sampler has hardly moved."""


@dataclass(frozen=True)
class Conditioned:
    """The given part of a record, and how the population's draws took it in.

    Attributes
    ----------
    window : (float, float), s
    samples : int
        At the rate of the calibrated tests.
    pareto_k : float
        Of the importance weights of the population's draws.
    method : {"weights", "sampling"}
        By importance weights, or, where they cannot be trusted, by sampling.
    effective : float
        Effective number of draws behind the band.
    powers : int
        Steps in which the sampler let the likelihood in; 0 for weights.
    accepted : float
        Share of its last steps that were accepted; 1 for weights.
    """

    window: tuple[float, float]
    samples: int
    pareto_k: float
    method: str
    effective: float
    powers: int = 0
    accepted: float = 1.0

    def holds(self, time: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether times (T,), s, are in the given part."""
        return (time >= self.window[0]) & (time <= self.window[1])

    @property
    def sentence(self) -> str:
        """What was given, and how it was used, for the source of a band."""
        begin, end = self.window
        text = f"the force given from {begin:.4g} s to {end:.4g} s"
        if self.method == "weights":
            return f"{text} (importance weights, Pareto k {self.pareto_k:.2f})"
        return f"{text} (sampled in {self.powers} steps, since Pareto k was {self.pareto_k:.2f})"

    @property
    def remarks(self) -> tuple[str, ...]:
        """Reason to trust the band less, if there is one."""
        if self.accepted >= FEW_MOVES:
            return ()
        return (
            f"the sampler of what the given part says accepted only {100 * self.accepted:.1f} % of "
            "its last steps: the band may be too narrow",
        )
