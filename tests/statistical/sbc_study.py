"""Synthetic tests drawn from a prior, and the ranks of their true values among the draws."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import Prior, PriorFile, known_quantities, load_priors
from mfd_bayes.calibration.sampling import Draws, sample
from mfd_bayes.errors import MfdError
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

TRUE, WRONG = "ou", "iid"
MEDIANS = {  # kip, in, s
    "sigma0": 25.0, "sigma1": 0.02, "sigma2": 0.01, "Fc_fwd": 1.0, "Fc_bwd": 1.2, "k2": 0.8,
    "k3": 20.0, "d2": 0.10, "d3": 0.08, "ell": 0.02, "k_fwd": 30.0, "k_bwd": 25.0, "gap": 0.12,
    "k_0": 0.8, "v_s": 0.4, "noise_sd": 0.04, "noise_time": 0.1,
}  # fmt: skip
SPREAD = 0.25  # of the logarithm
DERIVED = {
    "Fs_fwd": ("Fc_fwd", "static_excess_fwd"),
    "Fs_bwd": ("Fc_bwd", "static_excess_bwd"),
    "gap": ("d2", "d3"),
    "gamma2": ("ell", "gamma1"),
}
"""What follows from two quantities; ranked where both vary."""
LIKELIHOOD = "log likelihood"
QUANTITIES = tuple(name for name, q in known_quantities().items() if q.sampled)


@dataclass(frozen=True, eq=False)
class Study:
    """What the tests of a study share; priors and model are those of truths and posteriors."""

    priors: PriorFile
    motion: Trace
    effort: Effort
    draws: int  # L, taken of each posterior; ranks go from 0 to L
    seed: int
    model: str = "three_stage"


@dataclass(frozen=True)
class Ranked:
    """A test: ranks by quantity, and how its sampling went."""

    ranks: Mapping[str, int]
    converged: bool = False
    ess: float = 0.0
    r_hat: float = np.inf
    steps: int = 0
    seconds: float = 0.0
    error: str = ""  # why there are no draws


def narrow_priors(sampled: Iterable[str] = QUANTITIES, **medians: float) -> PriorFile:
    """The shipped priors, narrowed to sensible loops; what is not `sampled` has one value."""
    middle = MEDIANS | medians
    narrow = {n: Prior("lognormal", {"median": m, "sigma": SPREAD}) for n, m in middle.items()}
    narrow["offset"] = Prior("normal", {"mean": 0.0, "sd": 0.05})
    narrow["n"] = Prior("truncated_normal", {"mean": 3.0, "sd": 0.7, "lower": 1.0})
    shipped = load_priors("mfd")
    parameters = dict(shipped.parameters) | narrow
    for name in set(parameters) - set(sampled):
        parameters[name] = Prior("fixed", {"value": middle.get(name, parameters[name].median)})
    return replace(shipped, parameters=parameters)


def run_test(study: Study, index: int, noise: str = TRUE) -> Ranked:
    """Ranks of the truth of one synthetic test, whose posterior assumes `noise`."""
    posterior, truth = synthesize(study, index, noise)
    try:
        draws = sample(posterior, study.effort, seed=(study.seed, index, 1))
    except MfdError as error:
        return Ranked({}, error=str(error))
    convergence = draws.convergence
    return Ranked(
        ranks=ranks_of(truth, posterior, draws, study.draws),
        converged=convergence.reached(study.effort.r_hat, study.effort.ess),
        ess=convergence.worst_ess,
        r_hat=convergence.worst_r_hat,
        steps=draws.chains.steps,
        seconds=draws.wall_time,
    )


def synthesize(study: Study, index: int, noise: str) -> tuple[Posterior, dict[str, Array]]:
    """Posterior of a synthetic test, and its truth, (1,) each.

    The record does not depend on `noise`, which is only what the posterior takes it for.
    """
    rng = np.random.default_rng([study.seed, index, 0])
    blank = replace(study.motion, force=np.zeros(study.motion.samples))
    source = Posterior(blank, study.priors, TRUE, study.model)
    truth = source.sample_prior(1, rng)
    force = source.force(truth) + truth["offset"][:, None]
    force = force + source.noise.draw(rng, blank.time, truth)
    return Posterior(replace(blank, force=force[0]), study.priors, noise, study.model), truth


def ranks_of(
    truth: Mapping[str, Array], posterior: Posterior, draws: Draws, count: int
) -> dict[str, int]:
    """How many of `count` draws lie below the truth, by quantity.

    Draws are ordered by walker: taken evenly, they are of different walkers, which are
    independent of each other at any step.
    """
    flat = dict(draws.values) | {LIKELIHOOD: draws.log_likelihood}
    pick = np.linspace(0, draws.log_likelihood.size - 1, count).astype(np.intp)
    subset = with_derived({name: values.reshape(-1)[pick] for name, values in flat.items()})
    likelihood = posterior.log_likelihood(posterior.coordinates(truth))
    true = with_derived(dict(truth) | {LIKELIHOOD: likelihood})
    varied = {LIKELIHOOD, *(name for name in draws.values if np.ptp(subset[name]) > 0)}
    varied |= {name for name, terms in DERIVED.items() if varied.issuperset(terms)}
    return {name: int(np.sum(subset[name] < true[name])) for name in sorted(varied)}


def with_derived(values: Mapping[str, Array]) -> dict[str, Array]:
    """All quantities and those that follow from them, by name."""
    derived = {}
    if "d3" in values:
        derived["gap"] = values["d2"] + values["d3"]
        derived["gamma2"] = values["ell"] * values["gamma1"]
    for side in ("fwd", "bwd"):
        derived[f"Fs_{side}"] = values[f"Fc_{side}"] * (1.0 + values[f"static_excess_{side}"])
    return {**values, **derived}


def ranks_by_quantity(tests: Sequence[Ranked]) -> dict[str, list[int]]:
    """Ranks of all tests that have any, in the order of `QUANTITIES`, then what is derived."""
    ranked = [test.ranks for test in tests if not test.error]
    order = [n for n in (*QUANTITIES, *DERIVED, LIKELIHOOD) if ranked and n in ranked[0]]
    return {name: [ranks[name] for ranks in ranked] for name in order}
