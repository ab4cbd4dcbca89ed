"""Draws of a density by several ensembles, and what is watched while they are made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.jobs.job import Progress

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Chains:
    """Draws of a density; each ensemble is a chain.

    Attributes
    ----------
    q : (chain, draw, dim)
        A chain's draws are ordered by walker and, within a walker, by step, so that the
        autocorrelation of a chain is that of its walkers.
    log_prob : (chain, draw)
    walkers : int
    steps, thin, discarded : int
        Steps of each ensemble; the interval of steps between kept draws; steps of the warm-up,
        in which the proposal was learned and no draw is kept.
    acceptance : (chain,)
    autocorrelation : (dim,)
        Integrated autocorrelation time, steps.
    convergence : Convergence
        Of the coordinates, the log density and the derived quantities, in this order.
    """

    q: Array
    log_prob: Array
    walkers: int
    steps: int
    thin: int
    discarded: int
    acceptance: Array
    autocorrelation: Array
    convergence: Convergence


@dataclass(frozen=True)
class Watch:
    """What is computed and reported while sampling.

    Attributes
    ----------
    derived : callable, optional
        Other quantities that must converge too, (n, dim) -> (n, m).
    report : callable, optional
        Called with a `Progress` each time the convergence is measured.
    """

    derived: Callable[[Array], Array] | None = None
    report: Callable[[Progress], None] | None = None
