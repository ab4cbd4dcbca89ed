"""Sweeps over the joint posterior: the order of the moves, their tuning and acceptance rates.

A sweep

1.  updates scatter, effects' sd and shapes given the tests, with levels and effects integrated
    out, by differential evolution and by leaps between modes;
2.  draws levels and effects, and the tests' weights in the scatter, from their conditional
    densities;
3.  updates every test's coordinates given the population: proposals of a Gaussian near the
    conditional density, and differential evolution;
4.  moves levels and scatter of the quantities that hardly differ, with all tests;
5.  moves scatter and level of one quantity together with its tests' coordinates.

Companions, whose tests have surrogates in place of their likelihoods, move all tests and levels
along trajectories instead of 3 and 4. With companions a sweep ends by an exchange with them, after
some sweeps of theirs, and needs fewer moves of its own. Every move leaves the joint posterior as it
is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.chains import Accepted, Chains
from mfd_bayes.population.joint import Joint
from mfd_bayes.population.laws import draw_shape
from mfd_bayes.population.layout import NONE
from mfd_bayes.population.moves.exchange import exchange
from mfd_bayes.population.moves.glide import glide
from mfd_bayes.population.moves.hyperparameters import (
    draw_latent,
    draw_weights,
    evolve_hyperparameters,
)
from mfd_bayes.population.moves.leaps import leap
from mfd_bayes.population.moves.lines import Tuning, transport
from mfd_bayes.population.moves.one_test import (
    GaussianConditional,
    evolve_tests,
    step_near,
)
from mfd_bayes.population.moves.shared import rescale, shift, slopes_of
from mfd_bayes.population.sharing import draw_common

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Plan:
    """How often a sweep makes each kind of move.

    Attributes
    ----------
    evolutions : int
        Of scatter and shapes.
    near : int
        Proposals near the conditional density of every test.
    shifts : int
        Moves of the levels of quantities that hardly differ.
    glides : int
        Trajectories; they need surrogates.
    together : int
        Moves of scatter and level together with the tests.
    """

    evolutions: int
    near: int
    shifts: int
    glides: int
    together: int


ALONE = Plan(evolutions=4, near=2, shifts=4, glides=0, together=2)
"""For chains without companions."""

NEAR = Plan(evolutions=4, near=1, shifts=2, glides=0, together=2)
"""For tests with Gaussians in place of the likelihoods, of which a proposal is nearly a draw."""

ACCOMPANIED = Plan(evolutions=1, near=1, shifts=1, glides=0, together=0)
"""For chains with companions: most comes from these."""

COMPANION = Plan(evolutions=2, near=0, shifts=0, glides=2, together=1)
"""For companions."""

BETWEEN = 2
"""Sweeps of the companions in a sweep."""


class Sampler:
    """Samples a joint posterior sweep by sweep.

    Parameters
    ----------
    joint : Joint
    rng : numpy.random.Generator
    plan : Plan, optional

    Attributes
    ----------
    companions : (Sampler, Chains), optional
        Companions of the chains, and what samples them.
    accepted : dict of str to list of float
        Acceptance rates by kind of proposal, in the order of the sweeps.
    """

    def __init__(self, joint: Joint, rng: np.random.Generator, plan: Plan = ALONE) -> None:
        self.joint, self.rng, self.plan = joint, rng, plan
        self.companions: tuple[Sampler, Chains] | None = None
        self.accepted: dict[str, list[float]] = {}
        self._tune(Tuning.by_prior(joint.layout, joint.tests))

    def start(self, n: int, ensembles: int) -> Chains:
        """Chains with scatter near half of its prior scale, and tests from their Gaussians."""
        joint, layout, rng = self.joint, self.joint.layout, self.rng
        sd = layout.sd_scale
        log_sd = np.log(0.5 * sd) + 0.5 * rng.standard_normal((n, len(sd)))
        shapes = [draw_shape(shape, rng.random(n)) for _, shape in layout.shapes]
        common = np.flatnonzero(layout.common)
        log_sd[:, common] = np.log(NONE * layout.spread[common])
        h = np.concatenate([log_sd, np.reshape(shapes, (-1, n)).T], axis=1)
        latent = np.zeros((n, joint.design.shape[1], joint.d))
        ensemble = np.repeat(np.arange(ensembles), n // ensembles)
        weight = np.ones((n, len(joint.tests), joint.d))
        chains = Chains(h, latent, [], [], layout.draw_choice(n), weight, ensemble)
        mean, scatter = np.zeros((n, joint.d)), np.ones((n, joint.d))
        mean[:, common] = draw_common(layout, joint.tests, rng, n)
        scatter[:, common] = NONE
        for test in joint.tests:
            near = GaussianConditional.of(test, (mean, scatter), rng, 1)
            chains.x.append(near.mean + near.noise[0])
            chains.log_density.append(test.density(joint.d)(chains.x[-1]))
        draw_latent(joint, chains, rng)
        return chains

    def take_over(self, chains: Chains) -> None:
        """Go on with chains that sampled another density of the same layout."""
        for j, test in enumerate(self.joint.tests):
            density = test.density(self.joint.d)(chains.x[j])
            lost = ~np.isfinite(density)
            if np.any(lost):  # a Gaussian also covers points without any likelihood
                picks = self.rng.choice(np.flatnonzero(~lost), size=int(lost.sum()))
                chains.x[j][lost], density[lost] = chains.x[j][picks], density[picks]
            chains.log_density[j] = density

    def sweep(self, chains: Chains) -> None:
        """One sweep over everything, in place."""
        given = self.joint, chains, self.rng
        density = self.joint.log_blocks(self.joint.given(chains), chains.h)
        for _ in range(self.plan.evolutions):
            self._note(evolve_hyperparameters(*given, density))
        self._note(leap(*given, density))
        draw_latent(*given)
        draw_weights(*given)
        self._move_tests(chains)
        for _ in range(self.plan.glides):
            self._note(glide(*given))
        for _ in range(self.plan.shifts):
            self._note(shift(*given, self.slopes))
        self._note(rescale(*given, self.slopes))
        for _ in range(self.plan.together):
            self.move_together(chains)
        if self.companions:
            sampler, companions = self.companions
            for _ in range(BETWEEN):
                sampler.sweep(companions)
            self._note(exchange(self.joint, chains, sampler.joint, companions, self.rng))

    def _move_tests(self, chains: Chains) -> None:
        """Move every test's coordinates given the population, in place."""
        if not self.plan.near:
            return
        given = self.joint, chains, self.rng, self.joint.conditional(chains)
        self._note(step_near(*given, self.plan.near))
        self._note(evolve_tests(*given))

    def move_together(self, chains: Chains) -> None:
        """Move scatter and level of one quantity, with its tests' values, in place."""
        k = int(self.rng.choice(self.joint.d, p=self.weights))
        self._note(transport(self.joint, chains, self.rng, self.tuning, k))

    def tune(self, chains: Chains) -> None:
        """Tune proposals to the chains. It must not be called once chains are kept."""
        self._tune(Tuning.by_chains(self.joint.layout, self.joint.tests, chains))

    def take_tuning(self, other: Sampler) -> None:
        """Take the proposals' tuning from another sampler of the same layout."""
        self._tune(other.tuning)

    def _tune(self, tuning: Tuning) -> None:
        self.tuning, self.slopes = tuning, slopes_of(self.joint, tuning)
        missing = np.where(self.joint.layout.inferred[: self.joint.d], tuning.missing, 0.0)
        self.weights = missing / missing.sum()

    def _note(self, accepted: Accepted) -> None:
        for name, yes in accepted:
            self.accepted.setdefault(name, []).append(float(np.mean(yes)))
