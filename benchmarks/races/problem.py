"""One posterior as every tool wants it: densities, a transform of the unit cube, a start."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
from scipy import special, stats

from benchmarks.sampling.reference import find_posterior
from mfd_bayes.calibration.diagnostics import measure
from mfd_bayes.calibration.modes import find_modes
from mfd_bayes.calibration.proposal import Adaptive, around_modes

ESS, R_HAT = 400.0, 1.01
"""When a person may stop waiting: of every coordinate."""


@dataclass
class Problem:
    """A posterior with what samplers need of it, counting its evaluations.

    Attributes
    ----------
    posterior : Posterior
    seconds : float
        Processor time after which a tool must stop.
    evaluations : int
        Vectors of which the density was computed so far.
    """

    posterior: object
    seconds: float
    evaluations: int = 0
    began: float = field(default_factory=time.process_time)
    paused: float = 0.0

    @property
    def dim(self):
        """Number of coordinates."""
        return self.posterior.dim

    @property
    def spent(self):
        """Processor time since the start, s, without what measuring took."""
        return time.process_time() - self.began - self.paused

    @property
    def late(self):
        """Whether the time is up."""
        return self.spent > self.seconds

    def log_prob(self, q):
        """Log density of points (n, dim), (n,)."""
        self.evaluations += len(q)
        return self.posterior.log_prob(q)

    def log_likelihood(self, q):
        """Log likelihood of points (n, dim), (n,); finite, since nested samplers want it so.

        Raises
        ------
        TimeoutError
            When the time is up: nested samplers have nothing to show before their end.
        """
        if self.late:
            raise TimeoutError(f"no end after {self.seconds:g} s")
        self.evaluations += len(q)
        return np.maximum(np.nan_to_num(self.posterior.log_likelihood(q), nan=-1e30), -1e30)

    def transform(self, u):
        """Points (n, dim) of the unit cube to the prior, whose coordinates are independent."""
        columns = [_quantile(p, c) for p, c in zip(self.priors, np.transpose(u), strict=True)]
        return self.posterior.from_own(np.stack(columns, axis=1))

    @property
    def priors(self):
        """Prior of each coordinate."""
        return [self.posterior.priors[name] for name in self.posterior.names]

    def around_mode(self, n, seed):
        """Points around the modes from which ours begins, (n, dim); they cost nothing."""
        before = self.spent
        modes = find_modes(self.posterior, np.random.default_rng(seed))
        rng = np.random.default_rng(seed)
        drawn = Adaptive(self.posterior.log_prob, around_modes(modes), rng, 4 * n).run()
        found = drawn.q[rng.choice(len(drawn.q), n, p=drawn.weights)]
        self.paused += self.spent - before
        return found

    def enough(self, chains):
        """Whether chains (ensemble, step, walker, dim) are what a person waits for."""
        if chains.shape[1] < 10 or np.any(np.ptp(chains, axis=(0, 1, 2)) == 0):
            return False
        before = self.spent
        found = measure(chains)
        self.paused += self.spent - before
        least = min(found.ess_bulk.min(), found.ess_tail.min())
        return bool(least >= ESS and found.worst_r_hat <= R_HAT)


def problem_of(name, folder, seconds):
    """The posterior of a record of `benchmarks.sampling.reference`."""
    posterior = find_posterior(name, folder)
    posterior.log_prob(np.zeros((2, posterior.dim)))  # the path is worked out before the start
    return Problem(posterior, seconds)


def _quantile(prior, u):
    """Coordinates at quantiles of a prior."""
    f, u = prior.figures, np.clip(u, 1e-15, 1.0 - 1e-15)
    if prior.family == "normal":
        return stats.norm.ppf(u, f["mean"], f["sd"])
    if prior.family == "lognormal":
        return stats.norm.ppf(u, np.log(f["median"]), f["spread"])
    if prior.family == "uniform":
        return special.logit(u)
    if prior.family == "beta":
        return special.logit(np.clip(stats.beta.ppf(u, f["a"], f["b"]), 1e-15, 1.0 - 1e-15))
    raise ValueError(f"prior family {prior.family} is not ported")
