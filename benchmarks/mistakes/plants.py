"""Mistakes that people make with records, each as a change of one test of a session."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.records.trace import Trace

OTHER_DEVICE = (150, 0.02, 0.01, 7.0, 6.5, 7.6, 7.0, 1.0, 220, 0.03, 0.03, 1, 0.004, 0.5)
"""Parameters of the three stages of a stiffer device with a narrow gap, in kip, in and s."""


@dataclass(frozen=True)
class Planned:
    """A test as it is written: its table in s, in and kip, and what the campaign says of it.

    `names` are the columns' names, which carry the units; the numbers are written as they are.
    """

    id: str
    table: pd.DataFrame
    actuation: str
    names: dict[str, str]

    def changed(self, **columns: np.ndarray) -> Planned:
        """The test with other numbers in its columns."""
        return replace(self, table=self.table.assign(**columns))


Session = list[Planned]


@dataclass(frozen=True)
class Mistake:
    """A mistake; `plant` changes test `k` of a session, `cause` is a pattern of the right words."""

    name: str
    plant: Callable[[Session, int], tuple[Session, str]]
    cause: str


def _changed(change: Callable[[Planned], Planned]) -> Callable[[Session, int], tuple[Session, str]]:
    """Planting of a change of one test by itself."""

    def plant(tests: Session, k: int) -> tuple[Session, str]:
        return [change(t) if i == k else t for i, t in enumerate(tests)], tests[k].id

    return plant


def _scaled(column: str, by: float, **names: str) -> Callable[[Session, int], tuple[Session, str]]:
    """A column whose numbers are in another unit than its name says."""

    def change(test: Planned) -> Planned:
        return replace(
            test.changed(**{column: by * test.table[column]}), names={**test.names, **names}
        )

    return _changed(change)


def _added(change: Callable[[Planned], Planned]) -> Callable[[Session, int], tuple[Session, str]]:
    """Planting of one more test, made of another; the later one of both is to be named."""

    def plant(tests: Session, k: int) -> tuple[Session, str]:
        copy = replace(change(tests[k]), id=f"{tests[k].id}_again")
        return [*tests, copy], copy.id

    return plant


def _tension(text: str) -> Callable[[Session, int], tuple[Session, str]]:
    def change(test: Planned) -> Planned:
        number = float(test.actuation.split()[0])
        return replace(test, actuation=text.format(number, 10 * number, number / 10))

    return _changed(change)


def _cut(test: Planned) -> Planned:
    time = test.table["time"].to_numpy()
    grid = np.arange(time[0] + 0.23 * np.ptp(time), time[0] + 0.8 * np.ptp(time), 0.01)
    table = {c: np.interp(grid, time, test.table[c]) for c in ("displacement", "force")}
    frame = test.table.iloc[: grid.size].assign(time=grid - grid[0], **table)
    return replace(test, table=frame)


def _metric(test: Planned) -> Planned:
    names = {"displacement": "displacement_mm", "force": "force_kN"}
    table = test.table.assign(
        displacement=25.4 * test.table["displacement"], force=4.4482216 * test.table["force"]
    )
    return replace(test, table=table, names=names)


def _clipped(test: Planned) -> Planned:
    force = test.table["force"].to_numpy()
    limit = 0.6 * np.quantile(np.abs(force), 0.99)
    return test.changed(force=np.clip(force, -limit, limit))


def _lagged(test: Planned) -> Planned:
    time = test.table["time"].to_numpy()
    return test.changed(force=np.interp(time - 0.02, time, test.table["force"]))


def _drifted(test: Planned) -> Planned:
    time = test.table["time"].to_numpy()
    size = 0.8 * np.quantile(np.abs(test.table["force"]), 0.9)
    return test.changed(force=test.table["force"] + size * (time - time[0]) / np.ptp(time))


def _spiked(test: Planned) -> Planned:
    force = test.table["force"].to_numpy().copy()
    force[np.linspace(50, force.size - 50, 15).astype(int)] += 8.0
    return test.changed(force=force)


def _dropped(test: Planned) -> Planned:
    size = len(test.table)
    lost = [i + j for i in range(size // 7, size - 20, size // 7) for j in range(5)]
    return replace(test, table=test.table.drop(index=lost).reset_index(drop=True))


def _cycle(test: Planned) -> int:
    """Samples of a cycle at full stroke."""
    trace = Trace.from_arrays(test.table["time"], test.table["displacement"])
    return int(np.max(np.diff(trace.cycle_turns[::2]))) if trace.cycle_turns.size > 2 else 64


def _middle(test: Planned) -> int:
    """A sample in the middle of a stroke, about the middle of the test."""
    x = test.table["displacement"].to_numpy()
    middle = np.median(x)
    crossings = np.flatnonzero((x[1:] > middle) & (x[:-1] <= middle))
    return int(crossings[np.argmin(np.abs(crossings - x.size // 2))])


def _renumbered(test: Planned) -> Planned:
    """A third of a cycle is lost, and the time goes on as if nothing were."""
    first, time = _middle(test), test.table["time"].to_numpy()
    table = test.table.drop(index=range(first, first + _cycle(test) // 3)).reset_index(drop=True)
    return replace(test, table=table.assign(time=time[: len(table)]))


def _held(column: str) -> Callable[[Session, int], tuple[Session, str]]:
    """A third of a cycle in which a channel is frozen."""

    def change(test: Planned) -> Planned:
        values, first = test.table[column].to_numpy().copy(), _middle(test)
        values[first : first + _cycle(test) // 3] = values[first]
        return test.changed(**{column: values})

    return _changed(change)


def _zero_stepped(test: Planned) -> Planned:
    x = test.table["displacement"].to_numpy().copy()
    x[_middle(test) + _cycle(test) // 8 :] += 0.1 * np.ptp(x)
    return test.changed(displacement=x)


def _overflown(test: Planned) -> Planned:
    force = test.table["force"].to_numpy().copy()
    force[[force.size // 3, force.size // 2, force.size // 2 + 1]] = 1e6
    return test.changed(force=force)


def _other_device(test: Planned) -> Planned:
    rng = np.random.default_rng(0)
    table = test.table.iloc[::4].reset_index(drop=True)
    trace = Trace.from_arrays(table["time"], table["displacement"], 0.03)
    force = ThreeStage().force(np.array(OTHER_DEVICE, dtype=float)[None], trace)[0]
    noise = 0.03 * rng.normal(size=force.size)
    return replace(test, table=table.assign(force=force + noise))


def _wrong_file(tests: Session, k: int) -> tuple[Session, str]:
    """A file of another motion under the name of a test of 0.2 Hz and 0.4 in."""
    named = replace(tests[k], id=f"{tests[k].id}_0.2Hz_0.4in")
    return [named if i == k else t for i, t in enumerate(tests)], named.id


def _wrong_level(tests: Session, k: int) -> tuple[Session, str]:
    """The record of the highest tension under the name of the lowest; the former is not there."""
    level = [float(t.actuation.split()[0]) for t in tests]
    high, low = int(np.argmax(level)), int(np.argmin(level))
    swapped = replace(tests[low], table=tests[high].table)
    return [swapped if i == low else t for i, t in enumerate(tests) if i != high], tests[low].id


TENSION = r"actuation.*(probably|wrong)|another test"
MISTAKES = (
    Mistake(
        "cm for mm",
        _scaled("displacement", 2.54, displacement="displacement_mm"),
        "in cm|times too small",
    ),
    Mistake("mm for in", _scaled("displacement", 25.4), "displacement.*(in mm|times too large)"),
    Mistake(
        "in for mm",
        _scaled("displacement", 1.0, displacement="displacement_mm"),
        "displacement.*(in in|times too small)",
    ),
    Mistake("1.5 times the travel", _scaled("displacement", 1.5), "displacement.*times too large"),
    Mistake("kN for lbf of tension", _tension("{0:g} kN"), "probably .* lbf, not|actuation.*wrong"),
    Mistake("ten times the tension", _tension("{1:g} lbf"), TENSION),
    Mistake("a tenth of the tension", _tension("{2:g} lbf"), TENSION),
    Mistake("sign of force", _scaled("force", -1.0), "sign is probably that of the force"),
    Mistake("sign of displacement", _scaled("displacement", -1.0), "that of the displacement"),
    Mistake(
        "sign of both",
        _changed(
            lambda t: t.changed(displacement=-t.table["displacement"], force=-t.table["force"])
        ),
        "both swapped",
    ),
    Mistake("duplicate, whole", _added(lambda t: t), "same record|count twice"),
    Mistake("duplicate, cut, 100 Hz", _added(_cut), "same measurement|count twice"),
    Mistake("duplicate in mm and kN", _added(_metric), "same record|count twice"),
    Mistake(
        "time in ms",
        _changed(lambda t: t.changed(time=1000.0 * t.table["time"])),
        "time in ms",
    ),
    Mistake("wrong file under a name", _wrong_file, "the name of"),
    Mistake("file of another tension", _wrong_level, TENSION),
    Mistake("N for lbf of force", _scaled("force", 4448.2216, force="force_lbf"), "force.* in N,"),
    Mistake("kN for kip of force", _scaled("force", 4.4482216), "force.* in kN,"),
    Mistake("force clipped", _changed(_clipped), "at its limit"),
    Mistake("force 20 ms late", _changed(_lagged), "behind the displacement"),
    Mistake("zero of force drifts", _changed(_drifted), "drifts"),
    Mistake("record of another device", _changed(_other_device), "another device"),
    Mistake("spikes", _changed(_spiked), "isolated sample"),
    Mistake("samples lost", _changed(_dropped), "dropped"),
    Mistake("lost, time renumbered", _changed(_renumbered), "jumps by"),
    Mistake("displacement frozen", _held("displacement"), "displacement holds one value"),
    Mistake("force frozen", _held("force"), "force holds one value"),
    Mistake("zero of travel steps", _changed(_zero_stepped), "zero of the sensor"),
    Mistake(
        "half of the force", _scaled("force", 0.5), "tests at its actuation|force.*times too small"
    ),
    Mistake(
        "travel and force swapped",
        _changed(lambda t: t.changed(displacement=t.table["force"], force=t.table["displacement"])),
        "seem swapped",
    ),
    Mistake("overflow values", _changed(_overflown), "isolated sample"),
)
