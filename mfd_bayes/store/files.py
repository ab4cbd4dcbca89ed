"""Files of a run folder: NetCDF that ArviZ opens, JSON, text; each whole or not there."""

from __future__ import annotations

import io
import json
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import StoreError
from mfd_bayes.records.readers.hdf5 import UnsafeError, check_objects
from mfd_bayes.records.trace import Trace

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

MANIFEST = "manifest.json"
_CHAINS = ("chain", "draw")
_PART = ".part"
_LARGEST_JSON = 64 * 2**20
_DEEPEST = 50
_SLACK = 2**20
"""Bytes of dimensions that a file may declare without holding them."""


def write_atomically(path: Path, write: Callable[[Path], None]) -> None:
    """Write a file beside its place and rename it into it.

    Raises
    ------
    StoreError
        When the folder cannot be written to.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=_PART)
        os.close(handle)
    except OSError as error:
        raise StoreError(f"cannot write {path}: {error.strerror}") from error
    part = Path(name)
    try:
        write(part)
        part.chmod(0o644)
        with part.open("rb") as file:
            os.fsync(file.fileno())
        part.replace(path)
    except OSError as error:
        raise StoreError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        with suppress(OSError):  # read-only by now, and said; the next run sweeps it away
            part.unlink(missing_ok=True)


def is_part(path: Path, name: str) -> bool:
    """Whether a file is what a killed process was writing in the place of `name`."""
    return path.name.startswith(f".{name}.") and path.suffix == _PART


def sweep(out: Path) -> None:
    """Remove from a run folder what a killed process was writing, where it can be removed."""
    folders = [out / name for name in ("tests", "figures", "crossvalidation")]
    for parts in (out.glob, *(folder.rglob for folder in folders)):
        for part in parts(f".*{_PART}"):
            with suppress(OSError):  # why not will be said of what is to be written
                part.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Write a binary file atomically."""

    def write(part: Path) -> None:
        part.write_bytes(content)

    write_atomically(path, write)


def write_json(path: Path, content: object) -> None:
    """Write valid JSON atomically: what is not finite becomes null."""
    write_text(path, json.dumps(_plain(content), indent=2, allow_nan=False) + "\n")


def read_json(path: Path) -> dict[str, Any]:
    """Object of a JSON file.

    Raises
    ------
    StoreError
        When the file is missing or holds no JSON object.
    """
    try:
        if path.stat().st_size > _LARGEST_JSON:
            raise StoreError(f"{path} is larger than {_LARGEST_JSON >> 20} MB: it is none of ours")
        content = json.loads(path.read_text(encoding="utf-8"))
        _check_tree(content)
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise StoreError(f"{path} is not valid JSON: {error}") from error
    if not isinstance(content, dict):
        raise StoreError(f"{path} must hold a JSON object")
    return content


def _check_tree(content: object) -> None:
    """Refuse what cannot be written again: nested too deeply, or text that is no Unicode."""
    level, depth = [content], 0
    while level:
        depth += 1
        if depth > _DEEPEST:
            raise ValueError(f"nested more than {_DEEPEST} times")
        below: list[object] = []
        for part in level:
            if isinstance(part, Mapping):
                below += [*part, *part.values()]
            elif isinstance(part, list):
                below += part
            elif isinstance(part, str):
                part.encode()
        level = below


