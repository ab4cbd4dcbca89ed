"""One test of a campaign, from its trace to its posterior on disk; runs in a process of its own."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import measure_draws
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.predictive import replicate
from mfd_bayes.calibration.prior_files import PriorFile
from mfd_bayes.calibration.quantities import units
from mfd_bayes.calibration.sampling import Draws, sample
from mfd_bayes.errors import MfdError, StoreError
from mfd_bayes.jobs.job import Outcome, Progress, State, Step
from mfd_bayes.records.trace import Trace
from mfd_bayes.store.netcdf import CalibratedTest, save_test

Array = NDArray[np.float64]

REPLICAS = 50
"""Posterior predictive records that are stored for each ensemble."""


@dataclass(frozen=True, eq=False)
class Task:
    """All that a test's calibration needs: small enough to send.

    `file` is where in the run folder its posterior is stored.
    """

    id: str
    file: str
    trace: Trace
    priors: PriorFile
    model: str
    noise: str
    start: str
    effort: str
    seed: tuple[int, ...]

    @property
    def makes(self) -> tuple[str, ...]:
        """Its posterior."""
        return (self.file,)

    def needs(self, out: Path) -> tuple[str, ...]:
        """Nothing of the run folder."""
        return ()

    def run(self, out: Path, observe: Callable[[Step], Any]) -> Outcome:
        """Calibrate the test into a run folder."""
        return calibrate_test(self, out, observe)


def calibrate_test(task: Task, out: Path, observe: Callable[[Step], Any]) -> Outcome:
    """Sample one test's posterior and store it in a run folder.

    Raises
    ------
    StoreError
        When it cannot be written, as on a full disk: that is no fault of the test.
    """
    began = time.perf_counter()
    observe(Step(task.id, "finding modes"))
    try:
        posterior = Posterior(task.trace, task.priors, task.noise, task.model, start=task.start)
        draws = sample(
            posterior,
            task.effort,
            task.seed,
            report=lambda progress: observe(Step(task.id, "sampling", progress)),
        )
        _save(task, posterior, draws, out / task.file)
    except StoreError:
        raise
    except MfdError as error:
        observe(Step(task.id, State.FAILED, message=str(error)))
        return Outcome(task.id, State.FAILED, time.perf_counter() - began, str(error))
    seconds = time.perf_counter() - began
    worst = draws.convergence
    observe(
        Step(
            task.id,
            State.DONE,
            Progress(
                draws.chains.steps, draws.chains.steps, worst.worst_r_hat, worst.worst_ess, seconds
            ),
        )
    )
    return Outcome(task.id, State.DONE, seconds)


def _save(task: Task, posterior: Posterior, draws: Draws, path: Path) -> None:
    chains = draws.chains
    values = dict(draws.values)
    for k, name in enumerate(posterior.model.parameters):
        values[name] = draws.theta[..., k]
    ordered = [n for n in (*posterior.model.parameters, *values) if n in values]
    values = {name: values[name] for name in dict.fromkeys(ordered)}
    rng = np.random.default_rng(task.seed)
    flat = {name: value.reshape(-1) for name, value in values.items()}
    replicas = replicate(posterior, flat, rng, REPLICAS * len(draws.q))
    facts = {
        "test": task.id,
        "model": task.model,
        "noise": task.noise,
        "start": task.start,
        "first": posterior.first,
        "seed": task.seed,
        "walkers": chains.walkers,
        "steps": chains.steps,
        "thin": chains.thin,
        "discarded": chains.discarded,
        "acceptance": chains.acceptance.tolist(),
        "autocorrelation": dict(zip(draws.names, chains.autocorrelation.tolist(), strict=True)),
        "modes": len(draws.modes),
        "log_evidences": [mode.log_evidence for mode in draws.modes],
        "mode_shares": draws.mode_shares.tolist(),
        "convergence": _convergence(values, chains.walkers),
        "wall_time": draws.wall_time,
    }
    stored = CalibratedTest(
        values=values,
        units=units(),
        stats={
            "lp": draws.log_prob,
            "log_prior": draws.log_prior,
            "log_likelihood": draws.log_likelihood,
        },
        trace=task.trace,
        predictive=replicas.observed.reshape(len(draws.q), -1, task.trace.samples),
        facts=facts,
    )
    save_test(path, stored)


def _convergence(values: dict[str, Array], walkers: int) -> dict[str, list[float]]:
    """R̂, bulk and tail ESS of everything that is stored and varies."""
    found = {}
    for name, draws in values.items():
        if np.ptp(draws) == 0:
            continue
        figures = measure_draws(draws, walkers)
        found[name] = [
            float(figures.r_hat[0]),
            float(figures.ess_bulk[0]),
            float(figures.ess_tail[0]),
        ]
    return found
