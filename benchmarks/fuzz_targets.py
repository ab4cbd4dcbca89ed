"""What is fuzzed: a valid folder for each kind of file, how it is changed, and who reads it."""

from __future__ import annotations

import io
import json
import os
import pickle
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from fuzz_mutations import Mutate, Rng, mutate_bytes, mutate_json, mutate_text, mutate_zip
from nptdms import ChannelObject, TdmsWriter
from openpyxl import Workbook
from scipy.io import savemat

from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.prior_files import PriorFile, find_priors, load_priors
from mfd_bayes.campaign import load_campaign
from mfd_bayes.errors import MfdError
from mfd_bayes.initiation.columns import guess_columns
from mfd_bayes.population.hierarchy import Population
from mfd_bayes.population.pooling import Setting, pool
from mfd_bayes.population.predict import setting_of
from mfd_bayes.population.storage import load_population, save_population
from mfd_bayes.quantities import UNITS
from mfd_bayes.records.readers import read_table
from mfd_bayes.records.record import read_record
from mfd_bayes.records.trace import Trace
from mfd_bayes.run import load_result, open_run
from mfd_bayes.store import load_trace, save_test, save_trace, write_json

Files = Mapping[str, bytes]
LAWS = {"Fc_fwd": "power", "Fc_bwd": "proportional", "sigma0": "affine"}


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
    """

    name: str
    files: tuple[Files, ...]
    changed: str
    mutate: Mutate
    read: Callable[[Path], object]
    share: float


def read_as_record(path: Path) -> object:
    """All that is done with a file of a test before it is fitted."""
    table = read_table(path)
    for name in table.names[:4]:
        try:
            table.columns([name])
        except MfdError:
            continue  # another column may be right
    guess_columns(table)
    return read_record(path).trace(gap=0.3).path


def read_posterior(path: Path) -> object:
    """A calibrated test, as a run folder is opened."""
    return load_result("a", path, load_priors("priors.toml", path.parents[2]))


def read_population(path: Path) -> object:
    """The population of a run folder."""
    return load_population(path, load_priors("priors.toml", path.parent))


def _with_priors(files: Files, name: str) -> Files:
    return {key: files[key] for key in (name, "priors.toml")}


def read_run(path: Path) -> object:
    """A run folder with its population, of its manifest."""
    run = open_run(path.parent)
    return run.population, run.actuation_unit, [run.session(name) for name in run.tests]


def targets() -> tuple[Target, ...]:
    """Every target, with seeds that are made anew: none is stored."""
    run = _run_files()
    records: tuple[tuple[str, tuple[bytes, ...], Mutate, float], ...] = (
        ("csv", _texts(), mutate_text, 0.2),
        ("txt", _texts(), mutate_text, 0.08),
        ("json", _jsons(), mutate_json, 0.25),
        ("v5.mat", _matlab_v5(), mutate_bytes, 0.25),
        ("v73.mat", _matlab_v73(), mutate_bytes, 0.03),
        ("xlsx", (_workbook(),), mutate_zip, 0.015),
        ("tdms", (_tdms(),), mutate_bytes, 0.03),
    )
    found = [
        Target(
            *(name, tuple({f"a.{name}": seed} for seed in seeds), f"a.{name}"),
            *(mutate, read_as_record, share),
        )
        for name, seeds, mutate, share in records
    ]
    campaign = {"campaign.toml": CAMPAIGN, "a.csv": _texts()[0], "own.toml": _priors()}
    stored: tuple[tuple[str, Callable[[Path], object], float], ...] = (
        ("tests/a/posterior.nc", read_posterior, 0.003),
        ("tests/c/record.nc", load_trace, 0.004),
        ("population.nc", read_population, 0.003),
    )
    return (
        *found,
        Target("campaign.toml", (campaign,), "campaign.toml", mutate_text, load_campaign, 0.1),
        Target(
            *("priors.toml", ({"own.toml": _priors()},), "own.toml", mutate_text),
            *(lambda path: load_priors(path.name, path.parent), 0.03),
        ),
        Target("manifest.json", (run,), "manifest.json", mutate_json, read_run, 0.005),
        *(
            Target(name, (_with_priors(run, name),), name, mutate_bytes, read, share)
            for name, read, share in stored
        ),
    )


def controls() -> tuple[Target, ...]:
    """Readers with a fault each, which must all be found; share 0: they are never warmed up."""
    return tuple(
        Target(fault.__name__, ({"a": b"1"},), "a", mutate_bytes, fault, 0.0)
        for fault in (raises, hangs, dies, fills_memory, writes_elsewhere, unpickles, starts)
    )


def raises(path: Path) -> object:
    """No sentence."""
    raise ValueError(path)


def hangs(path: Path) -> object:
    """No end."""
    while path:
        time.sleep(0.01)
    return path


def dies(path: Path) -> object:
    """A signal."""
    os.kill(os.getpid(), signal.SIGSEGV)
    return path


def fills_memory(path: Path) -> object:
    """More memory than there is."""
    return bytes(2**31), path


def writes_elsewhere(path: Path) -> object:
    """A file beside the input's folder."""
    return (path.parent.parent / "elsewhere").write_bytes(b"")