def _plain(content: object) -> object:
    if isinstance(content, Mapping):
        return {str(key): _plain(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_plain(value) for value in content]
    if isinstance(content, np.ndarray | np.generic):
        return _plain(content.tolist())
    if isinstance(content, float):
        return content if np.isfinite(content) else None
    return str(content) if isinstance(content, Path) else content


@dataclass(frozen=True, eq=False)
class StoredTest:
    """A calibrated test as stored.

    Attributes
    ----------
    draws : xarray.Dataset
        Named variables (chain, draw) with units, as ArviZ reads them.
    stats : xarray.Dataset
        lp, log_prior and log_likelihood (chain, draw).
    trace : Trace
    facts : dict
        Fingerprint, model, noise, sampler's figures.
    """

    draws: xr.Dataset
    stats: xr.Dataset
    trace: Trace
    facts: dict[str, Any]

    def values(self) -> dict[str, Array]:
        """All quantities by name, (chain · draw,) each."""
        return {str(k): v.to_numpy().reshape(-1) for k, v in self.draws.data_vars.items()}


def save_test(
    path: Path,
    values: Mapping[str, Array],
    units: Mapping[str, str],
    stats: Mapping[str, Array],
    trace: Trace,
    predictive: Array,
    facts: Mapping[str, Any],
) -> None:
    """Write a posterior as NetCDF with the groups that ArviZ knows.

    Parameters
    ----------
    path : Path
    values : mapping of str to (chain, draw)
    units : mapping of str to str
    stats : mapping of str to (chain, draw)
    trace : Trace
    predictive : (chain, m, T), kip
        Replicated records.
    facts : mapping
        Kept as JSON in the posterior's attributes.
    """
    import xarray as xr

    posterior = xr.Dataset(
        {name: (_CHAINS, value, {"units": units[name]}) for name, value in values.items()},
        coords=_numbers(values),
        attrs={"facts": json.dumps(_plain(facts), allow_nan=False)},
    )
    replicas = {
        "force": (("chain", "draw", "time"), predictive.astype(np.float32), {"units": "kip"})
    }
    groups = {
        "posterior": posterior,
        "sample_stats": xr.Dataset(
            {name: (_CHAINS, value) for name, value in stats.items()}, coords=_numbers(stats)
        ),
        "posterior_predictive": xr.Dataset(
            replicas, coords={"time": trace.time, **_numbers({"force": predictive})}
        ),
        **_trace_groups(trace),
    }
    write_atomically(path, lambda part: _write_groups(part, groups))


def load_test(path: Path) -> StoredTest:
    """Posterior of a file written by `save_test`.

    Raises
    ------
    StoreError
        When the file is missing or is no such file.
    """
    with _reading(path):
        names = ("posterior", "sample_stats", "observed_data", "constant_data")
        groups = _read_groups(path, names)
        posterior = groups["posterior"]
        return StoredTest(
            draws=posterior,
            stats=groups["sample_stats"],
            trace=_trace_of(groups),
            facts=json.loads(posterior.attrs["facts"]),
        )


def save_trace(path: Path, trace: Trace, facts: Mapping[str, Any]) -> None:
    """Write the record of a test that is predicted, never fitted."""
    groups = _trace_groups(trace)
    groups["constant_data"].attrs["facts"] = json.dumps(_plain(facts), allow_nan=False)
    write_atomically(path, lambda part: _write_groups(part, groups))


def load_trace(path: Path) -> tuple[Trace, dict[str, Any]]:
    """Trace and facts written by `save_trace`.

    Raises
    ------
    StoreError
        When the file is missing or is no such file.
    """
    with _reading(path):
        groups = _read_groups(path, ("observed_data", "constant_data"))
        return _trace_of(groups), json.loads(groups["constant_data"].attrs["facts"])


def save_arrays(
    path: Path,
    arrays: Mapping[str, Array],
    facts: Mapping[str, Any],
    units: Mapping[str, str] | None = None,
) -> None:
    """Write draws, (chain, draw, …) each, as a posterior group."""
    import xarray as xr

    data = {}
    for name, values in arrays.items():
        extra = tuple(f"{name}_dim_{i}" for i in range(values.ndim - 2))
        about = {"units": units[name]} if units and name in units else {}
        data[name] = ((*_CHAINS, *extra), values, about)
    posterior = xr.Dataset(
        data,
        coords=_numbers(arrays),
        attrs={"facts": json.dumps(_plain(facts), allow_nan=False)},
    )
    write_atomically(path, lambda part: _write_groups(part, {"posterior": posterior}))


def load_arrays(path: Path) -> tuple[dict[str, Array], dict[str, Any]]:
    """Draws and facts written by `save_arrays`.

    Raises
    ------
    StoreError
        When the file is missing or is no such file.
    """
    with _reading(path):
        posterior = _read_groups(path, ("posterior",))["posterior"]
        arrays = {str(k): v.to_numpy() for k, v in posterior.data_vars.items()}
        return arrays, json.loads(posterior.attrs["facts"])


def _numbers(arrays: Mapping[str, Array]) -> dict[str, Array]:
    """Numbers of the chains and draws: ArviZ 1 draws no trace plot without them."""
    shape = next((values.shape[:2] for values in arrays.values()), (0, 0))
    return {name: np.arange(size) for name, size in zip(_CHAINS, shape, strict=True)}


def _trace_groups(trace: Trace) -> dict[str, xr.Dataset]:
    import xarray as xr

    time = {"time": ("time", trace.time, {"units": "s"})}
    constant = {
        "displacement": ("time", trace.displacement, {"units": "in"}),
        "velocity": ("time", trace.velocity, {"units": "in/s"}),
        "actuation": (("time",) if trace.varying else (), trace.actuation),
    }
    observed = {"force": ("time", np.asarray(trace.force), {"units": "kip"})}
    return {
        "observed_data": xr.Dataset(observed, coords=time),
        "constant_data": xr.Dataset(constant, coords=time),
    }


def _trace_of(groups: Mapping[str, xr.Dataset]) -> Trace:
    constant = groups["constant_data"]
    actuation = constant["actuation"].to_numpy()
    return Trace.from_arrays(
        constant["time"].to_numpy(),
        constant["displacement"].to_numpy(),
        actuation if actuation.ndim else (None if np.isnan(actuation) else float(actuation)),
        groups["observed_data"]["force"].to_numpy(),
        constant["velocity"].to_numpy(),
    )


def _write_groups(path: Path, groups: Mapping[str, xr.Dataset]) -> None:
    """Write NetCDF by way of memory: the HDF5 library crashes where a disk is full."""
    import h5netcdf
    from xarray.backends import H5NetCDFStore

    memory = io.BytesIO()
    with h5netcdf.File(memory, "w") as file:
        for name, dataset in groups.items():
            dataset.dump_to_store(H5NetCDFStore(file, group=name, mode="a"))
    path.write_bytes(memory.getbuffer())


def _read_groups(path: Path, names: tuple[str, ...]) -> dict[str, xr.Dataset]:
    import h5py
    import xarray as xr

    groups = {}
    with h5py.File(path, "r") as file:
        # It is written unpacked, so that it holds what it declares.
        check_objects(file, 2 * path.stat().st_size + _SLACK, plain=True)
    for name in names:
        with xr.open_dataset(path, group=name, engine="h5netcdf", decode_times=False) as dataset:
            groups[name] = dataset.load()
    return groups


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Name the file in whatever a missing, damaged or foreign one makes of its reading."""
    if not path.is_file():
        raise StoreError(f"{path} does not exist")
    try:
        yield
    except UnsafeError as error:
        raise StoreError(f"{path} {error}") from None
    except Exception as error:  # h5py, h5netcdf and xarray raise a dozen kinds
        reason = " ".join(str(error).split())
        raise StoreError(f"{path} is damaged or not of this program: {reason}") from error
