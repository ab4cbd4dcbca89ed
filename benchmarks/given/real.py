"""Earthquakes predicted from harmonic tests, alone and given the seconds before the shaking.

    python -m benchmarks.given.real --run OUT --run OTHER > benchmarks/given/real.txt

OUT and OTHER are finished runs of the 36 lb session of the band brake with different models, whose
harmonic tests are calibrated and whose earthquakes have the role "validate"; both together are the
last part of the table. RRSE of the median and of the mean of the draws are over the window that
the dataset's authors published an error of LuGre for, and so are coverage and width of the bands
of kind "observation". --pictures FOLDER draws the histories with both bands.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

import mfd_bayes as mb
from benchmarks.common.machine import processor, versions
from mfd_bayes.evaluation.scores import crps, rrse
from mfd_bayes.evaluation.views import Fan, Interval
from mfd_bayes.population.bands import Band
from mfd_bayes.reporting.figures import Marks, draw_history, to_png

RECORDS = {
    # test: end of the given part, window of the scores, s; RRSE published; wanted alone and given
    "36lb_ImperialValleyDBE": (3.0, (3.0, 7.5), 0.440, (0.30, 0.28)),
    "36lb_KocaeliDBE": (6.0, (6.0, 14.0), 0.794, (0.72, 0.45)),
}
HEAD = (
    f"{'record':24}{'given':>10}{'RRSE':>8}{'of mean':>9}{'wanted':>8}{'/ publ.':>9}{'CRPS':>8}"
    f"{'50 %':>7}{'95 %':>7}{'width':>8}  how"
)


def row(name: str, trace: mb.Trace, band: Band) -> str:
    """Line of the table."""
    _, window, published, wanted = RECORDS[name]
    at = (trace.time >= window[0]) & (trace.time <= window[1])
    force, draws = np.asarray(trace.force)[at], band.draws[:, at]
    low, high = np.quantile(draws, [0.25, 0.75], axis=0)
    half = 100.0 * np.mean((low <= force) & (force <= high))
    most = 100.0 * np.mean((band.lower[at] <= force) & (force <= band.upper[at]))
    error, mean, told = rrse(band.median[at], force), rrse(draws.mean(axis=0), force), band.given
    until = f"{told.window[1]:g} s" if told else "nothing"
    how = f"{told.method}, Pareto k {told.pareto_k:.2f}" if told else ""
    return (
        f"{name:24}{until:>10}{error:8.3f}{mean:9.3f}{wanted[told is not None]:8.2f}"
        f"{error / published:9.2f}{np.mean(crps(draws, force)):8.3f}{half:7.1f}{most:7.1f}"
        f"{np.mean((band.upper - band.lower)[at]):8.2f}  {how}"
    )


def draw(folder: Path, name: str, trace: mb.Trace, bands: list[Band]) -> None:
    """Pictures of the history with each band."""
    for word, band in zip(("before", "after"), bands, strict=True):
        fan = Fan(band.kind, band.median, (Interval(band.probability, band.lower, band.upper),))
        given = band.given.window if band.given else None
        figure = draw_history(
            f"{name}, {word} the given part", trace, [fan], marks=Marks(given=given)
        )
        (folder / f"{name}_{word}.png").write_bytes(to_png(figure))


def score(source: mb.Run | mb.ModelAverage, run: mb.Run, pictures: Path | None) -> None:
    """Rows of the records that the run left out, predicted by it or by several; their pictures."""
    print(HEAD)
    for name, (end, *_) in RECORDS.items():
        trace = run.held_out[name]
        bands = [
            source.predict(trace, "observation", draws=1000, given=given)
            for given in (None, (float(trace.time[0]), end))
        ]
        for band in bands:
            print(row(name, trace, band))
        if pictures:
            pictures.mkdir(exist_ok=True)
            draw(pictures, name, trace, bands)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--run", type=Path, required=True, action="append")
    parser.add_argument("--pictures", type=Path)
    options = parser.parse_args()
    runs = [mb.open_run(folder) for folder in options.run]
    print(f"{processor()}, {versions('numpy', 'arviz')}; draws 1000, seed 0")
    for run in runs:
        settings = run.manifest.settings
        print(f"\nModel {settings.model}, {len(run.tests)} calibrated tests\n")
        score(run, run, options.pictures)
    if len(runs) > 1:
        both = mb.ModelAverage(runs)
        print(f"\nModels {' and '.join(both.models)} in equal parts\n")
        score(both, runs[0], None)
    return 0


if __name__ == "__main__":
    sys.exit(main())
