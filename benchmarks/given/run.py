"""Is a prediction given the first seconds of a record right, and quick enough to follow it?

    python -m benchmarks.given.run RUN [RUN ...]

RUN is a finished run of the 36 lb session of the band brake, as `benchmarks.heldout.run` keeps it,
whose earthquakes are held out; several of different models are averaged too. Minutes; --quick takes
few draws.

The first tables (real.txt): each earthquake alone and given the seconds before the shaking. RRSE of
the median and of the mean of the draws are over the window that the dataset's authors published an
error of LuGre for, and so are coverage and width of the bands of kind "observation". The last
(speed.txt): milliseconds of an update with 64 samples of a record at 1024 Hz, and of a band.
Exit status 1: the slowest update takes longer than 64 samples take to arrive.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import time
from pathlib import Path

import numpy as np

import mfd_bayes as mb
from mfd_bayes.evaluation.views import crps, rrse
from mfd_bayes.population.bands import Band

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


def score(source: mb.Run | mb.ModelAverage, run: mb.Run, draws: int) -> None:
    """Rows of the records that the run left out, predicted by it or by several."""
    print(HEAD)
    for name, trace in run.held_out.items():
        end = RECORDS[name][0]
        bands = [
            source.predict(trace, "observation", draws=draws, given=given)
            for given in (None, (float(trace.time[0]), end))
        ]
        for band in bands:
            print(row(name, trace, band))


SAMPLES = 64
SECONDS = 12.0
DRAWS = (256, 1000)


def follow(run: mb.Run, trace: mb.Trace, draws: int) -> tuple[np.ndarray, float, float]:
    """Times of all updates, of a band of the next 64 samples, and of a refresh, s."""
    forecaster = run.follow(0.036, amplitude=0.18, velocity=1.5, draws=draws, refresh=False)
    times = []
    last = int(np.searchsorted(trace.time, SECONDS)) // SAMPLES * SAMPLES
    for begin in range(0, last, SAMPLES):
        part = slice(begin, begin + SAMPLES)
        columns = trace.time[part], trace.displacement[part], None, np.asarray(trace.force)[part]
        began = time.perf_counter()
        forecaster.update(*columns)
        times.append(time.perf_counter() - began)
    ahead = slice(last, last + SAMPLES)
    motion = mb.Trace.from_arrays(trace.time[ahead], trace.displacement[ahead])
    began = time.perf_counter()
    forecaster.band(motion)
    band = time.perf_counter() - began
    began = time.perf_counter()
    forecaster.refresh()
    return np.array(times), band, time.perf_counter() - began


def speed(run: mb.Run, data: Path, draws: tuple[int, ...]) -> list[str]:
    """Print the times of following a record; the bar if it is missed."""
    trace = mb.read_record(data / "brfd" / "2023_36lb_KocaeliDBE.csv").trace()
    arrive = SAMPLES * float(np.median(np.diff(trace.time)))
    print(f"\n64 samples arrive in {1e3 * arrive:.1f} ms; {SECONDS:g} s of record; times in ms\n")
    print(f"{'draws':>6}{'median':>9}{'95 %':>9}{'slowest':>9}{'band of 64':>12}{'refresh':>9}")
    slowest = 0.0
    for count in draws:
        times, band, refresh = follow(run, trace, count)
        ms = 1e3 * times
        print(
            f"{count:6}{np.median(ms):9.2f}{np.quantile(ms, 0.95):9.2f}{ms.max():9.2f}"
            f"{1e3 * band:12.1f}{1e3 * refresh:9.0f}"
        )
        slowest = max(slowest, float(times.max()))
    return [f"an update takes {slowest:.3f} s"] if slowest > arrive else []


def main() -> None:
    parser = common.parser_of(__doc__ or "", data=True)
    parser.add_argument("runs", type=Path, nargs="+")
    options = parser.parse_args()
    common.heading((__doc__ or "").splitlines()[0])
    runs = [mb.open_run(folder) for folder in options.runs]
    draws = 200 if options.quick else 1000
    for run in runs:
        settings = run.manifest.settings
        print(f"\nModel {settings.model}, {len(run.tests)} calibrated tests\n")
        score(run, run, draws)
    if len(runs) > 1:
        both = mb.ModelAverage(runs)
        print(f"\nModels {' and '.join(both.models)} in equal parts\n")
        score(both, runs[0], draws)
    failed = speed(runs[0], options.data, DRAWS[:1] if options.quick else DRAWS)
    common.finish([] if options.quick else failed)


if __name__ == "__main__":
    main()
