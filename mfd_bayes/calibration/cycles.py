"""Log likelihood of each cycle of a record, given all others."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.errors import FitError
from mfd_bayes.records.trace import Trace

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

FEWEST_CYCLES = 3  # least number of cycles of a record from which one can be left out
_PIECE = 1 << 19  # size of the arrays of one piece, in numbers


def find_cycles(trace: Trace, start: int = 0) -> NDArray[np.intp]:
    """First sample of each cycle of a record, and the end of the record, (C + 1,).

    A cycle ends at every second turn of the whole motion, as in a harmonic record. In an irregular
    record small loops are joined until they last half the mean period 2π sd(x)/sd(v): a shorter
    block would be predicted too easily from its neighbours. A short rest at the end joins the last
    cycle. The cycles follow from the motion alone: they are the same for every model. Samples
    before `start` are in no cycle.
    """
    time = trace.time
    shortest = np.pi * trace.displacement[start:].std() / trace.velocity[start:].std()
    edges, turns = [start], 0
    for turn in trace.cycle_turns[trace.cycle_turns > start].tolist():
        turns += 1
        if turns >= 2 and time[turn] - time[edges[-1]] >= shortest:
            edges.append(turn)
            turns = 0
    if len(edges) > 1 and time[-1] - time[edges[-1]] < shortest:
        edges.pop()
    if len(edges) < FEWEST_CYCLES:
        raise FitError(
            f"leaving out one cycle needs a record with at least {FEWEST_CYCLES} cycles, "
            f"got {len(edges)}"
        )
    return np.array([*edges, trace.samples], dtype=np.intp)


def cycle_log_likelihood(
    posterior: Posterior, values: Mapping[str, Array], cycles: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Log density of every cycle given all others, and of all together.

    log p(y_c | y_-c, θ), (n, C), and log p(y | θ), (n,), for draws of all quantities, (n,) each,
    and `cycles` from `find_cycles` with the posterior's `first`.
    """
    rows, size = slice(cycles[0], None), max(1, _PIECE // posterior.trace.samples)
    pieces = []
    for begin in range(0, values["offset"].size, size):
        batch = {name: column[begin : begin + size] for name, column in values.items()}
        residual = np.asarray(posterior.trace.force) - batch["offset"][:, None]
        residual -= posterior.force(batch)
        travel = posterior.travel(batch)
        decay, scale = posterior.noise.memory(
            posterior.trace.time[rows], batch, None if travel is None else travel[:, rows]
        )
        dof = batch["noise_dof"] if "noise_dof" in posterior.noise.parameters else None
        starts = cycles[:-1] - cycles[0]
        pieces.append(conditional_density(residual[:, rows], decay, scale, starts, dof))
    conditional, total = zip(*pieces, strict=True)
    return np.concatenate(conditional), np.concatenate(total)


def conditional_density(
    residual: Array, decay: Array, scale: Array, starts: NDArray[np.intp], dof: Array | None = None
) -> tuple[Array, Array]:
    """Log density of every block of a Markov chain given all others, (n, C), and of all, (n,).

    With a the first sample of a block and b the first sample after it,

        p(y_c | y_-c) = Π_{n=a}^{b} p(e_n | e_{n−1}) / p(e_b | e_{a−1}),

    where the last density bridges the gap: its φ is the product of all φ from a to b. That
    is exact for Gaussian noise. A sum of Student-t innovations has no closed form: there a
    Student-t with the same degrees of freedom `dof` (n,) and the sum's mean and variance is used.
    `residual` is (n, T), kip; `decay` and `scale` are from `Noise.memory`, (n, T); `starts` are
    the first samples of the blocks, (C,), beginning with 0.
    """
    standard = residual / scale
    previous = np.zeros_like(standard)
    previous[:, 1:] = standard[:, :-1]
    link = _transition(standard, previous, decay, dof)
    density = np.add.reduceat(link - np.log(scale), starts, axis=1)
    total = density.sum(axis=1)
    ends = starts[1:]
    hole = np.add.reduceat(decay, starts, axis=1)[:, :-1] + decay[:, ends]
    bridge = _transition(standard[:, ends], previous[:, starts[:-1]], hole, dof)
    density[:, :-1] += link[:, ends] - bridge
    return np.asarray(density), np.asarray(total)


def _transition(value: Array, previous: Array, decay: Array, dof: Array | None) -> Array:
    """Log density of standardised noise given its previous value, with φ = exp(−decay)."""
    shrink = -np.expm1(-2.0 * decay)
    squares = (value - np.exp(-decay) * previous) ** 2 / shrink
    if dof is None:
        return np.asarray(-0.5 * (squares + np.log(2 * np.pi * shrink)))
    nu = dof[:, None]
    peak = special.gammaln((nu + 1) / 2) - special.gammaln(nu / 2) - 0.5 * np.log(nu * np.pi)
    return np.asarray(peak - 0.5 * (nu + 1) * np.log1p(squares / nu) - 0.5 * np.log(shrink))


def density_groups(
    posterior: Posterior, values: Mapping[Any, Any], log_likelihood: Array
) -> dict[str, xr.Dataset]:
    """Groups `log_prior` and `log_likelihood` of ArviZ, of draws by name, (chain, draw) each.

    The log prior is that of each quantity's coordinate, the logarithm of most: there a prior that
    is raised to a power widens about its median. Of the log likelihood, `force` (chain, draw,
    cycle) is the log density of each cycle given all others, by which a cycle is left out.
    Neighbours are correlated, so that these do not sum to the joint log likelihood (chain, draw):
    `coupling` is what the sum lacks. A record of too few cycles has `all`, the joint one, in place
    of both.
    """
    import xarray as xr

    columns = {str(name): np.asarray(draws) for name, draws in values.items()}
    numbers = dict(zip(("chain", "draw"), map(np.arange, log_likelihood.shape), strict=True))
    priors = {
        name: (("chain", "draw"), prior.log_density(prior.coordinate(columns[name])))
        for name, prior in posterior.priors.items()
        if not prior.fixed and name in columns
    }
    terms: dict[str, Any] = {"all": (("chain", "draw"), log_likelihood)}
    with suppress(FitError):  # too few cycles to leave one out
        cycles = find_cycles(posterior.trace, posterior.first)
        flat = {name: draws.reshape(-1) for name, draws in columns.items()}
        conditional = cycle_log_likelihood(posterior, flat, cycles)[0]
        conditional = conditional.reshape(*log_likelihood.shape, -1)
        coupling = log_likelihood - conditional.sum(axis=2)
        terms = {
            "force": (("chain", "draw", "cycle"), conditional),
            "coupling": (("chain", "draw"), coupling),
        }
    return {
        "log_prior": xr.Dataset(priors, coords=numbers),
        "log_likelihood": xr.Dataset(terms, coords=numbers),
    }
