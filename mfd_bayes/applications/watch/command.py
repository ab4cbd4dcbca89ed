"""The command `watch`: a line for each cycle of a test that runs."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from mfd_bayes.applications.watch.options import WatchOptions
from mfd_bayes.console import say
from mfd_bayes.errors import MfdError, RecordError
from mfd_bayes.population.conditioning import Estimate, OnlinePredictor, is_enough
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.run import Run, actuation_level, open_run
from mfd_bayes.runs.stated import read_as_tests, stated_actuation, stated_conditions
from mfd_bayes.runs.tested_range import conditions_of
from mfd_bayes.runs.unit_system import UnitSystem
from mfd_bayes.units import parse_quantity

POLL = 1.0  # seconds between two looks at the file
SAMPLES = 64  # of the next cycle, of which the band is computed


@dataclass(frozen=True)
class WatchedCycle:
    """A cycle that has ended, with the estimates of the test so far.

    `band` is the mean width, kip, of the 95 % band of the force in one more cycle of the same
    motion, `misfit` whether the force is not that of a test of this device, and `enough` the cycle
    after which the test was long enough, 0 where it is not yet.
    """

    number: int
    estimates: Mapping[str, Estimate]
    band: float
    misfit: bool
    enough: int
    system: UnitSystem

    @property
    def sentence(self) -> str:
        """One line: properties with their intervals, beside the population, and what is next."""
        words = self.system.words
        figures = [
            f"{e.name} {words([e.median], e.unit, 3)} ({words([e.lower, e.upper], e.unit, 3)}; "
            f"{100 * e.percentile:.0f} % of new tests are below)"
            for e in self.estimates.values()
        ]
        best = max(self.estimates.values(), key=lambda e: e.narrowing)
        verdict = f"one more would narrow {best.name} by {100 * best.narrowing:.1f} %"
        if self.misfit:
            verdict = (
                "warning: the force does not fit this device, and these figures are not reliable: "
                "check the actuation, the columns and which device it is"
            )
        elif self.enough:
            verdict = f"enough after cycle {self.enough}"
        return (
            f"cycle {self.number}: {', '.join(figures)}; band {words([self.band], 'kip', 3)} wide; "
            f"{verdict}"
        )


def run_watch(options: WatchOptions) -> None:
    """Print a line for each cycle of a test as it ends."""
    for cycle in watch(options):
        say(cycle.sentence)


def watch(options: WatchOptions) -> Iterator[WatchedCycle]:
    """Cycles of a test as they end in its file, which may still grow."""
    run = open_run(options.run, trust=options.trust_model)
    run = replace(run, conditions=stated_conditions(options))
    options = replace(options, actuation=stated_actuation(run, options.actuation))
    level = actuation_level(run, options.actuation)
    narrowing = parse_quantity(options.narrowing, "dimensionless", of="--narrowing")
    wait = parse_quantity(options.wait, "time", of="--wait")
    follower: OnlinePredictor | None = None
    number = begin = enough = 0
    for trace in _growing(run, options, wait):
        if trace.force is None:
            raise RecordError(f"{options.record} has no column of the force")
        turns = trace.cycle_turns[::2]
        for start, end in pairwise(turns[turns >= begin - 1].tolist()):
            if follower is None:
                reached = conditions_of(trace)  # of the first cycle
                follower = run.follow(
                    level,
                    amplitude=0.5 * reached["stroke"],
                    velocity=reached.get("speed"),
                    session=options.session,
                    device=options.device,
                )
            segment = slice(begin, end + 1)
            follower.update(
                trace.time[segment],
                trace.displacement[segment],
                None,
                np.asarray(trace.force)[segment],
            )
            number, begin = number + 1, end + 1
            estimates = follower.estimates(number)
            misfit = follower.is_misfit
            if not (enough or misfit) and is_enough(estimates, number, narrowing):
                enough = number
            width = _width(follower, trace, start, end)
            yield WatchedCycle(number, estimates, width, misfit, enough, run.system)
    if not number:
        raise RecordError(
            f"{options.record} has no full cycle: expected a motion that turns three times"
        )


def _width(follower: OnlinePredictor, trace: Trace, start: int, end: int) -> float:
    """Mean width of the band of the cycle between two samples, made once more, kip."""
    indices = np.arange(start, end, max(1, (end - start) // SAMPLES))
    later = trace.time[end] - trace.time[start] + trace.time[indices[1]] - trace.time[indices[0]]
    again = Trace.from_arrays(
        trace.time[indices] + later, trace.displacement[indices], trace.actuation
    )
    band = follower.band(again)
    return float(np.mean(band.upper - band.lower))


def _growing(run: Run, options: WatchOptions, wait: float) -> Iterator[Trace]:
    """The record each time that its file has grown, until it has not for `wait` s.

    The last line of a file that is being written may be half a line: while the file grows, what
    cannot be read is read again.
    """
    size = None
    while True:
        try:
            state = options.record.stat()
        except OSError as error:
            raise RecordError(f"cannot read {options.record}: {error.strerror}") from error
        idle = time.time() - state.st_mtime >= wait
        if idle or state.st_size != size:
            size = state.st_size
            try:
                yield read_as_tests(run, options.record, options.actuation).trace()
            except MfdError:
                if idle:
                    raise
        if idle:
            return
        time.sleep(POLL)
