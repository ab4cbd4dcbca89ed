"""Semi-active tests of the band brake, predicted by three stages, by backlash, and by both.

    python -m benchmarks.heldout.semi_active > benchmarks/heldout/semi_active.txt

calibrates the sessions of 2022 and 2023 with both models ("quick", noise "ou", seed 1; an hour on
two cores), joins the tests of all of them in one population for each model, and predicts the three
semi-active records under the tension measured at the band's slack end: alone, and given their
first 4 s. "Both" are equal parts of both models' draws. Finished runs in --out are used again.
Exit status 1: a limit was missed.
"""

from __future__ import annotations

import os

# Read when numpy is imported.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import argparse
import sys
from pathlib import Path

import numpy as np

from benchmarks.common.data import PROJECT, add_data_option
from benchmarks.common.machine import processor, versions
from benchmarks.heldout import records
from benchmarks.heldout.run import DRAWS, finished
from mfd_bayes.evaluation.scores import score
from mfd_bayes.population.bands import Forecast, Predictor
from mfd_bayes.population.given import predict_given
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.scores import Score

SESSIONS = ("36lb", "2022-07", "30lb")
MODELS = ("three_stage", "backlash")
GIVEN = 4.0
"""First part that is given, s; scored is the rest."""

LEAST, MOST, HALF = 0.90, 0.98, 0.5
HEAD = (
    f"{'covered by the band of':26s}{'50 %':>6}{'90 %':>6}{'95 %':>6}"
    f"{'width':>8}{'CRPS':>8}{'RRSE':>8}"
)


def joined(options: argparse.Namespace, model: str) -> Predictor:
    """Predictor of all sessions' tests with a model, and the rates at which they were fitted."""
    chosen = argparse.Namespace(**{**vars(options), "model": model})
    runs = {session: finished(options.out, session, chosen) for session in SESSIONS}
    population, some = records.join(runs, options.fold_effort)
    return Predictor(population, some.model, some.noise)


def draws_of(predictor: Predictor, trace: Trace, session: str) -> tuple[np.ndarray, np.ndarray]:
    """Draws of a record's force alone, and given its first part, (n, T), kip."""
    forecast = Forecast("observation", draws=DRAWS, session=session)
    begin = float(trace.time[0])
    alone = predictor.predict(trace, forecast)
    given = predict_given(predictor, trace, forecast, (begin, begin + GIVEN))
    return alone.draws, given.draws


def line(name: str, found: Score) -> None:
    """Line of the table."""
    half, most, nearly = found.coverage
    print(
        f"  {name:24s}{100 * half:6.1f}{100 * most:6.1f}{100 * nearly:6.1f}"
        f"{found.width:8.2f}{found.crps:8.3f}{found.rrse:8.3f}",
        flush=True,
    )


def of_record(
    name: str, trace: Trace, drawn: dict[str, tuple[np.ndarray, np.ndarray]]
) -> list[str]:
    """Lines of one record; what was missed."""
    later, failed = trace.time > float(trace.time[0]) + GIVEN, []
    force = np.asarray(trace.force)[later]
    print(f"\n{name}\n{HEAD}")
    for model, both in drawn.items():
        alone, given = (score(draws[:, later], force) for draws in both)
        line(f"{model}, alone", alone)
        line(f"{model}, given {GIVEN:g} s", given)
        for words, found in (("alone", alone), (f"given {GIVEN:g} s", given)):
            if not LEAST <= found.coverage[2] <= MOST:
                covered = f"{100 * found.coverage[2]:.1f} % of 90 to 98 %"
                failed.append(f"{name}, {model}, {words}: {covered}")
        if given.rrse > HALF * alone.rrse:
            ratio = f"{given.rrse / alone.rrse:.2f} of {HALF:.2f}"
            failed.append(f"{name}, {model}: RRSE given over alone {ratio}")
    return failed


def parse() -> argparse.Namespace:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_data_option(parser)
    parser.add_argument("--out", type=Path, default=PROJECT / "out_heldout")
    parser.add_argument("--jobs", type=int, default=2)
    parser.set_defaults(effort="quick", fold_effort="quick", noise="ou", dependence=[])
    return parser.parse_args()


def main() -> None:
    options, failed = parse(), []
    print(__doc__.splitlines()[0])
    print(f"\n{processor()}, {versions('numpy', 'scipy')}; {DRAWS} draws, seed 0")
    known = {model: joined(options, model) for model in MODELS}
    for name, session, trace in records.semi_active_tests(options.data / "brfd"):
        drawn = {m: draws_of(k, trace, session) for m, k in known.items()}
        parts = [[draws[::2] for draws in both] for both in drawn.values()]
        drawn["both"] = tuple(np.concatenate(some) for some in zip(*parts, strict=True))
        failed += of_record(name, trace, drawn)
    print("\n" + ("\n".join(f"MISSED {what}" for what in failed) or "all bars hold"))
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
