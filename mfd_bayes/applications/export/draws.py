"""The posterior draws of every test as one table."""

from __future__ import annotations

import io
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mfd_bayes.applications.export.options import DrawsOptions
from mfd_bayes.errors import ReportError
from mfd_bayes.runs.folder import alone_in, check_places
from mfd_bayes.runs.manifest import read_manifest
from mfd_bayes.runs.run import Run, open_run
from mfd_bayes.runs.unit_system import UnitSystem, named_system
from mfd_bayes.store.files import write_bytes

if TYPE_CHECKING:
    import pandas as pd


def write_draws(options: DrawsOptions) -> tuple[Path, int]:
    """Write OUT/draws.csv or OUT/draws.parquet; returns its path and the number of rows."""
    import pandas as pd

    folder, to = options.out, options.to
    if to == "parquet" and find_spec("pyarrow") is None:
        raise ReportError(
            '--to parquet needs pyarrow, which is not installed: pip install "mfd_bayes[parquet]", '
            "or take --to csv"
        )
    read_manifest(folder)  # a folder that is no finished run is refused before it is locked
    with alone_in(folder):
        check_places(folder)
        run = open_run(folder, trust=options.trust_model)
        system = named_system(options.units, run.system)
        frame = pd.concat(draws_of(run, system, options.most), ignore_index=True)
        path, content = folder / f"draws.{to}", io.BytesIO()
        if to == "parquet":
            frame.to_parquet(content, engine="pyarrow", index=False)
        else:
            frame.to_csv(content, index=False, float_format="%.7g", lineterminator="\n")
        write_bytes(path, content.getvalue())
        return path, len(frame)


def draws_of(run: Run, system: UnitSystem, limit: int = 0) -> Iterator[pd.DataFrame]:
    """Draws of every calibrated test, a table each: test, chain, draw, quantities, log densities.

    A column of a quantity is called by its name and its unit in `system`: "Fc_fwd [kN]". With
    `limit`, so many draws are taken evenly out of all of them.
    """
    import pandas as pd

    for name, test in run.tests.items():
        stats = test.stored.stats
        chains, draws = stats["lp"].shape
        rows = np.arange(chains * draws)
        if 0 < limit < rows.size:
            rows = np.linspace(0, rows.size - 1, limit).astype(np.intp)
        frame = pd.DataFrame({"test": name, "chain": rows // draws, "draw": rows % draws})
        for quantity, values in test.stored.draws.data_vars.items():
            unit = str(values.attrs.get("units", "1"))
            head = f"{quantity} [{system.unit(unit)}]" if unit != "1" else str(quantity)
            frame[head] = values.to_numpy().reshape(-1)[rows] * system.factor(unit)
        for density in ("log_prior", "log_likelihood"):
            frame[density] = stats[density].to_numpy().reshape(-1)[rows]
        yield frame
