"""The response of a building: blocks of draws under each ground motion, here or in processes."""

from __future__ import annotations

import io
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.jobs.dispatch import Workplace, run_jobs
from mfd_bayes.jobs.job import Outcome, State, Step
from mfd_bayes.jobs.signals import before_end
from mfd_bayes.response.building import Building
from mfd_bayes.response.devices import Dampers
from mfd_bayes.response.draws import no_dampers, plain_friction
from mfd_bayes.response.ground import Ground
from mfd_bayes.response.result import Reference, Response
from mfd_bayes.response.settling import Accuracy, Settled, settle
from mfd_bayes.response.tally import Energies, Peaks
from mfd_bayes.store.files import write_bytes

Array = NDArray[np.float64]

ROWS = 1500
"""Dampers of a block of draws: enough for numpy to be quick, few enough for the cache."""

PLAIN_HALVINGS = 2
"""Most halvings of the step with plain friction: floors jump whenever it sticks, so that their
peak acceleration goes on to change by a percent or two long after drifts have settled."""


@dataclass(frozen=True, eq=False)
class Block:
    """Some draws of a building under one ground motion: work for one process.

    The blocks do not depend on the number of processes, so that the draws do not either.
    """

    id: str
    building: Building
    ground: Ground
    dampers: Dampers
    accuracy: Accuracy
    file: str = "block.npz"

    @property
    def makes(self) -> tuple[str, ...]:
        """File that it stores."""
        return (self.file,)

    def needs(self, out: Path) -> tuple[str, ...]:
        """No files."""
        return ()

    def solve(self, observe: Callable[[Step], Any] = lambda step: None) -> Settled:
        """Histories of its draws."""
        return settle(
            self.building,
            self.ground,
            self.dampers,
            self.accuracy,
            lambda share: observe(Step(self.id, "halving steps", message=f"{share:.0%}")),
        )

    def run(self, out: Path, observe: Callable[[Step], Any]) -> Outcome:
        """Compute the histories and store them.

        Raises
        ------
        StoreError
            When they cannot be written.
        """
        begun, stored = time.perf_counter(), io.BytesIO()
        observe(Step(self.id, "in the earthquake"))
        np.savez(stored, **_packed(self.solve(observe)))  # type: ignore[arg-type]
        write_bytes(out / self.file, stored.getbuffer())
        return Outcome(self.id, State.DONE, time.perf_counter() - begun)


@dataclass(frozen=True, eq=False)
class Analysis:
    """A building under ground motions.

    Attributes
    ----------
    building : Building
    grounds : sequence of Ground
    dampers : Dampers
        Of n draws of the building.
    accuracy : Accuracy
        Of the steps.
    """

    building: Building
    grounds: Sequence[Ground]
    dampers: Dampers
    accuracy: Accuracy = field(default_factory=Accuracy)

    def respond(
        self, jobs: int = 1, observe: Callable[[Step], None] = lambda step: None
    ) -> Response:
        """Response of every draw to every ground motion, and those without dampers beside.

        Parameters
        ----------
        jobs : int
            Number of processes; 0 for one per processor. The result does not depend on it.
        observe : callable, optional
            Called with every step.
        """
        blocks = list(self._blocks())
        processes = min(Workplace(jobs).processes, len(blocks))
        # the longest work first, so that no process waits for another at the end
        found = _solved([*blocks, *self._references()], processes, observe)
        size, each = len(self.grounds), len(blocks) // len(self.grounds)
        settled = [_joined(found[i * each :][:each]) for i in range(size)]
        bare, plain = [
            [_reference(f) for f in found[len(blocks) + i * size :][:size]] for i in range(2)
        ]
        histories = list(zip(settled, bare, plain, strict=True))
        given = self.building, self.grounds, self.dampers
        return Response.of(*given, histories, self.accuracy.tolerance)

    def _blocks(self) -> Iterator[Block]:
        """Blocks of draws under each ground motion."""
        dampers = self.dampers
        size = max(10, ROWS // max(dampers.count, 1))
        for number, ground in enumerate(self.grounds, start=1):
            for part, begin in enumerate(range(0, dampers.draws, size), start=1):
                some = dampers.chosen(np.arange(begin, min(begin + size, dampers.draws)))
                name = f"ground motion {number}, {ground.name}, part {part}"
                yield Block(name, self.building, ground, some, self.accuracy)

    def _references(self) -> Iterator[Block]:
        """The building without dampers, then with plain friction, under each ground motion."""
        dampers, accuracy = self.dampers, self.accuracy
        slip = np.median(dampers.slip, axis=0) if dampers.count else np.zeros(0)
        once = replace(accuracy, halvings=min(accuracy.halvings, PLAIN_HALVINGS))
        for number, ground in enumerate(self.grounds, start=1):
            name = f"ground motion {number}, {ground.name}, without dampers"
            yield Block(name, self.building.bare(), ground, no_dampers(), accuracy)
        for number, ground in enumerate(self.grounds, start=1):
            name = f"ground motion {number}, {ground.name}, with plain friction"
            yield Block(name, self.building, ground, plain_friction(slip), once)


def _solved(blocks: Sequence[Block], jobs: int, observe: Callable[[Step], None]) -> list[Settled]:
    """Histories of the blocks in their order."""
    if jobs == 1:
        found = []
        for block in blocks:
            observe(Step(block.id, "in the earthquake"))
            found.append(block.solve(observe))
            observe(Step(block.id, State.DONE))
        return found
    with (
        tempfile.TemporaryDirectory(prefix="mfd_bayes-") as folder,
        before_end(lambda: shutil.rmtree(folder, ignore_errors=True)),
    ):
        out = Path(folder)
        numbered = [replace(block, file=f"{n}.npz") for n, block in enumerate(blocks, start=1)]
        for outcome in run_jobs(numbered, out, Workplace(jobs), observe):
            observe(Step(outcome.id, outcome.status))
        return [_unpacked(out / block.file) for block in numbered]


def _packed(settled: Settled) -> dict[str, Array]:
    """Arrays of histories by name."""
    arrays = {}
    for one in fields(settled):
        value = getattr(settled, one.name)
        if isinstance(value, np.ndarray):
            arrays[one.name] = value
        else:
            arrays |= {f"{one.name}.{f.name}": getattr(value, f.name) for f in fields(value)}
    return arrays


def _unpacked(path: Path) -> Settled:
    with np.load(path) as stored:
        arrays = {name: stored[name] for name in stored.files}
    return _of_arrays(arrays)


def _of_arrays(arrays: dict[str, Array]) -> Settled:
    inner = {
        name: kind(**{f.name: arrays.pop(f"{name}.{f.name}") for f in fields(kind)})
        for name, kind in (("peaks", Peaks), ("energies", Energies))
    }
    return Settled(**arrays, **inner)  # type: ignore[arg-type]


def _joined(parts: Sequence[Settled]) -> Settled:
    """Histories of several blocks of draws, as one."""
    packed = [_packed(part) for part in parts]
    return _of_arrays({name: np.concatenate([p[name] for p in packed]) for name in packed[0]})


def _reference(found: Settled) -> Reference:
    """Peaks of one building without uncertainty."""
    return Reference(
        found.peaks.drift[0],
        found.peaks.acceleration[0],
        float(found.peaks.base_shear[0]),
        found.residual[0],
        found.drifts[0],
    )
