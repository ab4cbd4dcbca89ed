"""Joint draws of the population and of every test, from the tests' whole likelihoods.

Chains in parallel begin with a Gaussian in place of every test's likelihood, which is quick, and
go on with the likelihoods themselves. A sweep

1.  updates scatter, effects' sd and shapes given the tests' coordinates, with levels and
    effects integrated out: differential evolution between chains, block by block;
2.  draws levels and effects from their Gaussian;
3.  updates every test's coordinates given the population: independence proposals from its
    stored draws, which carry their likelihood, then one of a Gaussian close to the conditional
    (a Crank-Nicolson step around it) or of differential evolution, with the likelihood computed;
4.  moves scatter and level of one quantity and its tests' coordinates together: where these are
    not informed they would hold each other.

Every step leaves the joint posterior as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.evidence import Evidence
from mfd_bayes.population.laws import draw_shape
from mfd_bayes.population.pooling import Choice, Pooling

Array = NDArray[np.float64]

TRIES = 30
"""Stored draws of each test that every chain tries in a sweep."""

LOOSE = 0.005
"""Least weight of a quantity among those that are moved with their tests."""

TOGETHER = 2
"""Such moves in a sweep."""

EVOLUTIONS = 4
"""Updates of scatter and shapes in a sweep."""

HOPELESS = 40.0
"""Change of the log density, after some of the tests, at which such a move is given up."""

FAR = 15.0
"""Hyperparameters are not further than this from 0: scatter of e⁻¹⁹ is beyond double precision."""


@dataclass
class Chains:
    """State of n chains; `ensemble` (n,) tells which of them know of each other."""

    h: Array
    latent: Array
    x: list[Array]
    log_likelihood: list[Array]
    choice: Choice
    ensemble: NDArray[np.intp]


class Joint:
    """The joint density of a population and its tests, and the sweeps that sample it."""

    def __init__(
        self, pooling: Pooling, tests: Sequence[Evidence], rng: np.random.Generator
    ) -> None:
        self.pooling, self.tests, self.rng = pooling, tests, rng
        self.d = len(pooling.names)
        self.design = pooling.design()  # (J, m)
        self.gram = self.design.T @ self.design
        self.precisions = [np.linalg.inv(test.covariance) for test in tests]
        self.roots = [np.linalg.cholesky(precision) for precision in self.precisions]
        self.accepted: dict[str, list[float]] = {}
        self.loose = np.full(self.d, 1.0 / self.d)

    def begin(self, n: int, choice: Choice, ensembles: int) -> Chains:
        """Chains whose scatter is about half of its prior's scale, tests by their Gaussians."""
        pooling, rng = self.pooling, self.rng
        sd = pooling.sd_scale
        spread = np.log(0.5 * sd) + 0.5 * rng.standard_normal((n, len(sd)))
        shapes = [draw_shape(shape, rng.random(n)) for _, shape in pooling.shapes]
        h = np.concatenate([spread, np.reshape(shapes, (-1, n)).T], axis=1)
        latent = np.zeros((n, self.design.shape[1], self.d))
        ensemble = np.repeat(np.arange(ensembles), n // ensembles)
        chains = Chains(h, latent, [], [], choice, ensemble)
        tau = np.ones((n, self.d))
        for j, test in enumerate(self.tests):
            chains.x.append(self._near(j, np.zeros((n, self.d)), tau, np.ones(n), None)[0])
            chains.log_likelihood.append(test.log_likelihood(chains.x[j]))
        self._draw_latent(chains)
        return chains

    def resume(self, chains: Chains) -> None:
        """Take chains over from another density of the same layout, in place."""
        for j, test in enumerate(self.tests):
            density = test.log_likelihood(chains.x[j])
            lost = ~np.isfinite(density)
            if np.any(lost):  # the Gaussian reaches where the test has no density
                picks = self.rng.integers(len(test.draws), size=int(lost.sum()))
                chains.x[j][lost] = test.draws[picks]
                density[lost] = test.log_likelihood(chains.x[j][lost])
            chains.log_likelihood[j] = density

    def sweep(self, chains: Chains) -> None:
        """One sweep over everything, in place."""
        for _ in range(EVOLUTIONS):
            self._evolve_hyper(chains)
        self._draw_latent(chains)
        means, tau = (
            self._means(chains.h, chains.latent, chains.choice),
            self.pooling.scatter(chains.h),
        )
        for j in range(len(self.tests)):
            if not self.tests[j].gaussian:
                self._try_stored(chains, j, means[:, j], tau)
            if self.rng.random() < 0.6:
                self._step_near(chains, j, means[:, j], tau)
            else:
                self._evolve_test(chains, j, means[:, j], tau)
        for _ in range(TOGETHER):
            self._move_together(chains)

    def looseness(self) -> Array:
        """How often each quantity is to be moved with its tests, by how often that was accepted."""
        names = self.pooling.names
        shares = [np.mean(self.accepted.get(f"together {name}", [0.0])) for name in names]
        weights = np.maximum(np.array(shares), LOOSE)
        return np.asarray(weights / weights.sum())

    def products(self, chains: Chains) -> Array:
        """Of the tests' places in the scatter, standardised, summed over the tests, (n, d, d)."""
        means = self._means(chains.h, chains.latent, chains.choice)
        tau = self.pooling.scatter(chains.h)[:, None]
        places: Array = (self._pooled(chains) - means) / tau
        return np.asarray(np.swapaxes(places, 1, 2) @ places)

    # hyperparameters

    def _terms(self, h: Array, choice: Choice, x: Array) -> tuple[Array, Array, Array, Array]:
        """Log density by quantity (n, d) with the latent integrated out, and its parts.

        x (n, J, d) are the tests' coordinates. Parts: root sd of the latent (n, d, m),
        Cholesky factors (n, d, m, m), and factor⁻¹ b (n, d, m).
        """
        tau2 = self.pooling.scatter(h) ** 2  # (n, d)
        r = x - self.pooling.offsets(h, choice)
        sd = np.concatenate([np.ones((len(h), 1, self.d)), self.pooling.effect_sd(h)], axis=1)
        root = np.swapaxes(sd, 1, 2)  # (n, d, m)
        a = root[..., :, None] * self.gram * root[..., None, :] / tau2[..., None, None]
        m = self.design.shape[1]
        a[..., range(m), range(m)] += 1.0
        b = (np.swapaxes(r, 1, 2) @ self.design) * root / tau2[..., None]
        factor = np.linalg.cholesky(a)
        solved = np.linalg.solve(factor, b[..., None])[..., 0]
        log_det = 2.0 * np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(axis=-1)
        squares = np.einsum("njk,njk->nk", r, r) / tau2 - np.einsum("nkm,nkm->nk", solved, solved)
        terms = -0.5 * (len(self.tests) * np.log(tau2) + log_det + squares)
        return terms, root, factor, solved

    def _blocks(self, h: Array, choice: Choice, x: Array) -> Array:
        """Log density of each block of h given the tests, (n, G)."""
        density = self.pooling.log_prior(h)
        inside = np.all(np.abs(h) < FAR, axis=1)
        terms = self._terms(np.clip(h, -FAR, FAR), choice, x)[0]
        for g in range(density.shape[1]):
            density[:, g] += terms[:, self.pooling.member == g].sum(axis=1)
        density[~inside] = -np.inf
        return density

    def _evolve_hyper(self, chains: Chains) -> None:
        block = self.pooling.block
        x = self._pooled(chains)
        sizes = np.bincount(block, minlength=len(self.pooling.groups))
        for half, first, second in self._partners(chains):
            h = chains.h[half]
            scale = (2.38 / np.sqrt(2 * sizes))[block]
            scale = np.where(self.rng.random((len(half), 1)) < 0.2, 1.0, scale)
            jump = scale * (chains.h[first] - chains.h[second])
            proposed = h + jump + 1e-3 * self.rng.standard_normal(h.shape)
            given = chains.choice[half], x[half]
            old, new = self._blocks(h, *given), self._blocks(proposed, *given)
            yes = np.log(self.rng.random(old.shape)) < new - old  # (n, G)
            chains.h[half] = np.where(yes[:, block], proposed, h)
            self._note("scatter and shapes", yes)

    def _draw_latent(self, chains: Chains) -> None:
        x = self._pooled(chains)
        _, root, factor, solved = self._terms(chains.h, chains.choice, x)
        swing = solved + self.rng.standard_normal(solved.shape)
        raised = np.linalg.solve(np.swapaxes(factor, -1, -2), swing[..., None])[..., 0]
        chains.latent = np.swapaxes(root * raised, 1, 2)

    # tests

    def _log_population(self, j: int, x: Array, mean: Array, tau: Array) -> Array:
        """Log density of a test's coordinates given the population, (n,)."""
        standard = (x[:, : self.d] - mean) / tau
        density = -0.5 * np.einsum("nk,nk->n", standard, standard) - np.log(tau).sum(axis=1)
        own: Array = density + self.tests[j].log_own_prior(x[:, self.d :])
        return own

    def _try_stored(self, chains: Chains, j: int, mean: Array, tau: Array) -> None:
        """Independence proposals from the stored draws: their likelihood cancels."""
        test = self.tests[j]
        n, moved = len(mean), np.zeros(len(mean), dtype=bool)
        picks = self.rng.integers(len(test.draws), size=(TRIES, n))
        tried = test.draws[picks, : self.d]  # (TRIES, n, d)
        standard = (tried - mean) / tau
        ratio = -0.5 * np.einsum("tnk,tnk->tn", standard, standard) - test.draws_log_prior[picks]
        standard = (chains.x[j][:, : self.d] - mean) / tau
        here = -0.5 * np.einsum("nk,nk->n", standard, standard)
        here -= test.log_interim_prior(chains.x[j][:, : self.d])
        latest = np.full(n, -1)
        for t, chance in enumerate(np.log(self.rng.random((TRIES, n)))):
            yes = chance < ratio[t] - here
            here = np.where(yes, ratio[t], here)
            latest = np.where(yes, picks[t], latest)
            moved |= yes
        if np.any(moved):
            chains.x[j][moved] = test.draws[latest[moved]]
            chains.log_likelihood[j][moved] = test.log_likelihood(chains.x[j][moved])
        self._note(f"stored {j}", moved)

    def _near(
        self, j: int, mean: Array, tau: Array, beta: Array, x: Array | None
    ) -> tuple[Array, Array]:
        """Crank-Nicolson steps about the Gaussian near the conditional, and its log density.

        Returns proposals (n, D) and log N(x) − log N(proposal) (n,); without x, plain draws.
        """
        test, size = self.tests[j], len(self.tests[j].mean)
        known = self.precisions[j]
        about = np.ones((len(mean), size))
        about[:, : self.d] = 1.0 / tau**2
        precision = np.repeat(known[None], len(mean), axis=0)
        precision[:, range(size), range(size)] += about
        pull = np.repeat((known @ test.mean)[None], len(mean), axis=0)
        pull[:, : self.d] += about[:, : self.d] * mean
        swing = self.rng.standard_normal(pull.shape) @ self.roots[j].T
        swing += np.sqrt(about) * self.rng.standard_normal(pull.shape)  # of covariance `precision`
        solved = np.linalg.solve(precision, np.stack([pull, swing], axis=2))
        centre, noise = solved[..., 0], solved[..., 1]
        if x is None:
            return centre + noise, np.zeros(len(mean))
        away = x - centre
        moved = np.sqrt(1.0 - beta**2)[:, None] * away + beta[:, None] * noise
        old = np.sum((away @ known + about * away) * away, axis=1)
        new = np.sum((moved @ known + about * moved) * moved, axis=1)
        return centre + moved, 0.5 * (new - old)

    def _step_near(self, chains: Chains, j: int, mean: Array, tau: Array) -> None:
        beta = self.rng.choice([1.0, 0.5, 0.2], size=len(mean))
        proposed, correction = self._near(j, mean, tau, beta, chains.x[j])
        everyone = np.arange(len(mean))
        self._accept(chains, j, everyone, proposed, mean, tau, correction, "near")

    def _evolve_test(self, chains: Chains, j: int, mean: Array, tau: Array) -> None:
        size = chains.x[j].shape[1]
        for half, first, second in self._partners(chains):
            gamma = 2.38 / np.sqrt(2 * size) * self.rng.choice([1.0, 0.4], size=(len(half), 1))
            jump = gamma * (chains.x[j][first] - chains.x[j][second])
            proposed = chains.x[j][half] + jump
            proposed += 1e-4 * self.rng.standard_normal(proposed.shape)
            self._accept(chains, j, half, proposed, mean[half], tau[half], 0.0, "evolution")

    def _accept(
        self,
        chains: Chains,
        j: int,
        which: NDArray[np.intp],
        proposed: Array,
        mean: Array,
        tau: Array,
        correction: Array | float,
        name: str,
    ) -> None:
        x = chains.x[j][which]
        prior = self._log_population(j, proposed, mean, tau)
        prior -= self._log_population(j, x, mean, tau)
        chance = np.log(self.rng.random(len(which))) - prior - correction
        chance += chains.log_likelihood[j][which]
        density = np.full(len(which), -np.inf)
        asked = np.isfinite(prior)
        if np.any(asked):
            density[asked] = self.tests[j].log_likelihood(proposed[asked])
        yes = asked & (chance < density)
        chains.x[j][which[yes]] = proposed[yes]
        chains.log_likelihood[j][which[yes]] = density[yes]
        self._note(f"{name} {j}", yes)

    def _move_together(self, chains: Chains) -> None:
        """Scatter and level of one quantity, with its tests' places among them kept."""
        pooling, n = self.pooling, len(chains.h)
        k = int(self.rng.choice(self.d, p=self.loose))
        size = self.rng.choice([3.0, 1.0, 0.3], size=n)
        h, latent = chains.h.copy(), chains.latent.copy()
        what = self.rng.integers(3, size=n)  # the level, the scatter, or both
        h[:, k] += (what != 0) * 0.5 * size * self.rng.standard_normal(n)
        latent[:, 0, k] += (what != 1) * 0.3 * size * self.rng.standard_normal(n)
        old_tau, new_tau = pooling.scatter(chains.h), pooling.scatter(h)
        old = self._means(chains.h, chains.latent, chains.choice)
        new = self._means(h, latent, chains.choice)
        prior = (pooling.log_prior(h) - pooling.log_prior(chains.h)).sum(axis=1)
        prior += 0.5 * (chains.latent[:, 0, k] ** 2 - latent[:, 0, k] ** 2)
        xs, densities = [], []
        ratio, alive = prior, np.ones(n, dtype=bool)
        for j, test in enumerate(self.tests):
            x = chains.x[j].copy()
            place = (x[:, k] - old[:, j, k]) / old_tau[:, k]
            x[:, k] = new[:, j, k] + new_tau[:, k] * place
            density = np.full(n, -np.inf)
            if np.any(alive):
                density[alive] = test.log_likelihood(x[alive])
            ratio = ratio + density - chains.log_likelihood[j]
            # No move may lose this much on the way, for hardly one could make up for it; nor gain
            # it, so that the way back is as open as the way there.
            alive &= np.abs(ratio) < HOPELESS
            xs.append(x)
            densities.append(density)
        yes = alive & (np.log(self.rng.random(n)) < ratio)
        chains.h[yes], chains.latent[yes] = h[yes], latent[yes]
        for j in range(len(self.tests)):
            chains.x[j][yes] = xs[j][yes]
            chains.log_likelihood[j][yes] = densities[j][yes]
        self._note(f"together {pooling.names[k]}", yes)

    def _means(self, h: Array, latent: Array, choice: Choice) -> Array:
        """Tests' coordinates but for their scatter, (n, J, d)."""
        means = self.pooling.offsets(h, choice) + self.design @ latent
        return np.asarray(means)

    def _pooled(self, chains: Chains) -> Array:
        """Tests' pooled coordinates, (n, J, d)."""
        return np.stack([x[:, : self.d] for x in chains.x], axis=1)

    def _partners(
        self, chains: Chains
    ) -> list[tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]]:
        """Halves of the chains, and two different partners of each in its ensemble's other half."""
        found = []
        order = self.rng.permutation(len(chains.h))
        order = order[np.argsort(chains.ensemble[order], kind="stable")]
        by_ensemble = order.reshape(chains.ensemble[-1] + 1, -1)
        middle = by_ensemble.shape[1] // 2
        for own, other in (
            (by_ensemble[:, :middle], by_ensemble[:, middle:]),
            (by_ensemble[:, middle:], by_ensemble[:, :middle]),
        ):
            first = self.rng.integers(other.shape[1], size=own.shape)
            second = (first + self.rng.integers(1, other.shape[1], size=own.shape)) % other.shape[1]
            rows = np.arange(len(other))[:, None]
            found.append((own.ravel(), other[rows, first].ravel(), other[rows, second].ravel()))
        return found

    def _note(self, name: str, yes: Array | NDArray[np.bool_]) -> None:
        self.accepted.setdefault(name, []).append(float(np.mean(yes)))
