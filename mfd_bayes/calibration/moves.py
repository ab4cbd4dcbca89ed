"""emcee's moves, applied to several independent ensembles in lock-step."""

from __future__ import annotations

import emcee
import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.mixture import Proposal

Array = NDArray[np.float64]


class Apart(emcee.moves.Move):  # type: ignore[misc]  # emcee is not typed
    """An emcee move applied within each of several independent ensembles.

    The walkers of a sampler form `ensembles` blocks. Each block is split at random in two
    halves, and each half is proposed from the other half of its own block alone, as emcee's
    red–blue moves do. Only the density is evaluated for all blocks in one batch.
    """

    def __init__(self, move: emcee.moves.RedBlueMove, ensembles: int) -> None:
        self.move = move
        self.ensembles = ensembles

    def propose(
        self, model: emcee.model.Model, state: emcee.State
    ) -> tuple[emcee.State, NDArray[np.bool_]]:
        """New state, and which walkers moved, (ensembles · walkers,)."""
        self.move.setup(state.coords)
        total = len(state.coords)
        walkers = total // self.ensembles
        order = np.argsort(model.random.rand(self.ensembles, walkers), axis=1)
        order += walkers * np.arange(self.ensembles)[:, None]
        halves = order[:, : walkers // 2], order[:, walkers // 2 :]
        accepted = np.zeros(total, dtype=bool)
        for moving, still in (halves, halves[::-1]):
            proposals, factors = zip(
                *(
                    self.move.get_proposal(state.coords[m], [state.coords[s]], model.random)
                    for m, s in zip(moving, still, strict=True)
                ),
                strict=True,
            )
            proposal = np.concatenate(proposals)
            log_prob, _ = model.compute_log_prob_fn(proposal)
            index = moving.reshape(-1)
            gain = np.concatenate(factors) + log_prob - state.log_prob[index]
            taken = np.log(model.random.rand(index.size)) < gain
            moved = index[taken]
            state.coords[moved] = proposal[taken]
            state.log_prob[moved] = np.asarray(log_prob)[taken]
            accepted[moved] = True
        return state, accepted


class Independent(emcee.moves.Move):  # type: ignore[misc]  # emcee is not typed
    """Metropolis–Hastings with proposals that do not depend on a walker's position.

    Walkers are independent here, so that all move in one batch. The target stays invariant
    as long as the proposal is unchanged; draws from which it was learned must be discarded.
    """

    def __init__(self, proposal: Proposal) -> None:
        self.source = proposal
        self.forget()

    def forget(self) -> None:
        """Reset the acceptance rate."""
        self._proposed = self._accepted = 0

    @property
    def acceptance(self) -> float:
        """Acceptance rate since the last `forget`."""
        return self._accepted / max(self._proposed, 1)

    def propose(
        self, model: emcee.model.Model, state: emcee.State
    ) -> tuple[emcee.State, NDArray[np.bool_]]:
        """New state, and which walkers moved, (walkers,)."""
        proposal = self.source.draw(model.random, len(state.coords))
        log_prob, _ = model.compute_log_prob_fn(proposal)
        gain = np.asarray(log_prob) - state.log_prob
        gain += self.source.log_density(state.coords) - self.source.log_density(proposal)
        moved = np.log(model.random.rand(gain.size)) < gain
        state.coords[moved] = proposal[moved]
        state.log_prob[moved] = np.asarray(log_prob)[moved]
        self._proposed += moved.size
        self._accepted += int(moved.sum())
        return state, moved


def evolution(dim: int, ensembles: int, weight: float) -> list[tuple[emcee.moves.Move, float]]:
    """Differential evolution moves within each ensemble, with their weights.

    One step in five moves by the full difference of two walkers, so that it can jump between
    modes.

    emcee 3.1.6's DESnookerMove does not sample the target and is not used.
    """
    usual = 2.38 / np.sqrt(2 * dim)
    return [
        (Apart(emcee.moves.DEMove(sigma=1e-3, gamma0=usual), ensembles), 0.8 * weight),
        (Apart(emcee.moves.DEMove(sigma=1e-3, gamma0=1.0), ensembles), 0.2 * weight),
    ]
