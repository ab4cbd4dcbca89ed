"""One test, from its record to its stored posterior, and back."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol

import numpy as np
from pydantic import Field

from mfd_bayes.calibration.diagnostics import (
    Interval,
    interval_rows,
    intervals_of,
    measure_draws,
)
from mfd_bayes.calibration.evidence import Evidence, log_evidence
from mfd_bayes.calibration.noise_sensitivity import OtherFit, fit_other, other_noises
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.predictive import replicate
from mfd_bayes.calibration.prior_files import PriorFile, units
from mfd_bayes.errors import FitError, MfdError, StoreError
from mfd_bayes.friction.model import Model
from mfd_bayes.jobs.job import Outcome, Progress, State, Step
from mfd_bayes.records.regular import hash_file
from mfd_bayes.records.trace import Trace
from mfd_bayes.store.cards import grid
from mfd_bayes.store.netcdf import CalibratedTest, StoredTest, load_test, save_test
from mfd_bayes.store.schema import LARGEST, Figure, Index, Part, Positive, Three, check

if TYPE_CHECKING:
    import xarray as xr

    from mfd_bayes.calibration.sampling import Draws

LEAST_AFTER = 20
"""Fewest samples that are fitted after a start that is masked."""

REPLICAS = 50
"""Posterior predictive records that are stored for each ensemble."""

_Share = Annotated[float, Field(ge=0, le=1.001)]


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
    model: Model | str
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
    from mfd_bayes.calibration.sampling import sample  # emcee takes long to import

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
        "model": posterior.model.name,
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


class Extras(Protocol):
    """Pictures and ArviZ data of results."""

    def plot_band(self, band: Any, axes: Any, displacement: Any) -> Any:
        """Draw a band against time or displacement; returns Matplotlib axes."""

    def plot_loops(self, test: Any, axes: Any) -> Any:
        """Draw the loops of a calibrated test over its bands; returns Matplotlib axes."""

    def inference_data(self, result: Any) -> Any:
        """Data of a calibrated test or of a band that ArviZ's functions take."""


def needed(extras: Extras | None) -> Extras:
    """The extras of a result that came from `mfd_bayes.open_run`.

    Raises
    ------
    FitError
        When it did not.
    """
    if extras is None:
        raise FitError("this needs a result of a run that mfd_bayes.open_run has opened")
    return extras


@dataclass(frozen=True, eq=False)
class TestResult:
    """A calibrated test.

    Attributes
    ----------
    id : str
    posterior : Posterior
    path : Path
        Of the stored posterior.
    sha256 : str
        Of that file, where it is known: the draws of another run are not taken for this one's.
    intervals : mapping of str to (float, float, float)
        Median and equal-tailed 95 % interval of every quantity: 50, 2.5 and 97.5 %.
    """

    __test__ = False

    id: str
    posterior: Posterior
    path: Path
    sha256: str = ""
    intervals: Mapping[str, Interval] = field(default_factory=dict, repr=False)
    extras: Extras | None = field(default=None, repr=False)

    def plot_loops(self, axes: Any = None) -> Any:
        """Matplotlib axes with the measured loops over the bands of a measurement, as replicated.

        Parameters
        ----------
        axes : matplotlib.axes.Axes, optional
            Where to draw; a new figure by default.

        Raises
        ------
        FitError
            When the test does not come from a run of `mfd_bayes.open_run`.
        """
        return needed(self.extras).plot_loops(self, axes)

    def inference_data(self) -> Any:
        """What ArviZ's functions take: InferenceData, or a DataTree from ArviZ 1 on.

        Its groups are those of `posterior.nc`, and `log_likelihood`: the log density of each cycle
        given all others, by which `az.loo` leaves out whole cycles. That takes some seconds.

        Raises
        ------
        FitError
            When the test does not come from a run of `mfd_bayes.open_run`, or has fewer cycles
            than can be left out.
        """
        return needed(self.extras).inference_data(self)

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
        """What is stored of it, read anew each time: the draws of many tests are not all held.

        Raises
        ------
        StoreError
            When the file cannot be read, or was replaced since its run was opened.
        """
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


