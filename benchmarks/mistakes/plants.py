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
    level: float  # of tension
    names: dict[str, str]
    unit: str = "lbf"
    stem: str = ""  # of the file's name; the id where empty

    def column(self, name: str) -> np.ndarray:
        return self.table[name].to_numpy(copy=True)

    def changed(self, **columns: np.ndarray) -> Planned:
        """The test with other numbers in its columns."""
        return replace(self, table=self.table.assign(**columns))


Change = Callable[[Planned], Planned]


def scaled(column: str, factor: float, **names: str) -> Change:
    """A column whose numbers are in another unit than its name says."""

    def change(test: Planned) -> Planned:
        altered = test.changed(**{column: factor * test.table[column]})
        return replace(altered, names={**test.names, **names})

    return change


def tension(factor: float, unit: str = "lbf") -> Change:
    return lambda test: replace(test, level=factor * test.level, unit=unit)


def both_signs(test: Planned) -> Planned:
    return scaled("force", -1.0)(scaled("displacement", -1.0)(test))


def cut(test: Planned) -> Planned:
    time = test.column("time")
    grid = np.arange(time[0] + 0.23 * np.ptp(time), time[0] + 0.8 * np.ptp(time), 0.01)
    table = {c: np.interp(grid, time, test.table[c]) for c in ("displacement", "force")}
    frame = test.table.iloc[: grid.size].assign(time=grid - grid[0], **table)
    return replace(test, table=frame)


def metric(test: Planned) -> Planned:
    travel = scaled("displacement", 25.4, displacement="displacement_mm")
    return scaled("force", 4.4482216, force="force_kN")(travel(test))


def clipped(test: Planned) -> Planned:
    limit = 0.6 * np.quantile(np.abs(test.table["force"]), 0.99)
    return test.changed(force=np.clip(test.column("force"), -limit, limit))


def lagged(test: Planned) -> Planned:
    time = test.column("time")
    return test.changed(force=np.interp(time - 0.02, time, test.table["force"]))


def drifted(test: Planned) -> Planned:
    time = test.column("time")
    size = 0.8 * np.quantile(np.abs(test.table["force"]), 0.9)
    return test.changed(force=test.table["force"] + size * (time - time[0]) / np.ptp(time))


def other_device(test: Planned) -> Planned:
    rng = np.random.default_rng(0)
    table = test.table.iloc[::4].reset_index(drop=True)
    trace = Trace.from_arrays(table["time"], table["displacement"], 0.03)
    force = ThreeStage().force(np.array(OTHER_DEVICE, dtype=float)[None], trace)[0]
    noise = 0.03 * rng.normal(size=force.size)
    return replace(test, table=table.assign(force=force + noise))


def spiked(test: Planned) -> Planned:
    force = test.column("force")
    force[np.linspace(50, force.size - 50, 15).astype(int)] += 8.0
    return test.changed(force=force)


