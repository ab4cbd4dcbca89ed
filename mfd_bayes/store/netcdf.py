"""NetCDF files that ArviZ opens: posteriors, records and arrays of draws."""

from __future__ import annotations

import io
import json
import os
import sys
import tempfile
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from mfd_bayes.errors import StoreError
from mfd_bayes.records.trace import Array, Trace
from mfd_bayes.store.files import json_text, write_bytes

if TYPE_CHECKING:
    import h5py
    import xarray as xr


def import_arviz() -> Any:
    """ArviZ, imported without its announcements and also where no cache folder is writable.

    Where numba has not been imported before, ArviZ works without it in this process. Its own
    `arviz.Numba.enable_numba()` lets it use numba again.
    """
    with warnings.catch_warnings(), _hidden("bokeh.plotting", "bokeh.models", "numba"):
        # 0.23 announces its refactoring on the first import of a day
        warnings.simplefilter("ignore", FutureWarning)
        try:
            import arviz
        except OSError:  # it writes to the user's cache, which may be read-only
            os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp(prefix="mfd_bayes-cache-")
            import arviz
    return arviz


@contextmanager
def _hidden(*modules: str) -> Iterator[None]:
    """Make modules that are not loaded yet seem to be missing.

    ArviZ 0.x imports bokeh for three docstrings, which takes three quarters of the time. It also
    imports numba, which takes 100 MB and is not needed for what is computed here.
    """
    loaded: dict[str, Any] = sys.modules
    hidden = [name for name in modules if name not in loaded]
    loaded |= dict.fromkeys(hidden)
    try:
        yield
    finally:
        for name in hidden:
            del loaded[name]


_CHAINS = ("chain", "draw")
NO_UNITS: Mapping[str, str] = MappingProxyType({})
_GROUPS = ("posterior", "sample_stats", "observed_data", "constant_data")
_NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable"
_FORMAT_ATTRIBUTES = {
    "CLASS",
    "NAME",
    "DIMENSION_LIST",
    "REFERENCE_LIST",
    "_Netcdf4Dimid",
    "_Netcdf4Coordinates",
}
"""Attributes by which NetCDF tells dimensions; the others are of the variable."""


@dataclass(frozen=True, eq=False)
class Group:
    """A group of a file: arrays by name, each with its dimensions and attributes."""

    variables: Mapping[str, tuple[list[str], Any, dict[str, Any]]]
    attrs: Mapping[str, Any]

    @property
    def arrays(self) -> dict[str, Any]:
        """Its variables that are no coordinates, by name."""
        return {name: v for name, (dims, v, _) in self.variables.items() if dims != [name]}

    @cached_property
    def dataset(self) -> xr.Dataset:
        """The same for xarray, which takes long to import."""
        import xarray as xr

        raw = xr.Dataset(dict(self.variables), attrs=dict(self.attrs))
        return xr.decode_cf(raw, decode_times=False).load()


@dataclass(frozen=True, eq=False)
class StoredTest:
    """A calibrated test as stored; `facts` are its model, noise and figures of the sampler."""

    posterior: Group
    sample_stats: Group
    trace: Trace
    facts: dict[str, Any]

    @property
    def draws(self) -> xr.Dataset:
        """Variables (chain, draw) with units, as ArviZ reads them."""
        return self.posterior.dataset

    @property
    def stats(self) -> xr.Dataset:
        """Variables lp, log_prior and log_likelihood, (chain, draw)."""
        return self.sample_stats.dataset

    def values(self) -> dict[str, Array]:
        """Draws of every quantity by name, (chain · draw,) each."""
        return {name: values.reshape(-1) for name, values in self.posterior.arrays.items()}


