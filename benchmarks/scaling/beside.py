"""How much time do two installed versions of the package take for the same campaign, by stage?

    python -m benchmarks.scaling.beside OLD NEW --campaign campaign.toml

OLD and NEW are the commands `mfd-bayes` of two virtual environments. Each version calibrates the
campaign with two processes, in turn, with the same seeds; nothing else may run. A stage ends when
its last file is written: the tests' pooled draws, then the population's, then the rest. Seconds
are of a processor, of all processes together, and in brackets of wall time.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import json
import os
import subprocess
import time
from pathlib import Path

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


def calibration(command, campaign, output, effort, seed):
    """Seconds of a processor and of wall time by stage, and what the run says of its population."""
    words = [command, "calibrate", campaign.resolve(), "-o", output.resolve(), "--quiet"]
    words += ["--jobs", "2", "--effort", effort, "--seed", seed]
    output.parent.mkdir(parents=True, exist_ok=True)
    began, spent, moments = time.perf_counter(), {}, []
    with (output.parent / f"{output.name}.log").open("w") as log:
        line = [*map(str, words)]
        # elsewhere than the project, which workers would import in place of what is installed
        process = subprocess.Popen(
            line, stdout=log, stderr=log, cwd=output.parent, start_new_session=True
        )
        while process.poll() is None:
            spent.update(processor_times(process.pid))
            moments.append((time.time(), time.perf_counter() - began, sum(spent.values())))
            time.sleep(0.1)
    if process.returncode:
        raise SystemExit((output.parent / f"{output.name}.log").read_text())
    ends = [
        max(path.stat().st_mtime for path in output.glob("tests/*/posterior.nc")),
        (output / "population.nc").stat().st_mtime,
        moments[-1][0],
    ]
    rows, before = {}, (0.0, 0.0)
    for stage, end in zip(STAGES, ends, strict=True):
        _, wall, seconds = next(m for m in moments if m[0] >= end)
        rows[stage] = (seconds - before[1], wall - before[0])
        before = (wall, seconds)
    rows["whole"] = (before[1], before[0])
    manifest = json.loads((output / "manifest.json").read_text(encoding="utf-8"))
    return rows, manifest["population_sampler"]


def main():
    parser = common.parser_of(__doc__, output="beside")
    parser.add_argument("commands", nargs=2, type=Path, metavar=("OLD", "NEW"))
    parser.add_argument("--campaign", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    options = common.begin(parser)
    effort = "quick" if options.quick else options.effort
    print(f"seed{'':12}" + "".join(f"{stage:>20}" for stage in (*STAGES, "whole")))
    for seed in options.seeds:
        runs = []
        for word, command in zip(("old", "new"), options.commands, strict=True):
            output = options.out / f"{options.campaign.parent.name}_{seed}_{word}"
            rows, sampler = calibration(command, options.campaign, output, effort, seed)
            line = "".join(f"{seconds:11.1f} ({wall:6.1f})" for seconds, wall in rows.values())
            print(f"{seed:4d} {word:11}{line}  {sampler}", flush=True)
            runs.append(rows)
        line = "".join(
            f"{new / old:11.2f} ({new_wall / old_wall:6.2f})"
            for (old, old_wall), (new, new_wall) in zip(*(r.values() for r in runs), strict=True)
        )
        print(f"{seed:4d} new over old{line}", flush=True)


if __name__ == "__main__":
    main()
