"""False alarms over many populations, each by the linear mixed model alone, without its sampling.

    python -m benchmarks.accept.linear RUN FOLDER [FIRST LAST]

RUN is one finished run of `benchmarks.accept.simulated`, for settings and priors. Each seed has
twelve new tests of a prototype, of which a population is drawn from the Gaussian approximation of
the joint fit, and 200 good devices. It takes about 4 s of a quiet processor for each population.
"""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import mfd_bayes as mb
from benchmarks.accept.simulated import MATRIX, production_test, set_scatter
from mfd_bayes.calibration.diagnostics import intervals_of
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.campaign.synthetic import write_campaign
from mfd_bayes.evaluation.acceptance import Level, birge_ratios, compare_record, expect, trace_of
from mfd_bayes.evaluation.properties import stored_peaks
from mfd_bayes.population import inference
from mfd_bayes.population.inference import CHAINS, Draws
from mfd_bayes.records.loops import measured_cycles
from mfd_bayes.runs.run import Run

DEVICES, KEPT = 200, 64


class Linear:
    """Draws of the linear mixed model, in the place of the exact sampler."""

    def __init__(self, fit: Any, approximate: Any, unpooled: Any, choice: Any, rng: Any, _: Any):
        self.fit, self.choice, self.rng = fit, choice, rng
        self.mixed, self.pool = approximate(fit)

    def run(self, *_: Any) -> Draws:
        parts, mixed, walkers = [], self.mixed, len(self.choice) // CHAINS
        for first in range(0, len(self.choice), walkers):
            pool, choice = self.pool[first], self.choice[first]
            h = pool[self.rng.choice(len(pool), KEPT * walkers)]
            z = mixed.marginal(h, choice)[1].draw(self.rng)
            mean, factor = mixed.deviations(h, choice, z)
            e = self.rng.standard_normal(mean.shape)[..., None]
            x = np.repeat(self.fit.mean[None], len(h), axis=0)
            linear = mixed.offsets(h, choice) + mixed.design.linear(z, mixed.rows)
            x[..., : linear.shape[-1]] = linear
            x[..., mixed.design.free] += mean
            x[..., mixed.design.free] += np.linalg.solve(np.swapaxes(factor, -1, -2), e)[..., 0]
            parts.append((h, z, x))
        h, z, x = map(np.array, zip(*parts, strict=True))
        return Draws(h, z, x, None, 0, (1.0, 1.0))  # type: ignore[arg-type]


def new_run(base: Run, seed: int, folder: Path) -> Run:
    """A run of twelve new tests with the settings of a finished one."""
    folder.mkdir(parents=True, exist_ok=True)
    write_campaign(folder, seed, MATRIX)
    settings, tests, entries = base.manifest.settings, {}, dict(base.manifest.tests)
    for name, before in base.tests.items():
        level = name.split("_")[0].removeprefix("p")
        record = mb.read_record(folder / f"{name}.csv", actuation=f"{level} psi")
        trace = record.trace(settings.campaign.rate, gap=base.priors.gap)
        tests[name] = replace(before, posterior=Posterior(trace, base.priors, "ou", base.model))
        measured = measured_cycles(record.trace()).to_content()
        entries[name] = entries[name].model_copy(update={"measured": measured})
    found = inference.infer_population(tests, base.priors, settings.inference("quick", (seed, 5)))
    for j, name in enumerate(tests):
        own = {**tests[name].intervals, **intervals_of(found.values(j))}
        tests[name] = replace(tests[name], intervals=own)
    manifest = base.manifest.model_copy(update={"tests": entries})
    peaks = stored_peaks(replace(base, tests=tests, manifest=manifest))
    manifest = manifest.model_copy(update={"peak_factors": peaks})
    run = replace(base, tests=tests, manifest=manifest)
    run.__dict__["population"] = found.population
    return run


def main() -> None:
    base, folder = mb.open_run(sys.argv[1]), Path(sys.argv[2])
    first, last = map(int, sys.argv[3:5] or (1001, 1021))
    inference.ExactSampler = Linear  # type: ignore[misc, assignment]
    set_scatter(0.02)
    shares = []
    for seed in range(first, last):
        run, rng = new_run(base, seed, folder / f"s{seed}"), np.random.default_rng([seed, 77])
        columns = ("time_s", "displacement_in", "force_kip")
        path = folder / f"s{seed}" / "production.csv"
        rows = np.transpose(production_test(rng, {}))
        pd.DataFrame(rows, columns=columns).to_csv(path, index=False)
        record = mb.read_record(path, actuation="1 ksi")
        expected, alarms = (
            expect(
                run,
                trace_of(run, record),
                "",
                rate=record.rate,
                ratios=birge_ratios(run),
                draws=2000,
            ),
            0,
        )
        for _ in range(DEVICES):
            made = replace(record, force=production_test(rng, {})[2])
            group = [compare_record(made, trace_of(run, made), expected)]
            alarms += Level.of(group, independent=True).p_value < 0.05
        shares.append(100.0 * alarms / DEVICES)
        print(f"population {seed}: {shares[-1]:.1f} %", flush=True)
    error = np.std(shares, ddof=1) / np.sqrt(len(shares))
    print(
        f"{len(shares)} populations: {np.mean(shares):.1f} % ± {error:.1f} of good devices differ"
    )


if __name__ == "__main__":
    main()
