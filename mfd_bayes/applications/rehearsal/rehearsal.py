"""One rehearsal: a draw of the posterior makes records, which are calibrated anew.

The truth is one joint draw of the run's posterior: levels, scatters and laws with the parameters of
every test of the same draw, a discrepancy, and an excess of peaks. Records of the same motions are
made from it, with the noise that the population has learned, whatever noise the single tests
assume. They are calibrated by themselves, with the run's prior file, model, laws and settings.

Where the truth lies among the new draws is uniform if the posterior is right, for the quantities
that the records determine (Cook, Gelman and Rubin, 2006; with the truth from a posterior: Säilynoja
et al., 2025). Let λ be the variance of a quantity's posterior over that of its prior, and m the
distance of the posterior's mean from the prior's, in sds of the prior. With normal densities the
truth lies at a standard score

    z ~ N(√λ m, 1 − λ + λ²)

among the draws, for the prior counts twice: in the draw that is the truth, and in the calibration.
So z is standard normal for λ → 0. A calibration of the measured and the made records together would
have it exactly, and would be one of a campaign with twice the records: it would not say how right
the answer of this one is.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.applications.properties import sheet_conditions
from mfd_bayes.calibration.diagnostics import effective_size
from mfd_bayes.calibration.result import Task, TestResult, load_result, seed_of
from mfd_bayes.errors import FitError, MfdError, StoreError
from mfd_bayes.evaluation.bounds import drawn_properties, with_gains
from mfd_bayes.jobs.job import JobState, Outcome, Step
from mfd_bayes.population.bands import PredictionOptions
from mfd_bayes.population.inference import infer_population
from mfd_bayes.population.peaks import SIDES, largest_speed
from mfd_bayes.population.population import Population
from mfd_bayes.records.cycles import PROPERTIES
from mfd_bayes.records.trace import Trace, check_magnitude
from mfd_bayes.runs.folder import (
    MANIFEST,
    MODEL,
    POPULATION,
    PRIORS,
    REHEARSAL,
    check_stored,
    pooled_of,
    posterior_of,
)
from mfd_bayes.runs.run import Run, open_run, prediction_conditions, sequence_of
from mfd_bayes.runs.test_sequence import save_inference
from mfd_bayes.store.files import Figure, Part, check, read_json, write_json

Array = NDArray[np.float64]
Draws = Mapping[str, Array]  # of quantities by name, (chain, draw) each

ANOTHER_TEST, MEAN = "another test", "mean property"
LEVELS, SCATTERS = "levels and laws", "scatters"
POOLED, ALONE = "tests, pooled", "tests, each by itself"
"""What a quantity is of; the first two are those of the data sheet."""


class Position(Part):
    """Where a true value lies among the draws of a rehearsal."""

    of: str
    quantity: str
    condition: str  # of the data sheet, or id of a test
    pit: Figure  # share of all draws that are smaller (probability integral transform)
    rank: Figure  # of the truth among nearly independent draws, as a share, ties broken at random


@dataclass(frozen=True, eq=False)
class Truth:
    """A device that the posterior allows: its run has one draw of the population."""

    run: Run
    tests: Mapping[str, Draws]  # true quantities of each test, (1, 1) each
    traces: Mapping[str, Trace]  # their records
    peaks: Mapping[str, tuple[float, float]]  # largest raw forces, kip, forward and backward


# --- the job of one process


@dataclass(frozen=True)
class Rehearsal:
    """A rehearsal, as the job of one process."""

    number: int
    effort: str
    seed: int
    rests_on: str
    """Digest of what the run's population rests on."""

    @property
    def id(self) -> str:
        """Its name as a job."""
        return f"rehearsal {self.number}"

    @property
    def file(self) -> str:
        """Where its result is stored."""
        return f"{REHEARSAL}/run_{self.number:03d}.json"

    @property
    def makes(self) -> tuple[str, ...]:
        """Files that it writes: its result."""
        return (self.file,)

    def needs(self, folder: Path) -> tuple[str, ...]:
        """Files of a finished run that `open_run` reads."""
        stored = folder / MODEL, *sorted((folder / "tests").glob("*/*.nc"))
        names = (p.relative_to(folder).as_posix() for p in stored if p.is_file())
        return MANIFEST, PRIORS, POPULATION, *names

    def run(self, folder: Path, observe: Callable[[Step], Any]) -> Outcome:
        """Make records, calibrate them in a temporary folder, and store where the truth lies.

        A calibration that fails is a result too: it would fail again.
        """
        began, positions, error = time.perf_counter(), tuple[Position, ...](), ""
        observe(Step(self.id, "making records"))
        try:
            positions = self.positions(open_run(folder, trust=True), observe)
        except StoreError:
            raise
        except MfdError as failure:
            error = str(failure)
        rows = [position.model_dump() for position in positions]
        content = {"key": asdict(self), "error": error, "positions": rows}
        write_json(folder / self.file, content)
        observe(Step(self.id, JobState.DONE))
        return Outcome(self.id, JobState.DONE, time.perf_counter() - began)

    def positions(self, run: Run, observe: Callable[[Step], Any]) -> tuple[Position, ...]:
        """Where the true values of a run lie among the draws of this rehearsal."""
        seed = self.seed, self.number
        truth = simulate(run, np.random.default_rng([*seed, 1]))
        with tempfile.TemporaryDirectory(prefix="mfd-bayes-") as name:
            calibrated = recalibrate(
                *(run, truth, Path(name), self.effort, seed),
                lambda stage: observe(Step(self.id, stage)),
            )
            observe(Step(self.id, "data sheet"))
            rng = np.random.default_rng([*seed, 2])
            return tuple(positions_of(run, truth, calibrated, rng))

    def stored(self, folder: Path) -> StoredRehearsal | None:
        """The stored result; None where there is none, or it is damaged.

        Raises StoreError where it was made with other settings.
        """
        path = check_stored(folder, self.file, {})
        try:
            stored = check(StoredRehearsal, read_json(path), path)
        except StoreError:
            return None
        for name, value in asdict(self).items():
            if stored.key.get(name) != value:
                was = f" (--effort {stored.key.get(name)})" if name == "effort" else ""
                raise StoreError(
                    f"{path} was made with another {_WORDS[name]}{was}: give that one to go on, or "
                    "--force to replace the rehearsals"
                )
        return stored


