"""A finished run under another prior file: its draws weighted, and sampled where that is needed."""

from __future__ import annotations

import atexit
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.applications.reweighing.weights import (
    LEAST,
    Weights,
    check_same_parameters,
    difference_of_layout,
    weights_of_test,
)
from mfd_bayes.calibration.diagnostics import replicate
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import PriorFile, load_priors, units
from mfd_bayes.calibration.result import REPLICAS, Task, load_result
from mfd_bayes.errors import FitError, PriorError, StoreError, hash_file, path_of, whole_number
from mfd_bayes.jobs.job import JobState, Observe, Step, Workplace
from mfd_bayes.jobs.local import get_ready, run_jobs
from mfd_bayes.population.design import Design, design_of
from mfd_bayes.population.hyperprior import log_population_prior, log_prior, natural_levels
from mfd_bayes.population.inference import infer_population
from mfd_bayes.population.population import LawDraws, Population, save_population
from mfd_bayes.runs.folder import (
    CAMPAIGN,
    MANIFEST,
    MODEL,
    POPULATION,
    PRIORS,
    hash_stored,
    pooled_of,
    posterior_of,
    record_of,
)
from mfd_bayes.runs.run import Run, open_run
from mfd_bayes.runs.test_sequence import save_inference
from mfd_bayes.store.files import write_bytes
from mfd_bayes.store.netcdf import load_arrays, save_arrays, save_test

Array = NDArray[np.float64]
Index = NDArray[np.intp]

BEGIN = 6  # draws from which modes are climbed where a test is sampled
JOINT = "the population"


@dataclass(frozen=True, eq=False)
class Reweighing:
    """A run, and what it is under another prior file.

    `weights` are those of each test and of `JOINT`; `seconds` is the time that all took.
    """

    original: Run
    reweighed: Run
    weights: Mapping[str, Weights]
    seconds: float

    @property
    def sampled(self) -> tuple[str, ...]:
        """What was sampled again."""
        return tuple(name for name, weights in self.weights.items() if weights.reason)


def reweigh(
    run: Run,
    priors: str | Path,
    out: str | Path | None = None,
    *,
    jobs: int = 0,
    seed: int = 1,
    observe: Observe = lambda _: None,
) -> Reweighing:
    """A finished run under another prior file.

    Its tests and its population are weighted by the ratio of the priors. What has weights that
    cannot be trusted, with a Pareto k above 0.7, or that leave too few effective draws, is sampled
    again, from the stored draws as a start.

    Parameters
    ----------
    run : Run
    priors : str or path
        A name such as "mfd", or a prior file.
    out : path, optional
        Run folder to write, a new one; without it the new run lasts as long as this process.
    jobs : int
        Processes for what is sampled; 0 for one for each processor.
    seed : int
    observe : callable of a Step
        Is called with the news of the work.

    Returns
    -------
    Reweighing
        `original` and `reweighed`, runs under the one and the other priors, and `weights`.

    Raises
    ------
    PriorError
        When the priors lack a parameter of the model or the noise, or fix others than the run's.
    StoreError
        When `out` exists.
    """
    began = time.perf_counter()
    whole_number("seed", seed, 0, FitError)
    file = load_priors(str(priors), model=run.model, of_others=True)
    target = None if out is None else path_of("out", out, StoreError)
    if target is not None and target.exists():
        raise StoreError(f"{target} exists: give the name of a new folder")
    names = list(run.tests)
    posteriors = {name: _posterior(run, file, name) for name in names}
    for name in names:
        check_same_parameters(run.tests[name].posterior, posteriors[name], file.path.name)
    if target is not None:
        target.parent.mkdir(parents=True, exist_ok=True)
    scratch = tempfile.TemporaryDirectory(
        prefix=".reweighed-", dir=None if target is None else target.parent
    )
    atexit.register(scratch.cleanup)  # also where it is not finished
    folder = Path(scratch.name) / "run"
    (folder / "tests").mkdir(parents=True)
    work = _Work(run, file, posteriors, folder, seed, Workplace(jobs), observe)
    weights = {name: work.weigh_test(name) for name in names}
    work.sample_tests([name for name in names if weights[name].reason])
    weights[JOINT], results = work.weigh_population()
    work.finish(weights, results, time.perf_counter() - began)
    if target is not None:
        try:
            folder.rename(target)
        except OSError as error:
            raise StoreError(f"cannot write {target}: {error.strerror}") from error
        scratch.cleanup()
    reweighed = replace(open_run(folder if target is None else target, trust=True), units=run.units)
    return Reweighing(run, reweighed, weights, time.perf_counter() - began)


def _posterior(run: Run, file: PriorFile, name: str) -> Posterior:
    """Posterior of a test under other priors."""
    stored = run.tests[name].posterior
    settings = run.manifest.settings.campaign
    try:
        return Posterior(
            stored.trace, file, stored.noise.name, stored.model, initial=settings.initial
        )
    except PriorError as error:
        fit = f"{settings.model} with {settings.noise} noise"
        raise PriorError(f"the run is of {fit}: {error}") from error


