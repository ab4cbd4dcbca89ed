"""Records of new tests beside a finished run: devices are accepted, and running tests watched."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

import numpy as np

from mfd_bayes.errors import CampaignError, MfdError, RecordError
from mfd_bayes.evaluation.acceptance import DRAWS as ACCEPTANCE_DRAWS
from mfd_bayes.evaluation.acceptance import LIMITS, Acceptance, accept
from mfd_bayes.pipeline.predict import stated_actuation, stated_conditions
from mfd_bayes.population.given import NARROWING, Estimate, Forecaster, is_enough
from mfd_bayes.records.readers import read_table
from mfd_bayes.records.record import Record, read_record
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.page import acceptance_page
from mfd_bayes.reporting.tables import acceptance_table, to_csv
from mfd_bayes.runs.folder import check_folder
from mfd_bayes.runs.run import Run, open_run
from mfd_bayes.runs.tested_range import conditions_of
from mfd_bayes.runs.unit_system import System
from mfd_bayes.store.files import remove_file, write_bytes, write_text
from mfd_bayes.units import parse_quantity

_LIMIT = re.compile(r"\s*(\w+)\s*=\s*(\d+(?:\.\d+)?)\s*(%?)\s*")


@dataclass(frozen=True)
class Inspection:
    """Records of devices that are to be compared with the others; the options of the command.

    `device` is that of all records, or of each; by default each record is of another one. `limit`
    is such as "slip=15 %", by default that of the campaign, else 15 % of all.
    """

    records: tuple[Path, ...]
    folder: Path
    actuation: str = ""
    device: tuple[str, ...] = ()
    limit: tuple[str, ...] = ()
    session: str = ""
    date: str = ""
    cycles: float | None = None
    temperature: str = ""
    draws: int = ACCEPTANCE_DRAWS
    seed: int = 0
    units: str = ""
    force: bool = False


def parse_limits(texts: tuple[str, ...]) -> dict[str, float]:
    """Limits of texts such as "slip=15 %"."""
    found = {}
    for text in texts:
        read = _LIMIT.fullmatch(text)
        if read is None:
            raise CampaignError(
                f"--limit reads 'slip=15 %', with {', '.join(LIMITS)} or all, got {text!r}"
            )
        found[read[1]] = float(read[2]) / (100.0 if read[3] else 1.0)
    return found


def read_as_tests(run: Run, path: Path, actuation: str) -> Record:
    """A record by the campaign's columns where the file has them, else by its own headers."""
    stated = run.manifest.settings.columns.given
    names, axes = read_table(path).names, run.system.axes
    columns = {role: c.source for role, c in stated.items() if role != "actuation"}
    there = all(c.key in names or c.name is None for r, c in stated.items() if r in columns)
    return read_record(path, columns if columns and there else None, actuation=actuation, axes=axes)


def accept_records(out: Path, wish: Inspection) -> tuple[tuple[Acceptance, ...], tuple[Path, ...]]:
    """Compare devices with those of a run; table, pages (returned) and picture are written."""
    check_folder(wish.folder, force=wish.force)
    limits = parse_limits(wish.limit)
    run = replace(open_run(out), units=wish.units)
    wish = replace(wish, actuation=stated_actuation(run, wish.actuation))
    run.level_of(wish.actuation)
    records = [read_as_tests(run, path, wish.actuation) for path in wish.records]
    device = wish.device[0] if len(wish.device) == 1 else wish.device or ""
    devices = accept(
        *(run, records),
        device=device,
        limits=limits or None,
        session=wish.session,
        conditions=stated_conditions(wish),
        draws=wish.draws,
        seed=wish.seed,
    )
    return devices, _write(run, wish, devices)


def _write(run: Run, wish: Inspection, devices: tuple[Acceptance, ...]) -> tuple[Path, ...]:
    from mfd_bayes.reporting.figures import draw_batch, to_png

    today, manifest, folder = datetime.now(UTC).date().isoformat(), run.manifest, wish.folder
    made = (
        f"{manifest.title}, {run.folder.resolve().name} (seed {manifest.seed}, {manifest.finished})"
    )
    actuation = {"actuation": wish.actuation} if run.system.axes.actuated else {}
    heading = [f"run {made}", *(f"actuation {level}" for level in actuation.values())]
    heading.append(f"date {today}")
    heading += [f"{d.device}: {d.sentence}" for d in devices]
    write_text(folder / "acceptance.csv", to_csv(acceptance_table(devices, run.system), heading))
    pages: list[Path] = []
    for device in devices:
        about = {
            f"record {i}": f"{c.record.path.name}, SHA-256 {c.record.sha256}"
            for i, c in enumerate(device.comparisons, start=1)
        }
        about |= {
            **actuation,
            "compared with": f"{made}: {len(run.tests)} calibrated tests of {_devices(run)}",
            "program": f"mfd_bayes {manifest.versions.get('mfd_bayes', '')}",
        }
        name = re.sub(r"[^\w+-]+", "_", device.device).strip("_")[:80] or "device"
        path = folder / f"{name}.html"
        if path in pages:
            path = folder / f"{name}_{len(pages) + 1}.html"
        write_text(path, acceptance_page(device, about, today, len(devices), run.system))
        pages.append(path)
    picture = folder / "acceptance.png"
    if len(devices) > 1:
        write_bytes(picture, to_png(draw_batch(devices)))
    else:
        remove_file(picture)
    return tuple(pages)


