"""Small files that declare or unpack to much: each is refused in little memory and time."""

import json
import os
import subprocess
import sys
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="memory is limited as Linux does it"
)

HUGE = 1_250_000_000  # of doubles: 10 GB

# Reads the files in its arguments, "reader:path" each, as a process with little memory.
READER = """\
import json, resource, sys, time
from pathlib import Path
from mfd_bayes.calibration.posterior import load_priors
from mfd_bayes.campaign.campaign import load_campaign
from mfd_bayes.errors import MfdError
from mfd_bayes.records.readers import read_table
from mfd_bayes.store.files import read_json
from mfd_bayes.store.netcdf import load_arrays
import h5netcdf, h5py, nptdms, pandas, xarray

def columns(path):
    table = read_table(path)
    return {name: table.columns([name])[name].size for name in table.names}

READ = {"record": columns, "campaign": load_campaign, "priors": lambda p: load_priors(str(p)),
        "run": load_arrays, "json": read_json}
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
has = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (has + %d, has + %d))
for word in sys.argv[1:]:
    kind, _, name = word.partition(":")
    began = time.process_time()
    try:
        said = f"read {READ[kind](Path(name))}"[:100]
    except MfdError as error:
        said = str(error)
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    print(json.dumps([word, said, time.process_time() - began, grown]))
"""
MEMORY = 1280 * 2**20
"""More than what the process has once its libraries are imported, which differs with these."""


def deflated(size):
    """A zlib stream of so many zeros."""
    packer = zlib.compressobj(1)
    zeros = bytes(2**20)
    return b"".join(packer.compress(zeros) for _ in range(size >> 20)) + packer.flush()


def matlab_v73(path):
    with h5py.File(path, "w", userblock_size=512) as file:
        file.create_dataset("force", (HUGE,), "f8")


def unpacking_piece(path):
    with h5py.File(path, "w", userblock_size=512) as file:
        data = file.create_dataset("force", (1000,), "f8", chunks=(1000,), compression="gzip")
        data.id.write_direct_chunk((0,), deflated(2**29))


def unpacking_v5(path):
    savemat(path, {"force": np.arange(30.0)})
    packed = deflated(2**30)
    tag = (15).to_bytes(4, "little") + len(packed).to_bytes(4, "little")
    path.write_bytes(path.read_bytes()[:128] + tag + packed)


def netcdf(path):
    with h5py.File(path, "w") as file:
        group = file.create_group("posterior")
        group.attrs["facts"] = "{}"
        group.create_dataset("mu", (4, HUGE // 4), "f8", chunks=(1, 1000))


def long_line(path):
    path.write_bytes(b"time_s,displacement_in\n" + b"1," * 50_000_000)


def many_columns(path):
    names = ",".join(f"c{i}" for i in range(1_000_000))
    path.write_text(names + "\n" + "1," * 1_000_000 + "\n")


def text(content):
    return lambda path: path.write_text(content)


def objects_of_different_keys(path):
    path.write_text(json.dumps([{f"c{i}": i} for i in range(200_000)]))


TEST = '[[test]]\nid = "a"\nfile = "a.csv"\nactuation = "1 psi"\n'
BOMBS = {
    "record:unallocated.mat": (matlab_v73, "needs more than 2 GB"),
    "record:piece.mat": (unpacking_piece, "{'force': 1000}"),
    "record:unpacking_v5.mat": (unpacking_v5, "not a MATLAB file"),
    "run:declared.nc": (netcdf, "larger than the file"),
    "record:line.csv": (long_line, "line 2 of"),
    "record:columns.csv": (many_columns, "line 1 of"),
    "record:name.csv": (text("t," + "x" * 9000 + "\n1,2\n"), "longer than 300 characters"),
    "record:lists.json": (text("[" + "[]," * 2_000_000 + "[]]"), "1,000,000 lists"),
    "record:keys.json": (objects_of_different_keys, "200,000 columns"),
    "record:integer.json": (text('{"a": [' + "9" * 10_000 + "]}"), "not valid JSON"),
    "record:integer.csv": (text("a,b\n1," + "9" * 5000 + "\n"), "expected a finite number"),
    "json:nested.json": (text('{"a":' * 100_000), "not valid JSON"),
    "campaign:arrays.toml": (text("a = " + "[" * 100_000), "not valid TOML"),
    "campaign:keys.toml": (text("a" + ".a" * 100_000 + " = 1"), "200 dots"),
    "campaign:exponent.toml": (text("[campaign]\narea = 1e999\n" + TEST), "finite"),
    "campaign:large.toml": (text("#" * 2**21), "larger than 1 MB"),
    "campaign:tests.toml": (text('[[test]]\nid = "."\n' * 50_000), "names a folder"),
    "priors:integer.toml": (
        text(
            f'[parameters.static_excess_fwd]\nfamily = "lognormal"\nmedian = 1{"0" * 400}\nsd = 1'
        ),
        "must be finite",
    ),
}


@pytest.fixture(scope="module")
def heard(tmp_path_factory):
    """Message for every file, the seconds that it took, and the growth of memory so far, kB."""
    folder = tmp_path_factory.mktemp("bombs")
    words = []
    for word, (make, _) in BOMBS.items():
        kind, _, name = word.partition(":")
        path = folder / kind / name
        path.parent.mkdir(exist_ok=True)
        make(path)
        words.append(f"{kind}:{path}")
    done = subprocess.run(
        [sys.executable, "-c", READER % (MEMORY, MEMORY), *words],
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr[-2000:]
    found = [json.loads(line) for line in done.stdout.splitlines()]
    for path in folder.rglob("*.*"):
        path.unlink()
    return {
        f"{word.partition(':')[0]}:{Path(word.partition(':')[2]).name}": tuple(rest)
        for word, *rest in found
    }


def test_a_bomb_ends_in_a_sentence(heard):
    for bomb, (_, words) in BOMBS.items():
        said, seconds, grown = heard[bomb]
        assert words in said, bomb
        assert len(said) < 3000, bomb
        assert seconds < 10, bomb
        assert grown < 700_000, bomb  # kB, by all bombs so far
