"""Each record of the 36 lb session fitted by itself by least squares, under both models with a gap.

    python -m benchmarks.backlash.fits > benchmarks/backlash/fits.txt

takes some minutes. The error is the root relative squared error, √(Σ(F − F̂)²/Σ(F − F̄)²), and
stands beside that of the LuGre model that the dataset's authors published. Harmonic records are
fitted and scored as a whole, earthquakes from the first sample to the end of the window in which
they are scored. A weak prior term keeps what a record does not tell in place.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy import optimize

from benchmarks.common.data import add_data_option
from benchmarks.common.machine import load, processor
from benchmarks.heldout.records import Kind, lay_out
from benchmarks.heldout.run import PUBLISHED, WINDOWS
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.pipeline.plan import Options, plan_campaign
from mfd_bayes.records.trace import Trace

MODELS = ("three_stage", "backlash")
DRAWN, STARTS, EVALUATIONS, WEIGHT = 600, 8, 200, 0.02
SHOWN = {
    "three_stage": ("k3", "d2", "d3", "ell", "Fc_fwd", "Fc_bwd"),
    "backlash": ("k_fwd", "k_bwd", "gap", "ell", "Fc_fwd", "Fc_bwd", "n"),
}


def fit(trace: Trace, model: str) -> tuple[np.ndarray, dict[str, float]]:
    """Residual, (T,), kip, of the best of some fits, and the values of its quantities."""
    posterior = Posterior(trace, load_priors("brfd"), "iid", model)
    drawn = posterior.coordinates(posterior.draw_prior(np.random.default_rng(0), DRAWN))
    middle, scale = drawn.mean(axis=0), drawn.std(axis=0)
    free = [i for i, name in enumerate(posterior.names) if name != "noise_sd"]

    def full(q: np.ndarray) -> np.ndarray:
        points = np.repeat(middle[None], len(q), axis=0)
        points[:, free] = middle[free] + scale[free] * q
        return points

    def residual(q: np.ndarray) -> np.ndarray:
        return np.concatenate([posterior.residual(full(q[None]))[0], WEIGHT * q])

    def jacobian(q: np.ndarray) -> np.ndarray:
        around = q + 1e-4 * np.vstack([np.eye(q.size), -np.eye(q.size)])
        found = posterior.residual(full(around))
        return np.vstack([(found[: q.size] - found[q.size :]).T / 2e-4, WEIGHT * np.eye(q.size)])

    squares = np.sum(posterior.residual(drawn) ** 2, axis=1)
    starts = (drawn[np.argsort(squares)[:STARTS]][:, free] - middle[free]) / scale[free]
    fits = [optimize.least_squares(residual, q, jacobian, max_nfev=EVALUATIONS) for q in starts]
    best = min(fits, key=lambda found: found.cost)
    point = full(best.x[None])
    values = {name: float(column[0]) for name, column in posterior.values(point).items()}
    return posterior.residual(point)[0], values


def error(trace: Trace, residual: np.ndarray, window: tuple[float, float] | None) -> float:
    """Root relative squared error inside a window of time, s, or of the whole."""
    begin, end = window or (-np.inf, np.inf)
    inside = (trace.time >= begin) & (trace.time <= end)
    force = np.asarray(trace.force)[inside]
    return float(np.sqrt(np.sum(residual[inside] ** 2) / np.sum((force - force.mean()) ** 2)))


def records(data: Path) -> dict[str, Trace]:
    """Traces of the session's records by id, at the rates of a calibration."""
    with tempfile.TemporaryDirectory() as folder:
        plan = plan_campaign(
            lay_out(data / "brfd", Path(folder), "36lb", Kind("iid", "three_stage")), Options()
        )
        traces = {task.id: task.trace for task in plan.tasks} | dict(plan.held_out)
    return {name: _until(traces[name], WINDOWS.get(name)) for name in PUBLISHED}


def _until(trace: Trace, window: tuple[float, float] | None) -> Trace:
    """The trace up to the end of its window."""
    kept = trace.time <= (window[1] if window else np.inf)
    columns = (trace.time, trace.displacement, trace.force, trace.velocity)
    time, displacement, force, velocity = (np.asarray(c)[kept] for c in columns)
    return Trace.from_arrays(time, displacement, trace.actuation, force, velocity)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_data_option(parser)
    traces = records(parser.parse_args().data)
    print("Each record of the 36 lb session fitted by itself, by least squares, RRSE\n")
    print(f"{processor()}; {load()}\n")
    head = "".join(f"{model:>13s}" for model in MODELS)
    print(f"{'record':26s}{'samples':>8s}{'published':>11s}{head}   over published")
    shares: dict[str, list[float]] = {model: [] for model in MODELS}
    known: dict[str, list[str]] = {model: [] for model in MODELS}
    for name, trace in traces.items():
        found = {}
        for model in MODELS:
            begin = time.perf_counter()
            residual, values = fit(trace, model)
            found[model] = error(trace, residual, WINDOWS.get(name))
            shares[model].append(found[model] / PUBLISHED[name])
            some = "".join(f"{values[key]:9.3f}" for key in SHOWN[model])
            known[model].append(f"{name:26s}{some}   {time.perf_counter() - begin:5.0f} s")
        own = "".join(f"{found[model]:13.3f}" for model in MODELS)
        over = "  ".join(f"{shares[model][-1]:.2f}" for model in MODELS)
        print(f"{name:26s}{trace.samples:8d}{PUBLISHED[name]:11.3f}{own}   {over}", flush=True)
    harmonic = np.array([name not in WINDOWS for name in traces])
    means = ", ".join(f"{m} {np.mean(np.array(shares[m])[harmonic]):.3f}" for m in MODELS)
    print(f"\nmean of the harmonic records over published: {means}")
    for model in MODELS:
        print(
            f"\n{model}: fitted values (kip, in) and time\n{'':26s}"
            + "".join(f"{key:>9s}" for key in SHOWN[model])
        )
        print("\n".join(known[model]))


if __name__ == "__main__":
    main()