def save_test(
    path: Path,
    values: Mapping[str, Array],
    units: Mapping[str, str],
    stats: Mapping[str, Array],
    trace: Trace,
    predictive: Array,
    facts: Mapping[str, Any],
) -> None:
    """Write a calibrated test as NetCDF with the groups that ArviZ knows.

    `values` are draws by name, (chain, draw), `stats` lp, log_prior and log_likelihood,
    (chain, draw), and `predictive` replicated records, (chain, m, T), kip. `facts` become JSON.
    """
    import xarray as xr

    replicas = ((*_CHAINS, "time"), predictive.astype(np.float32), {"units": "kip"})
    coordinates = {"time": trace.time, **_numbers({"force": predictive})}
    densities = {name: (_CHAINS, value) for name, value in stats.items()}
    groups = {
        "posterior": draws_group(values, units, facts),
        "sample_stats": xr.Dataset(densities, coords=_numbers(stats)),
        "posterior_predictive": xr.Dataset({"force": replicas}, coords=coordinates),
        **trace_groups(trace),
    }
    _write_groups(path, groups)


def load_test(path: Path) -> StoredTest:
    """Calibrated test of a file written by `save_test`."""
    with _opened(path, *_GROUPS) as groups:
        posterior = groups["posterior"]
        facts = json.loads(posterior.attrs["facts"])
        return StoredTest(posterior, groups["sample_stats"], _trace_of(groups), facts)


def load_groups(path: Path) -> dict[str, xr.Dataset]:
    """Every group of a file written by `save_test`; errors as those of `load_test`."""
    with _opened(path, "posterior_predictive", *_GROUPS) as groups:
        return {name: group.dataset for name, group in groups.items()}


def arviz_data(groups: Mapping[str, xr.Dataset]) -> Any:
    """Groups as ArviZ's functions take them: InferenceData, or a DataTree from version 1 on."""
    import xarray as xr

    # newer versions warn where the name is asked for as an attribute
    inference_data: Any = vars(import_arviz()).get("InferenceData")
    return inference_data(**groups) if inference_data else xr.DataTree.from_dict(dict(groups))


def save_trace(path: Path, trace: Trace, facts: Mapping[str, Any]) -> None:
    """Write the trace of a test that is predicted and not fitted."""
    groups = trace_groups(trace)
    groups["constant_data"].attrs["facts"] = json_text(facts)
    _write_groups(path, groups)


def load_trace(path: Path) -> tuple[Trace, dict[str, Any]]:
    """Trace and facts written by `save_trace`; errors as those of `load_test`."""
    with _opened(path, "observed_data", "constant_data") as groups:
        return _trace_of(groups), json.loads(groups["constant_data"].attrs["facts"])


def save_arrays(
    path: Path,
    arrays: Mapping[str, Array],
    facts: Mapping[str, Any],
    units: Mapping[str, str] | None = None,
) -> None:
    """Write draws, (chain, draw, …) each, as a posterior group."""
    _write_groups(path, {"posterior": draws_group(arrays, units or {}, facts)})


def load_arrays(path: Path) -> tuple[dict[str, Array], dict[str, Any]]:
    """Draws and facts written by `save_arrays`; errors as those of `load_test`."""
    with _opened(path, "posterior") as groups:
        return groups["posterior"].arrays, json.loads(groups["posterior"].attrs["facts"])