_WORDS = {
    "number": "number",
    "effort": "effort",
    "seed": "seed",
    "rests_on": "calibration of this run",
}
"""What of a rehearsal may differ, in words."""


class StoredRehearsal(Part):
    """A result as it is stored."""

    key: dict[str, Any]
    error: str
    positions: tuple[Position, ...]


# --- the truth and its records


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def simulate(run: Run, rng: np.random.Generator) -> Truth:
    """A draw of a run's posterior, and records of all its tests."""
    population, predictor, tests, traces, peaks = run.population, run.predictor, {}, {}, {}
    index, residual = rng.integers(population.size, size=1), population.residual
    excess = {side: each.draw(rng) for side, each in run.peaks.items()}
    coordinates, pooled = population.design.coordinates, sequence_of(run).pooled
    for name, test in run.tests.items():
        if not (draws := pooled(name)):
            raise StoreError(f"{run.folder / pooled_of(name)} is missing: calibrate the run again")
        values = {k: v[index] for k, v in draws.items()}
        motion = replace(test.trace, force=None)
        how: dict[str, Any] = prediction_conditions(run, name)
        setting = PredictionOptions("observation", **how).setting(motion)
        grid = population.grid_of(motion)
        numbers = population.draw_numbers(1, grid.size, rng)
        x = coordinates.of({k: values[k] for k in coordinates.names})
        x = x[:, : len(population.design.names)]
        draw = predictor.sample_conditional(motion, setting, index, numbers, grid, x=x)
        start = {"start": values.get("start", draw.unshared["start"])}
        draw = replace(draw, unshared={**draw.unshared, **start})
        smooth = predictor.force(motion, draw)[0]
        noise = residual.draw_noise(rng, motion, values["noise_sd"])
        force = predictor.total(motion, replace(draw, noise=noise))[0]
        check_magnitude("the force of a rehearsal", force)
        offset = predictor.values(draw)["offset"][0]
        speed = largest_speed(motion)
        peaks[name] = tuple(
            float(np.max(sign * smooth))
            + sign * offset
            + excess[side].rate * speed
            + excess[side].scatter * rng.standard_normal()
            for side, sign in SIDES.items()
        )
        tests[name] = {k: v[None] for k, v in values.items()}
        traces[name] = replace(test.trace, force=force)
    single = population.single(int(index[0]))
    manifest = run.manifest.changed(peak_excess={side: asdict(e) for side, e in excess.items()})
    device = replace(run, manifest=manifest).with_population(single)
    return Truth(device, tests, traces, peaks)