def unpickles(path: Path) -> object:
    """An object of the file's choosing."""
    return pickle.loads(b"cos\ngetcwd\n(tR."), path


def starts(path: Path) -> object:
    """A program."""
    return subprocess.run(["true"], check=True), path


TIME = np.arange(60) * 0.05
MOTION = np.sin(2 * np.pi * TIME)
FORCE = 2.0 * np.sign(np.cos(2 * np.pi * TIME))
NAMES = ("time_s", "displacement_in", "force_kip")
ROWS = np.column_stack([TIME, MOTION, FORCE])

CAMPAIGN = b"""\
[campaign]
title = "Brake 7"
priors = "own.toml"
model = "three_stage"
noise = "ou"
rate = "64 Hz"
area = "1.5 in^2"

[columns]
time = { name = "time_s", unit = "s" }
displacement = { name = "displacement_in" }
force = { name = "force_kip", unit = "kip" }

[laws]
Fc_fwd = "affine"

[dependence]
Fc_bwd = ["velocity"]

[[test]]
id = "a"
file = "a.csv"
actuation = "500 psi"
fit = "0 s to 60 s"
session = "spring"

[[test]]
id = "b"
file = "a.csv"
actuation = { name = "pressure_psi", unit = "psi" }
role = "validate"
columns = { velocity = { name = "v", unit = "in/s" } }
"""


def _priors() -> bytes:
    return find_priors("mfd").read_bytes()


def _texts() -> tuple[bytes, ...]:
    plain = "\n".join([",".join(NAMES), *(",".join(f"{x:.6g}" for x in row) for row in ROWS)])
    head = "Station\tMTS 1\nDate 1.2.2013 10:11\n\nTime\tAxial Displacement\tAxial Force\n"
    head += "sec\tmm\tkN\n"
    controller = head + "\n".join("\t".join(f"{x:.5f}" for x in row) for row in ROWS)
    comma = "Zeit [s];Weg [mm];Kraft [kN]\n" + "\n".join(
        ";".join(f"{x:.4f}".replace(".", ",") for x in row) for row in ROWS
    )
    blanks = "# by hand\ntime_s  displacement_in  force_kip\n" + "\n".join(
        "  ".join(f"{x: .4e}" for x in row) for row in ROWS
    )
    return tuple(text.encode() for text in (plain, controller, comma, blanks))


def _jsons() -> tuple[bytes, ...]:
    lists = {name: column.tolist() for name, column in zip(NAMES, ROWS.T, strict=True)}
    rows = [dict(zip(NAMES, row, strict=True)) for row in ROWS.tolist()]
    split = {"columns": list(NAMES), "index": list(range(60)), "data": ROWS.tolist()}
    labels = {name: {str(i): x for i, x in enumerate(column)} for name, column in lists.items()}
    return tuple(json.dumps(form).encode() for form in (lists, rows, split, labels))


def _matlab_v5() -> tuple[bytes, ...]:
    content = {
        **dict(zip(NAMES, (TIME[:, None], MOTION[None, :], FORCE[:, None]), strict=True)),
        "test": {"time": TIME, "force": FORCE.astype(np.float32), "name": "p500"},
        "counts": np.arange(60, dtype=np.int16),
        "cells": np.array([1.0, "two", np.eye(2)], dtype=object),
        "z": TIME + 1j,
    }
    found = []
    for packed in (False, True):
        file = io.BytesIO()
        savemat(file, content, do_compression=packed)
        found.append(file.getvalue())
    return tuple(found)


def _matlab_v73() -> tuple[bytes, ...]:
    found = []
    for options in ({}, {"chunks": (1, 20), "compression": "gzip", "shuffle": True}):
        memory = io.BytesIO()
        with h5py.File(memory, "w", userblock_size=512) as file:
            for name, column in zip(NAMES, ROWS.T, strict=True):
                data = file.create_dataset(name, data=column[None, :], **options)
                data.attrs["MATLAB_class"] = np.bytes_("double")
            test = file.create_group("test")
            test.attrs["MATLAB_class"] = np.bytes_("struct")
            test.create_dataset("force", data=FORCE[None, :], **options)
            inner = file.create_group("#refs#").create_dataset("b", data=TIME)
            cells = file.create_dataset("cells", (2, 1), dtype=h5py.ref_dtype)
            cells[:] = inner.ref
        memory.getbuffer()[:128] = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
        found.append(memory.getvalue())
    return tuple(found)


