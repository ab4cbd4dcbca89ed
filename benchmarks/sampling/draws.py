"""Draws of a posterior: ours with their evaluations counted, and how far draws are off."""

from __future__ import annotations

import numpy as np


class Counted:
    """A posterior that counts the vectors whose force was computed."""

    def __init__(self, posterior):
        self.posterior, self.count = posterior, 0

        class Counting(type(posterior)):
            """The same posterior."""

            def force(this, values, *args, **options):
                self.count += len(values["offset"])
                return super().force(values, *args, **options)

        self.counting = object.__new__(Counting)
        vars(self.counting).update(vars(posterior))


def by_step(chains):
    """Our chains as (ensemble, step, walker, dim)."""
    ensembles, _, dim = chains.q.shape
    return chains.q.reshape(ensembles, chains.walkers, -1, dim).swapaxes(1, 2)


def halves(chain):
    """First and second half in time of a chain (step, walker, dim), as two ensembles."""
    half = len(chain) // 2
    return np.stack([chain[-2 * half : -half], chain[-half:]])


def disagreement(chains, reference):
    """Largest deviations of means and of sds from the reference, with their coordinates."""
    q = chains.reshape(-1, chains.shape[-1])
    names = list(reference["coordinates"])
    mean, sd = (
        np.array([c[key] for c in reference["coordinates"].values()]) for key in ("mean", "sd")
    )
    means, sds = np.abs(q.mean(axis=0) - mean) / sd, np.abs(q.std(axis=0, ddof=1) / sd - 1)
    worst = [(float(off.max()), names[int(off.argmax())]) for off in (means, sds)]
    return tuple(worst)
