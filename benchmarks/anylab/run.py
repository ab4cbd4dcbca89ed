"""Is a device of any size calibrated with nothing written by hand? Four devices, 10 N to 2 MN.

    python -m benchmarks.anylab.run > benchmarks/anylab/anylab.txt

takes a quarter of an hour (--quick: the first device). A line for each device, whose logger's files
go through init, prior-check and calibrate: how long it takes, how much of the force the drafted
priors hold, how many of the true values that the data inform lie inside their 95 % intervals, and
the slip force in the units of the report.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import tempfile
import time
from pathlib import Path

from mfd_bayes.evaluation.summary import assess
from mfd_bayes.runs.run import open_run
from tests.pipeline.devices import DEVICES, Device, complete, write_device


def main() -> None:
    options = common.begin(common.parser_of(__doc__ or ""))
    for device in DEVICES[:1] if options.quick else DEVICES:
        with tempfile.TemporaryDirectory() as folder:
            print(line_of(device, Path(folder)), flush=True)


def line_of(device: Device, folder: Path) -> str:
    truth, campaign, output = write_device(folder, device), folder / "campaign.toml", folder / "out"
    begin = time.monotonic()
    common.command("init", folder)
    if not device.named:
        complete(campaign, device)
        common.command("init", campaign)
    checked = common.command("prior-check", campaign, "-o", folder, may_fail=True)
    common.command("calibrate", campaign, "-o", output, "--effort", "quick", "--jobs", 1)
    run = open_run(output)
    rows = [
        (row, truth[row.subject][row.name])
        for view in assess(run).tests
        for row in view.rows
        if not row.note and row.name in truth[row.subject]
    ]
    hits = sum(row.lower <= value <= row.upper for row, value in rows)
    slip = max(row.median for row, _ in rows if row.name == "Fc_fwd")
    holds = checked.splitlines()[0].split(": ")[1].split(" of")[0]
    return (
        f"{device.name:20} {time.monotonic() - begin:6.0f} s  prior holds {holds:>4} of the force  "
        f"truth inside {hits:3d} of {len(rows):3d} ({hits / len(rows):.0%})  "
        f"Fc_fwd {run.system.words([slip], 'kip', 3)}"
    )


if __name__ == "__main__":
    main()