def overflown(test: Planned) -> Planned:
    force = test.column("force")
    force[[force.size // 3, force.size // 2, force.size // 2 + 1]] = 1e6
    return test.changed(force=force)


def dropped(test: Planned) -> Planned:
    size = len(test.table)
    lost = [i + j for i in range(size // 7, size - 20, size // 7) for j in range(5)]
    return replace(test, table=test.table.drop(index=lost).reset_index(drop=True))


def middle(test: Planned, divisor: int) -> tuple[int, int]:
    """A sample in the middle of a stroke, about the middle of the test; another, later one.

    The other one comes after one of so many parts of a cycle at full stroke.
    """
    x = test.column("displacement")
    crossings = np.flatnonzero((x[1:] > np.median(x)) & (x[:-1] <= np.median(x)))
    start = int(crossings[np.argmin(np.abs(crossings - x.size // 2))])
    turns = Trace.from_arrays(test.table["time"], x).cycle_turns
    cycle = int(np.max(np.diff(turns[::2]))) if turns.size > 2 else 64
    return start, start + cycle // divisor


def renumbered(test: Planned) -> Planned:
    """A third of a cycle is lost, and the time goes on as if nothing were."""
    table = test.table.drop(index=range(*middle(test, 3))).reset_index(drop=True)
    return replace(test, table=table.assign(time=test.column("time")[: len(table)]))


def held(column: str) -> Change:
    """A third of a cycle in which a channel is frozen."""

    def change(test: Planned) -> Planned:
        values, (start, stop) = test.column(column), middle(test, 3)
        values[start:stop] = values[start]
        return test.changed(**{column: values})

    return change


def zero_stepped(test: Planned) -> Planned:
    x = test.column("displacement")
    x[middle(test, 8)[1] :] += 0.1 * np.ptp(x)
    return test.changed(displacement=x)


def repeated(test: Planned) -> Planned:
    """A second of the record is written twice, and the time goes on."""
    time = test.column("time")
    start, stop = np.searchsorted(time, time[0] + np.array([0.4, 0.4]) * np.ptp(time) + [0.0, 1.0])
    table = pd.concat([test.table.iloc[:stop], test.table.iloc[start:]], ignore_index=True)
    step = float(np.median(np.diff(time)))
    return replace(test, table=table.assign(time=time[0] + step * np.arange(len(table))))


def coarse(test: Planned) -> Planned:
    """A force of 17 levels over its range."""
    force = test.column("force")
    step = np.ptp(force) / 16.0
    return test.changed(force=step * np.round(force / step))


def drifting_travel(test: Planned) -> Planned:
    time, x = test.column("time"), test.column("displacement")
    return test.changed(displacement=x + 0.2 * np.ptp(x) * (time - time[0]) / np.ptp(time))


def humming(test: Planned) -> Planned:
    """A force with mains hum of a tenth of its range."""
    time, force = test.column("time"), test.column("force")
    return test.changed(force=force + 0.05 * np.ptp(force) * np.sin(2.0 * np.pi * 50.0 * time))


MM = {"displacement": "displacement_mm"}
TENSION = r"actuation.*(probably|wrong)|another test"
HALF = "tests at its actuation|force.*times too small"
MISTAKES: dict[str, tuple[str, Change]] = {
    # name: pattern of the right words, and the change of a test
    "cm for mm": ("in cm|times too small", scaled("displacement", 2.54, **MM)),
    "mm for in": ("displacement.*(in mm|times too large)", scaled("displacement", 25.4)),
    "in for mm": ("displacement.*(in in|times too small)", scaled("displacement", 1.0, **MM)),
    "1.5 times the travel": ("displacement.*times too large", scaled("displacement", 1.5)),
    "kN for lbf of tension": ("probably .* lbf, not|actuation.*wrong", tension(1.0, "kN")),
    "ten times the tension": (TENSION, tension(10.0)),
    "a tenth of the tension": (TENSION, tension(0.1)),
    "sign of force": ("sign is probably that of the force", scaled("force", -1.0)),
    "sign of displacement": ("that of the displacement", scaled("displacement", -1.0)),
    "sign of both": ("both swapped", both_signs),
    "duplicate, whole": ("same record|count twice", lambda test: test),
    "duplicate, cut, 100 Hz": ("same measurement|count twice", cut),
    "duplicate in mm and kN": ("same record|count twice", metric),
    "time in ms": ("time in ms", scaled("time", 1000.0)),
    "wrong file under a name": ("the name of", lambda t: replace(t, id=f"{t.id}_0.2Hz_0.4in")),
    "file of another tension": (TENSION, lambda test: test),
    "N for lbf of force": ("force.* in N,", scaled("force", 4448.2216, force="force_lbf")),
    "kN for kip of force": ("force.* in kN,", scaled("force", 4.4482216)),
    "force clipped": ("at its limit", clipped),
    "force 20 ms late": ("behind the displacement", lagged),
    "zero of force drifts": ("drifts", drifted),
    "record of another device": ("another device", other_device),
    "spikes": ("isolated sample", spiked),
    "samples lost": ("dropped", dropped),
    "lost, time renumbered": ("jumps by", renumbered),
    "displacement frozen": ("displacement holds one value", held("displacement")),
    "force frozen": ("force holds one value", held("force")),
    "zero of travel steps": ("zero of the sensor", zero_stepped),
    "half of the force": (HALF, scaled("force", 0.5)),
    "travel and force swapped": (
        "seem swapped",
        lambda t: t.changed(displacement=t.table["force"], force=t.table["displacement"]),
    ),
    "overflow values": ("isolated sample", overflown),
    # of few tests: about five of a session
    "exchanged tensions": ("exchanged", lambda test: test),
    "exchanged tensions, few tests": ("exchanged", lambda test: test),
    "kN for lbf, few tests": ("probably .* lbf, not|actuation.*wrong", tension(1.0, "kN")),
    "a tenth, few tests": (TENSION, tension(0.1)),
    "force in kN, few tests": ("force.* in kN,", scaled("force", 4.4482216)),
    "time a tenth too long": ("time|rate|frequency", scaled("time", 1.1)),
    "a second repeated": ("repeat|twice|same", repeated),
    "force of 17 levels": ("levels|resolution|quanti|steps of", coarse),
    "displacement drifts": ("displacement.*drift|drift.*displacement", drifting_travel),
    "hum": (r"\bhum\b|mains|50 Hz", humming),
}


def plant(name: str, tests: list[Planned], k: int) -> tuple[list[Planned], list[str]]:
    """A session with a mistake in test k, or in another, and the tests that are to be named."""
    if name.endswith("few tests"):  # every second one
        tests, k = tests[k % 2 :: 2], k // 2
    wrong = MISTAKES[name][1](tests[k])
    if name.startswith("exchanged"):  # with the test whose tension is farthest
        rival = max(tests, key=lambda test: abs(np.log(test.level / wrong.level)))
        levels = {wrong.id: rival.level, rival.id: wrong.level}
        return [replace(t, level=levels.get(t.id, t.level)) for t in tests], [*levels]
    if name.startswith("duplicate"):
        return [*tests, replace(wrong, id=f"{wrong.id}_again")], [f"{wrong.id}_again"]
    if name == "file of another tension":  # the highest one's under the name of the lowest
        low, high = (pick(tests, key=lambda test: test.level) for pick in (min, max))
        swapped = replace(low, table=high.table)
        return [swapped if test is low else test for test in tests if test is not high], [low.id]
    return [wrong if i == k else test for i, test in enumerate(tests)], [wrong.id]


def neutral(tests: list[Planned]) -> dict[str, Planned]:
    """Tests under ids and files that are only numbered, by their former id."""
    return {
        test.id: replace(test, id=f"t{20 + number}", stem=f"r{20 + number}")
        for number, test in enumerate(tests)
    }
