"""The population of tests: levels, laws and test-to-test scatter, from the tests' stored draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.map_fit import climb
from mfd_bayes.calibration.prior_files import PriorFile
from mfd_bayes.calibration.priors import Prior
from mfd_bayes.calibration.sampling import sample_density
from mfd_bayes.errors import FitError, PriorError
from mfd_bayes.population.laws import LAWS, PAPER
from mfd_bayes.population.marginal import Marginal, Pooling, TestSummary

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Population:
    """Draws of the hyperparameters, (chain, draw) first.

    Attributes
    ----------
    pooling : Pooling
    levels : (chain, draw, d)
        Coordinates of the medians at the reference actuation.
    shapes : mapping of str to (chain, draw)
        Coordinates of the laws' shapes, by quantity.
    scatter : (chain, draw, G)
        Standard deviation of the coordinates between tests, by group.
    priors : mapping of str to Prior
    actuation_unit : str
    walkers : int
        A chain's draws are ordered by walker.
    convergence : Convergence
    """

    pooling: Pooling
    levels: Array
    shapes: Mapping[str, Array]
    scatter: Array
    priors: Mapping[str, Prior]
    actuation_unit: str
    walkers: int
    convergence: Convergence

    def ratio(self, name: str, actuation: Array) -> Array:
        """Law's value at each actuation over that at the reference, (chain, draw, m)."""
        law = LAWS[self.pooling.laws.get(name, "constant")]
        shape = self.shapes.get(name, np.zeros(self.levels.shape[:2]))
        return law.ratio(np.asarray(actuation) / self.pooling.reference, shape[..., None])

    def median(self, name: str, actuation: Array) -> Array:
        """Median over tests of a quantity at each actuation, (chain, draw, m)."""
        level = self.levels[..., self.pooling.names.index(name)]
        return self.priors[name].value(level)[..., None] * self.ratio(name, actuation)

    @property
    def slopes(self) -> dict[str, Array]:
        """The paper's constants, as far as the laws are the paper's, (chain, draw) each.

        K_c and K_s in kip per unit of actuation, `alpha_sigma0` in kip/in per unit of
        actuation, `sigma0_0` in kip/in.
        """
        p0 = self.pooling.reference
        one = np.array([p0])
        found: dict[str, Array] = {}
        for side in ("fwd", "bwd"):
            if self.pooling.laws.get(f"Fc_{side}") != "proportional":
                continue
            kinetic = self.median(f"Fc_{side}", one)[..., 0] / p0
            found[f"K_c_{side}"] = kinetic
            excess = self.median(f"static_excess_{side}", one)[..., 0]
            found[f"K_s_{side}"] = kinetic * (1.0 + excess)
        if "sigma0" in self.pooling.names:
            stiffness = self.median("sigma0", np.array([0.0, p0]))
            if self.pooling.laws.get("sigma0") in ("affine", "proportional"):
                found["alpha_sigma0"] = (stiffness[..., 1] - stiffness[..., 0]) / p0
            if self.pooling.laws.get("sigma0") == "affine":
                found["sigma0_0"] = stiffness[..., 0]
        return found

    @property
    def scatters(self) -> dict[str, Array]:
        """Test-to-test scatter of each group, (chain, draw); sd of the logarithm, or kip."""
        return {g: self.scatter[..., i] for i, g in enumerate(self.pooling.groups)}

    @property
    def law_weights(self) -> dict[str, dict[str, float]]:
        """Weight of each law that was considered, by quantity."""
        return {name: {law: 1.0} for name, law in self.pooling.laws.items()}


def pool(
    priors: PriorFile,
    names: Sequence[str],
    actuations: Sequence[float],
    laws: Mapping[str, str] | None = None,
) -> Pooling:
    """Layout of the population of tests.

    Raises
    ------
    PriorError
        When a quantity to be pooled has no scatter prior.
    FitError
        When a law needs what there is not: a positive quantity, or positive actuations.
    """
    pooled = tuple(n for n in names if n not in ("start", "noise_dof"))
    chosen = {n: law for n, law in (PAPER | dict(laws or {})).items() if n in pooled}
    for name in chosen:
        prior = priors.parameters[name]
        if prior.lower != 0.0 or np.isfinite(prior.upper):
            raise FitError(f"a law for {name} needs a prior on the positive half line")
    levels = np.asarray(actuations, dtype=np.float64)
    if not np.all(levels > 0):
        raise FitError("every calibrated test needs an actuation above zero for the pressure laws")
    groups, member = _group(priors, pooled)
    rng = np.random.default_rng(0)
    draws = [priors.parameters[n].coordinate(priors.parameters[n].draw(rng, 4000)) for n in pooled]
    return Pooling(
        names=pooled,
        centre=np.array([d.mean() for d in draws]),
        spread=np.array([d.std() for d in draws]),
        laws=chosen,
        groups=groups,
        member=member,
        scatter_sd=np.array([priors.scatter[g].sd for g in groups]),
        reference=float(np.exp(np.mean(np.log(levels)))),
    )


def _group(priors: PriorFile, names: tuple[str, ...]) -> tuple[tuple[str, ...], NDArray[np.intp]]:
    home = {name: group for group, s in priors.scatter.items() for name in s.parameters}
    lost = [name for name in names if name not in home]
    if lost:
        raise PriorError(f"prior file {priors.path.name} has no [scatter] group with {lost[0]}")
    groups = tuple(dict.fromkeys(home[name] for name in names))
    return groups, np.array([groups.index(home[name]) for name in names], dtype=np.intp)


def infer(
    pooling: Pooling,
    tests: Sequence[TestSummary],
    priors: Mapping[str, Prior],
    actuation_unit: str,
    effort: Effort,
    rng: np.random.Generator,
) -> Population:
    """Draws of levels, shapes and scatter, given the tests' summaries."""
    marginal = Marginal(pooling, tests)
    groups = len(pooling.groups)
    begin = np.concatenate([np.log(0.5 * pooling.scatter_sd), np.ones(len(pooling.shaped))])
    mode = climb(marginal.log_prob, begin, np.ones(len(begin)))
    chains = sample_density(marginal.log_prob, (mode,), effort, rng)
    shape = chains.q.shape[:2]
    flat = chains.q.reshape(-1, len(begin))
    levels = np.concatenate(
        [marginal.draw_levels(part, rng) for part in np.array_split(flat, max(1, len(flat) // 500))]
    )
    return Population(
        pooling=pooling,
        levels=(pooling.centre + pooling.spread * levels).reshape(*shape, -1),
        shapes={n: chains.q[..., groups + i] for i, n in enumerate(pooling.shaped)},
        scatter=np.exp(chains.q[..., :groups]),
        priors=priors,
        actuation_unit=actuation_unit,
        walkers=chains.walkers,
        convergence=chains.convergence,
    )
