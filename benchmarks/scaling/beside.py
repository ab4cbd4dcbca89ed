"""How much time do two installed versions of the package take for the same campaign, by stage?

    python -m benchmarks.scaling.beside OLD NEW --campaign campaign.toml

OLD and NEW are the commands `mfd-bayes` of two virtual environments. First the one calibrates the
campaign, then the other, with the same seed and --jobs processes (2), each with one thread; nothing
else may run. --quick: effort "quick", some minutes. The tests end when the last of their own draws
is written, the population when its draws are; the rest is the report. Seconds are those of all
processors together; wall time is in brackets.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import json
import os
import subprocess
import time
from pathlib import Path

import numpy as np

TICK = 1.0 / os.sysconf("SC_CLK_TCK")
STAGES = ("tests", "population", "report")


def processor_times(session):
    """Seconds of a processor by process, of those alive in a session."""
    times = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            words = path.read_text(encoding="utf-8").rsplit(")", 1)[1].split()
        except (OSError, IndexError):
            continue
        if int(words[3]) == session:
            times[int(path.parent.name)] = (int(words[11]) + int(words[12])) * TICK
    return times


def calibration(command, campaign, output, options):
    """Seconds (4, 2), of processors and of wall time, of each stage and of all; how it sampled."""
    words = [command, "calibrate", campaign, "-o", output, "--quiet", "--effort", options.effort]
    words += ["--jobs", options.jobs, "--seed", options.seed]
    log = output.parent / f"{output.name}.log"
    log.parent.mkdir(parents=True, exist_ok=True)
    began, spent, clock, seconds = time.time(), {}, [], []
    with log.open("w") as file:
        # elsewhere than the project, which workers would import in place of what is installed
        process = subprocess.Popen(
            [*map(str, words)], stdout=file, stderr=file, cwd=log.parent, start_new_session=True
        )
        while process.poll() is None:
            spent.update(processor_times(process.pid))
            clock.append(time.time())
            seconds.append((sum(spent.values()), clock[-1] - began))
            time.sleep(0.1)
    if process.returncode:
        raise SystemExit(log.read_text())
    tests = max(path.stat().st_mtime for path in output.glob("tests/*/posterior.nc"))
    population = (output / "population.nc").stat().st_mtime
    ends = np.array(seconds)[[*np.searchsorted(clock, [tests, population]), -1]]
    manifest = json.loads((output / "manifest.json").read_text(encoding="utf-8"))
    stages = np.diff(ends, axis=0, prepend=0.0)
    return np.vstack([stages, ends[-1]]), manifest["population_sampler"]


def show(title, rows, digits, sampler=""):
    """Print one line of the table."""
    pairs = "".join(f"{a:11.{digits}f} ({b:6.{digits}f})" for a, b in rows)
    print(f"{title:16}{pairs}  {sampler}".rstrip(), flush=True)


def main():
    parser = common.parser_of(__doc__, jobs=2, output="out_beside")
    parser.add_argument("commands", nargs=2, type=Path, metavar=("OLD", "NEW"))
    parser.add_argument("--campaign", type=Path, required=True)
    options = common.begin(parser)
    campaign, out = options.campaign.resolve(), options.out.resolve()
    print(f"seed{'':12}" + "".join(f"{stage:>20}" for stage in (*STAGES, "whole")))
    runs = []
    for word, command in zip(("old", "new"), options.commands, strict=True):
        output = out / f"{campaign.parent.name}_{options.seed}_{word}"
        rows, sampler = calibration(command.absolute(), campaign, output, options)
        show(f"{options.seed:4d} {word}", rows, 1, sampler)
        runs.append(rows)
    show(f"{options.seed:4d} new over old", runs[1] / runs[0], 2)


if __name__ == "__main__":
    main()
