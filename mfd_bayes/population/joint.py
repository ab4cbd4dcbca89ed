"""Joint draws of the population and of every test, from the tests' whole likelihoods.

Chains in parallel begin with a Gaussian in place of every test's likelihood, which is quick, and
go on with the likelihoods themselves. A sweep

1.  updates scatter, effects' sd and shapes given the tests' coordinates, with levels and
    effects integrated out: differential evolution between chains, block by block;
2.  draws levels and effects from their Gaussian;
3.  updates every test's coordinates given the population: one of some of its stored draws or
    where it is, by importance, then proposals of a Gaussian close to the conditional
    (Crank-Nicolson steps around it) and of differential evolution, with the likelihood computed;
4.  moves scatter and level of one quantity and its tests' coordinates together (`lines`): where
    these are not informed they would hold each other.

Every step leaves the joint posterior as it is.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.jobs.likelihoods import Evaluate
from mfd_bayes.population.laws import draw_shape
from mfd_bayes.population.layout import Choice, Layout
from mfd_bayes.population.lines import FAR, Tuning, redraw, transport, untuned
from mfd_bayes.population.test_likelihood import TestLikelihood

Array = NDArray[np.float64]

TRIES = 30
"""Stored draws of each test that every chain tries in a sweep."""

NEAR = 2
"""Proposals from near the conditional in a sweep, for every test."""

STEPS = (1.0, 1.0, 0.8, 0.6)
"""Crank-Nicolson steps of these; 1 is independent of where a test is."""

TOGETHER = 2
"""Moves of scatter and level with the tests in a sweep."""

EVOLVED = 0.25
"""Share of sweeps in which a test is also moved by differential evolution."""

BLUNT = 0.1
"""Share of redraws that has to be accepted, or transport takes their place."""

EVOLUTIONS = 4
"""Updates of scatter and shapes in a sweep."""


Index = NDArray[np.intp]


@dataclass
class Chains:
    """State of n chains; `ensemble` (n,) tells which of them know of each other."""

    h: Array
    latent: Array
    x: list[Array]
    log_likelihood: list[Array]
    choice: Choice
    ensemble: Index


@dataclass(frozen=True, eq=False)
class _Proposal:
    """Where some chains of test j might go, with log N(x) − log N(there) and log chance."""

    j: int
    which: Index
    x: Array
    correction: Array | float
    chance: Array


class At(Protocol):
    """Some points of a test."""

    @property
    def j(self) -> int:
        """Number of the test."""

    @property
    def x(self) -> Array:
        """The points, (…, D)."""


T = TypeVar("T", bound=At)


class Joint:
    """The joint density of a population and its tests, and the sweeps that sample it.

    Likelihoods are computed by `evaluate`, one test's after the other's where it is not given.
    """

    def __init__(
        self,
        layout: Layout,
        tests: Sequence[TestLikelihood],
        rng: np.random.Generator,
        evaluate: Evaluate | None = None,
    ) -> None:
        self.layout, self.tests, self.rng = layout, tests, rng
        self.evaluate = evaluate or self._in_turn
        self.d = len(layout.names)
        self.design = layout.design()  # (J, m)
        self.gram = self.design.T @ self.design
        self.precisions = [np.linalg.inv(test.covariance) for test in tests]
        self.roots = [np.linalg.cholesky(precision) for precision in self.precisions]
        self.accepted: dict[str, list[float]] = {}
        self.blunt = np.full(self.d, all(test.gaussian for test in tests))
        self._stored: list[Array] = []
        self.tune(untuned(layout, tests))

    def begin(self, n: int, choice: Choice, ensembles: int) -> Chains:
        """Chains whose scatter is about half of its prior's scale, tests by their Gaussians."""
        layout, rng = self.layout, self.rng
        sd = layout.sd_scale
        spread = np.log(0.5 * sd) + 0.5 * rng.standard_normal((n, len(sd)))
        shapes = [draw_shape(shape, rng.random(n)) for _, shape in layout.shapes]
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
        means = self.means(chains.h, chains.latent, chains.choice)
        tau = self.layout.scatter(chains.h)
        self._try_stored(chains, means, tau)
        for _ in range(NEAR):
            self._step_near(chains, means, tau)
        self._evolve_tests(chains, means, tau)
        for _ in range(TOGETHER):
            self._move_together(chains)

    def _in_turn(self, points: Iterable[tuple[int, Array]]) -> Iterator[Array]:
        for j, x in points:
            yield self.tests[j].log_likelihood(x)

    def with_likelihoods(self, asked: Iterable[T]) -> Iterator[tuple[T, Array]]:
        """Each of what is asked, in its order, with the log likelihoods of its points, (…,)."""
        waiting: deque[T] = deque()

        def points() -> Iterator[tuple[int, Array]]:
            for one in asked:
                waiting.append(one)
                yield one.j, one.x.reshape(-1, one.x.shape[-1])

        for density in self.evaluate(points()):
            one = waiting.popleft()
            yield one, density.reshape(one.x.shape[:-1])

    def tune(self, tuning: Tuning) -> None:
        """Aim the moves of scatter and level; not while chains are kept."""
        self.tuning = tuning
        self.weights = tuning.missing / tuning.missing.sum()

    def settle(self) -> None:
        """Choose between the two such moves by what was accepted; not while chains are kept."""
        for k, name in enumerate(self.layout.names):
            shares = self.accepted.get(f"redraw {name}", [1.0])
            self.blunt[k] |= bool(np.mean(shares) < BLUNT)

    def products(self, chains: Chains) -> Array:
        """Of the tests' places in the scatter, standardised, summed over the tests, (n, d, d)."""
        means = self.means(chains.h, chains.latent, chains.choice)
        tau = self.layout.scatter(chains.h)[:, None]
        places: Array = (self._pooled(chains) - means) / tau
        return np.asarray(np.swapaxes(places, 1, 2) @ places)

    # hyperparameters

    def _terms(self, h: Array, choice: Choice, x: Array) -> tuple[Array, Array, Array, Array]:
        """Log density by quantity (n, d) with the latent integrated out, and its parts.

        x (n, J, d) are the tests' coordinates. Parts: root sd of the latent (n, d, m),
        Cholesky factors (n, d, m, m), and factor⁻¹ b (n, d, m).
        """
        tau2 = self.layout.scatter(h) ** 2  # (n, d)
        r = x - self.layout.offsets(h, choice)
        sd = np.concatenate([np.ones((len(h), 1, self.d)), self.layout.effect_sd(h)], axis=1)
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
        density = self.layout.log_prior(h)
        inside = np.all(np.abs(h) < FAR, axis=1)
        terms = self._terms(np.clip(h, -FAR, FAR), choice, x)[0]
        for g in range(density.shape[1]):
            density[:, g] += terms[:, self.layout.member == g].sum(axis=1)
        density[~inside] = -np.inf
        return density

    def _evolve_hyper(self, chains: Chains) -> None:
        block = self.layout.block
        x = self._pooled(chains)
        sizes = np.bincount(block, minlength=len(self.layout.groups))
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

    def _try_stored(self, chains: Chains, means: Array, tau: Array) -> None:
        """One of some stored draws, or where a test is, by importance: likelihoods cancel."""
        for j, test in enumerate(self.tests):
            if test.gaussian:  # what is near its conditional will be that itself
                continue
            n, x = len(tau), chains.x[j]
            picks = self.rng.integers(len(test.draws), size=(TRIES, n))
            tried = test.draws[picks, : self.d]  # (TRIES, n, d)
            standard = (tried - means[:, j]) / tau
            there = -0.5 * np.einsum("tnk,tnk->tn", standard, standard)
            there -= test.draws_log_prior[picks]
            standard = (x[:, : self.d] - means[:, j]) / tau
            here = -0.5 * np.einsum("nk,nk->n", standard, standard)
            here -= test.log_interim_prior(x[:, : self.d])
            weights = np.concatenate([here[None], there]) + self.rng.gumbel(size=(TRIES + 1, n))
            taken = np.argmax(weights, axis=0)  # one of all, in proportion to exp of their weights
            moved = taken > 0
            latest = picks[taken[moved] - 1, np.flatnonzero(moved)]
            x[moved] = test.draws[latest]
            chains.log_likelihood[j][moved] = self._stored_likelihood(j)[latest]
            self._note(f"stored {j}", moved)

    def _stored_likelihood(self, j: int) -> Array:
        if not self._stored:
            draws = ((i, test.draws.astype(np.float64)) for i, test in enumerate(self.tests))
            self._stored = list(self.evaluate(draws))
        return self._stored[j]

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

    def _step_near(self, chains: Chains, means: Array, tau: Array) -> None:
        everyone = np.arange(len(tau))

        def propose() -> Iterator[_Proposal]:
            for j, test in enumerate(self.tests):
                steps = (1.0,) if test.gaussian else STEPS
                beta = self.rng.choice(steps, size=len(tau))
                x, correction = self._near(j, means[:, j], tau, beta, chains.x[j])
                yield _Proposal(j, everyone, x, correction, np.log(self.rng.random(len(tau))))

        self._accept(chains, propose(), means, tau, "near")

    def _evolve_tests(self, chains: Chains, means: Array, tau: Array) -> None:
        share = self.rng.random(len(self.tests))
        chosen = [j for j, t in enumerate(self.tests) if not t.gaussian and share[j] < EVOLVED]
        for half, first, second in self._partners(chains):

            def propose(
                half: Index = half, first: Index = first, second: Index = second
            ) -> Iterator[_Proposal]:
                for j in chosen:
                    x = chains.x[j]
                    shorter = self.rng.choice([1.0, 0.4], size=(len(half), 1))
                    jump = 2.38 / np.sqrt(2 * x.shape[1]) * shorter * (x[first] - x[second])
                    there = x[half] + jump + 1e-4 * self.rng.standard_normal(jump.shape)
                    yield _Proposal(j, half, there, 0.0, np.log(self.rng.random(len(half))))

            self._accept(chains, propose(), means, tau, "evolution")

    def _accept(
        self,
        chains: Chains,
        proposals: Iterable[_Proposal],
        means: Array,
        tau: Array,
        name: str,
    ) -> None:
        """Take proposals of different tests, or not, in place."""
        for proposal, density in self.with_likelihoods(proposals):
            j, which = proposal.j, proposal.which
            given = means[which, j], tau[which]
            prior = self._log_population(j, proposal.x, *given)
            prior -= self._log_population(j, chains.x[j][which], *given)
            chance = proposal.chance - prior - proposal.correction
            chance += chains.log_likelihood[j][which]
            yes = np.isfinite(prior) & (chance < density)
            chains.x[j][which[yes]] = proposal.x[yes]
            chains.log_likelihood[j][which[yes]] = density[yes]
            self._note(f"{name} {j}", yes)

    def _move_together(self, chains: Chains) -> None:
        """Scatter and level of one quantity, with its tests' values of it."""
        k = int(self.rng.choice(self.d, p=self.weights))
        move, name = (transport, "transport") if self.blunt[k] else (redraw, "redraw")
        self._note(f"{name} {self.layout.names[k]}", move(self, chains, k))

    def means(self, h: Array, latent: Array, choice: Choice) -> Array:
        """Tests' coordinates but for their scatter, (n, J, d)."""
        means = self.layout.offsets(h, choice) + self.design @ latent
        return np.asarray(means)

    def _pooled(self, chains: Chains) -> Array:
        """Tests' pooled coordinates, (n, J, d)."""
        return np.stack([x[:, : self.d] for x in chains.x], axis=1)

    def _partners(self, chains: Chains) -> list[tuple[Index, Index, Index]]:
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
