"""The draws of a run as one table, for other programs: CSV or Parquet."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mfd_bayes.errors import ReportError
from mfd_bayes.runs.run import Run
from mfd_bayes.runs.unit_system import System
from mfd_bayes.store.files import write_bytes

if TYPE_CHECKING:
    import pandas as pd


def frames_of(run: Run, system: System, most: int = 0) -> Iterator[pd.DataFrame]:
    """Draws of every calibrated test, a table each: test, chain, draw, quantities, log densities.

    A column of a quantity is called by its name and its unit in `system`: "Fc_fwd [kN]". With
    `most`, so many draws are taken evenly out of all of them.
    """
    import pandas as pd

    for name, test in run.tests.items():
        stats = test.stored.stats
        chains, draws = stats["lp"].shape
        kept = np.arange(chains * draws)
        if 0 < most < kept.size:
            kept = np.linspace(0, kept.size - 1, most).astype(np.intp)
        frame = pd.DataFrame({"test": name, "chain": kept // draws, "draw": kept % draws})
        for quantity, values in test.stored.draws.data_vars.items():
            unit = str(values.attrs.get("units", "1"))
            head = f"{quantity} [{system.unit(unit)}]" if unit != "1" else str(quantity)
            frame[head] = values.to_numpy().reshape(-1)[kept] * system.factor(unit)
        for density in ("log_prior", "log_likelihood"):
            frame[density] = stats[density].to_numpy().reshape(-1)[kept]
        yield frame


def write_csv(path: Path, frames: Iterable[pd.DataFrame]) -> int:
    """Write tables one below the other as CSV, with seven digits; returns the number of rows."""
    text, rows = io.StringIO(), 0
    for frame in frames:
        frame.to_csv(text, index=False, header=rows == 0, float_format="%.7g", lineterminator="\n")
        rows += len(frame)
    write_bytes(path, text.getvalue().encode())
    return rows


def write_parquet(path: Path, frames: Iterable[pd.DataFrame]) -> int:
    """Write tables one below the other as Parquet, in full precision; returns the rows.

    Raises
    ------
    ReportError
        When pyarrow is not installed.
    """
    check_parquet()
    import pyarrow as pa
    import pyarrow.parquet as pq

    content, rows = io.BytesIO(), 0
    tables = (pa.Table.from_pandas(frame, preserve_index=False) for frame in frames)
    first = next(tables)
    with pq.ParquetWriter(content, first.schema) as writer:
        for table in (first, *tables):
            writer.write_table(table)
            rows += table.num_rows
    write_bytes(path, content.getbuffer())
    return rows


def check_parquet() -> None:
    """Refuse Parquet where pyarrow is not installed.

    Raises
    ------
    ReportError
        When it is not.
    """
    if find_spec("pyarrow") is None:
        raise ReportError(
            '--to parquet needs pyarrow, which is not installed: pip install "mfd_bayes[parquet]", '
            "or take --to csv"
        )
