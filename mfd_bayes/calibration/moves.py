"""emcee's moves, applied to several independent ensembles in lock-step."""

from __future__ import annotations

import emcee
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Apart(emcee.moves.Move):  # type: ignore[misc]  # emcee is not typed
    """A move of emcee's within each of several ensembles that know nothing of each other.

    The walkers of a sampler are taken as `ensembles` blocks. Each block is split at random
    in two halves, and each half is proposed from the other half of its own block alone, as
    emcee's red–blue moves do; only the evaluation of the density is shared, one batch for
    all blocks.

    Parameters
    ----------
    move : emcee.moves.RedBlueMove
    ensembles : int
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
