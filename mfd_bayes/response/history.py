"""Actuations of dampers that change in time, from files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import BuildingError, MfdError
from mfd_bayes.records.readers import read_table
from mfd_bayes.records.roles import header_unit
from mfd_bayes.response.beside import file_beside
from mfd_bayes.response.building import Building, Device
from mfd_bayes.units import actuation_factor, factor

Array = NDArray[np.float64]


def level_of(device: Device, folder: Path) -> float:
    """Actuation of a damper, ksi or kip; the mean of a history."""
    if device.history is None:
        return device.actuation
    return float(np.mean(_read(device, folder)[1]))


def histories_of(building: Building) -> list[tuple[Device, Array, Array]]:
    """Dampers with a history, each with its times, s, and its actuations then, (T,) each."""
    changing = [device for device in building.devices if device.history is not None]
    return [(device, *_read(device, building.folder)) for device in changing]


def levels_along(building: Building) -> tuple[Array, list[Array]] | None:
    """Times, (T,) s, and the actuation of each damper then, (T,); None where all are constant."""
    found = histories_of(building)
    if not found:
        return None
    times, rest = np.unique(np.concatenate([time for _, time, _ in found])), iter(found)
    levels = []
    for device in building.devices:
        if device.history is None:
            levels.append(np.full(times.size, device.actuation))
        else:
            _, time, level = next(rest)
            levels.append(np.interp(times, time, level))
    return times, levels


def _read(device: Device, folder: Path) -> tuple[Array, Array]:
    """Times, s, and actuations, ksi or kip, of a damper's file."""
    history = device.history
    if history is None:
        raise BuildingError(f"damper at {device.name} has no history of its actuation")
    path = file_beside(folder, history.file, f"the actuation of {device.name}")
    try:
        table = read_table(path)
        times = [name for name in table.names if name.lower().startswith(("time", "t_", "t["))]
        if not times:
            raise BuildingError(f"actuation.file {path} needs a column of the time, 'time_s'")
        columns = table.columns([times[0], history.column])
        time = columns[times[0]] * factor(header_unit(times[0]) or "s", "time")
        level = columns[history.column] * actuation_factor(history.unit)[0]
    except MfdError as error:
        raise BuildingError(f"the actuation of {device.name}: {error}") from error
    if time.size < 2 or not np.all(np.diff(time) > 0) or np.any(level < 0):
        raise BuildingError(
            f"the actuation of {device.name}: {path} must have growing times and no value below 0"
        )
    return time, level
