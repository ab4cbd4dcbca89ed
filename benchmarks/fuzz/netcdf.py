"""Damaged NetCDF files of a run folder: facts, numbers, shapes and attributes."""

from __future__ import annotations

import io

import h5py
import numpy as np

from benchmarks.fuzz.mutations import FLOATS, Rng, mutate_bytes, mutate_tree


def mutate_netcdf(data: bytes, rng: Rng) -> bytes:
    """Facts, numbers and parts of a NetCDF file changed; now and then bytes."""
    if rng.random() < 0.3:
        return mutate_bytes(data, rng)
    memory = io.BytesIO(data)
    with h5py.File(memory, "r+") as file:
        for k in rng.choice(len(_CHANGES), rng.integers(1, 3), replace=False, p=_SHARES):
            _CHANGES[k](file, rng)
    return memory.getvalue()


def _change_facts(file: h5py.File, rng: Rng) -> None:
    group = file.get("posterior", file.get("constant_data"))
    if group is not None and "facts" in group.attrs:
        changed = mutate_tree(str(group.attrs["facts"]).encode(), rng).decode("utf-8", "replace")
        group.attrs["facts"] = changed.replace("\0", "")[:40_000]


def _some(file: h5py.File, rng: Rng) -> h5py.Dataset | None:
    """One of the data sets of a file."""
    found: list[h5py.Dataset] = []
    file.visititems(lambda _, item: found.append(item) if hasattr(item, "shape") else None)
    return found[rng.integers(len(found))] if found else None


def _change_numbers(file: h5py.File, rng: Rng) -> None:
    data = _some(file, rng)
    if data is None or data.dtype.kind not in "fiu" or not data.size:
        return
    values = data[()].astype(np.float64)
    flat = np.atleast_1d(values).reshape(-1)
    with np.errstate(all="ignore"):
        match int(rng.integers(6)):
            case 0:
                at = rng.integers(flat.size, size=int(rng.integers(1, 4)))
                flat[at] = (*FLOATS, 0.0, -1.0, 1e6, 1e10, 1e-10)[rng.integers(len(FLOATS) + 5)]
            case 1:
                flat *= 10.0 ** rng.uniform(-30, 30)
            case 2:
                flat[:] = flat[0]
            case 3:
                flat *= -1.0
            case 4:
                flat[:] = rng.permutation(flat)
            case _:
                flat += rng.normal(size=flat.size)
        data[...] = flat.reshape(data.shape).astype(data.dtype)


def _change_shape(file: h5py.File, rng: Rng) -> None:
    """Replace a data set by one of another shape or type, or by none."""
    data = _some(file, rng)
    if data is None:
        return
    name, values = data.name, np.atleast_1d(data[()])
    del file[name]
    match int(rng.integers(5)):
        case 0:
            file[name] = values[..., : int(rng.integers(0, 3))]
        case 1:
            file[name] = np.stack([values] * int(rng.integers(1, 4)))
        case 2:
            file[name] = values.astype(("f4", "i8", "i1", "?", "S4")[rng.integers(5)])
        case 3:
            file[f"{name}{rng.integers(9)}"] = values


def _change_attribute(file: h5py.File, rng: Rng) -> None:
    """Give a data set an attribute that readers of NetCDF act upon."""
    data = _some(file, rng)
    names = ("scale_factor", "add_offset", "_FillValue", "missing_value", "units", "dtype")
    names += ("coordinates", "calendar", "_Unsigned", "valid_range", "CLASS", "_Netcdf4Dimid")
    values = (0.0, np.nan, 1e308, -1, 2**40, "days since 0", "bool", "x y z", [1.0, 2.0], "")
    if data is not None:
        data.attrs[names[rng.integers(len(names))]] = values[rng.integers(len(values))]


_CHANGES = (_change_facts, _change_numbers, _change_shape, _change_attribute)
_SHARES = (0.4, 0.35, 0.15, 0.1)
