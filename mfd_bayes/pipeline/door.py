"""The commands `calibrate`, `demo` and `inspect` for Python."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from mfd_bayes.errors import CampaignError, StoreError, path_of
from mfd_bayes.runs.run import Run, open_run

if TYPE_CHECKING:
    from mfd_bayes.jobs.job import Observe
    from mfd_bayes.records.data_quality import Inspection


def calibrate(
    campaign: str | PathLike[str],
    out: str | PathLike[str],
    *,
    effort: Literal["quick", "standard", "thorough"] = "standard",
    seed: int = 1,
    jobs: int = 0,
    resume: bool = False,
    force: bool = False,
    observe: Observe = lambda step: None,
) -> Run:
    """Calibrate every test of a campaign, infer the laws, and write the report.

    As `mfd-bayes calibrate` does. In a script the call must stand under
    `if __name__ == "__main__":`, for other processes import the script.

    Parameters
    ----------
    campaign : path
        Of a campaign.toml.
    out : path
        Run folder to write.
    effort : {"quick", "standard", "thorough"}
    seed : int
    jobs : int
        Processes; 0 for one for each processor. The draws do not depend on them.
    resume : bool
        Whether to go on with a run in `out`; what is unchanged is kept.
    force : bool
        Whether to replace a run in `out`.
    observe : callable of a Step
        Is called with the news of the work.

    Raises
    ------
    MfdError
        When a file cannot be used, or `out` exists and is neither resumed nor replaced.
    """
    from mfd_bayes.pipeline.calibrate import calibrate_plan
    from mfd_bayes.pipeline.options import RunOptions
    from mfd_bayes.pipeline.plan import plan_campaign

    path, folder = path_of("campaign", campaign, CampaignError), path_of("out", out, StoreError)
    options = RunOptions(effort=effort, seed=seed, jobs=jobs, resume=resume, force=force)
    calibrate_plan(plan_campaign(path, options), folder, observe)
    return open_run(folder)


def demo(
    out: str | PathLike[str],
    *,
    effort: Literal["quick", "standard", "thorough"] = "standard",
    seed: int = 1,
    jobs: int = 0,
    force: bool = False,
    observe: Observe = lambda step: None,
) -> Run:
    """Calibrate a synthetic campaign after the MFD paper's test matrix, as `mfd-bayes demo` does.

    Parameters are those of `calibrate`.
    """
    from mfd_bayes.pipeline import calibrate as pipeline
    from mfd_bayes.pipeline.options import RunOptions

    folder = path_of("out", out, StoreError)
    pipeline.demo(folder, RunOptions(effort=effort, seed=seed, jobs=jobs, force=force), observe)
    return open_run(folder)


def inspect(path: str | PathLike[str], **reading: Any) -> Sequence[Inspection]:
    """What was read of a test file, or of every test of a campaign.toml, and its faults.

    Parameters
    ----------
    path : path
    **reading
        Of a test file, as `read_record` takes it: columns, units, rate and others.

    Returns
    -------
    list of Inspection
        `name`, `facts` by title, `faults`, and `trace`; printed as the command `inspect` does,
        in internal units.
    """
    from mfd_bayes.pipeline.inspect import inspect_campaign
    from mfd_bayes.records.data_quality import inspect_record
    from mfd_bayes.records.record import read_record

    file = Path(path_of("path", path, CampaignError))
    if file.suffix.lower() == ".toml":
        return inspect_campaign(file)[0]
    return [inspect_record(file.name, read_record(file, **reading))]
