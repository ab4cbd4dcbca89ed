"""A building under ground motions: blocks of draws, here or in processes, and what they give."""

from __future__ import annotations

import io
import shutil
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from mfd_bayes.jobs.job import Outcome, State, Step
from mfd_bayes.jobs.local import Workplace, run_jobs
from mfd_bayes.jobs.signals import before_end
from mfd_bayes.response.building import Building
from mfd_bayes.response.device_draws import Dampers, no_dampers, plain_friction
from mfd_bayes.response.ground import Ground
from mfd_bayes.response.result import Response, combined
from mfd_bayes.response.time_integration import HALVINGS, integrate
from mfd_bayes.store.files import write_bytes

BEND = 2.0  # largest bend of the forces at first (see `integrate`), over the tolerance
LARGEST_BEND = 0.1
SHARPER = 0.25  # share of this for the draws that are computed again
ROWS = 1500  # dampers of a block of draws: enough for numpy to be quick, few enough for the cache


@dataclass(frozen=True)
class Accuracy:
    """How exactly a response is computed.

    Attributes
    ----------
    tolerance : float
        Largest estimated error of a draw's drift, relative.
    rounds : int
        Most times that a draw is computed again with shorter steps.
    halvings : int
        Most halvings of a step.
    kept : int
        Draws of each block whose dampers' histories are kept.
    """

    tolerance: float = 0.01
    rounds: int = 2
    halvings: int = HALVINGS
    kept: int = 8


def settle(
    building: Building,
    ground: Ground,
    dampers: Dampers,
    accuracy: Accuracy,
    tick: Callable[[float], object] = lambda share: None,
) -> Response:
    """Response of every draw to one ground motion, at steps that suit each."""
    bend = min(BEND * accuracy.tolerance, LARGEST_BEND)
    halvings, kept = accuracy.halvings, accuracy.kept
    found = integrate(building, ground, dampers, bend, halvings=halvings, kept=kept, tick=tick)
    for _ in range(accuracy.rounds):
        far = (found.change > accuracy.tolerance) & ~found.unstable
        rows = np.flatnonzero(far[:, 0])
        if not rows.size:
            break
        bend *= SHARPER
        keep = int(np.searchsorted(rows, kept))
        some = dampers.chosen(rows)
        fine = integrate(building, ground, some, bend, halvings=halvings, kept=keep, tick=tick)
        found.put(rows, fine)
    return found


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

    def solve(self, observe: Callable[[Step], Any]) -> Response:
        """Response of its draws."""

        def tick(share: float) -> None:
            observe(Step(self.id, "in the earthquake", message=f"{share:.0%}"))

        return settle(self.building, self.ground, self.dampers, self.accuracy, tick)

    def run(self, out: Path, observe: Callable[[Step], Any]) -> Outcome:
        """Compute the response and store its arrays.

        Raises
        ------
        StoreError
            When they cannot be written.
        """
        begun, stored = time.perf_counter(), io.BytesIO()
        observe(Step(self.id, "in the earthquake"))
        np.savez(stored, **self.solve(observe).arrays)  # type: ignore[arg-type]
        write_bytes(out / self.file, stored.getbuffer())
        return Outcome(self.id, State.DONE, time.perf_counter() - begun)

    def stored(self, out: Path) -> Response:
        """The response that it stored."""
        with np.load(out / self.file) as arrays:
            return Response.of_ground(self.building, self.ground, self.dampers, arrays)


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
    bounds : mapping of str to Dampers
        Those of one more building each, such as "lower" and "upper".
    """

    building: Building
    grounds: Sequence[Ground]
    dampers: Dampers
    accuracy: Accuracy = field(default_factory=Accuracy)
    bounds: Mapping[str, Dampers] = field(default_factory=dict)

    def respond(
        self, jobs: int = 1, observe: Callable[[Step], None] = lambda step: None
    ) -> Response:
        """Response of every draw to every ground motion, and its `references`.

        Parameters
        ----------
        jobs : int
            Number of processes; 0 for one per processor. The result does not depend on it.
        observe : callable, optional
            Called with every step.
        """
        dampers, size = self.dampers, max(10, ROWS // max(self.dampers.count, 1))
        rows = np.split(np.arange(dampers.draws), np.arange(size, dampers.draws, size))
        plain = plain_friction(np.median(dampers.slip, axis=0)) if dampers.count else no_dampers()
        # the longest work first, so that no process waits for another at the end
        kinds = [(f"part {k}", self.building, dampers.chosen(r)) for k, r in enumerate(rows, 1)]
        references = {"bare": ("without dampers", self.building.bare(), no_dampers())}
        references["plain"] = ("with plain friction", self.building, plain)
        for name, bound in self.bounds.items():
            references[name] = (f"all at the {name} bound", self.building, bound)
        kinds += references.values()
        blocks = [
            Block(f"ground motion {g}, {ground.name}, {name}", built, ground, some, self.accuracy)
            for name, built, some in kinds
            for g, ground in enumerate(self.grounds, 1)
        ]
        found = iter(_solved(blocks, min(Workplace(jobs).processes, len(blocks)), observe))
        each = [[next(found) for _ in self.grounds] for _ in kinds]
        whole = combined(list(zip(*each[: len(rows)], strict=True)), dampers)
        single = {
            name: combined([[part] for part in row], row[0].dampers)
            for name, row in zip(references, each[len(rows) :], strict=True)
        }
        return replace(whole, references=single, tolerance=self.accuracy.tolerance)


def _solved(blocks: Sequence[Block], jobs: int, observe: Callable[[Step], None]) -> list[Response]:
    """Responses of the blocks in their order."""
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
        return [block.stored(out) for block in numbered]