def _devices(run: Run) -> str:
    names = [name for name in run.devices if name]
    return f"{len(names)} devices ({', '.join(names)})" if len(names) > 1 else "one device"


POLL = 1.0  # seconds between two looks at the file
SAMPLES = 64  # of the next cycle, of which the band is computed


@dataclass(frozen=True)
class Watched:
    """What is watched, and when it ends; the options of the command.

    `narrowing` is the share by which one more cycle must narrow an interval, to be worth it. The
    command ends when the file has not grown for `wait`.
    """

    record: Path
    actuation: str = ""
    session: str = ""
    device: str = ""
    date: str = ""
    cycles: float | None = None
    temperature: str = ""
    narrowing: str = f"{100 * NARROWING:g} %"
    wait: str = "10 s"


@dataclass(frozen=True)
class Cycle:
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
    system: System

    @property
    def sentence(self) -> str:
        """One line: properties with their intervals, beside the population, and what is next."""
        words = self.system.words
        parts = [
            f"{e.name} {words([e.median], e.unit, 3)} ({words([e.lower, e.upper], e.unit, 3)}; "
            f"{100 * e.percentile:.0f} % of new tests are below)"
            for e in self.estimates.values()
        ]
        most = max(self.estimates.values(), key=lambda e: e.narrowing)
        verdict = f"one more would narrow {most.name} by {100 * most.narrowing:.1f} %"
        if self.misfit:
            verdict = (
                "warning: the force does not fit this device, and these figures are not reliable: "
                "check the actuation, the columns and which device it is"
            )
        elif self.enough:
            verdict = f"enough after cycle {self.enough}"
        return (
            f"cycle {self.number}: {', '.join(parts)}; band {words([self.band], 'kip', 3)} wide; "
            f"{verdict}"
        )


def watch(out: Path, watched: Watched) -> Iterator[Cycle]:
    """Cycles of a test as they end in its file, which may still grow."""
    run = replace(open_run(out), conditions=stated_conditions(watched))
    watched = replace(watched, actuation=stated_actuation(run, watched.actuation))
    level = run.level_of(watched.actuation)
    narrowing = parse_quantity(watched.narrowing, "dimensionless", of="--narrowing")
    wait = parse_quantity(watched.wait, "time", of="--wait")
    follower: Forecaster | None = None
    number = begin = enough = 0
    for trace in _growing(run, watched, wait):
        if trace.force is None:
            raise RecordError(f"{watched.record} has no column of the force")
        turns = trace.cycle_turns[::2]
        for first, end in pairwise(turns[turns >= begin - 1].tolist()):
            follower = follower or _follow(run, trace, level, watched)
            part = slice(begin, end + 1)
            follower.update(
                trace.time[part], trace.displacement[part], None, np.asarray(trace.force)[part]
            )
            number, begin = number + 1, end + 1
            estimates = follower.estimates(number)
            misfit = follower.is_misfit
            if not (enough or misfit) and is_enough(estimates, number, narrowing):
                enough = number
            width = _width(follower, trace, first, end)
            yield Cycle(number, estimates, width, misfit, enough, run.system)
    if not number:
        raise RecordError(
            f"{watched.record} has no full cycle: expected a motion that turns three times"
        )


def _follow(run: Run, trace: Trace, level: float, watched: Watched) -> Forecaster:
    """Forecaster of a test with the stroke and the speed of its first cycle."""
    reached = conditions_of(trace)
    return run.follow(
        level,
        amplitude=0.5 * reached["stroke"],
        velocity=reached.get("speed"),
        session=watched.session,
        device=watched.device,
    )


def _width(follower: Forecaster, trace: Trace, first: int, end: int) -> float:
    """Mean width of the band of the cycle between two samples, made once more, kip."""
    at = np.arange(first, end, max(1, (end - first) // SAMPLES))
    later = trace.time[end] - trace.time[first] + trace.time[at[1]] - trace.time[at[0]]
    again = Trace.from_arrays(trace.time[at] + later, trace.displacement[at], trace.actuation)
    band = follower.band(again)
    return float(np.mean(band.upper - band.lower))


def _growing(run: Run, watched: Watched, wait: float) -> Iterator[Trace]:
    """The record each time that its file has grown, until it has not for `wait` s.

    The last line of a file that is being written may be half a line: while the file grows, what
    cannot be read is read again.
    """
    seen = None
    while True:
        try:
            state = watched.record.stat()
        except OSError as error:
            raise RecordError(f"cannot read {watched.record}: {error.strerror}") from error
        idle = time.time() - state.st_mtime >= wait
        if idle or state.st_size != seen:
            seen = state.st_size
            try:
                yield read_as_tests(run, watched.record, watched.actuation).trace()
            except MfdError:
                if idle:
                    raise
        if idle:
            return
        time.sleep(POLL)
