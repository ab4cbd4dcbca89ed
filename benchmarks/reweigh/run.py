"""Weights against sampling: a run under other priors, reweighed, and sampled under them.

    python -m benchmarks.reweigh.run RUN -o FOLDER [--priors wider …] [--campaign CAMPAIGN.toml]

The data sheet and the laws rest on the population alone, so that this is inferred anew from the
records under each other prior, with another seed; under the run's own too: by so much do two
samplings differ from chance alone. With a campaign, every test is calibrated anew too, and the
tests' own parameters are compared. Differences are of nominal values (basis "mean") and of the
device tested again ("new_test"), for each test's motion. Seconds are of the processor, of all
processes. What is sampled is kept in FOLDER.
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.reweigh.priors import CHANGES, write_priors
from mfd_bayes.applications.reweighing.reweighing import JOINT, reweigh
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.evaluation.bounds import drawn_properties, places_of
from mfd_bayes.pipeline.calibrate import calibrate
from mfd_bayes.pipeline.options import RunOptions
from mfd_bayes.pipeline.plan import plan_campaign
from mfd_bayes.population.inference import infer_population
from mfd_bayes.population.peaks import NO_EXCESS
from mfd_bayes.records.cycles import PROPERTIES
from mfd_bayes.runs.run import Run, open_run

OWN = "its own, another seed"
HEAD = (
    f"{'priors':22} {'weights':41} medians, sds: half 95 % largest | sds, shares: the same | within"
    " | seconds: reweighed, population, whole run"
)
SEED = 2


def main() -> None:
    """Compare, and print a line for each prior."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--priors", nargs="*", default=[OWN, *CHANGES])
    parser.add_argument("--campaign", type=Path)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    run = open_run(arguments.run)
    chance = 1.25 / np.sqrt(run.population.convergence.worst_ess)
    print(f"{run.manifest.title}, {run.manifest.effort.name}; {len(run.tests)} tests")
    print(
        f"Chance alone: a median of the fewest effective draws has a standard error of "
        f"{chance:.2f} sd.\n{HEAD}"
    )
    for label in arguments.priors:
        path = run.folder / "priors.toml"
        how, cost, after = "", 0.0, run
        if label != OWN:
            path = write_priors(
                run.priors, label, arguments.out / f"{label.replace(' ', '_')}.toml"
            )
            began = used()
            reweighing = reweigh(run, path, jobs=1)
            cost, after = used() - began, reweighing.reweighed
            joint = reweighing.weights[JOINT]
            tests = [w.pareto_k for n, w in reweighing.weights.items() if n != JOINT]
            n_sampled = len([n for n in reweighing.sampled if n != JOINT])
            how = f"k {joint.pareto_k:5.2f} {'sampled ' if joint.reason else 'weighted'}"
            how += f" tests to {max(tests):.2f}, {n_sampled} sampled"
        began = used()
        whole = with_population(run, path)
        sampled = f"{used() - began:6.0f}"
        line = summary(differences(after, whole))
        if arguments.campaign:
            whole, seconds = calibrated(run, arguments.campaign, arguments.out, label, path)
            sampled += f" {seconds:6.0f}"
        print(f"{label:22} {how:41} {line} {cost:6.0f} {sampled}", flush=True)
        if arguments.campaign:
            print(
                f"{'':22} {'  parameters of tests':41} {summary(of_tests(after, whole))}",
                flush=True,
            )


def with_population(run: Run, path: Path) -> Run:
    """The run with the population that its records have under other priors."""
    file = load_priors(str(path), model=run.model, of_others=True)
    settings = run.manifest.settings
    tests = {
        name: replace(
            test,
            posterior=Posterior(
                test.trace, file, settings.noise, run.model, initial=settings.campaign.initial
            ),
        )
        for name, test in run.tests.items()
    }
    inference = infer_population(
        tests, file, settings.inference(run.manifest.effort.name, (SEED, 0), 1)
    )
    return replace(run, priors=file).with_population(inference.population)


def calibrated(run: Run, campaign: Path, out: Path, label: str, priors: Path) -> tuple[Run, float]:
    """The campaign calibrated under other priors, and the seconds it took; kept if it is there."""
    folder = out / label.replace(" ", "_").replace(",", "")
    times = folder / "seconds.json"
    if not times.is_file():
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(campaign.parent, folder / "campaign")
        shutil.copy(priors, folder / "campaign" / "other.toml")
        path, text = folder / "campaign" / campaign.name, campaign.read_text("utf-8")
        own = f'priors = "{run.manifest.settings.campaign.priors}"'
        path.write_text(text.replace(own, 'priors = "other.toml"'), "utf-8")
        options = RunOptions(effort=run.manifest.effort.name, seed=SEED, jobs=1)
        began = used()
        calibrate(plan_campaign(path, options), folder / "out", lambda _: None)
        times.write_text(json.dumps(used() - began))
    return open_run(folder / "out"), json.loads(times.read_text())


def used() -> float:
    """Seconds of the processor, of this process and of those that it has ended."""
    usages = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime for usage in usages)


def differences(run: Run, whole: Run) -> Iterator[tuple[float, float]]:
    """Of medians, in sds, and of sds, as a share, of each value of the sheet."""
    places = places_of(run)
    runs = [replace(r) for r in (run, whole)]
    for copied, r in zip(runs, (run, whole), strict=True):
        # the correction of measured peaks is of the records: the same in both
        vars(copied).update(population=r.population, peaks=NO_EXCESS)
    for test in run.tests.values():
        draws = [drawn_properties(r, replace(test.trace, force=None), places) for r in runs]
        for basis in ("mean", "new_test"):
            for name, item in PROPERTIES.items():
                a, b = (of[basis].get(name, np.array([np.nan])) for of in draws)
                if item.sheet and np.all(np.isfinite(a)) and np.all(np.isfinite(b)):
                    yield difference(a, b)


def of_tests(run: Run, whole: Run) -> Iterator[tuple[float, float]]:
    """The same of the sampled parameters of every test by itself, in their coordinates."""
    for name in run.tests:
        a, b = (
            r.tests[name].posterior.coordinates(r.tests[name].stored.values()).T
            for r in (run, whole)
        )
        yield from map(difference, a, b)


def difference(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Of medians in sds, and of sds as a share."""
    sd = b.std()
    return abs(np.median(a) - np.median(b)) / sd, abs(a.std() / sd - 1.0)


def summary(pairs: Iterator[tuple[float, float]]) -> str:
    """Quantiles of both differences, and the share that is within the bar."""
    both = np.array(list(pairs))
    shown = [" ".join(f"{np.quantile(of, q):6.2f}" for q in (0.5, 0.95, 1.0)) for of in both.T]
    return f"{' | '.join(shown)} | {np.mean(np.all(both <= 0.1, axis=1)):5.0%}"


if __name__ == "__main__":
    main()
