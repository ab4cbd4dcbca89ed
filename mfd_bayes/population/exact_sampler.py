"""Chains of the exact joint posterior of population and tests.

Under the Gaussian likelihoods of the tests the population's h has a known density, near which a
Student t lies, and given h the coefficients z and the tests' own coordinates are affine in standard
normal numbers e. A sweep of the sampler has three moves:

1. the numbers of each test, each accepted by its own likelihood;
2. one of these, each accepted by all tests:
   - the numbers of z, with another h from the Student t, accepted by the density of h over that of
     the t too (independence Metropolis: Tierney, 1994);
   - the levels of what all tests share, by the difference of two draws of the warm-up (DE-MC(Z):
     ter Braak and Vrugt, 2008), or from a mixture fitted to these draws (independence Metropolis);
     the rest of z is shifted as its Gaussian given h says;
3. given all tests, which needs no force: the coordinates of h by random-walk Metropolis with z
   integrated out, those of different quantities side by side, then z from its Gaussian (collapsed
   Gibbs sampler: Liu, 1994).

Numbers change by the preconditioned Crank-Nicolson step e' = √(1 - β²) e + β ξ, which leaves the
approximation as it is. Moves 1 and 2 are accepted by the exact over the approximate likelihoods too
(Rudolf and Sprungk, 2018). They are of the non-centred form of the hierarchy, and move 3 of the
centred one: where one mixes slowly the other does not (Yu and Meng, 2011).

While warming up the Gaussian likelihoods are fitted anew, by least squares, to the exact ones of
what was proposed, each weighted by the probability of its acceptance (waste recycling: Frenkel,
2004). With Gaussian likelihoods move 1 is always accepted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import TAIL_SHARE, Convergence, measure
from mfd_bayes.calibration.proposal import Proposal, fit_mixture, fit_proposal
from mfd_bayes.jobs.local import Evaluate, in_turn
from mfd_bayes.population.joint_fit import Array, Index, JointFit
from mfd_bayes.population.mixed_model import (
    STEP,
    MixedModel,
    StudentTProposal,
    backward,
    forward,
    tuned,
)

CHAINS = 4  # groups of independent chains; R̂ is taken across groups
STORED = 2**26  # most numbers of the tests' coordinates that are held
# how often the Gaussians are fitted anew, sweeps before each and after the last, of which the first
# quarter is forgotten, and kept sweeps before the first look at the convergence
REFITS, WARM_UP, FIRST = 3, 20, 40
LOOK = (1.2, 1.5)  # least and largest growth of the kept sweeps from look to look
RIDGE = 3.0  # of the least squares, for a direction that few draws show
LEAST = 1e-3  # least precision of a test over that of its posterior, in any direction
ACCEPT = 0.3  # share of moves of the tests that is to be accepted
ACCEPT_Z = 0.2  # the same of z
# shares of the moves of z: with another h; of common levels by a difference of draws; by a mixture
MOVES = (0.2, 0.1, 0.7)
FULL = 0.15  # share of the differences of draws that are taken as they are: from mode to mode
COMPONENTS = 4  # of the mixture


class ChainState(NamedTuple):
    """All chains, n of them."""

    h: Array  # (n, dim)
    z: Array  # (n, Z)
    x: Array  # (n, J, D): the tests' coordinates
    excess: Array  # (n, J): exact less approximate log density of each test


class PopulationDraws(NamedTuple):
    """Kept draws, ordered by walker, and their convergence."""

    h: Array  # (chain, draw, dim)
    z: Array  # (chain, draw, Z)
    x: Array  # (chain, draw, J, D)
    log_likelihood: Array  # (chain, draw, J): of each test given h and z, by its Gaussian
    convergence: Convergence  # of h, and of the levels and slopes in z
    sweeps: int
    accepted: tuple[float, float]  # shares of accepted moves of tests and of the population


class ExactSampler:
    """Chains of the exact posterior."""

    def __init__(
        self,
        fit: JointFit,
        approximate: Callable[[JointFit], tuple[MixedModel, StudentTProposal]],
        unpooled: NDArray[np.bool_],
        choice: Index,
        rng: np.random.Generator,
        evaluate: Evaluate[Array, Array] | None = None,
    ) -> None:
        self.fit, self.approximate, self.unpooled, self.rng = fit, approximate, unpooled, rng
        self.mixed, self.student_t = mixed, _ = approximate(fit)
        self.choice, self.d = choice, len(mixed.design.names)
        self.evaluate = evaluate or in_turn([test.log_likelihood for test in fit.tests])
        local = np.any(unpooled, axis=0)
        local[mixed.free] = True
        self.local = np.flatnonzero(local)
        self.beta, self.beta_z = np.full(len(fit.mean), 0.8), 0.8  # step sizes
        self.step_h = np.full(mixed.dim, STEP)
        # while warming up: proposals x, their excess, and the share of it that each test accepts
        self.proposals: list[tuple[Array, Array, Array]] = []
        self.warming_up = True
        # shares of moves that were accepted: of each test, and of what all share
        self.accepted: list[Array] = []
        self.accepted_together: list[float] = []
        # levels of what all tests share: columns of z, draws of the warm-up, and their mixture
        self.common = np.flatnonzero(mixed.design.common)
        self.levels: list[Array] = []
        self.archive: tuple[Array, Proposal] | None = None
        h, _ = self._propose_h()
        e = rng.standard_normal((len(h), len(fit.mean), self.local.size))
        self.state = self._at(h, mixed.marginal(h, choice)[1].draw(rng), e)

    def _propose_h(self) -> tuple[Array, Array]:
        """Draws of h of every chain from its Student t, (n, dim), and their log weights, (n,)."""
        g = self.student_t.draw(self.rng, len(self.choice))
        return self.mixed.from_standard_normal(g), self._log_weight(g)

    def _log_weight(self, g: Array) -> Array:
        """Log prior density of numbers (n, dim) over that of each chain's Student t, (n,)."""
        return np.asarray(-0.5 * np.sum(g**2, axis=1) - self.student_t.log_density(g))

    def _linear(self, z: Array) -> Array:
        """Levels, slopes and effects of the tests, (n, J, d)."""
        return self.mixed.design.linear(z, self.mixed.rows)

    def _conditional(self, h: Array, z: Array) -> tuple[Array, Array]:
        """Mean (n, J, D) of the tests given the population, and factor of the local precision.

        Of the coordinates that are not local the mean is what the population says.
        """
        local, mean = self.local, np.zeros((len(h), *self.unpooled.shape))
        mean[..., : self.d] = self.mixed.offsets(h, self.choice) + self._linear(z)
        mean = np.where(self.unpooled, 0.0, mean)
        sd = np.ones((len(h), len(self.unpooled), local.size))
        sd[..., np.searchsorted(local, self.mixed.free)] = self.mixed.sd(h)
        sd = np.where(self.unpooled[:, local], 1.0, sd)
        p = self.fit.precision[:, local]
        inner = p[:, :, local] + sd[..., None] ** -2.0 * np.eye(local.size)
        pull = np.einsum("jla,nja->njl", p, self.fit.mean - mean)
        mean[..., local] += forward(inner, pull)
        return mean, np.asarray(np.linalg.cholesky(inner))

    def _at(self, h: Array, z: Array, e: Array) -> ChainState:
        """State with standard normal numbers e (n, J, L) of the tests."""
        x = self._tests_of(self._conditional(h, z), e)
        return ChainState(h, z, x, self._excess(x))

    def _tests_of(self, conditional: tuple[Array, Array], e: Array) -> Array:
        """Tests' coordinates (n, J, D) of standard normal numbers."""
        mean, factor = conditional
        x = mean.copy()
        x[..., self.local] += backward(factor, e)
        return x

    def _excess(self, x: Array) -> Array:
        """Exact less approximate log density of each test, (n, J)."""
        distance = x - self.fit.mean
        pairs = "nja,jab,njb->nj"
        gaussian = -0.5 * np.einsum(pairs, distance, self.fit.precision, distance, optimize=True)
        exact = self.evaluate((j, np.ascontiguousarray(x[:, j])) for j in range(x.shape[1]))
        excess = np.stack(list(exact), axis=1) - gaussian
        for j, unpooled in enumerate(self.unpooled):
            if np.any(unpooled):
                excess[:, j] += self.fit.tests[j].coordinates.log_prior(x[:, j], unpooled)
                excess[:, j] += 0.5 * np.sum(x[:, j][:, unpooled] ** 2, axis=1)
        return np.where(np.isnan(excess), -np.inf, excess)

    def sweep(self) -> None:
        """One move of each kind; while warming up the step sizes are tuned."""
        conditional = self._conditional(self.state.h, self.state.z)
        self._move_tests(conditional)
        self._move_together(conditional)
        self._move_h()
        if self.warming_up:
            self.levels.append(self.state.z[:, self.common])

    def _numbers(self, conditional: tuple[Array, Array], x: Array) -> Array:
        """Standard normal numbers (n, J, L) of the tests' coordinates: undoes `_tests_of`."""
        mean, factor = conditional
        return np.asarray(np.einsum("njab,nja->njb", factor, (x - mean)[..., self.local]))

    def _move_tests(self, conditional: tuple[Array, Array]) -> None:
        """Move each test by itself."""
        s, e = self.state, self._numbers(conditional, self.state.x)
        x = self._tests_of(conditional, self._autoregressive(e, self.beta[:, None]))
        new = s._replace(x=x, excess=self._excess(x))
        self._keep(s, new)
        accepted = np.log(self.rng.random(s.excess.shape)) < new.excess - s.excess
        self.state = s._replace(
            x=np.where(accepted[..., None], new.x, s.x),
            excess=np.where(accepted, new.excess, s.excess),
        )
        share = accepted.mean(axis=0)
        self.accepted.append(share)
        if self.warming_up:
            self.beta = tuned(self.beta, share, ACCEPT, (0.05, 1.0))

    def _move_together(self, conditional: tuple[Array, Array]) -> None:
        """Move what all tests share, and all tests with it."""
        s, e = self.state, self._numbers(conditional, self.state.x)
        move = self.rng.choice(len(MOVES), p=MOVES) if self.archive else 0
        h, z, log_ratio = self._with_another_h(s) if move == 0 else self._shift_common(s, move == 1)
        new = self._at(h, z, e)
        self._keep(s, new)
        log_ratio += new.excess.sum(axis=1) - s.excess.sum(axis=1)
        accepted = np.log(self.rng.random(len(log_ratio))) < log_ratio
        self.state = ChainState(
            *(
                np.where(accepted.reshape(-1, *[1] * (a.ndim - 1)), b, a)
                for a, b in zip(s, new, strict=True)
            )
        )
        share = float(accepted.mean())
        self.accepted_together.append(share)
        if self.warming_up and move == 0:  # the others do not depend on this step
            self.beta_z = float(tuned(self.beta_z, share, ACCEPT_Z, (0.02, 1.0)))

    def _with_another_h(self, s: ChainState) -> tuple[Array, Array, Array]:
        """Proposed h, from its Student t, and z near its numbers; log ratio but for the excess."""
        log, gaussian = self.mixed.marginal(s.h, self.choice)
        log += self._log_weight(self.mixed.to_standard_normal(s.h))
        e_z = self._autoregressive(gaussian.numbers_of(s.z), self.beta_z)
        h, log_weight = self._propose_h()
        log_marginal, gaussian = self.mixed.marginal(h, self.choice)
        return h, gaussian.of_numbers(e_z), log_marginal + log_weight - log

    def _shift_common(self, s: ChainState, by_difference: bool) -> tuple[Array, Array, Array]:
        """The same of common levels that are moved; h stays."""
        assert self.archive is not None
        (draws, mixture), rng, n = self.archive, self.rng, len(s.h)
        levels, log_ratio = s.z[:, self.common], np.zeros(n)
        if by_difference:
            first, second = draws[rng.integers(len(draws), size=(2, n))]
            scale = np.where(rng.random(n) < FULL, 1.0, 2.38 / np.sqrt(2 * self.common.size))
            moved = levels + scale[:, None] * (first - second)
        else:
            moved = mixture.draw(rng, n)
            log_ratio += mixture.log_density(levels) - mixture.log_density(moved)
        gaussian = self.mixed.marginal(s.h, self.choice)[1]
        precision = gaussian.factor @ np.swapaxes(gaussian.factor, 1, 2)
        remainder = np.setdiff1d(np.arange(s.z.shape[1]), self.common)
        across = precision[:, remainder[:, None], self.common]
        shift = np.einsum("nrc,nc->nr", across, moved - levels)
        z = s.z.copy()
        z[:, self.common] = moved
        z[:, remainder] -= forward(precision[:, remainder[:, None], remainder], shift)
        log_ratio += gaussian.log_density(z) - gaussian.log_density(s.z)
        return s.h, z, log_ratio

    def _learn_common(self) -> None:
        """Take levels of what all tests share, of the last two fits, as their moves' archive."""
        if self.common.size:
            draws = np.concatenate(self.levels[-2 * WARM_UP :])
            wide = fit_mixture(draws, self.rng, components=1)
            self.archive = draws, fit_proposal(draws, COMPONENTS, self.rng, wide)

    def _autoregressive(self, e: Array, beta: Array | float) -> Array:
        """Standard normal numbers near others."""
        return np.sqrt(1.0 - beta**2) * e + beta * self.rng.standard_normal(e.shape)

    def _keep(self, state: ChainState, proposal: ChainState) -> None:
        """Keep a proposal for the next fit."""
        if self.warming_up:
            possible = np.isfinite(proposal.excess)
            excess = np.where(possible, proposal.excess, 0.0)
            share = np.exp(np.minimum(excess - state.excess, 0.0)) * possible
            self.proposals.append((proposal.x, excess, share))

    def refit(self, x: Array, excess: Array, weight: Array) -> None:
        """Take other Gaussian likelihoods of the tests, and go on from where the chains are.

        Least squares on draws x (m, J, D) of the posterior: what the exact log densities have over
        the Gaussian ones, `excess` (m, J), is a quadratic form (response surface).
        """
        fit, size = self.fit, x.shape[-1]
        mean, precision = fit.mean.copy(), fit.precision.copy()
        i, k = np.triu_indices(size)
        for j, p in enumerate(fit.precision):
            w = weight[:, j]
            centre = np.average(x[:, j], axis=0, weights=w)
            spread = np.cov(x[:, j].T, aweights=w)
            root = np.asarray(np.linalg.cholesky(spread + 1e-9 * np.eye(size)), dtype=np.float64)
            u = forward(root, x[:, j] - centre)
            terms = np.column_stack([u, u[:, i] * u[:, k] - (i == k)])
            weighted = (terms * w[:, None]).T
            pairs = weighted @ terms + RIDGE * np.eye(terms.shape[1])
            pulled = weighted @ (excess[:, j] - np.average(excess[:, j], weights=w))
            linear, square = np.split(np.linalg.solve(pairs, pulled), [size])
            quadratic = np.zeros((size, size))
            quadratic[i, k] = square
            inner = root.T @ p @ root - quadratic - quadratic.T
            values, vectors = np.linalg.eigh(inner)
            values = np.maximum(values, LEAST)
            pull = root.T @ p @ (fit.mean[j] - centre) + linear
            mean[j] = centre + root @ (vectors / values) @ vectors.T @ pull
            outer = np.linalg.solve(root.T, vectors)
            precision[j] = (outer * values) @ outer.T
        self.fit = replace(fit, mean=mean, precision=precision)
        self.mixed, self.student_t = self.approximate(self.fit)
        self.state = self.state._replace(excess=self._excess(self.state.x))

    def _move_h(self) -> None:
        """Move h given z and the tests, then z."""
        s, pooled = self.state, ~self.unpooled[:, self.mixed.free]
        x = s.x[..., : self.d]
        h, z, step = self.mixed.move_given_tests(
            *(s.h, s.z, x, pooled, self.choice, self.step_h, self.rng)
        )
        self.state = s._replace(h=h, z=z)
        if self.warming_up:
            self.step_h = step

    def run(
        self,
        r_hat: float,
        ess: float,
        limit: int,
        n_kept: int,
        report: Callable[[int, Convergence], None],
    ) -> PopulationDraws:
        """Sweep until targets or limit are reached; `n_kept` draws of each group are kept."""
        for step in range(1, (REFITS + 1) * WARM_UP + 1):
            self.sweep()
            if step % WARM_UP == 0 and step <= REFITS * WARM_UP:
                proposals = self.proposals[len(self.proposals) // 4 :]
                self.refit(*(np.concatenate(block) for block in zip(*proposals, strict=True)))
            if step % WARM_UP == 0:
                self.proposals = []
                self._learn_common()
        self.warming_up = False
        self.accepted.clear()
        self.accepted_together.clear()
        stride = max(1, self.state.x.size * limit // STORED)
        tabled = self.mixed.design.tabled
        shown = np.append(np.ones(self.mixed.dim, dtype=bool), tabled)
        tail_share = np.where(shown, 1.0, TAIL_SHARE)
        h: list[Array] = []
        z: list[Array] = []
        x: list[NDArray[np.float32]] = []
        look = FIRST
        while True:
            while len(h) < look:
                self.sweep()
                h.append(self.state.h)
                z.append(self.state.z)
                if (len(h) - 1) % stride == 0:
                    x.append(np.asarray(self.state.x, dtype=np.float32))
            # of the coordinates of h, the levels and the slopes, across groups of chains
            columns = np.concatenate([np.array(h), np.array(z)[..., : tabled.size]], axis=2)
            grouped = columns.reshape(len(h), CHAINS, columns.shape[1] // CHAINS, -1)
            convergence = measure(np.swapaxes(grouped, 0, 1), tail_share)
            report(len(h), convergence)
            if convergence.reached(r_hat, ess) or len(h) >= limit:
                break
            share = max(convergence.share(r_hat, ess), 1e-9)
            look = min(limit, math.ceil(len(h) * np.clip(1.1 / share, *LOOK)))
        n_states = max(1, min(len(x), n_kept // (len(self.choice) // CHAINS)))
        steps = np.linspace(0, len(x) - 1, n_states).astype(int)

        def by_chain(states: Sequence[NDArray[Any]]) -> Array:
            stacked = np.stack(states, axis=1).astype(np.float64)
            return stacked.reshape(CHAINS, -1, *stacked.shape[2:])

        accepted = float(np.mean(self.accepted)), float(np.mean(self.accepted_together))
        scatter, levels = ([values[t * stride] for t in steps] for values in (h, z))
        log_likelihood = [
            self.mixed.log_tests(*pair, self.choice) for pair in zip(scatter, levels, strict=True)
        ]
        return PopulationDraws(
            *(by_chain(scatter), by_chain(levels), by_chain([x[t] for t in steps])),
            by_chain(log_likelihood),
            *(convergence, len(h), accepted),
        )