def _workbook() -> bytes:
    book = Workbook()
    book.active.append(list(NAMES))
    for row in ROWS.tolist():
        book.active.append(row)
    file = io.BytesIO()
    book.save(file)
    return file.getvalue()


def _tdms() -> bytes:
    file = io.BytesIO()
    wave = {"wf_increment": 0.05, "wf_start_offset": 0.0, "unit_string": "kip"}
    with TdmsWriter(file) as writer:
        for part in (slice(0, 30), slice(30, 60)):
            writer.write_segment(
                [
                    *(ChannelObject("t", n, c) for n, c in zip(NAMES, ROWS[part].T, strict=True)),
                    ChannelObject("t", "F", FORCE[part], wave),
                    ChannelObject("t", "text", ["a", "bc"]),
                ]
            )
    return file.getvalue()


def _run_files() -> Files:
    """A run folder that no sampler has seen: draws of the prior, and a population of them."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_run(folder)
        files = [path for path in folder.rglob("*") if path.is_file()]
        return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def write_run(folder: Path) -> None:
    """Write a run folder of two calibrated tests, one that is predicted, and a population."""
    (folder / "priors.toml").write_bytes(_priors())
    priors = load_priors("priors.toml", folder)
    rng = np.random.default_rng(1)
    under = []
    for test, actuation in (("a", 0.5), ("b", 1.0)):
        trace = Trace.from_arrays(TIME, MOTION, actuation, FORCE)
        posterior = Posterior(trace, priors)
        flat = posterior.draw_prior(rng, 24)
        theta = posterior.theta(flat)
        flat |= {name: theta[:, k] for k, name in enumerate(posterior.model.parameters)}
        values = {name: draws.reshape(2, 12) for name, draws in flat.items()}
        stats = dict.fromkeys(("lp", "log_prior", "log_likelihood"), np.zeros((2, 12)))
        facts = {"model": "three_stage", "noise": "ou", "start": "sample", "test": test}
        path = folder / "tests" / test / "posterior.nc"
        save_test(path, values, UNITS, stats, trace, np.zeros((2, 3, 60)), facts)
        under.append(setting_of(trace, ""))
    save_trace(folder / "tests/c/record.nc", Trace.from_arrays(TIME, MOTION, 0.7, FORCE), {})
    _write_population(folder / "population.nc", priors, posterior, under, rng)
    write_json(folder / "manifest.json", _manifest())


def _write_population(
    path: Path, priors: PriorFile, posterior: Posterior, under: list[Setting], rng: Rng
) -> None:
    pooling = pool(priors, posterior.names, under, LAWS)
    cells = sum(len(effect.cells) for effect in pooling.effects)
    d = len(pooling.names)
    factors = np.tril(rng.normal(size=(2, 6, d, d)))
    population = Population(
        pooling=pooling,
        h=rng.normal(-2.0, 0.2, size=(2, 6, pooling.dim)),
        latent=0.1 * rng.normal(size=(2, 6, 1 + cells, d)),
        choice=pooling.draw_choice(12).reshape(2, 6, -1),
        together=factors / np.linalg.norm(factors, axis=-1, keepdims=True),
        priors=priors.parameters,
        actuation_unit="ksi",
        walkers=6,
        convergence=Convergence(np.ones(2), np.full(2, 500.0), np.ones(2)),
    )
    save_population(path, population)


def _manifest() -> dict[str, Any]:
    entry = {"status": "done", "samples": 60, "rate": 20.0, "record_rate": 20.0, "unit": "in"}
    given = {"file": "a.csv", "actuation": "500 psi", "fit": None, "session": "", "columns": {}}
    return {
        "status": "finished",
        "title": "Brake 7",
        "command": "mfd-bayes calibrate",
        "started": "2026-01-01T00:00:00+00:00",
        "finished": "2026-01-01T00:01:00+00:00",
        "seed": 1,
        "effort": {"name": "quick", "r_hat": 1.03, "ess": 100.0, "walkers": 6},
        "settings": {
            "model": "three_stage",
            "noise": "ou",
            "start": "sample",
            "priors": "MFD (mfd.toml)",
            "laws": LAWS,
            "dependence": {},
            "rate": None,
            "area": 1.5,
            "actuation_unit": "ksi",
            "tests": {"a": given, "b": given, "c": given},
        },
        "inputs": {"campaign.toml": "00"},
        "versions": {"python": "3.11.7", "numpy": "2.4.6"},
        "platform": "Linux",
        "tests": {
            "a": {"role": "calibrate", **entry},
            "b": {"role": "calibrate", **entry},
            "c": {"role": "validate", **entry, "status": "held out"},
        },
        "files": {},
        "law_scores": [],
        "free_exponents": {"Fc_fwd": [0.9, 1.0, 1.1]},
        "dependence_scores": [],
        "seconds": 1.0,
    }
