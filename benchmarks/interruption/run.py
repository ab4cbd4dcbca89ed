"""What a calibration leaves after a fault at a random moment, and whether it resumes to the same.

    python -m benchmarks.interruption.run [FAULTS] [SEED] > benchmarks/interruption/interruption.txt

runs `mfd-bayes calibrate` on a small synthetic campaign undisturbed, on this machine and on a dask
cluster; then FAULTS (60) times from the start, each time with one fault:

SIGINT, SIGTERM, SIGKILL  the signal is sent to the command
worker       one of its worker processes is killed
disk         its disk fills up (a tmpfs of random size; needs root)
read-only    its disk becomes read-only, every second time by the second way of `forbid_writing`
lost worker  one of the two workers of a cluster is killed
all workers  both are killed, and 3 s later another is started
no workers   both are killed and none is started; asked to wait for one, the user presses Ctrl-C
scheduler    the cluster's scheduler is killed
client       the command that works on a cluster gets SIGKILL

After each fault, every file in the run folder must be equal to that of the undisturbed run, and
every posterior must open. `check` reads the folder, or `report` reads a copy of it: they must
print what the undisturbed run gives, or one sentence that the run is not finished. Then the run
is resumed with another number of processes (after "client" on the same cluster) and compared with
the undisturbed run: arrays bit for bit, everything else byte for byte except times and the
command. "c" in the column of jobs is the cluster.

The moments are drawn over the duration of the undisturbed run; on a cluster they end when its
tests are done, and so they do for a worker process, counted from the start of the first. The model
is LuGre, which takes half the time of the three-stage model. Two faults run side by side; it takes
half an hour on two cores that are busy with other work too.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.common.machine import platform_line
from benchmarks.interruption import cluster as dask
from benchmarks.interruption import harness
from benchmarks.interruption.folder import (
    Fault,
    Undisturbed,
    check,
    is_complete,
    is_whole,
    left_behind,
    look_at,
)
from benchmarks.interruption.harness import EXITS, Ended, calibrate, differing, end, files

ON_CLUSTER = ("lost worker", "all workers", "no workers", "scheduler", "client")
AS_ROOT = ("disk", "read-only")
KINDS = (
    *("SIGINT", "SIGTERM", "SIGKILL", "worker", "disk", "read-only"),
    *("lost worker", ("all workers", "no workers"), "scheduler", "client"),
)
"""Kinds of faults in turn; two in brackets alternate."""
AT_A_TIME = 2
"""Number of runs at a time; the undisturbed runs are made in the same way."""
QUIET = ("SIGKILL", "worker", "lost worker", "all workers", "client")  # not a word on stderr
HEAD = (
    *("", "fault", "moment", "jobs", "exit", "orphans", "words", "said before", "looked at"),
    *("resumed", "identical"),
)
WIDTHS = (3, 12, 13, 5, 5, 8, 6, 26, 11, 8, 10)


@dataclass(frozen=True)
class Plan:
    """Number of faults, their kinds in turn, and the seed of their moments."""

    faults: int
    seed: int
    kinds: tuple[str | tuple[str, ...], ...]


@dataclass
class Found:
    """Consequences of a fault: how the run ended, the state of its folder, the resumed run."""

    ended: Ended
    complete: bool
    whole: bool
    look: str
    again: Ended
    same: bool
    left: list[str]


def run_here(campaign: Path, out: Path) -> tuple[float, Ended]:
    """Seconds from the first worker until the tests are done, and the end."""
    began = time.monotonic()
    process = calibrate(campaign, out, 2)
    while process.poll() is None and not harness.workers_of(process.pid):
        time.sleep(0.02)
    first = time.monotonic()
    return until_population(process, out) - first, end(process, out, began)


def until_population(process: subprocess.Popen[str], out: Path) -> float:
    """Moment at which a command begins with the population."""
    while process.poll() is None and "population" not in harness.printed(out).read_text():
        time.sleep(0.05)
    return time.monotonic()


def run_on_cluster(campaign: Path, out: Path) -> tuple[float, Ended]:
    """Seconds until the tests are done, and the end."""
    with dask.cluster(out.parents[1] / "dask") as own:
        began = time.monotonic()
        process = calibrate(campaign, out, 0, "--scheduler", own.address)
        return until_population(process, out) - began, end(process, out, began)


def prepare(home: Path) -> Undisturbed:
    """Run the campaign here and on a cluster, and check that both give the same."""
    campaign = harness.lay_out(home / "campaign")
    campaign.write_text(campaign.read_text().replace('"three_stage"', '"lugre"'))
    out, other = (home / name / "disk" / "out" for name in ("here", "cluster"))
    for path in (out, other):
        path.parent.mkdir(parents=True)
    with ThreadPoolExecutor(AT_A_TIME) as pool:
        local = pool.submit(run_here, campaign, out)
        tests, on_cluster = run_on_cluster(campaign, other)
    workers, ended = local.result()
    for each in (ended, on_cluster):
        if each.code or each.complaint:
            sys.exit(each.complaint)
    if differing(other, out) or files(other) != files(out):
        sys.exit(f"a cluster makes a difference: {differing(other, out)}")
    size = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
    return Undisturbed(campaign, out, ended.seconds, tests, workers, check(out).stdout, size)


def bring(fault: Fault, process: subprocess.Popen[str], run: Undisturbed) -> bool:
    """Cause a fault while a command runs; whether the command was still running."""
    if fault.kind == "disk":
        process.wait(timeout=harness.LIMIT)
        return True
    if fault.cluster:
        printed = harness.printed(fault.out)
        moment = fault.share * run.on_cluster
        return dask.disturb_cluster(fault.kind, process, fault.cluster, printed, moment)
    moment = fault.share * run.lasting(fault.kind)
    if fault.kind == "read-only":
        time.sleep(moment)
        in_time = process.poll() is None
        harness.forbid_writing(fault.out.parent, over=fault.jobs == 2)
        return in_time
    return harness.disturb(fault.kind, process, moment)


def follow(fault: Fault, run: Undisturbed) -> Found | Ended:
    """Cause a fault and collect its consequences; only the end, if the fault came too late."""
    jobs, cluster = fault.where
    began = time.monotonic()
    process = calibrate(run.campaign, fault.out, jobs, *cluster)
    in_time = bring(fault, process, run)
    fault.said = harness.stage(fault.out)
    ended = end(process, fault.out, began)
    if not in_time:
        return ended
    whole, complete = is_whole(fault, run), is_complete(fault.out, run)
    look = look_at(fault, run)
    if fault.kind == "disk":
        harness.mount(fault.out.parent, 2**28, again=True)
    if fault.kind == "read-only":
        harness.allow_writing(fault.out.parent)
    jobs, cluster = fault.where if fault.kind == "client" else (3 - fault.jobs, ())
    process = calibrate(run.campaign, fault.out, jobs, "--resume", *cluster)
    again = end(process, fault.out, time.monotonic())
    same = is_complete(fault.out, run)
    return Found(ended, complete, whole, look, again, same, left_behind(fault))


def facts(kind: str, found: Found) -> dict[str, bool]:
    """Facts that must hold, and whether each does."""
    ended, again = found.ended, found.again
    late = ended.code == 0 and found.complete  # all was written before it could be missed
    lines = ended.complaint.splitlines()
    silent = ended.code == 0 or kind in QUIET
    sentence = "Traceback" not in ended.complaint and len(lines) == (0 if silent else 1)
    if kind == "no workers" and not late:
        sentence = sentence and "waits for a worker" in ended.printed
    return {
        "exit code as documented": ended.code == EXITS[kind] or late,
        "one sentence where one is due, no traceback": sentence,
        "no process left": not ended.orphans,
        "every file there is whole, and the undisturbed run's": found.whole,
        "check or report shows all, or says that the run is not finished": found.look != "BAD",
        "complete at once where the exit code is 0": ended.code != 0 or found.complete,
        "resumed with exit code 0, and no complaint": again.code == 0 and not again.complaint,
        "identical to the undisturbed run": found.same,
        "no hidden file, lock or test of a cluster left": not found.left,
    }


def show(*cells: object) -> None:
    print("".join(f"{cell!s:>{width}}" for cell, width in zip(cells, WIDTHS, strict=True)))
    sys.stdout.flush()


def tell(fault: Fault, moment: str, found: Found) -> Counter[str]:
    """Print the row of a fault; counts of the facts that hold."""
    so = facts(fault.kind, found)
    here = "c" if fault.cluster else str(fault.jobs)
    then = "c" if fault.kind == "client" else str(3 - fault.jobs)
    clean = so["one sentence where one is due, no traceback"] and so["no process left"]
    show(
        *(fault.number, fault.kind, moment, f"{here}>{then}", found.ended.code),
        *(found.ended.orphans, "clean" if clean else "BAD", fault.said[:25], found.look),
        *(found.again.code, "yes" if found.same and not found.left else "NO"),
    )
    for fact, holds in so.items():
        if not holds:
            print(fault.number, fact, found.ended, found.again, found.left, file=sys.stderr)
    return Counter({fact: int(holds) for fact, holds in so.items()})


def meet(number: int, home: Path, plan: Plan, run: Undisturbed) -> tuple[Fault, str, Found]:
    """Cause a fault of the plan, again if it came too late: fault, moment, consequences."""
    turn, which = divmod(number, len(plan.kinds))
    kind = plan.kinds[which]
    kind = kind[turn % 2] if isinstance(kind, tuple) else kind
    rng = np.random.default_rng([plan.seed, number])
    while True:
        share = (turn + rng.random()) / -(-plan.faults // len(plan.kinds))
        fault = Fault(number + 1, kind, share, home / "disk" / "out", 1 + turn % 2)
        room = int(4096 + share * 0.98 * run.size)
        course = run.on_cluster if kind in ON_CLUSTER else run.lasting(kind)
        fault.out.parent.mkdir(parents=True)
        if kind in AS_ROOT:
            harness.mount(fault.out.parent, room if kind == "disk" else 2**28)
        own = dask.cluster(home / "dask") if kind in ON_CLUSTER else nullcontext()
        try:
            with own as fault.cluster:
                found = follow(fault, run)
        finally:
            harness.unmount(fault.out.parent)
            shutil.rmtree(home)
        if isinstance(found, Found):
            moment = f"{room / 1e3:.0f} kB" if kind == "disk" else f"{share:.0%} of {course:.0f} s"
            return fault, moment, found
        run.seconds = min(run.seconds, found.seconds)  # the machine has grown faster
        run.workers *= 0.8 if kind == "worker" else 1.0


def study(home: Path, plan: Plan) -> None:
    run = prepare(home)
    print(f"mfd-bayes calibrate, {platform_line()}")
    print(
        f"undisturbed: {run.seconds:.0f} s, {run.size / 1e6:.1f} MB, {len(files(run.out))} files; "
        f"on a cluster its tests are done after {run.on_cluster:.0f} s, to the same bits"
    )
    show(*HEAD)
    totals: Counter[str] = Counter()
    with ThreadPoolExecutor(AT_A_TIME) as pool:
        numbers = range(plan.faults)
        for met in pool.map(lambda number: meet(number, home / str(number), plan, run), numbers):
            totals.update(tell(*met))
    for fact, count in totals.items():
        print(f"{count:3d} of {plan.faults}  {fact}")
    if min(totals.values()) < plan.faults:
        sys.exit("not everything is as it must be: see above")


def main() -> None:
    faults = int(sys.argv[1]) if len(sys.argv) > 1 else 60
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    kinds = tuple(kind for kind in KINDS if os.geteuid() == 0 or kind not in AS_ROOT)
    harness.heed_interrupts()
    with tempfile.TemporaryDirectory() as folder:
        study(Path(folder), Plan(faults, seed, kinds))


if __name__ == "__main__":
    main()
