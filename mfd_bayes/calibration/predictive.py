"""Posterior predictive records of a test, checks on them, and derived quantities."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.friction.model import Model
from mfd_bayes.records.loops import STRONG
from mfd_bayes.records.trace import Trace, check_magnitude

Array = NDArray[np.float64]

COVERAGES = (0.5, 0.9, 0.95)


@dataclass(frozen=True, eq=False)
class Replicas:
    """Records that the posterior predicts for the motion of its own test."""

    force: Array  # (n, T), kip: model force and offset, for posterior draws
    observed: Array  # (n, T), kip: the same with noise
    values: Mapping[str, Array]  # (n,): the posterior draws that were used


@dataclass(frozen=True)
class PredictiveCheck:
    """A test statistic: observed value, mean and p-value under the posterior predictive.

    `kind` is what it measures, as `campaign.tolerances` names it, and `size` by how much the model
    misses it: expected minus observed, as a share of what is measured.
    """

    name: str
    observed: float
    expected: float
    p_value: float
    kind: str = ""
    size: float = float("nan")


def replicate(
    posterior: Posterior, values: Mapping[str, Array], rng: np.random.Generator, n: int = 1000
) -> Replicas:
    """Replicated records."""
    total = len(values["offset"])
    pick = np.linspace(0, total - 1, min(n, total)).astype(np.intp)
    taken = {name: column[pick] for name, column in values.items()}
    with np.errstate(over="ignore", invalid="ignore"):  # refused just below
        force = posterior.force(taken) + taken["offset"][:, None]
        noise = posterior.noise.draw(rng, posterior.trace.time, taken, posterior.travel(taken))
    check_magnitude("the replicated force", force + noise)
    return Replicas(force, force + noise, taken)


def check_predictive(
    posterior: Posterior, replicas: Replicas, gap: float | None
) -> tuple[PredictiveCheck, ...]:
    """Posterior predictive p-values of the test statistics, P(T(replica) ≥ T(record))."""
    kept = slice(posterior.first, None)
    force, replica = replicas.force[:, kept], replicas.observed[:, kept]
    record = np.broadcast_to(np.asarray(posterior.trace.force)[kept], force.shape)
    half = 0.5 * float(np.ptp(record[0]))
    rests = record - force, replica - force
    lags = _lag_one(rests[0]), _lag_one(rests[1])
    found = [
        _check("residual rms, kip", "residual", _rms(rests[0]), _rms(rests[1])),
        _check("lag-one residual correlation", "correlation", *lags, scale=1.0),
        *_energy_checks(posterior, replicas),
        _check("peak force forward, kip", "peak", record.max(axis=1), replica.max(axis=1)),
        _check("peak force backward, kip", "peak", -record.min(axis=1), -replica.min(axis=1)),
    ]
    if gap is not None:
        at = _mid_gap(posterior.trace, gap) - posterior.first
        at = at[at >= 0]
        if at.size:
            sides = _rms(record[:, at]), _rms(replica[:, at])
            found.append(_check("force at mid-gap, kip", "mid_gap", *sides, scale=half))
    return (*found, *_coverage_checks(record[0], replica))


def _check(
    name: str, kind: str, observed: Array, replicated: Array, scale: float | None = None
) -> PredictiveCheck:
    """Check of a statistic; `scale` is what its size is a share of, by default the observed."""
    ties = np.mean(replicated == observed)
    p_value = float(np.mean(replicated > observed) + 0.5 * ties)
    seen, expected = float(observed.mean()), float(replicated.mean())
    whole = max(abs(seen) if scale is None else scale, 1e-12)
    return PredictiveCheck(name, seen, expected, p_value, kind, (expected - seen) / whole)


def _energy_checks(posterior: Posterior, replicas: Replicas) -> list[PredictiveCheck]:
    """Energy of a cycle at full stroke, and in all where other cycles have a part in it."""
    trace, first = posterior.trace, posterior.first
    forces = np.asarray(trace.force)[None], replicas.observed
    strong = full_strokes(trace, first)
    found = []
    if strong.any():
        seen, drawn = (cycle_energies(f, trace, first)[:, strong].mean(axis=1) for f in forces)
        found.append(_check("energy per cycle, kip·in", "energy", seen, drawn))
    if not strong.all() or not strong.any():
        x = trace.displacement[first:]
        seen, drawn = (np.asarray(np.trapezoid(f[:, first:], x, axis=1)) for f in forces)
        found.append(_check("energy in all, kip·in", "energy", seen, drawn))
    return found


def cycle_energies(force: Array, trace: Trace, first: int = 0) -> Array:
    """Energy dissipated in each of the L full cycles, E = ∮ F dx, (n, L), kip·in, of force (n, T).

    A full cycle runs from one turn of the whole motion (`Trace.cycle_turns`) to the second one
    after it. Cycles follow each other from the first turn at or after sample `first`.
    """
    bounds = _cycle_bounds(trace, first)
    if bounds.size < 2:
        return np.empty((len(force), 0))
    kept = slice(bounds[0], bounds[-1] + 1)
    mean = 0.5 * (force[:, kept][:, 1:] + force[:, kept][:, :-1])
    work = mean * np.diff(trace.displacement[kept])
    return np.add.reduceat(work, bounds[:-1] - bounds[0], axis=1)


def full_strokes(trace: Trace, first: int = 0) -> NDArray[np.bool_]:
    """Whether each of the full cycles has at least `STRONG` of the largest amplitude, (L,)."""
    bounds = _cycle_bounds(trace, first)
    if bounds.size < 2:
        return np.empty(0, dtype=bool)
    x, begins = trace.displacement[bounds[0] : bounds[-1] + 1], bounds[:-1] - bounds[0]
    stroke = np.maximum.reduceat(x, begins) - np.minimum.reduceat(x, begins)
    return np.asarray(stroke >= STRONG * stroke.max())


def _cycle_bounds(trace: Trace, first: int) -> NDArray[np.intp]:
    """Samples at which full cycles begin, and at which the last ends, (L + 1,)."""
    return trace.cycle_turns[trace.cycle_turns >= first][::2]


def derive_from_parameters(
    model: Model,
    values: Mapping[str, Array],
    pressure: float = float("nan"),
    area: float | None = None,
) -> dict[str, Array]:
    """Gap width, in, and self-energizing factors C = F_c/(p A) by name, (n,) each.

    Those that are unknown, as without a pressure (ksi) or an area of the actuator (in²), are left
    out.
    """
    width = model.gap_width(values)
    derived = {} if width is None else {"gap_width": width}
    if area is not None and pressure > 0.0:
        sides = zip(("C_fwd", "C_bwd"), model.slip_forces, strict=False)
        derived |= {name: values[force] / (pressure * area) for name, force in sides}
    return derived


def _coverage_checks(record: Array, replica: Array) -> list[PredictiveCheck]:
    """Coverage of bands made from one half of the replicas, against that of the other half."""
    band, held = replica[::2], replica[1::2]
    checks = []
    for probability in COVERAGES:
        tail = 0.5 * (1.0 - probability)
        lower, upper = np.quantile(band, [tail, 1.0 - tail], axis=0)
        observed = np.mean((record >= lower) & (record <= upper))
        replicated = np.mean((held >= lower) & (held <= upper), axis=1)
        name = f"coverage of the {probability:.0%} band".replace("%", " %")
        found = _check(name, "coverage", np.full(len(held), observed), replicated)
        checks.append(replace(found, size=float(observed) - probability))
    return checks


def _rms(values: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(values**2, axis=1)))


def _lag_one(values: Array) -> Array:
    centred = values - values.mean(axis=1, keepdims=True)
    products = np.sum(centred[:, 1:] * centred[:, :-1], axis=1)
    correlation: Array = products / np.maximum(np.sum(centred**2, axis=1), 1e-300)
    return correlation


def _mid_gap(trace: Trace, gap: float) -> NDArray[np.intp]:
    """Samples nearest to half the gap after each turning point that is followed by a crossing."""
    ends = [*trace.turning_points.tolist(), trace.samples - 1]
    samples = []
    for begin, end in itertools.pairwise(ends):
        travel = np.abs(trace.displacement[begin : end + 1] - trace.displacement[begin])
        if travel.max() >= gap:
            samples.append(begin + int(np.argmax(travel >= 0.5 * gap)))
    return np.array(samples, dtype=np.intp)
