"""The kinds of file that are damaged: a valid folder for each, how it is changed, its reader."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmarks.fuzz.mutations import (
    Mutate,
    mutate_bytes,
    mutate_json,
    mutate_text,
    mutate_tree,
    mutate_zip,
)
from benchmarks.fuzz.netcdf import mutate_netcdf
from benchmarks.fuzz.options import files_of_command, mutate_command, read_command
from benchmarks.fuzz.outputs import (
    files_of_question,
    mutate_question,
    read_looked,
    read_predicted,
)
from benchmarks.fuzz.runs import (
    read_fold,
    read_held_out,
    read_population,
    read_posterior,
    read_report,
    read_resumed,
    read_shown,
    run_files,
    seal,
)
from benchmarks.fuzz.seeds import (
    CAMPAIGN,
    jsons,
    matlab_v5,
    matlab_v73,
    priors,
    scaled_priors,
    tdms,
    texts,
    workbook,
)
from mfd_bayes.calibration.prior_files import load_priors
from mfd_bayes.campaign.campaign import load_campaign
from mfd_bayes.campaign.draft.columns import guess_columns
from mfd_bayes.campaign.draft.priors import Units, priors_text
from mfd_bayes.errors import MfdError
from mfd_bayes.records.channels import Source, Subtracted
from mfd_bayes.records.loops import scales_of
from mfd_bayes.records.readers import read_table
from mfd_bayes.records.record import read_record

Files = Mapping[str, bytes]


@dataclass(frozen=True)
class Target:
    """A kind of file.

    Attributes
    ----------
    name : str
    files : tuple of mapping of str to bytes
        Valid folders, by the paths in them.
    changed : str
        The file of them that is changed.
    mutate : callable
    read : callable
        Takes the changed file; ends in a result or raises.
    share : float
        Of all inputs: cheap targets have more.
    writes : bool
        Whether it writes, as a command does; else it may not, not even in its own folder.
    finish : callable
        Files once one of them is changed, such as with its hash made anew.
    """

    name: str
    files: tuple[Files, ...]
    changed: str
    mutate: Mutate
    read: Callable[[Path], object]
    share: float
    finish: Callable[[dict[str, bytes]], dict[str, bytes]] = dict
    writes: bool = False


_BY_NUMBER = {
    "time": 1,
    "displacement": 2,
    "force": Source(
        3, minus=Subtracted(2, "in", "0.1 kip/in"), minus_mass="3 kg", tare="0 s to 1 s"
    ),
}
_UNITS = {"time": "s", "displacement": "in", "force": "kip"}


def read_as_record(path: Path) -> object:
    """Everything that is done with a test file before it is fitted."""
    table = read_table(path)
    for name in table.names[:4]:
        try:
            table.columns([name])
        except MfdError:
            continue  # another column may be right
    guess_columns(table)
    if table.headed:
        return read_record(path).trace(gap=0.3).path
    record = read_record(path, _BY_NUMBER, _UNITS)
    scales = scales_of(record.trace())
    own = "" if scales is None else priors_text({path.name: scales}, Units("N", "mm"))
    return record.trace(gap=0.3).path, record.derived, own


def targets() -> tuple[Target, ...]:
    """Every target, with seeds that are made anew: none is stored."""
    campaign = {"campaign.toml": CAMPAIGN, "a.csv": texts()[0], "own.toml": priors()}
    return (
        *_runs(),  # first, for they take longest
        *commands(),
        *_records(),
        Target("campaign.toml", (campaign,), "campaign.toml", mutate_text, load_campaign, 0.1),
        Target(
            *("priors.toml", _priors(), "own.toml", mutate_text),
            *(lambda path: load_priors(path.name, path.parent), 0.03),
        ),
    )


def _priors() -> tuple[Files, ...]:
    return tuple({"own.toml": content} for content in (priors(), scaled_priors()))


def few() -> tuple[Target, ...]:
    """All targets except whole run folders, which take a second for each input."""
    return tuple(target for target in targets() if target.share >= 0.002)


def commands() -> tuple[Target, ...]:
    """Commands with other options, and with something in the place of their outputs."""
    run = run_files(small=True)
    asked, question = (files_of_command(run),), (files_of_question(),)
    said = (question, "question.json", mutate_question)
    return (
        Target("options", asked, "command.json", mutate_command, read_command, 0.006, writes=True),
        Target("outputs: predict", *said, read_predicted, 0.05, writes=True),
        Target("outputs: inspect", *said, read_looked, 0.02, writes=True),
    )


def _records() -> list[Target]:
    records: tuple[tuple[str, tuple[bytes, ...], Mutate, float], ...] = (
        ("csv", texts(), mutate_text, 0.2),
        ("txt", texts(), mutate_text, 0.08),
        ("json", jsons(), mutate_json, 0.25),
        ("v5.mat", matlab_v5(), mutate_bytes, 0.25),
        ("v73.mat", matlab_v73(), mutate_bytes, 0.03),
        ("xlsx", (workbook(), workbook(named=False)), mutate_zip, 0.015),
        ("tdms", (tdms(),), mutate_bytes, 0.03),
    )
    return [
        Target(
            *(name, tuple({f"a.{name}": seed} for seed in seeds), f"a.{name}"),
            *(mutate, read_as_record, share),
        )
        for name, seeds, mutate, share in records
    ]


def _runs() -> list[Target]:
    """Run folders of which one file is changed and its hash made anew; a part of them, or all."""
    run, other = run_files(small=True), run_files(small=False)
    manifest, fold = "manifest.json", "crossvalidation/test_1.json"
    parts = (
        ("tests/a/posterior.nc", read_posterior, 0.003),
        ("tests/c/record.nc", read_held_out, 0.003),
        ("population.nc", read_population, 0.003),
    )
    whole = (
        ("whole, manifest", run, manifest, mutate_tree, 0.001),
        ("whole, posterior", other, "tests/b/posterior.nc", mutate_netcdf, 0.0003),
        ("whole, population", run, "population.nc", mutate_netcdf, 0.0005),
        ("whole, priors", run, "priors.toml", mutate_text, 0.0007),
    )
    return [
        Target("run: manifest", (run,), manifest, mutate_tree, read_shown, 0.026),
        Target(
            *("run: manifest, resumed", (run,), manifest, mutate_tree, read_resumed, 0.016),
            writes=True,  # what rests on changed inputs is removed
        ),
        Target("run: left out", (run,), fold, mutate_tree, read_fold, 0.01),
        *(
            Target(f"run: {Path(name).name}", (run,), name, mutate_netcdf, read, share, seal)
            for name, read, share in parts
        ),
        *(
            Target(f"run: {name}", (files,), changed, mutate, read_report, share, finish)
            for name, files, changed, mutate, share in whole
            for finish in (dict if changed == manifest else seal,)
        ),
    ]


def controls() -> tuple[Target, ...]:
    """Readers with a fault each, which must all be found; share 0: they are never warmed up."""
    return tuple(
        Target(fault.__name__, ({"a": b"1"},), "a", mutate_bytes, fault, 0.0) for fault in _FAULTS
    )


def raises(path: Path) -> object:
    """Raise an error that is no `MfdError`."""
    raise ValueError(path)


def hangs(path: Path) -> object:
    """Never end."""
    while path:
        time.sleep(0.01)
    return path


def dies(path: Path) -> object:
    """End by a signal."""
    os.kill(os.getpid(), signal.SIGSEGV)
    return path


def fills_memory(path: Path) -> object:
    """Ask for more memory than the limit."""
    return bytes(2**31), path


def writes_elsewhere(path: Path) -> object:
    """Write a file outside the input's folder."""
    return (path.parent.parent / "elsewhere").write_bytes(b"")


def unpickles(path: Path) -> object:
    """Unpickle an object that the file chooses."""
    return pickle.loads(b"cos\ngetcwd\n(tR."), path


def starts(path: Path) -> object:
    """Start a program."""
    return subprocess.run(["true"], check=True), path


def looks_up(path: Path) -> object:
    """Read an optional key of a manifest as if it were always there."""
    return {"tests": path}["law_scores"]


_FAULTS = (raises, hangs, dies, fills_memory, writes_elsewhere, unpickles, starts, looks_up)
