"""The report of a run, its checks, and the table of its draws."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from mfd_bayes.errors import MfdError, ReportError
from mfd_bayes.evaluation.properties import datasheet, parse_condition, stored_peaks
from mfd_bayes.evaluation.summary import assess, verdicts
from mfd_bayes.evaluation.views import IDENTIFIABILITY, CampaignView
from mfd_bayes.jobs.job import Step, Workplace, get_ready
from mfd_bayes.reporting.page import PLAIN, Forms
from mfd_bayes.reporting.tables import CROSSVALIDATION
from mfd_bayes.runs.folder import Verdict, alone_in, check_places, read_manifest
from mfd_bayes.runs.run import Run, open_run
from mfd_bayes.runs.unit_system import SI, System, named_system
from mfd_bayes.store.files import write_bytes

if TYPE_CHECKING:
    from pathlib import Path

    import pandas as pd

Observe = Callable[[Step], None]


def report(
    out: Path,
    observe: Observe = lambda _: None,
    *,
    jobs: int = 0,
    forms: Forms = PLAIN,
    units: str = "",
) -> CampaignView:
    """Write the tables, figures and report of a finished run, from its stored results."""
    forms.check(tuple(read_manifest(out).tests))  # no lock for what is no finished run
    if Workplace(jobs).processes > 1:
        get_ready()
    with alone_in(out):
        check_places(out)
        return write_report(open_run(out), observe, jobs=jobs, forms=forms, units=units)


def write_report(
    run: Run, observe: Observe, *, jobs: int, forms: Forms = PLAIN, units: str = ""
) -> CampaignView:
    """Write the tables, figures and report of an open run, whose folder must be locked."""
    from mfd_bayes.reporting.page import publish

    try:
        at = [parse_condition(text, run.actuation_unit, run.system.axes) for text in forms.at]
    except MfdError as error:
        raise ReportError(f"--at: {error}") from error
    processes = Workplace(jobs).processes
    observe(Step("report", "checks and bands"))
    system = named_system(units, run.system)
    # once, and of these tests: what an earlier report has stored may be of others
    run = replace(run, manifest=run.manifest.changed(peak_factors=stored_peaks(run)))
    view = replace(assess(run, processes), metric=system.name == SI.name)
    if forms.next_test:
        observe(Step("report", "which test next"))
        view = replace(view, next_test=run.next_test())
    run = run.rewrite(verdicts=verdicts(view), warnings=view.warnings)
    if view.left_out is None:  # a table that an earlier cross-validation wrote
        (run.folder / CROSSVALIDATION).unlink(missing_ok=True)
    observe(Step("report", "data sheet"))
    sheet = datasheet(replace(run, units=system.name), at) if run.tests else None
    publish(view, run.folder, processes, observe, forms, sheet)
    return view


def check(out: Path, units: str = "") -> CampaignView:
    """Report of a finished run with the checks that `mfd-bayes check` shows; writes nothing.

    Its sentences are in the units of a system, "us" or "si"; by default the campaign's.
    """
    run = open_run(out)
    metric = named_system(units, run.system).name == SI.name
    view = assess(run)
    checks = [c for c in view.checks if c.check not in IDENTIFIABILITY or c.status != Verdict.PASS]
    return replace(view, metric=metric, checks=tuple(checks))


def write_draws(out: Path, to: str, units: str = "", most: int = 0) -> tuple[Path, int]:
    """Write OUT/draws.csv or OUT/draws.parquet; returns its path and the number of rows."""
    import pandas as pd

    if to == "parquet" and find_spec("pyarrow") is None:
        raise ReportError(
            '--to parquet needs pyarrow, which is not installed: pip install "mfd_bayes[parquet]", '
            "or take --to csv"
        )
    read_manifest(out)  # a folder that is no finished run is refused before it is locked
    with alone_in(out):
        check_places(out)
        run = open_run(out)
        frame = pd.concat(draws_of(run, named_system(units, run.system), most), ignore_index=True)
        path, content = out / f"draws.{to}", io.BytesIO()
        if to == "parquet":
            frame.to_parquet(content, engine="pyarrow", index=False)
        else:
            frame.to_csv(content, index=False, float_format="%.7g", lineterminator="\n")
        write_bytes(path, content.getvalue())
        return path, len(frame)


def draws_of(run: Run, system: System, most: int = 0) -> Iterator[pd.DataFrame]:
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