def recalibrate(
    run: Run,
    truth: Truth,
    folder: Path,
    effort: str,
    seed: Sequence[int],
    observe: Callable[[str], Any] = lambda _: None,
) -> Run:
    """Calibration of a truth's records as that of a run, into a folder."""
    settings, manifest, size = run.manifest.settings, run.manifest, len(truth.traces)
    results: dict[str, TestResult] = {}
    for name, trace in truth.traces.items():
        observe(f"test {len(results) + 1} of {size}")
        task = Task(
            *(name, posterior_of(name), trace, run.priors, run.model),
            noise=settings.campaign.noise,
            initial=settings.campaign.initial,
            effort=effort,
            seed=(*seed, seed_of(name)),
        )
        if error := task.run(folder, lambda _: None).error:
            raise FitError(f"{name}: {error}")
        results[name] = load_result(name, folder / task.file, run.priors, run.model)
        # as the run has them, a raw record's: what a filter or a low rate loses is not simulated
        measured = dict(run.manifest.tests[name].measured)
        sides = zip(SIDES, truth.peaks[name], strict=True)
        measured |= {f"largest_{side}": (peak,) for side, peak in sides}
        manifest = manifest.with_test(name, measured=measured)
    observe("population")
    inference = infer_population(results, run.priors, settings.inference(effort, (*seed, 0)))
    save_inference(folder, inference, results, run.model)
    manifest = manifest.changed(files={}, peak_excess={})
    calibrated = replace(run, folder=folder, manifest=manifest, tests=results)
    return calibrated.with_population(inference.population)


# --- where the truth lies


def positions_of(
    run: Run, truth: Truth, calibrated: Run, rng: np.random.Generator
) -> Iterator[Position]:
    """Positions of a truth among the draws of its calibration: data sheet, population, tests."""
    yield from _of_sheet(run, truth, calibrated, rng)
    true, draws = (_of_population(each.population) for each in (truth.run, calibrated))
    for (of, name), values in draws.items():
        yield from _position((of, name, ""), true[of, name], values, rng)
    population = calibrated.population
    pooled, device_wide = sequence_of(calibrated).pooled, (*population.common, "noise_time")
    for test, true_values in truth.tests.items():
        for name, values in pooled(test).items():
            if name not in device_wide and name in true_values:
                values = values.reshape(population.shape)
                yield from _position((POOLED, name, test), true_values[name], values, rng)
        result = calibrated.tests[test]
        stored, noise = result.stored.draws, result.posterior.noise.parameters
        for name in result.posterior.names:
            if name in true_values and name not in noise:
                values = stored[name].to_numpy()
                yield from _position((ALONE, name, test), true_values[name], values, rng)


def _of_sheet(
    run: Run, truth: Truth, calibrated: Run, rng: np.random.Generator
) -> Iterator[Position]:
    """Of the mean property and of another test of the device, at each condition of the sheet."""
    # the sheet's draws are picks from chains: of a quarter of the effective number, few are alike
    size = max(int(calibrated.population.convergence.worst_ess / 4.0), 10)
    for label, trace, places in sheet_conditions(run):
        true, draws = (
            with_gains(each, drawn_properties(each, trace, places))
            for each in (truth.run, calibrated)
        )
        for of, basis in ((ANOTHER_TEST, "observation"), (MEAN, "mean")):
            pick = int(rng.integers(len(next(iter(true[basis].values())))))
            for item in PROPERTIES.values():
                if item.sheet and item.applies(run.system.axes):
                    value, values = true[basis][item.name][pick], draws[basis][item.name]
                    values = values[np.isfinite(values)]
                    subject = of, run.system.text(item.feature), label
                    yield from _position(subject, value, values, rng, size)


def _of_population(population: Population) -> dict[tuple[str, str], Array]:
    """Draws of levels, laws and scatters, (chain, draw), by what and name."""
    names, shape = population.design.names, population.shape
    levels = population.values(population.draws.z[..., : len(names)].reshape(-1, len(names)))
    draws = {(LEVELS, name): values.reshape(shape) for name, values in levels.items()}
    for name in population.design.laws:
        for kind, values in zip(("share", "exponent"), population.shapes(name), strict=True):
            draws[LEVELS, f"{name}_{kind}"] = values
    draws |= {(LEVELS, name): values for name, values in population.dependences.items()}
    draws |= {(SCATTERS, name): values for name, values in population.scatters.items()}
    return draws | {(SCATTERS, name): values for name, values in population.effect_sds.items()}


def _position(
    subject: tuple[str, str, str],
    truth: ArrayLike,
    draws: Array,
    rng: np.random.Generator,
    size: int = 0,
) -> Iterator[Position]:
    """Position of a truth among draws, (chain, draw) in their order, or (n,) in any.

    Of the former as many are ranked as are effective, of the latter the first `size`. None where
    the truth is not finite, or the draws do not vary.
    """
    value = np.asarray(truth).item()
    if not (draws.size and np.isfinite(value) and np.ptp(draws) > 0.0):
        return
    if size:
        thinned = draws[:size]
    else:
        step = math.ceil(draws.size / max(effective_size(draws), 1.0))
        thinned = draws.reshape(-1)[::step]
    pit = np.mean(draws < value) + 0.5 * np.mean(draws == value)
    ties = np.count_nonzero(thinned == value)
    rank = np.count_nonzero(thinned < value) + rng.random() * (1 + ties)
    keys = zip(("of", "quantity", "condition"), subject, strict=True)
    yield Position(**dict(keys), pit=float(pit), rank=float(rank / (thinned.size + 1)))
