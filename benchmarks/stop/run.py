"""The stop rule of `watch`: how many cycles it saves, and what that costs in width.

Simulated tests of a finished run's device, ten cycles each, are followed to their end. Compared
are the cycle at which the rule stops, and the interval there of the device's property (its slip
forces and its gap, with the scatter from test to test), with those after all cycles, and with a
fixed number of cycles that gives the same mean width.

    python -m benchmarks.stop.run OUT --actuation "36 lbf" [--tests 100]

takes about a minute of a processor for 20 tests.
"""

import argparse

import numpy as np

import mfd_bayes as mb
from mfd_bayes.population.given import is_enough
from mfd_bayes.units import parse_actuation

CYCLES, FREQUENCY = 10, 0.5


def follow(run, motion, level, force):
    """Width of each property's interval after each cycle, (cycles, k), and where to stop."""
    follower = run.follow(level, amplitude=1.0, velocity=2.0 * np.pi * FREQUENCY)
    begin, widths, stop = 0, [], 0
    for number, end in enumerate(motion.cycle_turns[2::2], start=1):
        part = slice(begin, end + 1)
        follower.update(motion.time[part], motion.displacement[part], None, force[part])
        begin = end + 1
        known = follower.estimates(number)
        stop = stop or (number if is_enough(known, number) else 0)
        own = [np.log(e.upper / e.lower) / 3.92 for e in known.values()]
        scatter = [follower.scatter[name] for name in known]
        widths.append(np.hypot(own, scatter))
    return np.array(widths), stop or len(widths)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out")
    parser.add_argument("--actuation", required=True)
    parser.add_argument("--tests", type=int, default=100)
    options = parser.parse_args()
    run, level = mb.open_run(options.out), parse_actuation(options.actuation)[0]
    time = np.arange(0.0, (CYCLES + 0.5) / FREQUENCY, 1.0 / 64.0)
    motion = mb.Trace.from_arrays(time, np.sin(2.0 * np.pi * FREQUENCY * time), level)
    forces = run.predict(motion, "observation", draws=options.tests, seed=7).draws
    found = [follow(run, motion, level, force) for force in forces]
    widths, stops = np.stack([w for w, _ in found]), np.array([stop for _, stop in found])
    at_stop = widths[np.arange(len(stops)), stops - 1]
    mean = widths.mean(axis=0)  # (cycles, k): of a fixed number of cycles
    equal = [
        int(np.argmax(column <= own)) + 1
        for column, own in zip(mean.T, at_stop.mean(axis=0), strict=True)
    ]
    print(f"{len(stops)} tests of {CYCLES} cycles at {options.actuation}")
    print(f"stops after {stops.mean():.2f} cycles on average ({stops.min()} to {stops.max()})")
    for k, name in enumerate(run.follow(level).scatter):
        print(
            f"{name}: width at the stop over that after {CYCLES} cycles "
            f"{at_stop[:, k].mean() / mean[-1, k]:.3f}; as wide after {equal[k]} cycles fixed"
        )


if __name__ == "__main__":
    main()