def draws_group(
    arrays: Mapping[str, Array],
    units: Mapping[str, str] = NO_UNITS,
    facts: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Group of draws, (chain, draw, …) each, with their units and facts."""
    import xarray as xr

    data = {}
    for name, values in arrays.items():
        extra = tuple(f"{name}_dim_{i}" for i in range(values.ndim - 2))
        attrs = {"units": units[name]} if name in units else {}
        data[name] = ((*_CHAINS, *extra), values, attrs)
    about = {} if facts is None else {"facts": json_text(facts)}
    return xr.Dataset(data, coords=_numbers(arrays), attrs=about)


def _numbers(arrays: Mapping[str, Array]) -> dict[str, Array]:
    """Numbers of the chains and of the draws, which ArviZ 1 needs for a trace plot."""
    shape = next((values.shape[:2] for values in arrays.values()), (0, 0))
    return {name: np.arange(size) for name, size in zip(_CHAINS, shape, strict=True)}


def trace_groups(trace: Trace) -> dict[str, xr.Dataset]:
    """Groups of a record: its force, and its motion."""
    import xarray as xr

    time = {"time": ("time", trace.time, {"units": "s" if trace.timed else "1"})}
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


def _trace_of(groups: Mapping[str, Group]) -> Trace:
    constant = groups["constant_data"].arrays
    actuation = np.asarray(constant["actuation"])
    _, time, attrs = groups["constant_data"].variables["time"]
    trace = Trace.from_arrays(
        time,
        constant["displacement"],
        actuation if actuation.ndim else (None if np.isnan(actuation) else float(actuation)),
        groups["observed_data"].arrays["force"],
        constant["velocity"],
    )
    return replace(trace, timed=attrs.get("units") != "1")


def _write_groups(path: Path, groups: Mapping[str, xr.Dataset]) -> None:
    """Write NetCDF to memory, then to the file: the HDF5 library crashes on a full disk."""
    import h5netcdf
    from xarray.backends import H5NetCDFStore

    memory = io.BytesIO()
    with h5netcdf.File(memory, "w") as file:
        for name, dataset in groups.items():
            dataset.dump_to_store(H5NetCDFStore(file, group=name, mode="a"))
    write_bytes(path, memory.getbuffer())


@contextmanager
def _opened(path: Path, *names: str) -> Iterator[dict[str, Group]]:
    """Groups of a file, read by h5py in a third of the time of xarray's own reader.

    Every error, also one of what is made of them, becomes a `StoreError` that names the file.
    """
    import h5py

    if not path.is_file():
        raise StoreError(f"{path} does not exist")
    try:
        with h5py.File(path, "r") as file:
            members = {name: _member(file, name) for name in names}
            size = path.stat().st_size
            groups = {name: _read_group(group, size) for name, group in members.items()}
        yield groups
    except Exception as error:  # h5py, h5netcdf and xarray raise a dozen kinds
        reason = " ".join(str(error).split())
        raise StoreError(f"{path} is damaged or not of this program: {reason}") from error


def _read_group(group: h5py.Group, max_bytes: int) -> Group:
    """Variables of a group, of at most so many bytes each; a coordinate is named as its dimension.

    This program writes plain numbers: what is packed could be larger than the file, or a plugin's.
    """
    variables: dict[str, tuple[list[str], Any, dict[str, Any]]] = {}
    sizes: dict[str, int] = {}
    for name in group:
        data = _member(group, name)
        if _NO_VARIABLE in str(data.attrs.get("NAME")):
            continue
        if data.dtype.kind not in "fiub" or data.external:
            raise ValueError(f"{name} holds no numbers of its own")
        if data.id.get_storage_size() != data.nbytes or data.nbytes > max_bytes:
            raise ValueError(f"{name} is packed, or larger than the file")
        dims = [(dim[0].name if len(dim) else data.name).rpartition("/")[2] for dim in data.dims]
        attrs = {key: data.attrs[key] for key in data.attrs.keys() - _FORMAT_ATTRIBUTES}
        if packed := {"scale_factor", "add_offset"} & attrs.keys():
            raise ValueError(f"{name} has the attribute {min(packed)}")
        values = np.asarray(data[()])
        if any(sizes.setdefault(d, n) != n for d, n in zip(dims, values.shape, strict=True)):
            raise ValueError(f"the dimensions of {name} do not fit those of others")
        variables[name] = (dims, values, attrs)
    return Group(variables, dict(group.attrs))


def _member(group: h5py.Group, name: str) -> Any:
    """What a group itself holds of a name, and no link leads to."""
    import h5py

    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise ValueError(f"it has no {name} of its own")
    return group[name]
