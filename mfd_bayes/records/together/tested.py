"""What is kept of a test for its comparison with the others of its campaign."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from mfd_bayes.records.faults import without_spikes
from mfd_bayes.records.loops import channels_swapped, find_loops
from mfd_bayes.records.motion import Array
from mfd_bayes.records.readings import Readings, asymmetry, read_off
from mfd_bayes.records.record import Record
from mfd_bayes.records.together.twins import Signature
from mfd_bayes.records.trace import Trace

STEADY = 3
"""Fewest loops at full stroke of a record whose readings are compared."""


@dataclass(frozen=True, eq=False)
class Tested:
    """A test as it is compared with others.

    Attributes
    ----------
    signature : Signature
    readings : Readings or None
        None where the record has too few loops at full stroke.
    lopsided : (P,), kip
        Difference of the two directions along a stroke.
    direction : int
        First direction of the motion, +1 or -1.
    work : float, kip*in
        Energy of the loops; negative where one sign is swapped.
    level : float, kip or ksi
        Actuation, NaN where it is not known.
    actuation : str
        As the campaign gives it, "" for a column.
    units : mapping of str to str
        Unit of displacement and of force that the record was read in.
    step, cycle : float, s
        Median step of time, and median time of a full loop; 0 where there is none.
    speed : float, in/s
        Exceeded in a tenth of the samples.
    swapped : bool
        Whether displacement and force seem to be each other.
    """

    __test__: ClassVar[bool] = False  # pytest must not take it for a test class

    id: str
    signature: Signature
    readings: Readings | None
    lopsided: Array
    direction: int
    work: float
    level: float
    actuation: str
    units: dict[str, str]
    step: float = 0.0
    cycle: float = 0.0
    speed: float = float("nan")
    swapped: bool = False

    @classmethod
    def of(cls, name: str, record: Record, trace: Trace, actuation: str = "") -> Tested:
        """A test of its record, whose trace has every sample and a force."""
        trace = without_spikes(trace)
        loops = find_loops(trace)
        steady = bool(np.count_nonzero(loops.strong) >= STEADY)
        energy = np.empty(0) if loops.energy is None else loops.energy
        units = {role: record.columns[role][1] for role in ("displacement", "force")}
        readings = read_off(trace) if steady else None
        return cls(
            id=name,
            signature=Signature.of(trace),
            readings=readings,
            lopsided=asymmetry(trace) if steady else np.full(1, np.nan),
            direction=trace.direction,
            work=float(energy.sum()),
            level=trace.reference_actuation,
            actuation=actuation,
            units=units,
            step=float(np.median(np.diff(trace.time))),
            cycle=float(np.median(loops.period)) if loops.period.size else 0.0,
            speed=float(np.quantile(np.abs(trace.velocity), 0.9)),
            swapped=channels_swapped(trace),
        )
