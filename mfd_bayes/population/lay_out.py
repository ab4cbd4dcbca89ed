"""The layout of a campaign's population: which hyperparameters its tests call for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mfd_bayes.calibration.prior_files import PriorFile
from mfd_bayes.calibration.quantities import known_quantities
from mfd_bayes.errors import FitError, PriorError
from mfd_bayes.population.coordinates import Coordinates
from mfd_bayes.population.effects import effects_of
from mfd_bayes.population.laws import default_laws
from mfd_bayes.population.layout import ODD, Choice, Layout
from mfd_bayes.population.setting import Setting
from mfd_bayes.population.zeros import informs_of, weights_of, with_zeros

USUAL = 2.0 / np.pi
"""Mean over peak speed of a sine: the speed on the Stribeck curve at which tests are compared."""


def lay_out(
    priors: PriorFile,
    names: Sequence[str],
    settings: Sequence[Setting],
    laws: Mapping[str, str] | None = None,
    dependence: Mapping[str, Sequence[str]] | None = None,
) -> Layout:
    """Layout of the population of tests under these settings.

    Parameters
    ----------
    priors : PriorFile
    names : sequence of str
        Quantities of the tests.
    settings : sequence of Setting
        Of each test.
    laws : mapping of str to str, optional
        Laws by quantity, instead of the paper's.
    dependence : mapping of str to sequence of str, optional
        Covariates that quantities follow.

    Raises
    ------
    PriorError
        When a shared quantity has no scatter prior.
    FitError
        When a law's quantity can be negative, an actuation is negative, or all are zero.
    """
    quantities = known_quantities()
    shared = tuple(n for n in names if n not in quantities or quantities[n].pooled)
    known = {n: priors.parameters[n] for n in shared}
    chosen = {n: law for n, law in (default_laws() | dict(laws or {})).items() if n in shared}
    _check_laws(priors, chosen)
    settings = with_zeros(settings)
    groups, member = _group(priors, shared)
    coordinates = Coordinates(shared, known, USUAL * _typical_speed(settings))
    rng = np.random.default_rng(0)
    drawn = coordinates.of({n: prior.draw(rng, 4000) for n, prior in known.items()})
    follows = {n: tuple(c) for n, c in (dependence or {}).items() if n in shared and c}
    used = sorted({c for those in follows.values() for c in those})
    weights = {n: weights_of(law, settings) for n, law in chosen.items()}
    informs = informs_of(settings, shared, weights)
    return Layout(
        coordinates=coordinates,
        centre=drawn.mean(axis=0),
        spread=drawn.std(axis=0),
        laws=chosen,
        weights=weights,
        groups=groups,
        member=member,
        scatter_sd=np.array([priors.scatter[groups[g]].sd for g in member]),
        sparse=tuple(priors.scatter[groups[g]].sparse for g in member),
        reference=_geometric_mean([s.actuation for s in settings if s.actuation > 0]),
        settings=settings,
        effects=effects_of(settings, shared, member, chosen, informs),
        odd=ODD,
        dependence=follows,
        covariate_reference={c: _geometric_mean([s.covariates[c] for s in settings]) for c in used},
    )


def _check_laws(priors: PriorFile, laws: Mapping[str, str]) -> None:
    """Refuse laws of quantities that may be negative."""
    for name in laws:
        prior = priors.parameters[name]
        if prior.lower != 0.0 or np.isfinite(prior.upper):
            raise FitError(f"a law for {name} needs a prior on the positive half line")


def _geometric_mean(values: Sequence[float]) -> float:
    return float(np.exp(np.mean(np.log(values))))


def _typical_speed(settings: Sequence[Setting]) -> float:
    """Geometric mean of the tests' peak speeds, in/s."""
    speeds = [s.covariates["velocity"] for s in settings if s.covariates.get("velocity", 0.0) > 0]
    return _geometric_mean(speeds) if speeds else 1.0


def _group(priors: PriorFile, names: tuple[str, ...]) -> tuple[tuple[str, ...], Choice]:
    """Scatter groups of the quantities, and the index of each quantity's group."""
    home = {name: group for group, s in priors.scatter.items() for name in s.parameters}
    lost = [name for name in names if name not in home]
    if lost:
        raise PriorError(f"prior file {priors.path.name} has no [scatter] group with {lost[0]}")
    groups = tuple(dict.fromkeys(home[name] for name in names))
    return groups, np.array([groups.index(home[name]) for name in names], dtype=np.intp)
