"""Time integration of a building with dampers."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from mfd_bayes.applications.buildings.building import Building
from mfd_bayes.applications.buildings.dampers import (
    Dampers,
    ElastoPlastic,
    no_dampers,
    plain_friction,
)
from mfd_bayes.applications.buildings.response import (
    PER_DRAW,
    PER_GROUND,
    Array,
    Response,
    combined,
)
from mfd_bayes.jobs.job import JobState, Outcome, Step, Workplace
from mfd_bayes.jobs.local import run_jobs

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from mfd_bayes.applications.buildings.ground import Ground

Rows = NDArray[np.intp]


# --- integration: what is kept of histories, and the steps

LONGEST = 0.02  # longest step, s
HALVINGS = 6  # most halvings of a step
CLOSE = 1e-4  # A force is in equilibrium when it is answered within this share of the slip force
NEWTON = 3  # iterations by Newton's method alone; from then on each force is held in a bracket
ITERATIONS = (8, 30)
"""Most iterations of a step; one that needs more is halved. Of the shortest step: more."""

JUMP = 30.0
"""Width, in tolerances, at which a bracket has closed on a jump: the force is in equilibrium."""

EASY = 1 / 8  # share of the largest bend below which the next step is twice as long
RUNAWAY = 1e5  # travel, in, beyond which a draw diverged
TOLERANCE = 0.01  # largest estimated error of a draw's drift, relative
ROUNDS = 2  # most times that a draw is computed again with shorter steps
KEPT = 8  # draws of each block whose dampers' histories are kept
BEND = 2.0  # largest bend of the forces at first (see `integrate`), over the tolerance
LARGEST_BEND = 0.1
SHARPER = 0.25  # share of this for the draws that are computed again
ROWS = 1500  # dampers of a block of draws: enough for numpy to be quick, few enough for the cache
BOOLE = np.array([7.0, 32.0, 12.0, 32.0, 7.0]) / 90.0  # weights of Boole's rule


@dataclass(frozen=True, eq=False)
class Devices:
    """All devices of n buildings after a step: m dampers, then s storeys that yield."""

    # states of n devices for each column of the slice: of the dampers, of what their model
    # leaves over, and of storeys
    states: tuple[tuple[Any, slice], ...]
    force: Array  # (n, m + s), kip
    times: Array | None
    scales: Mapping[str, Array]

    @classmethod
    def at_rest(cls, building: Building, dampers: Dampers, way: Array) -> Devices:
        """Devices at rest, the dampers about to move in the directions of the signs of `way`."""
        n, m, strong = dampers.draws, dampers.count, np.isfinite(building.yields)
        states = [(dampers.state(np.where(way < 0, -1.0, 1.0)), slice(0, m))]
        if dampers.leftover is not None:
            states.append((dampers.leftover, slice(0, m)))
        if strong.any():
            stiffness, strength = (
                np.tile(values[strong], n) for values in (building.storeys, building.yields)
            )
            yielding = ElastoPlastic.at_rest(stiffness, strength, elastic=stiffness)
            states.append((yielding, slice(m, m + int(strong.sum()))))
        zero = np.zeros((n, m + int(strong.sum())))
        return cls((), zero, dampers.times, dampers.scales)._with(states)

    def _with(self, states: Sequence[tuple[Any, slice]]) -> Devices:
        force = np.zeros(self.force.shape)
        for state, columns in states:
            force[:, columns] += state.force.reshape(len(force), -1)
        return Devices(tuple(states), force, self.times, self.scales)

    def step(self, travel: Array, velocity: Array, size: float, time: float) -> Devices:
        """Devices after a step to `time`, from travels and velocities (n, m + s)."""
        scales, states = None, []
        if self.times is not None:
            position = float(np.interp(time, self.times, np.arange(self.times.size)))
            index = min(int(position), self.times.size - 2)
            share = position - index
            scales = {
                name: ((1.0 - share) * s[..., index] + share * s[..., index + 1]).ravel()
                for name, s in self.scales.items()
            }
        for state, columns in self.states:
            x, v = travel[:, columns].ravel(), velocity[:, columns].ravel()
            states.append((state.step(x, v, size, scales) if x.size else state, columns))
            scales = None  # the dampers come first
        return self._with(states)

    def chosen(self, rows: Rows) -> Devices:
        """The devices of some buildings."""
        states = [(state.chosen(_flat(rows, columns)), columns) for state, columns in self.states]
        scales = {name: column[rows] for name, column in self.scales.items()}
        return Devices(tuple(states), self.force[rows], self.times, scales)

    def replaced(self, rows: Rows, replacement: Devices) -> Devices:
        """The devices with the state of those of some buildings replaced."""
        pairs = zip(self.states, replacement.states, strict=True)
        return self._with(
            [
                (state.replaced(_flat(rows, columns), update), columns)
                for (state, columns), (update, _) in pairs
            ]
        )


def _flat(rows: Rows, columns: slice) -> Rows:
    """Places in a state of the devices of some buildings that have these columns."""
    width = columns.stop - columns.start
    return np.asarray((rows[:, None] * width + np.arange(width)).ravel())


@dataclass(frozen=True, eq=False)
class Propagator:
    """What a linear building with devices does in a step: exact, by matrix exponentials.

    A row (x, v, f at the begin) times `free`, plus the ground's acceleration at both ends times
    `shaken`, plus (f at the end, bump) times `forced`, is the row

        x, v after ¼, ½, ¾ and the whole step; travel, v of the devices after ½; and after 1

    where forces are those beyond the ones at rest, f(s) = (1 − s) f₀ + s f₁ + 4 s (1 − s) bump, and
    travels are less what a brace takes. From the exponential of the matrix that is augmented by the
    loads' powers of time (Van Loan, 1978).
    """

    size: float  # s
    # (2N + m, 8N + 4m), (2, 8N + 4m), (2m, 8N + 4m)
    free: Array
    shaken: Array
    forced: Array

    @classmethod
    def of(cls, building: Building, places: Array, brace: Array, size: float) -> Propagator:
        """Step of `size` seconds, with devices at places (m, N) and braces (m,), in/kip."""
        n, m = building.freedoms, len(places)
        inverse = linalg.inv(building.mass)
        generator = np.zeros((2 * n + 3 * (1 + m),) * 2)
        generator[:n, n : 2 * n] = np.eye(n)
        generator[n : 2 * n, :n] = -inverse @ building.stiffness
        generator[n : 2 * n, n : 2 * n] = -inverse @ building.damping
        generator[n : 2 * n, 2 * n] = -building.influence
        generator[n : 2 * n, 2 * n + 1 : 2 * n + 1 + m] = -inverse @ places.T
        generator[: 2 * n] *= size / 4.0
        generator[2 * n : 2 * n + 2 * (1 + m), 2 * n + 1 + m :] = np.eye(2 * (1 + m)) / 4.0
        quarter = linalg.expm(generator)
        columns, power = [], np.eye(len(generator))
        for _ in range(4):  # the load's powers of time go on from quarter to quarter
            power = quarter @ power
            columns.append(power[: 2 * n].T)
        solution = np.concatenate(columns, axis=1)
        constant, linear, square = np.split(solution[2 * n :], 3)  # answers to loads 1, s and s²/2
        decreasing, bump = constant - linear, 4.0 * linear - 8.0 * square
        transition = np.concatenate([solution[: 2 * n], decreasing[1:]])
        shaken = np.array([decreasing[0], linear[0]])
        forced = np.concatenate([linear[1:], bump[1:]])
        travels = np.kron(np.eye(4), places.T)
        transition, shaken, forced = (
            np.concatenate([a, a[:, np.r_[2 * n : 4 * n, 6 * n : 8 * n]] @ travels], axis=1)
            for a in (transition, shaken, forced)
        )
        loss, rate, zero = np.diag(brace), np.diag(brace) / size, np.zeros((m, m))
        transition[2 * n :, 8 * n :] -= np.concatenate([0.5 * loss, -rate, zero, -rate], axis=1)
        forced[:m, 8 * n :] -= np.concatenate([0.5 * loss, rate, loss, rate], axis=1)
        forced[m:, 8 * n :] -= np.concatenate([loss, zero, zero, -4.0 * rate], axis=1)
        return cls(size, transition, shaken, forced)

    def inner(self, state: Array, shaking: Array, forces: Array) -> Array:
        """States after ¼, ½ and ¾ of the step, (3, r, 2N).

        `state` is (r, 2N), `shaking` (2,), and `forces` are (3, r, m), kip: at the begin,
        in the middle and at the end.
        """
        begin, middle, end = forces
        width = 3 * state.shape[1]
        states = np.concatenate([state, begin], axis=1) @ self.free[:, :width]
        states += shaking @ self.shaken[:, :width]
        curve = np.concatenate([end, middle - 0.5 * (begin + end)], axis=1)
        states += curve @ self.forced[:, :width]
        return states.reshape(len(state), 3, -1).swapaxes(0, 1)


def equilibrium(
    devices: Devices,
    motion: Callable[[Array], tuple[Array, Array]],
    when: tuple[float, float],
    flexibility: Array,
    begin: tuple[Array, Array],
    tolerance: Array,
    max_iterations: int,
) -> tuple[Devices, Array, Array, NDArray[np.bool_]]:
    """Devices that answer their motion with the forces that cause it, by Newton's method.

    `motion` gives travel and velocity at the end of a step, (n, m) each, by the forces then; `when`
    is the length of the step and the time at its end, s; `flexibility` is the change of the travel
    of each device (row) by the force of each (column), (m, m), in/kip. It begins with forces and
    changes of each device's force by its travel, (n, m): a secant of the last step at first, of the
    last two iterations then; `tolerance` is (n, m), kip.

    Returned are the devices, their forces and those changes, (n, m) each, and which of the n
    buildings are in equilibrium, (n,).
    """
    (force, slope), diagonal, previous = begin, np.abs(flexibility.diagonal()), begin
    # −A is symmetric and positive. Where no slope is below this, the eigenvalues of I − K A are ½
    # or more, for any number of devices that share a travel: its solution is unique
    softest = -0.5 / np.abs(flexibility).sum(axis=1)
    low, high = np.full_like(force, -np.inf), np.full_like(force, np.inf)
    for iteration in range(max_iterations):
        travel, velocity = motion(force)
        trial = devices.step(travel, velocity, *when)
        residual = trial.force - force
        far = ~(np.abs(residual) <= tolerance)
        if iteration:
            way = travel - previous[0]
            usable = np.abs(way) > 0.1 * tolerance * diagonal
            secant = (trial.force - previous[1]) / np.where(usable, way, 1.0)
            usable &= np.isfinite(secant)
            slope = np.where(usable, np.clip(secant, softest, 1e4 / diagonal), slope)
        if not far.any():
            break
        previous = travel, trial.force
        proposal = force + _solved(slope, flexibility, residual)
        if iteration >= NEWTON:
            # the answer less the force falls with the force; a bracket is opened again where it
            # was passed as other devices moved
            positive, negative = residual > 0, residual < 0
            high = np.where(positive & (force >= high), np.inf, high)
            low = np.where(negative & (force <= low), -np.inf, low)
            low, high = (
                np.where(positive, np.maximum(low, force), low),
                np.where(negative, np.minimum(high, force), high),
            )
            far &= ~(high - low <= JUMP * tolerance)
            if not far.any():
                break
            proposal = np.where(
                far & ~((low < proposal) & (proposal < high)), 0.5 * (low + high), proposal
            )
        # a building in equilibrium stays as it is, whatever others do
        force = np.where(np.isfinite(proposal) & far.any(axis=1, keepdims=True), proposal, force)
    answered = np.abs(residual) <= tolerance
    return trial, np.where(answered, trial.force, force), slope, np.asarray(~far.any(axis=1))


def _solved(slope: Array, flexibility: Array, residual: Array) -> Array:
    """Solution d of (I − K A) d = off, with slopes K (n, m) and a flexibility A (m, m)."""
    system = np.eye(len(flexibility)) - slope[:, :, None] * flexibility
    return np.asarray(np.linalg.solve(system, residual[..., None])[..., 0])


class _Draws:
    """Draws of a building under one ground motion, each stepped as its forces bend; its record."""

    def __init__(
        self, building: Building, ground: Ground, dampers: Dampers, bend: float, count: int
    ) -> None:
        self.building, self.ground, self.dampers, self.bend = building, ground, dampers, bend
        strong = np.isfinite(building.yields)
        self.places = np.concatenate([building.travels, building.drifts[strong]])
        self.brace = np.zeros(len(self.places))
        self.brace[: len(building.devices)] = [1.0 / device.brace for device in building.devices]
        self.parts = max(1, int(np.ceil(ground.step / LONGEST - 1e-9)))
        # the sign of the first travel, as the building's own stiffness lets it sway
        sway = np.linalg.solve(building.stiffness, building.mass @ building.influence)
        way = -ground.acceleration[np.flatnonzero(ground.acceleration)[0]]
        self.devices = Devices.at_rest(building, dampers, way * (building.travels @ sway))
        self.rest = self.devices.force
        n, m = self.rest.shape
        yields = np.broadcast_to(building.yields[strong], (n, int(strong.sum())))
        self.scale = np.concatenate([dampers.slip, yields], axis=1)
        self.state, self.error = np.zeros((2, n, 2 * building.freedoms))
        self.slope, self.rate = np.zeros((2, n, m))
        self.level, self.deepest = np.zeros((2, n), dtype=np.intp)
        self.change, self.open = np.zeros((2, n))
        self.unstable = np.zeros(n, dtype=bool)
        self.steps: dict[int, Propagator] = {}
        # what is kept: peaks; work of the ground, of damping and of each device; residual drift
        storeys, devices, samples = len(building.drifts), len(building.devices), ground.time.size
        self.inverse = linalg.inv(building.mass)
        self.late = float(ground.time[-1] - 2.0 * building.modes.periods[0])
        widths = {"drift": storeys, "acceleration": building.freedoms, "base_shear": 1}
        widths |= dict.fromkeys(("peak_fwd", "peak_bwd", "speed", "travel"), devices)
        self.peaks = {name: np.zeros((n, width)) for name, width in widths.items()}
        self.work = np.zeros((n, 2 + m))
        self.residual, self.late_time = np.zeros((n, storeys)), np.zeros((n, 1))
        self.most_input, self.most_lost = np.zeros((2, n))
        self.histories = np.zeros((n, samples, storeys), dtype=np.float32)
        self.loops = np.zeros((2, min(count, n), samples, devices), dtype=np.float32)

    def advance(self, rows: Rows, begin: float, level: int) -> None:
        """Move draws by a step of a level, from `begin`, in samples; or by two of the next one."""
        finer = self.level[rows] > level
        ready, deeper = rows[~finer], rows[finer]
        if ready.size:
            late = ready[~self.step(ready, begin, level)]
            self.level[late] = level + 1
            deeper = np.sort(np.concatenate([deeper, late]))
        for half in (0.0, 0.5):
            deeper = deeper[~self.unstable[deeper]]
            if deeper.size:
                self.advance(deeper, begin + half / (self.parts * 2**level), level + 1)

    def step(self, rows: Rows, begin: float, level: int) -> NDArray[np.bool_]:
        """Move draws by one step of a level, unless forces bend too much in it: which, (r,)."""
        n, m = self.building.freedoms, len(self.places)
        size = self.ground.step / (self.parts * 2**level)
        if level not in self.steps:
            self.steps[level] = Propagator.of(self.building, self.places, self.brace, size)
        linear, k = self.steps[level], int(begin + 1e-9)
        low, high = self.ground.acceleration[k : k + 2].tolist()
        ends = np.array([begin, begin + size / self.ground.step])
        shaking, time = low + (ends - k) * (high - low), begin * self.ground.step
        is_full = rows.size == len(self.state)
        devices = self.devices if is_full else self.devices.chosen(rows)
        state, rest_force, scale = self.state[rows], self.rest[rows], self.scale[rows]
        f0, slope = devices.force - rest_force, self.slope[rows]
        unforced = np.concatenate([state, f0], axis=1) @ linear.free[:, 6 * n :]
        unforced += shaking @ linear.shaken[:, 6 * n :]
        forced, half, full = linear.forced[:, 6 * n :], 2 * n, 2 * n + 2 * m

        def motion(force: Array) -> tuple[Array, Array]:
            moved = unforced[:, full:] + (force - rest_force) @ forced[:m, full:]
            return moved[:, :m], moved[:, m:]

        final, force, slope, closed = equilibrium(
            *(devices, motion, (size, time + size), forced[:m, full : full + m].T),
            *((devices.force + size * self.rate[rows], slope), CLOSE * scale),
            ITERATIONS[level == HALVINGS],
        )
        f1 = force - rest_force
        moved = unforced[:, half:full] + f1 @ forced[:m, half:full]
        middle = devices.step(moved[:, :m], moved[:, m:], 0.5 * size, time + 0.5 * size)
        answer = middle.force - rest_force - 0.5 * (f0 + f1)
        # the bump itself takes from the travel in the middle: one iteration of Newton's
        bump = _solved(slope, forced[m:, half : half + m].T, answer)
        bump = np.clip(bump, np.minimum(answer, 0.0), np.maximum(answer, 0.0))
        curve = np.concatenate([f1, bump], axis=1)
        end = unforced[:, : 2 * n] + curve @ forced[:, : 2 * n]
        bent = np.max(np.abs(bump) / scale, axis=1, initial=0.0) * size / (LONGEST * self.bend)
        sound = (np.abs(end).max(axis=1) < RUNAWAY) & np.isfinite(f1).all(axis=1)
        mask = closed & (bent <= 1.0) & sound
        if level == HALVINGS:
            self.open[rows[~mask]] += size
            self.unstable[rows[~sound]] = True
            self.state[rows[~sound]] = 0.0
            mask = sound
        if not mask.any():
            return np.asarray(mask)
        moved_rows, error = rows[mask], self.error[rows] @ linear.free[: 2 * n, 6 * n : 8 * n]
        error += bump @ forced[m:, : 2 * n]
        drift_error = np.abs(error[:, :n] @ self.building.drifts.T).max(axis=1)
        for column, values in (
            (self.state, end),
            (self.error, error),
            (self.slope, slope),
            (self.rate, (f1 - f0) / size),
            (self.level, np.maximum(level - (bent < EASY), 0)),
            (self.deepest, np.maximum(self.deepest[rows], level)),
            (self.change, np.maximum(self.change[rows], drift_error)),
        ):
            column[moved_rows] = values[mask]
        forces = np.stack([f0, 0.5 * (f0 + f1) + bump, f1])[:, mask]
        inner = linear.inner(state[mask], shaking, forces)
        states = np.concatenate([state[None, mask], inner, end[None, mask]])
        self.record(moved_rows, time, size, shaking, states, forces)
        if is_full and mask.all():
            self.devices = final
        else:
            self.devices = self.devices.replaced(moved_rows, final.chosen(np.flatnonzero(mask)))
        return np.asarray(mask)

    def sample(self, k: int) -> None:
        """Keep the histories and the energy of all draws at a sample of the ground motion."""
        building, m, count = self.building, len(self.building.devices), len(self.loops[0])
        x, v = np.split(self.state, 2, axis=1)
        force, pulled = self.devices.force, self.devices.force - self.rest
        self.histories[:, k] = x @ building.drifts.T
        travels = x[:count] @ self.places[:m].T - (pulled * self.brace)[:count, :m]
        self.loops[:, :, k] = travels, force[:count, :m]
        # energy that is not accounted for, now
        stored = 0.5 * ((v @ building.mass) * v + (x @ building.stiffness) * x).sum(axis=1)
        lost = self.work[:, 0] - self.work[:, 1:].sum(axis=1) - stored
        self.most_lost = np.maximum(self.most_lost, np.abs(lost))
        self.most_input = np.maximum(self.most_input, np.abs(self.work[:, 0]))
        self.elastic = 0.5 * (self.brace * pulled**2)[:, :m]

    def record(
        self, rows: Rows, time: float, size: float, shaking: Array, state: Array, forces: Array
    ) -> None:
        """Keep what a step of some draws from `time` has of peaks, work and residual drift.

        `shaking` is the ground's acceleration at both ends, (2,), in/s²; `state` is (5, r, 2N), at
        the begin, after ¼, ½ and ¾, and at the end; `forces` are those of the devices beyond those
        at rest, (3, r, m), at the begin, in the middle and at the end. The devices do work against
        what they hold at rest, in which the building is in equilibrium.
        """
        building, n, m = self.building, self.building.freedoms, len(self.building.devices)
        (f0, half, f1), share = forces, np.linspace(0.0, 1.0, 5)[:, None, None]
        pulled = (1.0 - share) * f0 + share * f1
        pulled += 4.0 * share * (1.0 - share) * (half - 0.5 * (f0 + f1))
        x, v = state[..., :n], state[..., n:]
        weights = building.mass @ building.influence
        load = x @ building.stiffness + v @ building.damping + pulled @ self.places
        acceleration, drift = -load @ self.inverse, x @ building.drifts.T  # absolute
        pull = forces[..., :m] + self.rest[rows, :m]
        peaks = {
            "drift": drift,
            "acceleration": acceleration,
            "base_shear": (acceleration @ weights)[..., None],
            "peak_fwd": np.maximum(pull, 0.0),
            "peak_bwd": np.maximum(-pull, 0.0),
            "speed": v @ self.places[:m].T,
            "travel": x @ self.places[:m].T - pulled[..., :m] * self.brace[:m],
        }
        for name, values in peaks.items():
            self.peaks[name][rows] = np.maximum(self.peaks[name][rows], np.abs(values).max(axis=0))
        ground_acceleration = (1.0 - share[..., 0]) * shaking[0] + share[..., 0] * shaking[1]
        input_power = -ground_acceleration * (v @ weights)
        damped = ((v @ building.damping) * v).sum(axis=-1)
        power = np.concatenate(
            [input_power[..., None], damped[..., None], pulled * (v @ self.places.T)], axis=2
        )
        self.work[rows] += size * np.tensordot(BOOLE, power, axes=1)
        if time + size > self.late:
            self.residual[rows] += size * drift[2]
            self.late_time[rows] += size

    def response(self) -> Response:
        """What was found of the draws."""
        ground, devices = self.ground, len(self.building.devices)
        drift = self.peaks["drift"].max(axis=1)
        of_draws: dict[str, NDArray[Any]] = self.peaks | {
            "base_shear": self.peaks["base_shear"][:, 0],
            "energy": self.work[:, 2 : 2 + devices] - self.elastic,
            "residual": self.residual / np.maximum(self.late_time, 1e-300),
            "unstable": self.unstable,
            "open": self.open / ground.time[-1],
            "imbalance": self.most_lost / np.maximum(self.most_input, 1e-300),
            "change": self.change / np.maximum(drift, 1e-300),
            "steps": ground.step / self.parts / 2.0**self.deepest,
        }
        arrays: dict[str, Any] = {name: values[:, None] for name, values in of_draws.items()}
        arrays |= {"histories": (self.histories,), "travels": (self.loops[0],)}
        arrays |= {"forces": (self.loops[1],)}
        return Response(self.building, (ground,), self.dampers, **arrays)


def integrate(
    building: Building,
    ground: Ground,
    dampers: Dampers,
    bend: float,
    *,
    count: int = 0,
    tick: Callable[[float], object] = lambda share: None,
) -> Response:
    """Response of every draw to one ground motion.

    A step is halved where a device's force in its middle, off the mean of those at its ends, gives
    a larger impulse than the share `bend` of the slip force in the longest step. The histories of
    the dampers are kept of the first draws, `count` of them. `tick` is called with the share of the
    motion that is done.
    """
    draws, samples = _Draws(building, ground, dampers, bend, count), ground.time.size
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(samples):
            draws.sample(k)
            for substep in range(draws.parts if k < samples - 1 else 0):
                draws.advance(np.flatnonzero(~draws.unstable), k + substep / draws.parts, 0)
            if not k % 100:
                tick(k / samples)
    return draws.response()


# --- blocks of draws, here or in processes


def settle(
    building: Building,
    ground: Ground,
    dampers: Dampers,
    tolerance: float = TOLERANCE,
    *,
    rounds: int = ROUNDS,
    tick: Callable[[float], object] = lambda share: None,
) -> Response:
    """Response of every draw to one ground motion, at steps that suit each.

    A draw whose drift has an estimated relative error above the tolerance is computed again with
    shorter steps, at most so many `rounds`.
    """
    bend, count = min(BEND * tolerance, LARGEST_BEND), KEPT
    response = integrate(building, ground, dampers, bend, count=count, tick=tick)
    for _ in range(rounds):
        rows = np.flatnonzero((response.change > tolerance) & ~response.unstable)
        if not rows.size:
            break
        bend *= SHARPER
        count = int(np.searchsorted(rows, KEPT))
        fine = integrate(building, ground, dampers.chosen(rows), bend, count=count, tick=tick)
        for name in PER_DRAW:
            getattr(response, name)[rows] = getattr(fine, name)
        for name in PER_GROUND:
            (target,), (source,) = getattr(response, name), getattr(fine, name)
            target[rows[: len(source)]] = source
    return response


@dataclass(frozen=True, eq=False)
class Block:
    """Some draws of a building under one ground motion: work for one process."""

    id: str
    building: Building
    ground: Ground
    dampers: Dampers
    tolerance: float
    makes: tuple[str, ...] = ()

    def needs(self, folder: Path) -> tuple[str, ...]:
        """No files."""
        return ()

    def run(self, folder: Path, observe: Callable[[Step], Any]) -> Outcome:
        """Compute the response of its draws, the value of the outcome."""
        started = time.perf_counter()

        def tick(share: float) -> None:
            observe(Step(self.id, "in the earthquake", message=f"{share:.0%}" if share else ""))

        tick(0.0)
        response = settle(self.building, self.ground, self.dampers, self.tolerance, tick=tick)
        return Outcome(self.id, JobState.DONE, time.perf_counter() - started, value=response)


def response_of(
    building: Building,
    grounds: Sequence[Ground],
    dampers: Dampers,
    tolerance: float = TOLERANCE,
    bounds: Mapping[str, Dampers] = MappingProxyType({}),
    jobs: int = 1,
    observe: Callable[[Step], None] = lambda step: None,
) -> Response:
    """Response of every draw to every ground motion, and its `references`.

    `bounds` are the dampers of one more building each, such as "lower" and "upper". The result does
    not depend on the number of processes, `jobs` (0 for one per processor), for blocks do not.
    """
    size = max(10, ROWS // max(dampers.count, 1))
    rows = np.split(np.arange(dampers.draws), np.arange(size, dampers.draws, size))
    friction = plain_friction(np.median(dampers.slip, axis=0)) if dampers.count else no_dampers()
    references = {
        "bare": ("without dampers", building.bare(), no_dampers()),
        "plain": ("with plain friction", building, friction),
    } | {name: (f"all at the {name} bound", building, bound) for name, bound in bounds.items()}
    # the longest work first, so that no process waits for another at the end
    kinds = [(f"part {k}", building, dampers.chosen(r)) for k, r in enumerate(rows, 1)]
    kinds += references.values()
    blocks = [
        Block(f"ground motion {g}, {ground.name}, {name}", built, ground, group, tolerance)
        for name, built, group in kinds
        for g, ground in enumerate(grounds, 1)
    ]
    folder, processes = Path(), min(Workplace(jobs).processes, len(blocks))
    outcomes = (
        (block.run(folder, observe) for block in blocks)
        if processes == 1
        else run_jobs(blocks, folder, Workplace(processes), observe)
    )
    responses = {}
    for outcome in outcomes:
        observe(Step(outcome.id, outcome.status))
        responses[outcome.id] = outcome.value
    ordered = iter(responses[block.id] for block in blocks)
    by_kind = [[next(ordered) for _ in grounds] for _ in kinds]
    result = combined(by_kind[: len(rows)], dampers)
    single = {
        name: combined([row], row[0].dampers)
        for name, row in zip(references, by_kind[len(rows) :], strict=True)
    }
    return replace(result, references=single, tolerance=tolerance)
