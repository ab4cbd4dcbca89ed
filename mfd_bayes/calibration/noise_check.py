"""Whether the noise model decides a test's parameters: fits of the same test under others."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.noises import NOISES
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.sampling import Draws
from mfd_bayes.calibration.second_fit import fit_again
from mfd_bayes.errors import MfdError

Array = NDArray[np.float64]
Bounds = tuple[float, float, float]

FIRST = ("ou", "staged", "iid")
"""Other noises are taken in this order, then the rest."""

HALF = 0.5
"""Share of its 95 % interval by which a quantity may move."""

QUANTILES = (0.025, 0.5, 0.975)

_TAG = 17
"""Added to a test's seed, so that the check takes no random number of its draws."""

FORMAL = frozenset({"gamma1", "gamma2", "start"})
"""Quantities that say nothing about the damper."""


@dataclass(frozen=True)
class OtherFit:
    """A test's parameters under another noise.

    Attributes
    ----------
    noise : str
    how : str
        As `second_fit.SecondFit` has it; "" where it failed.
    k, size : float
        Pareto k of its weights, and the effective number of its draws.
    quantities : mapping of str to three floats
        2.5 %, 50 % and 97.5 % quantile of each quantity, in its internal unit.
    seconds : float
        Processor time.
    error : str
        Why there is no fit, if there is none.
    """

    noise: str
    how: str = ""
    k: float = float("nan")
    size: float = 0.0
    quantities: Mapping[str, Bounds] = field(default_factory=dict)
    seconds: float = 0.0
    error: str = ""


def moves(own: Sequence[float], other: Sequence[float]) -> bool:
    """Whether another noise moves a quantity: 2.5 %, 50 % and 97.5 % quantile under each.

    Its median moves by more than `HALF` of its 95 % interval, or the intervals do not overlap.
    """
    (low, middle, high), (below, there, above) = own, other
    return abs(there - middle) > HALF * (high - low) or below > high or above < low


def other_noises(noise: str) -> tuple[str, ...]:
    """Noises under which a test with this noise is fitted again."""
    ordered = dict.fromkeys((*FIRST, *NOISES))
    return tuple(name for name in ordered if name != noise and name in NOISES)


def fit_other(
    noise: str,
    first: Posterior,
    make: Callable[[], Posterior],
    draws: Draws,
    seed: Sequence[int],
) -> OtherFit:
    """Parameters of a test under another noise; a fit that fails is a result too.

    Parameters
    ----------
    noise : str
        The other noise.
    first : Posterior
        Under the test's own noise.
    make : callable
        Makes the posterior under the other noise.
    draws : Draws
        Of the first posterior.
    seed : sequence of int
        Of the test.
    """
    began = time.process_time()
    rng = np.random.default_rng((*seed, _TAG, *noise.encode()))
    try:
        second = make()
        found = fit_again(second, _known(first, draws), rng)
        quantities = quantiles_of(second, second.values(found.q), found.weights)
    except (MfdError, np.linalg.LinAlgError) as error:
        return OtherFit(noise, error=str(error), seconds=time.process_time() - began)
    seconds = time.process_time() - began
    return OtherFit(noise, found.how, found.k, found.size, quantities, seconds)


def quantiles_of(
    posterior: Posterior, values: Mapping[str, Array], weights: Array | None = None
) -> dict[str, Bounds]:
    """2.5 %, 50 % and 97.5 % quantile of all that tells of the damper, and of the gap.

    Parameters
    ----------
    values : mapping of str to (n,)
        Draws of all quantities.
    weights : (n,), optional
        Of the draws; all alike without.
    """
    model = posterior.model
    named = dict(zip(model.parameters, posterior.theta(values).T, strict=True)) | dict(values)
    if (gap := model.gap(values)) is not None:
        named["gap"] = gap
    formal = {*FORMAL, *posterior.noise.parameters}
    return {
        name: _three(column, weights)
        for name, column in named.items()
        if name not in formal and np.ptp(column) > 0.0
    }


def _three(column: Array, weights: Array | None) -> Bounds:
    if weights is None:
        found = np.quantile(column, QUANTILES)
    else:
        found = np.quantile(column, QUANTILES, weights=weights, method="inverted_cdf")
    low, middle, high = (float(value) for value in found)
    return low, middle, high


def _known(first: Posterior, draws: Draws) -> dict[str, Array]:
    """Draws of what has the same meaning under every noise, (n,) each."""
    sampled = (name for name in first.names if name not in first.noise.parameters)
    return {name: draws.values[name].reshape(-1) for name in sampled}
