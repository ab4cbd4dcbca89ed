"""Draws of a density by several ensembles, and what is watched while they are made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import Convergence, measure
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
    watched : (ensemble, step, walker, m)
        Kept draws of all that must converge: coordinates, log density, derived quantities.
    """

    q: Array
    log_prob: Array
    walkers: int
    steps: int
    thin: int
    discarded: int
    acceptance: Array
    autocorrelation: Array
    watched: Array

    @property
    def slowest(self) -> float:
        """Largest autocorrelation time of a coordinate, steps."""
        return float(np.max(self.autocorrelation))

    @cached_property
    def convergence(self) -> Convergence:
        """Of all that is watched, in that order; to measure it takes as long as some ten steps."""
        return measure(self.watched)


@dataclass(frozen=True)
class Watch:
    """What is computed and reported while sampling.

    Attributes
    ----------
    derived : callable, optional
        Other quantities that must converge too, (n, dim) -> (n, m).
    report : callable, optional
        Called with a `Progress` after every block of steps.
    """

    derived: Callable[[Array], Array] | None = None
    report: Callable[[Progress], None] | None = None