def load_result(
    test_id: str, path: Path, priors: PriorFile, model: Model | None = None
) -> TestResult:
    """Calibrated test of its stored posterior; `model` is that of its run.

    Raises
    ------
    StoreError
        When the file is missing, or holds no posterior under these priors.
    """
    stored = load_test(path)
    facts = stored.facts
    check_facts(facts, path)
    try:
        if model is not None and facts["model"] != model.name:
            raise FitError(f"it is of the model {facts['model'][:60]!r}, not {model.name!r}")
        chosen = model or facts["model"]
        posterior = Posterior(stored.trace, priors, facts["noise"], chosen, start=facts["start"])
    except MfdError as error:
        raise StoreError(f"{path} is damaged or not of this program: {error}") from error
    check_draws(stored, posterior, path)
    return TestResult(test_id, posterior, path, intervals=intervals_of(stored.values()))


class _OtherFit(Part):
    """A fit under another noise, as `noise_sensitivity.OtherFit` is stored."""

    noise: Annotated[str, Field(max_length=100)]
    how: Annotated[str, Field(max_length=100)]
    k: Figure
    size: Figure
    quantities: dict[str, Three]
    seconds: Figure
    error: str


class _Facts(Part):
    """Facts of a sampling that are read back."""

    model: str
    noise: str
    start: Literal["sample", "mask"]
    walkers: Annotated[int, Field(ge=1)]
    steps: Annotated[int, Field(le=10**12)]
    discarded: Index
    seed: list[Index]
    modes: Annotated[int, Field(ge=1, le=1000)]
    mode_shares: list[list[_Share]] = Field(default_factory=list, max_length=1000)
    mode_values: list[dict[str, float | None]] = Field(default_factory=list, max_length=1000)
    autocorrelation: Annotated[dict[str, Positive | None], Field(min_length=1)]
    other_noises: list[_OtherFit] = Field(default_factory=list, max_length=20)
    convergence: dict[str, Annotated[list[float | None], Field(min_length=3, max_length=3)]]


def check_facts(facts: Any, where: Path) -> None:
    """Refuse sampling facts that no calibration stores."""
    found = check(_Facts, facts, where)
    if len({len(shares) for shares in found.mode_shares}) > 1:
        raise StoreError(f"{where} is damaged: mode_shares differ in length between chains")


def check_draws(stored: StoredTest, posterior: Posterior, where: Path) -> None:
    """Refuse draws with wrong names or sizes, or outside the support of their priors."""
    level = posterior.trace.reference_actuation
    if not level >= 0:
        raise StoreError(f"{where} must be of a test with an actuation, got {level:g}")
    wanted = {*posterior.names, *posterior.model.parameters, "offset", "start"}
    arrays, stats = stored.posterior.arrays, stored.sample_stats.arrays
    if missing := wanted - set(arrays):
        raise StoreError(f"{where} holds no draws of {min(missing)}")
    if unknown := set(arrays) - wanted - {*posterior.priors, "gamma1"}:
        raise StoreError(
            f"{where} holds draws of {min(unknown)[:60]!r}, which the model does not have"
        )
    densities = ("log_prior", "log_likelihood")
    if not set(densities) <= set(stats):
        raise StoreError(f"{where} holds no {' and '.join(densities)} in its sample_stats")
    shape = arrays["offset"].shape
    for name, values in (arrays | {n: stats[n] for n in densities}).items():
        if values.shape != shape or values.ndim != 2 or values.dtype != np.float64:
            raise StoreError(f"{where} must hold {name} as (chain, draw) numbers like the others")
        if not np.all(np.abs(values) <= LARGEST):
            raise StoreError(f"{where} must hold finite draws of {name}")
    if shape[0] < 1 or shape[1] < 1 or shape[1] % stored.facts["walkers"]:
        raise StoreError(f"{where} must hold draws of {stored.facts['walkers']} walkers")
    for name in wanted & set(posterior.priors):
        prior, values = posterior.priors[name], arrays[name]
        with np.errstate(all="ignore"):
            inside = np.isfinite(prior.log_density(prior.coordinate(values)))
        if not np.all(inside):
            value = values[~inside][0]
            raise StoreError(f"{where} holds a draw of {name}, {value:g}, that its prior excludes")
