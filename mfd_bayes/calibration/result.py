"""One test, from its record to its stored posterior, and back."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import (
    Interval,
    interval_rows,
    intervals_of,
    measure_draws,
    replicate,
)
from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import PriorFile, units
from mfd_bayes.calibration.proposal import Evidence, log_evidence, nearest_modes
from mfd_bayes.errors import FitError, MfdError, StoreError, hash_file
from mfd_bayes.friction.model import Model
from mfd_bayes.jobs.job import JobState, Outcome, Progress, Step
from mfd_bayes.records.trace import Trace
from mfd_bayes.store.cards import grid
from mfd_bayes.store.netcdf import StoredTest, load_test, save_test

if TYPE_CHECKING:
    import xarray as xr

    from mfd_bayes.calibration.sampling import Draws

Array = NDArray[np.float64]

LEAST_AFTER = 20  # fewest samples that are fitted after the samples that are discarded
REPLICAS = 50  # posterior predictive records that are stored for each ensemble


def seed_of(name: str) -> int:
    """Number of a test's name for its seed: that of other tests does not change it."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big")


@dataclass(frozen=True, eq=False)
class Task:
    """All that a test's calibration needs: small enough to send.

    `file` is where in the run folder its posterior is stored.
    """

    id: str
    file: str
    trace: Trace
    priors: PriorFile
    model: Model | str
    noise: str
    initial: str
    effort: str | Effort
    seed: tuple[int, ...]
    begin: Array | None = None  # (m, dim), points near its modes, where some are known

    @property
    def makes(self) -> tuple[str, ...]:
        """Its posterior."""
        return (self.file,)

    def needs(self, folder: Path) -> tuple[str, ...]:
        """Nothing of the run folder."""
        return ()

    def posterior(self) -> Posterior:
        """Posterior of the test."""
        posterior = Posterior(self.trace, self.priors, self.noise, self.model, initial=self.initial)
        if (samples := self.trace.samples - posterior.first) < LEAST_AFTER:
            raise FitError(
                f"initial = 'discard' leaves {samples} samples of {self.id} after its first long "
                f"stroke, and at least {LEAST_AFTER} are needed"
            )
        return posterior

    def run(self, folder: Path, observe: Callable[[Step], Any]) -> Outcome:
        """Sample the test's posterior and store it in a run folder."""
        from mfd_bayes.calibration.sampling import sample  # emcee takes long to import

        began = time.perf_counter()
        observe(Step(self.id, "finding modes"))
        try:
            posterior = self.posterior()
            draws = sample(
                posterior,
                self.effort,
                self.seed,
                report=lambda progress: observe(Step(self.id, "sampling", progress)),
                begin=self.begin,
            )
            _store(folder / self.file, self, posterior, draws)
        except StoreError:
            raise
        except MfdError as error:
            observe(Step(self.id, JobState.FAILED, message=str(error)))
            return Outcome(self.id, JobState.FAILED, time.perf_counter() - began, str(error))
        seconds, steps = time.perf_counter() - began, draws.chains.steps
        worst = draws.convergence.worst_r_hat, draws.convergence.worst_ess
        observe(Step(self.id, JobState.DONE, Progress(steps, steps, *worst, seconds)))
        return Outcome(self.id, JobState.DONE, seconds)


# --- what is stored of a test, and read again


def _store(path: Path, task: Task, posterior: Posterior, draws: Draws) -> None:
    """Store draws of all quantities, the model's parameters first, with replicated records."""
    values = {name: draws.theta[..., k] for k, name in enumerate(posterior.model.parameters)}
    values |= {name: draws.values[name] for name in draws.values if name not in values}
    flat = {name: value.reshape(-1) for name, value in values.items()}
    rng = np.random.default_rng(task.seed)
    replicas = replicate(posterior, flat, rng, REPLICAS * len(draws.q))
    nearest = nearest_modes(draws.modes, draws.q)[..., None] == np.arange(len(draws.modes))
    mode_values = [
        {n: float(np.median(x[mask])) if mask.any() else np.nan for n, x in draws.values.items()}
        for mask in np.moveaxis(nearest, -1, 0)
    ]
    chains, convergence = draws.chains, {}
    for name, value in values.items():
        if np.ptp(value) > 0:
            convergence[name] = [*measure_draws(value, chains.walkers).figures().values()]
    facts = {
        "test": task.id,
        "model": posterior.model.name,
        "noise": task.noise,
        "initial": task.initial,
        "seed": task.seed,
        "walkers": chains.walkers,
        "steps": chains.steps,
        "thin": chains.thin,
        "discarded": chains.discarded,
        "acceptance": chains.acceptance.tolist(),
        "autocorrelation": dict(zip(draws.names, chains.autocorrelation.tolist(), strict=True)),
        "modes": len(draws.modes),
        "log_evidences": [mode.log_evidence for mode in draws.modes],
        "mode_shares": nearest.mean(axis=1).tolist(),
        "mode_values": mode_values if len(mode_values) > 1 else [],
        "wall_time": draws.wall_time,
        "first": posterior.first,
        "convergence": convergence,
    }
    save_test(
        path,
        values=values,
        units=units(posterior.model),
        stats={
            "lp": draws.log_prob,
            "log_prior": draws.log_prior,
            "log_likelihood": draws.log_likelihood,
        },
        trace=task.trace,
        predictive=replicas.observed.reshape(len(draws.q), -1, task.trace.samples),
        facts=facts,
    )


