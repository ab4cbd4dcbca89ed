"""The draws of a run, written as a table for other programs."""

from __future__ import annotations

from pathlib import Path

from mfd_bayes.reporting.draws import check_parquet, frames_of, write_csv, write_parquet
from mfd_bayes.runs.folder import check_places
from mfd_bayes.runs.lock import alone_in
from mfd_bayes.runs.manifest import read_manifest
from mfd_bayes.runs.paths import draws_as
from mfd_bayes.runs.run import open_run
from mfd_bayes.runs.unit_system import named_system


def write_draws(out: Path, to: str, units: str = "", most: int = 0) -> tuple[Path, int]:
    """Write OUT/draws.csv or OUT/draws.parquet; returns its path and the number of rows.

    Parameters
    ----------
    out : Path
        Run folder.
    to : {"csv", "parquet"}
    units : {"", "us", "si"}
        By default those of the campaign.
    most : int
        Most draws of a test, evenly taken out of all of them; 0 for all.

    Raises
    ------
    MfdError
        When the folder is no finished run, or pyarrow is missing; nothing is written then.
    """
    if to == "parquet":
        check_parquet()
    read_manifest(out)  # a folder that is no finished run is refused before it is locked
    with alone_in(out):
        check_places(out)
        run = open_run(out)
        path = out / draws_as(to)
        write = write_parquet if to == "parquet" else write_csv
        return path, write(path, frames_of(run, named_system(units, run.system), most))
