"""What follows the prior, and what the data: parameters of tests, laws, and values for design."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.result import TestResult
from mfd_bayes.calibration.sensitivity import Follows, power_scaling
from mfd_bayes.evaluation.scores import Row, Rows
from mfd_bayes.messages import Message
from mfd_bayes.population.hyperprior import log_prior
from mfd_bayes.population.law_scores import LARGEST_K
from mfd_bayes.runs.run import Run
from mfd_bayes.runs.test_sequence import stored_log_likelihood
from mfd_bayes.store.netcdf import StoredTest

Array = NDArray[np.float64]
Index = NDArray[np.intp]

DESIGN = "data sheet"
"""Group of the rows of values for design; that of laws is "population", of others the test."""

MOST = 3  # values that a sentence names


@dataclass(frozen=True, eq=False)
class JointDensity:
    """Log prior of the population's draws, and log likelihood of all tests, (chain, draw) each.

    That is the likelihood of levels, laws and scatter: what a test has to itself is integrated out.
    With the likelihood of the records in its place, which know the tests and not the device, a
    level that the tests show would follow nothing.
    """

    log_prior: Array
    log_likelihood: Array

    @classmethod
    def of(cls, run: Run) -> JointDensity | None:
        """Those of a run; None where an earlier version has stored no log likelihood."""
        stored = [stored_log_likelihood(run.folder, run.manifest, name) for name in run.tests]
        of_tests = [values for values in stored if values is not None]
        if not run.tests or len(of_tests) < len(stored):
            return None
        return cls(log_prior(run.population, ()), np.sum(of_tests, axis=0))


def test_rows(test: TestResult, stored: StoredTest) -> Rows:
    """Rows of the sampled quantities of a test by itself."""
    stats = stored.sample_stats.arrays
    draws = {(n, "parameter"): stored.posterior.arrays[n] for n in test.posterior.names}
    return _rows(test.id, "", draws, stats["log_prior"], stats["log_likelihood"])


def law_rows(run: Run, joint: JointDensity | None) -> Rows:
    """Rows of the constants of the laws, and of the scatter."""
    if joint is None:
        return ()
    population = run.population
    constants = population.slopes
    constants |= {f"scatter_{name}": tau for name, tau in population.scatters.items()}
    constants |= {f"deviation_{name}": omega for name, omega in population.effect_sds.items()}
    draws = {(name, "constant"): values for name, values in constants.items()}
    return _rows("population", "", draws, joint.log_prior, joint.log_likelihood)


def design_rows(
    joint: JointDensity | None,
    index: Index,
    where: str,
    properties: Mapping[tuple[str, str], Array],
) -> Rows:
    """Rows of properties under a motion, by their name and what they are of; draws (n,) each.

    `index` (n,) are the numbers of the population's draws behind them, whose weights they have.
    """
    finite = {
        key: values[None] for key, values in properties.items() if np.all(np.isfinite(values))
    }
    # beyond the tests laws are mixed that have no density here
    if joint is None or not finite or np.any(index >= joint.log_prior.size):
        return ()
    densities = (density.ravel()[index][None] for density in vars(joint).values())
    return _rows(DESIGN, where, finite, *densities)


def _rows(
    group: str,
    where: str,
    draws: Mapping[tuple[str, str], Array],
    log_prior: Array,
    log_likelihood: Array,
) -> Rows:
    scaled = power_scaling(dict(enumerate(draws.values())), log_prior, log_likelihood)
    keys = list(draws)
    return tuple(
        {"group": group, "condition": where, "name": keys[i][0], "of": keys[i][1]}
        | {"prior": s.prior, "data": s.data, "pareto_k": s.pareto_k, "verdict": s.verdict.value}
        for i, s in scaled.items()
    )


# --- what a report shows of them


@dataclass(frozen=True)
class Summary:
    """Verdicts on a quantity over conditions or tests, and the one that follows the prior most."""

    name: str
    of: str
    counts: Mapping[str, int]  # of each of `Follows`
    most: Row
    pareto_k: float

    @property
    def notable(self) -> bool:
        """Whether any does not follow the data alone."""
        return self.counts[Follows.DATA] < sum(self.counts.values())

    @property
    def where(self) -> str:
        """Condition or test in which it follows the prior most."""
        return str(self.most["condition"] or self.most["group"])


def summaries(rows: Rows, *, design: bool) -> tuple[Summary, ...]:
    """Verdicts on each value for design, or on each of the other quantities."""
    by_quantity: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if (row["group"] == DESIGN) == design:
            by_quantity.setdefault((row["name"], row["of"]), []).append(row)
    return tuple(
        Summary(
            *key,
            {verdict.value: [r["verdict"] for r in of].count(verdict) for verdict in Follows},
            max(of, key=lambda row: row["prior"]),
            max(row["pareto_k"] for row in of),
        )
        for key, of in by_quantity.items()
    )


def sentences(rows: Rows) -> tuple[Message, ...]:
    """Which values for design follow the prior, or in which prior and data disagree."""
    design = [row for row in rows if row["group"] == DESIGN]
    texts = []
    for verdict, meaning in (
        (Follows.PRIOR, "follow the prior: another prior would change them"),
        (Follows.DISAGREE, "lie between a prior and data that disagree: look at both"),
    ):
        values = sorted((r for r in design if r["verdict"] == verdict), key=lambda r: -r["prior"])
        if values:
            named = [f"{r['of']} of {r['name']} at {r['condition']}" for r in values[:MOST]]
            more = len(values) - MOST
            listed = "; ".join(named) + (f"; and {more} more" if more > 0 else "")
            text = f"Of {len(design)} values for design, {len(values)} {meaning} ({{values}})."
            texts.append(Message(text, {"values": listed}))
    if design and not texts:
        texts.append(Message(f"None of {len(design)} values for design follows the prior."))
    worst = max((row["pareto_k"] for row in design), default=0.0)
    if worst > LARGEST_K:
        caveat = "The weights behind this cannot be trusted (Pareto k {k})."
        texts.append(Message(caveat, {"k": f"{worst:.2f}"}))
    return tuple(texts)
