"""Checks of a test's stored posterior, so that all later results can be computed from it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.errors import StoreError
from mfd_bayes.store.netcdf import StoredTest
from mfd_bayes.store.schema import LARGEST, Figure, Index, Part, Positive, Three, check

_DENSITIES = ("log_prior", "log_likelihood")


_Share = Annotated[float, Field(ge=0, le=1.001)]


class _OtherFit(Part):
    """A fit under another noise, as `noise_check.OtherFit` is stored."""

    noise: Annotated[str, Field(max_length=100)]
    how: Annotated[str, Field(max_length=100)]
    k: Figure
    size: Figure
    quantities: dict[str, Three]
    seconds: Figure
    error: str


class _Facts(Part):
    """Facts of a sampling that are read back."""

    model: str
    noise: str
    start: Literal["sample", "mask"]
    walkers: Annotated[int, Field(ge=1)]
    steps: Annotated[int, Field(le=10**12)]
    discarded: Index
    seed: list[Index]
    modes: Annotated[int, Field(ge=1, le=1000)]
    mode_shares: list[list[_Share]] = Field(default_factory=list, max_length=1000)
    mode_values: list[dict[str, float | None]] = Field(default_factory=list, max_length=1000)
    autocorrelation: Annotated[dict[str, Positive | None], Field(min_length=1)]
    other_noises: list[_OtherFit] = Field(default_factory=list, max_length=20)
    convergence: dict[str, Annotated[list[float | None], Field(min_length=3, max_length=3)]]


def check_facts(facts: Any, where: Path) -> None:
    """Refuse sampling facts that no calibration stores.

    Raises
    ------
    StoreError
        When one is missing or of the wrong kind.
    """
    found = check(_Facts, facts, where)
    if len({len(shares) for shares in found.mode_shares}) > 1:
        raise StoreError(f"{where} is damaged: mode_shares differ in length between chains")


def check_draws(stored: StoredTest, posterior: Posterior, where: Path) -> None:
    """Refuse draws with wrong names or sizes, or outside the support of their priors.

    Raises
    ------
    StoreError
        When the draws in the file are not from this posterior.
    """
    level = posterior.trace.reference_actuation
    if not level >= 0:
        raise StoreError(f"{where} must be of a test with an actuation, got {level:g}")
    wanted = {*posterior.names, *posterior.model.parameters, "offset", "start"}
    names = set(map(str, stored.draws.data_vars))
    if missing := wanted - names:
        raise StoreError(f"{where} holds no draws of {min(missing)}")
    if unknown := names - wanted - {*posterior.priors, "gamma1"}:
        raise StoreError(
            f"{where} holds draws of {min(unknown)[:60]!r}, which the model does not have"
        )
    shape = stored.draws["offset"].shape
    arrays = {str(k): v.to_numpy() for k, v in stored.draws.data_vars.items()}
    densities = {n: stored.stats[n].to_numpy() for n in _DENSITIES if n in stored.stats}
    if len(densities) < len(_DENSITIES):
        raise StoreError(f"{where} holds no {' and '.join(_DENSITIES)} in its sample_stats")
    for name, values in (arrays | densities).items():
        if values.shape != shape or values.ndim != 2 or values.dtype != np.float64:
            raise StoreError(f"{where} must hold {name} as (chain, draw) numbers like the others")
        if not np.all(np.abs(values) <= LARGEST):
            raise StoreError(f"{where} must hold finite draws of {name}")
    if shape[0] < 1 or shape[1] < 1 or shape[1] % stored.facts["walkers"]:
        raise StoreError(f"{where} must hold draws of {stored.facts['walkers']} walkers")
    for name in wanted & set(posterior.priors):
        _check_support(name, arrays[name], posterior, where)


def _check_support(name: str, values: Any, posterior: Posterior, where: Path) -> None:
    prior = posterior.priors[name]
    with np.errstate(all="ignore"):
        inside = np.isfinite(prior.log_density(prior.coordinate(values)))
    if not np.all(inside):
        value = values[~inside][0]
        raise StoreError(f"{where} holds a draw of {name}, {value:g}, that its prior excludes")
