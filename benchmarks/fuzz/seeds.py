"""Valid files to damage: records in every format, a campaign file and its priors."""

from __future__ import annotations

import io
import json

import h5py
import numpy as np
from nptdms import ChannelObject, TdmsWriter
from openpyxl import Workbook
from scipy.io import savemat

from mfd_bayes.calibration.priors import find_priors

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
displacement = { column = 2, unit = "in", tare = "0 s to 1 s" }
force = { name = "force_kip", minus = { name = "p_psi", times = "1 in^2" }, minus_mass = "3 kg" }

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


def priors() -> bytes:
    """The priors of the MFD."""
    return find_priors("mfd").read_bytes()


def scaled_priors() -> bytes:
    """Priors that are multiples of scales."""
    scales = b'[scales]\nforce = "7 N"\nlength = "0.5 mm"\nspeed = "60 mm/s"\n\n[parameters.sigma0]'
    return find_priors("any").read_bytes().replace(b"[parameters.sigma0]", scales, 1)


def texts() -> tuple[bytes, ...]:
    """Text files, as programs and controllers write them."""
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
    bare = "Logger 4, channels as wired\nrig two\n" + "\n".join(
        "\t".join(f"{x:.5f}" for x in row) for row in ROWS
    )
    below = plain.replace("force_kip", "time_s", 1) + "\nEnd of test\n"
    return tuple(text.encode() for text in (plain, controller, comma, blanks, bare, below))


def jsons() -> tuple[bytes, ...]:
    """JSON in the layouts that are read."""
    lists = {name: column.tolist() for name, column in zip(NAMES, ROWS.T, strict=True)}
    rows = [dict(zip(NAMES, row, strict=True)) for row in ROWS.tolist()]
    split = {"columns": list(NAMES), "index": list(range(60)), "data": ROWS.tolist()}
    labels = {name: {str(i): x for i, x in enumerate(column)} for name, column in lists.items()}
    return tuple(json.dumps(form).encode() for form in (lists, rows, split, labels, ROWS.tolist()))


def matlab_v5() -> tuple[bytes, ...]:
    """MATLAB files up to version 7, plain and packed."""
    content = {
        **dict(zip(NAMES, (TIME[:, None], MOTION[None, :], FORCE[:, None]), strict=True)),
        "test": {"time": TIME, "force": FORCE.astype(np.float32), "name": "p500"},
        "counts": np.arange(60, dtype=np.int16),
        "cells": np.array([1.0, "two", np.eye(2)], dtype=object),
        "z": TIME + 1j,
        "log": ROWS,
    }
    found = []
    for packed in (False, True):
        file = io.BytesIO()
        savemat(file, content, do_compression=packed)
        found.append(file.getvalue())
    return tuple(found)


def matlab_v73() -> tuple[bytes, ...]:
    """MATLAB files of version 7.3, plain and packed."""
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
            log = file.create_dataset("log", data=ROWS.T)
            log.attrs["MATLAB_class"] = np.bytes_("double")
        memory.getbuffer()[:128] = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
        found.append(memory.getvalue())
    return tuple(found)


def workbook(*, named: bool = True) -> bytes:
    """An Excel workbook, with a row of names or with a title alone."""
    book = Workbook()
    book.active.append(list(NAMES) if named else ["rig two"])
    for row in ROWS.tolist():
        book.active.append(row)
    file = io.BytesIO()
    book.save(file)
    return file.getvalue()


def tdms() -> bytes:
    """A TDMS file of two segments."""
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
