"""What is kept of histories while they are computed: peaks, residuals, energies, samples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from mfd_bayes.response.building import Building
from mfd_bayes.response.ground import Ground

Array = NDArray[np.float64]

BOOLE = np.array([7.0, 32.0, 12.0, 32.0, 7.0]) / 90.0  # weights of Boole's rule
CHUNK = 128  # steps of draws that are taken in together, at least


@dataclass(frozen=True, eq=False)
class Piece:
    """One step of some draws.

    Attributes
    ----------
    inner : callable
        States after ¼, ½ and ¾ of the step, (3, r, 2N), from those at its begin, the ground's
        acceleration at its ends, (r, 2), and the forces.
    size : float, s
        Its length.
    rows : (r,)
        Which draws.
    time : float, s
        Its begin.
    shaking : (2,), in/s²
        Ground's acceleration at both ends.
    begin, end : (r, 2N), in and in/s
        Displacements and velocities.
    forces : three of (r, m), kip
        Of the devices, beyond those at rest: at the begin, in the middle and at the end.
    """

    inner: Callable[[Array, Array, Sequence[Array]], Array]
    size: float
    rows: NDArray[np.intp]
    time: float
    shaking: Array
    begin: Array
    end: Array
    forces: Sequence[Array]


class Recorder:
    """Peaks, energies and histories of n draws under one ground motion.

    The devices' forces do work against the forces that they hold at rest, in which the building is
    in equilibrium.
    """

    def __init__(
        self,
        building: Building,
        ground: Ground,
        places: Array,
        brace: Array,
        rest: Array,
        kept: int,
    ) -> None:
        self.building, self.places, self.brace, self.rest = building, places, brace, rest
        self.inverse = linalg.inv(building.mass)
        n, samples, storeys = len(rest), ground.acceleration.size, len(building.drifts)
        m = self.dampers = len(building.devices)
        self.late = float(ground.time[-1] - 2.0 * building.modes.periods[0])
        widths = {"drift": storeys, "acceleration": building.freedoms, "base_shear": 1}
        widths |= {"force": m, "travel": m}
        self.peaks = {name: np.zeros((n, width)) for name, width in widths.items()}
        self.work = np.zeros((n, 2 + len(places)))  # of the ground, of damping, of each device
        self.residual, self.late_time = np.zeros((n, storeys)), np.zeros((n, 1))
        self.most_input, self.most_lost = np.zeros((2, n))
        self.histories = np.zeros((n, samples, storeys), dtype=np.float32)
        self.loops = np.zeros((2, min(kept, n), samples, m), dtype=np.float32)
        self.pieces: list[Piece] = []
        self.samples: list[tuple[Array, Array]] = []
        self.sampled = 0

    def include(self, pieces: Sequence[Piece], state: Array, force: Array, *, last: bool) -> None:
        """Take in the steps to the next sample of the ground motion, and all draws there.

        All that waits is worked up together when it is enough, and with the last sample.
        """
        self.pieces += pieces
        self.samples.append((state.copy(), force))
        if not last and sum(piece.rows.size for piece in self.pieces) < CHUNK:
            return
        n, m, building, kept = (
            self.building.freedoms,
            self.dampers,
            self.building,
            self.loops.shape[1],
        )
        states, forces = (np.stack(column, axis=1) for column in zip(*self.samples, strict=True))
        span = slice(self.sampled, self.sampled + states.shape[1])
        self.histories[:, span] = states[..., :n] @ building.drifts.T
        pulled = (forces - self.rest[:, None])[:kept, :, :m]
        travels = states[:kept, :, :n] @ self.places[:m].T - pulled * self.brace[:m]
        self.loops[:, :, span] = travels, forces[:kept, :, :m]
        self.sampled = span.stop
        for size in {piece.size for piece in self.pieces}:
            self._take_in([piece for piece in self.pieces if piece.size == size])
        self.pieces, self.samples = [], []
        # energy that is not accounted for, now
        x, v = state[:, :n], state[:, n:]
        stored = 0.5 * ((v @ building.mass) * v + (x @ building.stiffness) * x).sum(axis=1)
        lost = self.work[:, 0] - self.work[:, 1:].sum(axis=1) - stored
        self.most_lost = np.maximum(self.most_lost, np.abs(lost))
        self.most_input = np.maximum(self.most_input, np.abs(self.work[:, 0]))
        self.elastic = 0.5 * (self.brace * (force - self.rest) ** 2)[:, :m]

    def _take_in(self, pieces: Sequence[Piece]) -> None:
        """Peaks, work and residual drift of steps of one length; those of a draw together."""
        n, m, building, size = self.building.freedoms, self.dampers, self.building, pieces[0].size
        rows = np.concatenate([piece.rows for piece in pieces])
        order = np.argsort(rows, kind="stable")
        rows, counts = rows[order], [piece.rows.size for piece in pieces]
        starts = np.flatnonzero(np.diff(rows, prepend=-1))
        draws = rows[starts]
        begin, end = (
            np.concatenate([getattr(piece, name) for piece in pieces])[order]
            for name in ("begin", "end")
        )
        first, half, last = (
            np.concatenate([piece.forces[i] for piece in pieces])[order] for i in range(3)
        )
        ground, time = (
            np.repeat([getattr(piece, name) for piece in pieces], counts, axis=0)[order]
            for name in ("shaking", "time")
        )
        # (5, P, ...): at the begin, after ¼, ½ and ¾, and at the end of every step
        share = np.linspace(0.0, 1.0, 5)[:, None, None]
        state = np.concatenate(
            [begin[None], pieces[0].inner(begin, ground, (first, half, last)), end[None]]
        )
        pulled = (1.0 - share) * first + share * last
        pulled += 4.0 * share * (1.0 - share) * (half - 0.5 * (first + last))
        x, v = state[..., :n], state[..., n:]
        weights = building.mass @ building.influence
        load = x @ building.stiffness + v @ building.damping + pulled @ self.places
        acceleration, drift = -load @ self.inverse, x @ building.drifts.T  # absolute
        peaks = {
            "drift": drift,
            "acceleration": acceleration,
            "base_shear": (acceleration @ weights)[..., None],
            "force": pulled[::2, :, :m] + self.rest[rows, :m],
            "travel": x @ self.places[:m].T - pulled[..., :m] * self.brace[:m],
        }
        for name, values in peaks.items():
            most = np.maximum.reduceat(np.abs(values).max(axis=0), starts, axis=0)
            self.peaks[name][draws] = np.maximum(self.peaks[name][draws], most)
        shaking = (1.0 - share[..., 0]) * ground[:, 0] + share[..., 0] * ground[:, 1]
        given = -shaking * (v @ weights)
        damped = ((v @ building.damping) * v).sum(axis=-1)
        taken = pulled * (v @ self.places.T)
        power = np.concatenate([given[..., None], damped[..., None], taken], axis=2)
        work = size * np.tensordot(BOOLE, power, axes=1)
        self.work[draws] += np.add.reduceat(work, starts, axis=0)
        late = size * (time + size > self.late)[:, None]
        self.residual[draws] += np.add.reduceat(late * drift[2], starts, axis=0)
        self.late_time[draws] += np.add.reduceat(late, starts, axis=0)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """What was found of n draws, by the names of a response."""
        return {
            **self.peaks,
            "base_shear": self.peaks["base_shear"][:, 0],
            "energy": self.work[:, 2 : 2 + self.dampers] - self.elastic,
            "residual": self.residual / np.maximum(self.late_time, 1e-300),
            "imbalance": self.most_lost / np.maximum(self.most_input, 1e-300),
            "histories": self.histories,
            "travels": self.loops[0],
            "forces": self.loops[1],
        }