@dataclass(frozen=True, eq=False)
class _Work:
    """What is written into the folder of the new run."""

    run: Run
    file: PriorFile
    posteriors: Mapping[str, Posterior]
    folder: Path
    seed: int
    workplace: Workplace
    observe: Callable[[Step], Any]

    def weigh_test(self, name: str) -> Weights:
        """Weights of a test; its draws are stored where they can be trusted."""
        stored, posterior = self.run.tests[name].stored, self.posteriors[name]
        arrays, shape = stored.posterior.arrays, stored.posterior.arrays["offset"].shape
        sizes = [e for _, *of in stored.facts["convergence"].values() for e in of if e is not None]
        weights = weights_of_test(
            self.run.tests[name].posterior, posterior, arrays, self.least_ess / min(sizes)
        )
        if weights.reason:
            return weights
        rng = self._generator(name)
        pick = weights.pick(rng)
        flat = {n: values.reshape(-1)[pick] for n, values in arrays.items()}
        for n in posterior.model.nonidentifiable:
            flat[n] = posterior.priors[n].draw(rng, pick.size)
        flat |= dict(zip(posterior.model.parameters, posterior.theta(flat).T, strict=True))
        log_prior = posterior.log_prior(posterior.coordinates(flat))
        likelihood = stored.sample_stats.arrays["log_likelihood"].reshape(-1)[pick]
        densities = {
            "lp": log_prior + likelihood,
            "log_prior": log_prior,
            "log_likelihood": likelihood,
        }
        replicas = replicate(posterior, flat, rng, REPLICAS * shape[0])
        convergence = {
            n: [r_hat, *(e and e * weights.efficiency for e in sizes)]
            for n, (r_hat, *sizes) in stored.facts["convergence"].items()
        }
        save_test(
            self.folder / posterior_of(name),
            values={n: values.reshape(shape) for n, values in flat.items()},
            units=units(posterior.model),
            stats={n: values.reshape(shape) for n, values in densities.items()},
            trace=stored.trace,
            predictive=replicas.observed.reshape(shape[0], -1, stored.trace.samples),
            facts={**stored.facts, "convergence": convergence},
        )
        return weights

    def sample_tests(self, names: list[str]) -> None:
        """Sample tests from the stored draws as a start, and store them."""
        if not names:
            return
        if self.workplace.processes > 1:
            get_ready()
        tasks = [self._task(name) for name in names]
        for outcome in run_jobs(tasks, self.folder, self.workplace, self.observe):
            if outcome.error:
                raise FitError(
                    f"test {outcome.id} cannot be sampled under {self.file.path.name}: "
                    f"{outcome.error}"
                )

    def _task(self, name: str) -> Task:
        """Job that samples a test; it climbs to the modes from some of the stored draws."""
        stored, posterior = self.run.tests[name].stored, self.posteriors[name]
        settings, model = self.run.manifest.settings, self.run.model
        with np.errstate(divide="ignore", invalid="ignore"):  # draws that the priors exclude
            q = posterior.coordinates(stored.values())
            density = posterior.log_prior(np.nan_to_num(q, nan=np.inf))
        allowed = np.flatnonzero(np.isfinite(density))
        # the likeliest of equal blocks of the chains, so that each mode has some
        blocks = [block for block in np.array_split(allowed, BEGIN) if block.size]
        begin = [block[np.argmax(density[block])] for block in blocks]
        return Task(
            id=name,
            file=posterior_of(name),
            trace=stored.trace,
            priors=self.file,
            model=model if model.source else settings.model,
            noise=settings.noise,
            initial=settings.campaign.initial,
            effort=self.run.manifest.effort,
            seed=(*self.words, *name.encode()),
            begin=q[begin] if begin else None,
        )

    @property
    def least_ess(self) -> float:
        """Effective number of draws that weights must leave: half of what the run aimed at."""
        effort = self.run.manifest.effort
        return effort.ess if self.run.manifest.reweighed else LEAST * effort.ess

    @property
    def words(self) -> tuple[int, int]:
        """Of the seed of everything here."""
        return self.seed, 71

    def _generator(self, name: str) -> np.random.Generator:
        return np.random.default_rng([*self.words, *name.encode()])

    def weigh_population(self) -> tuple[Weights, dict[str, Any]]:
        """Weights of the population, and what changes in the manifest; it is stored.

        It is weighted, or inferred again with the tests' new posteriors as a start.
        """
        run, population = self.run, self.run.population
        layout = population.design
        names = layout.coordinates.names
        conditions = run.manifest.settings.inference("quick", ())
        settings = [conditions.setting(name, test.trace) for name, test in run.tests.items()]
        design = design_of(self.file, names, settings, layout.laws, layout.dependence, run.model)
        pooled, weights = [], Weights.none("")
        reason = difference_of_layout(layout, design)
        paths = [run.folder / pooled_of(name) for name in run.tests]
        if not reason and not all(path.is_file() for path in paths):
            reason = "the run has no draws of its tests together"
        if not reason:
            pooled = [load_arrays(path)[0] for path in paths]
            shape = population.shape
            log_ratio = log_prior(population, pooled, design) - log_prior(population, pooled)
            # laws keep their weights, which are no probabilities of the prior
            for choice in np.unique(population.choice.reshape(population.size, -1), axis=0):
                rows = np.all(population.choice == choice, axis=-1)
                log_ratio[rows] -= np.logaddexp.reduce(log_ratio[rows]) - np.log(rows.sum())
            min_share = self.least_ess / population.convergence.worst_ess
            weights = Weights.of(log_ratio.reshape(shape), min_share)
        else:
            weights = Weights.none(reason)
        if weights.reason:
            return weights, self._infer_population()
        pick = weights.pick(self._generator(JOINT))
        save_population(
            self.folder / POPULATION, _picked(population, design, self.file, pick, weights)
        )
        for name, arrays in zip(run.tests, pooled, strict=True):
            values = {n: v.reshape(-1)[pick].reshape(v.shape) for n, v in arrays.items()}
            save_arrays(self.folder / pooled_of(name), values, {"test": name}, units(run.model))
        return weights, {}

    def _infer_population(self) -> dict[str, Any]:
        """Infer the population from the new posteriors and store it; results for the manifest."""
        run, model = self.run, self.run.model
        results = {
            name: load_result(name, self.folder / posterior_of(name), self.file, model)
            for name in run.tests
        }
        self.observe(Step("population", "the joint fit"))
        inference = infer_population(
            results,
            self.file,
            replace(
                run.manifest.settings.inference("", self.words, self.workplace.processes),
                effort=run.manifest.effort,
            ),
            lambda progress: self.observe(Step("population", "sampling", progress)),
        )
        save_inference(self.folder, inference, results, model)
        self.observe(Step("population", JobState.DONE))
        return {
            "law_scores": inference.scores,
            "free_exponents": inference.exponents,
            "dependence_scores": inference.dependence,
        }

    def finish(
        self, weights: Mapping[str, Weights], results: Mapping[str, Any], seconds: float
    ) -> None:
        """Write what else a finished run has; its manifest says where the draws come from."""
        run, manifest = self.run, self.run.manifest
        for name in (CAMPAIGN, MODEL, *map(record_of, run.held_out)):
            if (source := run.folder / name).is_file():
                (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
                write_bytes(self.folder / name, source.read_bytes())
        write_bytes(self.folder / PRIORS, self.file.path.read_bytes())
        general = manifest.settings.campaign.model_copy(update={"priors": str(self.file.path)})
        inputs = {n: d for n, d in manifest.inputs.items() if not n.startswith("priors/")}
        digest = hash_file(run.folder / MANIFEST)
        effort, now = manifest.effort, f"{datetime.now(UTC).isoformat(timespec='seconds')}"
        stored = [f(n) for n in manifest.tests for f in (posterior_of, pooled_of, record_of)]
        manifest.changed(
            **results,
            priors=f"{self.file.title} ({self.file.path.name})",
            settings=manifest.settings.model_copy(update={"campaign": general}),
            inputs=inputs | {f"priors/{self.file.path.name}": hash_file(self.file.path)},
            # draws that were weighted are worth less than they were sampled to be
            effort=replace(effort, ess=self.least_ess),
            keys={},  # a calibration does not take its draws for those of a sampler
            reweighed={"this run": f"{run.folder.name}, SHA-256 of its {MANIFEST} {digest}"}
            | {n: w.words for n, w in weights.items()},
            finished=now,
            seconds=seconds,
            crossvalidation=None,
            comparison=None,
            verdicts={},
            peak_excess={},
            files=hash_stored(self.folder, [PRIORS, MODEL, POPULATION, *stored]),
        ).write(self.folder)


def _picked(
    population: Population, design: Design, file: PriorFile, pick: Index, weights: Weights
) -> Population:
    """The population's draws by their numbers (n,), as those of a design of the same layout."""
    layout, d = population.design, len(population.design.names)

    def moved(draws: LawDraws) -> LawDraws:
        z = draws.z.copy()
        levels = natural_levels(layout, z)
        z[..., :d] = (levels - design.coordinates.centre[:d]) / design.spread
        return replace(draws, z=z)

    def picked(values: NDArray[Any]) -> NDArray[Any]:
        return values.reshape(population.size, -1)[pick].reshape(values.shape)

    alternatives = population.alternatives
    log_ratio = log_population_prior(alternatives, layout, design) - log_population_prior(
        alternatives, layout, layout
    )
    ratio = population.alternative_weight * np.exp(log_ratio - log_ratio.max(initial=-np.inf))
    total = population.alternative_weight.sum()
    convergence = population.convergence
    sizes = {n: weights.efficiency * getattr(convergence, n) for n in ("ess_bulk", "ess_tail")}
    return replace(
        population,
        design=design,
        draws=moved(LawDraws(**{k: picked(v) for k, v in vars(population.draws).items()})),
        choice=picked(population.choice),
        alternatives=moved(alternatives),
        alternative_weight=ratio * (total / max(ratio.sum(), 1e-300)),
        priors=file.parameters,
        convergence=replace(convergence, **sizes),
    )