class PlottingBackend(Protocol):
    """Pictures and ArviZ data of results."""

    def plot_band(self, band: Any, axes: Any, displacement: Any) -> Any:
        """Draw a band against time or displacement; returns Matplotlib axes."""

    def plot_loops(self, test: Any, axes: Any) -> Any:
        """Draw the loops of a calibrated test over its bands; returns Matplotlib axes."""

    def to_inference_data(self, result: Any) -> Any:
        """Data of a calibrated test or of a band that ArviZ's functions take."""


def needed(backend: PlottingBackend | None) -> PlottingBackend:
    """The backend of a result that came from `mfd_bayes.open_run`."""
    if backend is None:
        raise FitError("this needs a result of a run that mfd_bayes.open_run has opened")
    return backend


@dataclass(frozen=True, eq=False)
class TestResult:
    """A calibrated test."""

    __test__ = False  # for pytest

    id: str
    posterior: Posterior
    path: Path  # of the stored posterior
    sha256: str = ""  # of that file, where it is known
    # median and equal-tailed 95 % interval of every quantity: 50, 2.5 and 97.5 %
    intervals: Mapping[str, Interval] = field(default_factory=dict, repr=False)
    _backend: PlottingBackend | None = field(default=None, repr=False)

    def plot_loops(self, axes: Any = None) -> Any:
        """Matplotlib axes with the measured loops over the bands of a measurement."""
        return needed(self._backend).plot_loops(self, axes)

    def to_inference_data(self) -> Any:
        """What ArviZ's functions take: InferenceData, or a DataTree from ArviZ 1 on.

        Its groups are those of `posterior.nc`, and `log_prior` and `log_likelihood`, whose terms
        sum to the joint densities, as `psense` needs them. `force` of the latter is the log density
        of each cycle given all others: `az.loo(data, var_name="force")` leaves out whole cycles.
        That takes some seconds.
        """
        return needed(self._backend).to_inference_data(self)

    def __repr__(self) -> str:
        trace = self.posterior.trace
        return (
            f"TestResult({self.id!r}, {self.posterior.model.name}; {trace.samples} samples over "
            f"{np.ptp(trace.time):.4g} s; {len(self.posterior.names)} quantities)"
        )

    def _repr_html_(self) -> str:
        title = f"Test {self.id}, {self.posterior.model.name}"
        return grid(title, *interval_rows(self.intervals, self.posterior.model))

    def log_evidence(self) -> Evidence:
        """Log of likelihood times prior, integrated, by bridge sampling from the stored draws.

        It compares models of the same record, and depends on their priors. It takes some seconds.
        """
        stored = self.stored
        shape, stats = stored.draws["offset"].shape, stored.sample_stats.arrays
        q = self.posterior.coordinates(stored.values()).reshape(*shape, -1)
        log_prob = np.asarray(stats["log_prior"] + stats["log_likelihood"])
        rng = np.random.default_rng(stored.facts["seed"])
        return log_evidence(self.posterior.log_prob, q, log_prob, stored.facts["walkers"], rng)

    @property
    def stored(self) -> StoredTest:
        """What is stored of it, read anew each time: the draws of many tests are not all held."""
        if self.sha256 and self.path.is_file() and hash_file(self.path) != self.sha256:
            raise StoreError(f"{self.path} was changed by another process since it was opened")
        return load_test(self.path)

    @property
    def draws(self) -> xr.Dataset:
        """Posterior draws as ArviZ reads them: named variables (chain, draw) with units."""
        return self.stored.draws

    @property
    def trace(self) -> Trace:
        """The record that was fitted."""
        return self.posterior.trace


def load_result(test_id: str, path: Path, priors: PriorFile, model: Model) -> TestResult:
    """Calibrated test of its stored posterior; `model` is that of its run."""
    stored = load_test(path)
    facts, draws = stored.facts, stored.values()
    try:
        if facts["model"] != model.name:
            raise FitError(f"it is of the model {facts['model'][:60]!r}, not {model.name!r}")
        posterior = Posterior(stored.trace, priors, facts["noise"], model, initial=facts["initial"])
        if missing := {*posterior.names, *posterior.model.parameters, "offset"} - draws.keys():
            raise FitError(f"it holds no draws of {min(missing)}")
    except (MfdError, LookupError, TypeError) as error:
        raise StoreError(f"{path} is damaged or not of this program: {error}") from error
    return TestResult(test_id, posterior, path, intervals=intervals_of(draws))
