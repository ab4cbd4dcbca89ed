"""Checks of a stored population, so that predictions from it cannot fail later."""

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from mfd_bayes.calibration.quantities import sampled_quantities
from mfd_bayes.errors import StoreError
from mfd_bayes.population.laws import COMPARE, LAWS
from mfd_bayes.population.layout import Layout
from mfd_bayes.population.population import Population
from mfd_bayes.population.strokes import LARGEST
from mfd_bayes.population.travel import KNOTS
from mfd_bayes.store.schema import Figure, Index, Part, check

_WIDEST = 40.0
"""Largest scatter over its half-normal scale; no draw is larger."""

_FARTHEST = 1e6
"""Largest coordinate in prior units; no draw is larger."""

_Scale = Annotated[float, Field(ge=1e-12, le=_FARTHEST)]
_Size = Annotated[float, Field(ge=1e-12, le=1e10)]
"""Quotients of scales and of sizes stay finite."""

_Near = Annotated[float, Field(ge=-_FARTHEST, le=_FARTHEST)]
_Share = Annotated[float, Field(ge=0, le=LARGEST)]
_Shape = Annotated[float, Field(ge=-_WIDEST, le=_WIDEST)]
_Name = Annotated[str, AfterValidator(lambda name: _known(name, sampled_quantities()))]
_Law = Annotated[str, AfterValidator(lambda name: _known(name, LAWS))]
_Covariate = Literal["velocity", "amplitude"]


_Level = Annotated[float, Field(ge=0, le=1e10)]


def _known(name: str, names: Collection[str]) -> str:
    if name not in names:
        raise ValueError("must be a known name")
    return name


class _Setting(Part):
    actuation: _Level
    session: str
    covariates: dict[_Covariate, Annotated[float, Field(ge=0, le=1e10)]]


class _Effect(Part):
    name: Literal["level", "session"]
    group: Index
    members: Annotated[list[Index], Field(min_length=1)]
    cells: list[Annotated[tuple[str, _Level], Field(strict=False)]]
    home: list[Index]
    kernel: Literal["matern", "exponential"] = "exponential"  # of earlier versions
    scale: Annotated[float, Field(ge=0.01, le=100)] = 1.0  # likewise
    reference: _Level = 0.0  # likewise


class _Basis(Part):
    shortest: _Size
    longest: _Size


class _Levels(Part):
    share: Annotated[list[_Share], Field(min_length=2 * KNOTS, max_length=2 * KNOTS)]
    memory: _Share


class _Residual(Part):
    basis: _Basis
    levels: _Levels | None = None
    mean: Annotated[list[_Near], Field(min_length=2 * KNOTS, max_length=2 * KNOTS)]
    covariance: Annotated[list[list[_Near]], Field(min_length=2 * KNOTS, max_length=2 * KNOTS)]
    log_shape: Annotated[list[_Shape], Field(min_length=2 * KNOTS, max_length=2 * KNOTS)]
    slip_force: _Size
    noise_time: _Size
    information: Annotated[float, Field(ge=1e-12, le=1)]

    @model_validator(mode="after")
    def _check_together(self) -> Self:
        _need(
            all(len(row) == len(self.mean) for row in self.covariance),
            "covariance must be as wide as the mean is long",
        )
        return self


