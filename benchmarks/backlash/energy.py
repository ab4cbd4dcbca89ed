"""Whether the backlash model gives energy in any closed motion: 10,000 random cases.

    python -m benchmarks.backlash.energy > benchmarks/backlash/energy.txt

takes about a minute of one core. A case is a damper with random parameters and a random closed
motion of four harmonics, from far inside the gap to many times its width, taken three times. The
energy that the last round takes up is ∮ F dx less what the spring holds more at its end than at
its beginning, over the largest force and the length of the way. It can only be below zero by the
errors of the rule and of the sum over samples. Exit status 1: it is below the bar.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.machine import processor
from mfd_bayes.friction.backlash import BacklashLuGre
from mfd_bayes.friction.spring import Spring
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

MODEL = BacklashLuGre()
CENTRE = np.array([50.0, 42.0, 0.2, 0.02, 0.4, 2.2, 1.8, 3.0, 0.0, 0.2, 0.15, 0.5])
SAMPLES, ROUNDS = 512, 3
BAR = -2e-5


def dampers(count: int, rng: np.random.Generator) -> Array:
    """Random parameters, (count, 12), without viscous friction; n from 1 to 10."""
    theta = CENTRE * rng.lognormal(0.0, 0.6, (count, CENTRE.size))
    theta[:, MODEL.parameters.index("n")] = rng.uniform(1.0, 10.0, count)
    return theta


def motions(count: int, rng: np.random.Generator) -> Iterator[Trace]:
    """Closed motions, each taken `ROUNDS` times."""
    angle = 2 * np.pi * np.arange(1, 5)[:, None] * np.arange(ROUNDS * SAMPLES + 1) / SAMPLES
    for _ in range(count):
        size, seconds = rng.lognormal(-2.0, 1.0), rng.lognormal(1.0, 1.0)
        waves = size * rng.normal(size=(4, 2)) / np.arange(1, 5)[:, None]
        x = (waves[:, :1] * np.sin(angle) + waves[:, 1:] * np.cos(angle)).sum(axis=0)
        time = np.arange(x.size) * seconds / SAMPLES
        yield Trace.from_arrays(time, x, velocity=np.zeros(x.size))


def taken_up(theta: Array, trace: Trace) -> Array:
    """Energy that the last round takes up, (n,), over largest force and way."""
    spring = Spring(*np.ascontiguousarray(theta.T[:5]))
    last = slice(-SAMPLES - 1, None)
    force, x = MODEL.force(theta, trace)[:, last], trace.displacement[last]
    low, high = spring.deflection(force[:, [0, -1]].T)
    between = low + (high - low) * np.linspace(0.0, 1.0, 41)[:, None]
    held = np.trapezoid(spring.evaluate(between)[0], between, axis=0)
    work = np.trapezoid(force, x, axis=1) - held
    return work / (np.abs(force).max(axis=1) * np.abs(np.diff(x)).sum())


def main() -> None:
    """Print the table."""
    rng = np.random.default_rng(1)
    theta = dampers(50, rng)
    found = np.array([taken_up(theta, trace) for trace in motions(200, rng)]).ravel()
    print("Energy taken up in the last of three rounds of a closed motion, over force times way\n")
    print(f"{processor()}; {found.size:,} cases, {SAMPLES} samples a round")
    print(f"least {found.min():.1e}, bar {BAR:.0e}; below zero {np.mean(found < 0):.2%}")
    for share in (0.1, 0.5, 0.9):
        print(f"{share:.0%} of the cases below {np.quantile(found, share):.4f}")
    sys.exit(bool(found.min() < BAR))


if __name__ == "__main__":
    main()
