"""Whether the noise model decides a test's parameters: fits of the same test under other noises."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import Effort
from mfd_bayes.calibration.modes import find_modes
from mfd_bayes.calibration.noise import NOISES
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.errors import FitError, MfdError

Array = NDArray[np.float64]
Bounds = tuple[float, float, float]

HALF = 0.5  # share of its 95 % interval by which a quantity may move
QUANTILES = (0.025, 0.5, 0.975)
FORMAL = frozenset({"gamma1", "gamma2", "start"})  # quantities that say nothing about the damper
# enough for a median and an interval, not for their digits
ROUGH = Effort(
    name="other noise", ess=50, limit=800, r_hat=1.1, length=2.0, ensembles=2, kept=1200, starts=16
)
APART = 1.2  # R-hat of these walkers above which they do not tell where the posterior is


@dataclass(frozen=True)
class OtherFit:
    """A test's parameters under another noise."""

    noise: str
    size: float = 0.0  # effective number of draws
    quantities: Mapping[str, Bounds] = field(default_factory=dict)  # 2.5 %, 50 %, 97.5 %
    seconds: float = 0.0  # processor time
    error: str = ""  # why there is no fit, if there is none


def moves(own: Sequence[float], other: Sequence[float]) -> bool:
    """Whether another noise moves a quantity: 2.5 %, 50 % and 97.5 % quantile under each.

    Its median moves by more than `HALF` of its 95 % interval, or the intervals do not overlap.
    """
    (low, middle, high), (below, there, above) = own, other
    return abs(there - middle) > HALF * (high - low) or below > high or above < low


def other_noises(noise: str) -> tuple[str, ...]:
    """Noises under which a test with this noise is fitted again."""
    return tuple(name for name in dict.fromkeys(("ou", "staged", *NOISES)) if name != noise)


def fit_other(noise: str, make: Callable[[], Posterior], seed: Sequence[int]) -> OtherFit:
    """Parameters of a test under another noise; a fit that fails is a result too."""
    from mfd_bayes.calibration.sampling import sample_density  # emcee takes long to import

    began = time.process_time()
    rng = np.random.default_rng((*seed, 17, *noise.encode()))
    try:
        posterior = make()
        modes = find_modes(posterior, rng, starts=ROUGH.starts)
        chains = sample_density(posterior.log_prob, modes, ROUGH, rng)
        if not chains.convergence.reached(APART, ROUGH.ess):
            raise FitError("the walkers did not settle")
        values = posterior.values(chains.q.reshape(-1, posterior.dim))
        quantities = quantiles_of(posterior, values)
    except (MfdError, np.linalg.LinAlgError) as error:
        return OtherFit(noise, error=str(error), seconds=time.process_time() - began)
    size, seconds = chains.convergence.worst_ess, time.process_time() - began
    return OtherFit(noise, size, quantities, seconds)


def quantiles_of(posterior: Posterior, values: Mapping[str, Array]) -> dict[str, Bounds]:
    """2.5 %, 50 % and 97.5 % quantile of all that tells of the damper, and of the gap."""
    model = posterior.model
    formal = {*posterior.noise.parameters, "start"} | (set() if model.own else FORMAL)
    columns = dict(zip(model.parameters, posterior.theta(values).T, strict=True)) | dict(values)
    if (gap := model.gap(values)) is not None:
        columns["gap"] = gap
    return {
        name: tuple(np.quantile(column, QUANTILES).tolist())
        for name, column in columns.items()
        if name not in formal and np.ptp(column) > 0.0
    }