class _Facts(Part):
    names: Annotated[list[_Name], Field(min_length=1)]
    speed: _Size
    centre: list[_Near]
    spread: list[_Scale]
    laws: dict[_Name, str]
    weights: dict[_Name, dict[_Law, Annotated[float, Field(ge=0, le=1)]]]
    groups: list[str]
    member: list[Index]
    scatter_sd: list[_Scale]
    reference: _Size
    settings: Annotated[list[_Setting], Field(min_length=1)]
    effects: list[_Effect]
    dependence: dict[_Name, list[_Covariate]]
    covariate_reference: dict[_Covariate, _Scale]
    actuation_unit: Literal["ksi", "kip"]
    walkers: Annotated[int, Field(ge=1)]
    r_hat: list[Figure]
    ess_bulk: list[Figure]
    ess_tail: list[Figure]
    sparse: tuple[bool, ...] = ()  # earlier versions had none of these
    common: tuple[bool, ...] = ()
    odd: Annotated[float, Field(ge=0, lt=1)] = 0.0
    residual: _Residual | None = None
    unloaded: Annotated[float, Field(ge=0, le=1)] = 0.0
    left: list[Annotated[float, Field(ge=0, le=1)]] | None = None

    @model_validator(mode="after")
    def _check_together(self) -> Self:
        d = len(self.names)
        _need(len(set(self.names)) == d, "names must differ")
        for key in ("centre", "spread", "member", "scatter_sd"):
            _need(len(getattr(self, key)) == d, f"{key} must be as many as the names")
        for key in ("sparse", "common"):
            _need(len(getattr(self, key)) in (0, d), f"{key} must be as many as the names")
        _need(
            self.left is None or len(self.left) == len(self.settings),
            "left must be as many as the settings",
        )
        _need(max(self.member) < len(self.groups), "member must be indices of groups")
        _need(set(self.laws) <= set(self.names), "laws must be of known names")
        _need(set(self.laws.values()) <= {*LAWS, COMPARE}, "laws must be known")
        _need(set(self.weights) == set(self.laws), "weights must be those of the laws")
        _need(all(sum(w.values()) > 0 for w in self.weights.values()), "weights must not be zero")
        _need(set(self.dependence) <= set(self.names), "dependence must be of the names")
        used = {c for those in self.dependence.values() for c in those}
        _need(
            used <= set(self.covariate_reference),
            "covariate_reference lacks a covariate",
        )
        _need(
            all(setting.covariates.get(c, 0) > 0 for setting in self.settings for c in used),
            "covariates of the settings must be above zero",
        )
        for effect in self.effects:
            _need(effect.group < len(self.groups), "group of an effect must be an index of groups")
            _need(max(effect.members) < d, "members of an effect must be indices of names")
            _need(len(effect.home) == len(self.settings), "home must be as many as the settings")
            _need(max(effect.home) < len(effect.cells), "home must be indices of cells")
        return self


def _need(holds: bool, sentence: str) -> None:
    if not holds:
        raise ValueError(sentence)


def check_facts(facts: Any, where: object) -> None:
    """Refuse facts that no inference stores.

    Raises
    ------
    StoreError
        When one is missing or of the wrong kind, or they do not fit together.
    """
    check(_Facts, facts, where)


def check_draws(population: Population, where: object) -> None:
    """Refuse draws that no inference gives.

    Raises
    ------
    StoreError
        When they do not have the population's size, or are out of range.
    """
    layout, shape = population.layout, population.h.shape[:2]
    d, cells = len(layout.names), sum(len(effect.cells) for effect in layout.effects)
    for name, values, rest in (
        ("hyperparameters", population.h, (layout.dim,)),
        ("latent", population.latent, (1 + cells, d)),
        ("law", population.choice, (len(layout.laws),)),
        ("together", population.together, (d, d)),
    ):
        if values.shape != (*shape, *rest):
            raise StoreError(f"{where} must hold {name} of shape {(*shape, *rest)}")
        if not np.all(np.abs(values) <= _FARTHEST):
            raise StoreError(f"{where} must hold {name} that is finite and within {_FARTHEST:g}")
    if population.size < 1 or shape[1] % population.walkers:
        raise StoreError(f"{where} must hold draws of {population.walkers} walkers")
    starts = population.starts
    if starts is not None and not (
        starts.shape == (*shape, len(layout.settings)) and np.all((starts >= 0) & (starts <= 1))
    ):
        raise StoreError(f"{where} must hold starts between 0 and 1, one for each test")
    try:
        _ = [effect.root for effect in layout.effects]
    except np.linalg.LinAlgError:
        raise StoreError(f"{where} holds an effect with the same cell twice") from None
    _check_sizes(population, layout, where)


def _check_sizes(population: Population, layout: Layout, where: object) -> None:
    """Refuse scatter, shapes and levels that their priors exclude."""
    h = population.h.reshape(population.size, -1)
    scales = layout.sd_scale
    with np.errstate(over="ignore"):
        wide = np.exp(h[:, : scales.size]) > _WIDEST * scales
    if np.any(wide):
        raise StoreError(f"{where} holds a scatter that its prior excludes")
    if np.any(np.abs(h[:, scales.size :]) > _WIDEST):
        raise StoreError(f"{where} holds a law's shape that its prior excludes")
    if np.any(np.abs(population.together) > 1.001):
        raise StoreError(f"{where} holds a correlation beyond 1")
    levels = population.levels.reshape(population.size, -1)
    with np.errstate(all="ignore"):
        inside = np.isfinite(layout.coordinates.log_prior(levels))
    if not np.all(inside):
        raise StoreError(f"{where} holds a level that its prior excludes")
