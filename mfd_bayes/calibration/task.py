"""One test of a campaign, from its trace to its posterior on disk; runs in a process of its own."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mfd_bayes.calibration.diagnostics import measure_draws
from mfd_bayes.calibration.noise_sensitivity import OtherFit, fit_other, other_noises
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.predictive import replicate
from mfd_bayes.calibration.prior_files import PriorFile
from mfd_bayes.calibration.quantities import units
from mfd_bayes.calibration.sampling import Draws, sample
from mfd_bayes.errors import FitError, MfdError, StoreError
from mfd_bayes.jobs.job import Outcome, Progress, State, Step
from mfd_bayes.records.trace import Trace
from mfd_bayes.store.netcdf import CalibratedTest, save_test

LEAST_AFTER = 20
"""Fewest samples that are fitted after a start that is masked."""

REPLICAS = 50
"""Posterior predictive records that are stored for each ensemble."""


@dataclass(frozen=True, eq=False)
class Task:
    """All that a test's calibration needs: small enough to send.

    `file` is where in the run folder its posterior is stored, and `checks_noise` says whether the
    test is fitted under other noises too.
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
    checks_noise: bool = False

    @property
    def makes(self) -> tuple[str, ...]:
        """Its posterior."""
        return (self.file,)

    def needs(self, out: Path) -> tuple[str, ...]:
        """Nothing of the run folder."""
        return ()

    def posterior(self) -> Posterior:
        """Posterior of the test.

        Raises
        ------
        MfdError
            When it cannot be made: no force, a name that is unknown, or a prior that is missing.
        """
        found = Posterior(self.trace, self.priors, self.noise, self.model, start=self.start)
        if self.trace.samples - found.first < LEAST_AFTER:
            raise FitError(
                f"start = 'mask' leaves {self.trace.samples - found.first} samples of {self.id} "
                f"after its first long stroke, and at least {LEAST_AFTER} are needed"
            )
        return found

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
        posterior = task.posterior()
        draws = sample(
            posterior,
            task.effort,
            task.seed,
            report=lambda progress: observe(Step(task.id, "sampling", progress)),
        )
        others: list[OtherFit] = []
        if task.checks_noise:
            observe(Step(task.id, "checking the noise"))
            for noise in other_noises(task.noise):
                make = replace(task, noise=noise).posterior
                others.append(fit_other(noise, posterior, make, draws, task.seed))
        save_test(out / task.file, _stored_of(task, posterior, draws, others))
    except StoreError:
        raise
    except MfdError as error:
        observe(Step(task.id, State.FAILED, message=str(error)))
        return Outcome(task.id, State.FAILED, time.perf_counter() - began, str(error))
    seconds, steps = time.perf_counter() - began, draws.chains.steps
    worst = draws.convergence.worst_r_hat, draws.convergence.worst_ess
    observe(Step(task.id, State.DONE, Progress(steps, steps, *worst, seconds)))
    return Outcome(task.id, State.DONE, seconds)


def _stored_of(
    task: Task, posterior: Posterior, draws: Draws, others: list[OtherFit]
) -> CalibratedTest:
    """Draws of all quantities, the model's parameters first, with replicated records."""
    values = {name: draws.theta[..., k] for k, name in enumerate(posterior.model.parameters)}
    values |= {name: draws.values[name] for name in draws.values if name not in values}
    flat = {name: value.reshape(-1) for name, value in values.items()}
    rng = np.random.default_rng(task.seed)
    replicas = replicate(posterior, flat, rng, REPLICAS * len(draws.q))
    chains, convergence = draws.chains, {}
    for name, value in values.items():
        if np.ptp(value) > 0:
            found = measure_draws(value, chains.walkers)
            figures = found.r_hat, found.ess_bulk, found.ess_tail
            convergence[name] = [float(figure[0]) for figure in figures]
    facts = {
        "test": task.id,
        "model": task.model,
        "noise": task.noise,
        "start": task.start,
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
        "mode_values": draws.mode_values if len(draws.modes) > 1 else [],
        "wall_time": draws.wall_time,
        "first": posterior.first,
        "convergence": convergence,
        "other_noises": [asdict(other) for other in others],
    }
    return CalibratedTest(
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
