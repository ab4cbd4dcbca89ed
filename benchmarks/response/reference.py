"""One degree of freedom with a damper, by scipy's solve_ivp: computed a second way."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.special import expit

Array = NDArray[np.float64]
RTOL = 1e-9


class Oscillator:
    """m ẍ + c ẋ + k x + F − F(0) = −m a_g, with a damper that has inner states."""

    def __init__(self, mass: float, damping: float, stiffness: float, step: float, ground: Array):
        self.mass, self.damping, self.stiffness = mass, damping, stiffness
        self.step, self.ground = step, ground

    def acceleration(self, t: float, x: float, v: float, force: float) -> float:
        """ẍ, in/s²."""
        place = min(max(t / self.step, 0.0), len(self.ground) - 1.0)
        i = min(int(place), len(self.ground) - 2)
        a = self.ground[i] + (place - i) * (self.ground[i + 1] - self.ground[i])
        return -a - (self.damping * v + self.stiffness * x + force) / self.mass

    @property
    def end(self) -> float:
        """Time of the last sample, s."""
        return self.step * (len(self.ground) - 1)


def bouc_wen(o: Oscillator, row: Array) -> tuple[float, float]:
    """Largest travel and force of Bouc-Wen hysteresis, in and kip."""
    k, alpha, fwd, bwd, beta, n, c = row

    def force(x: Array, v: Array, z: Array) -> Array:
        return np.asarray(alpha * k * x + (1 - alpha) * z + c * v)

    def flow(t: float, y: Array) -> list[float]:
        x, v, z = y
        strength = fwd if v >= 0 else bwd
        grown = abs(z / strength) ** n * (1 - beta + beta * np.sign(z * v))
        return [v, o.acceleration(t, x, v, force(x, v, z)), k * v * (1 - grown)]

    return _peaks(_solved(flow, o, np.zeros(3)), force)


def backlash(o: Oscillator, row: Array, start: float) -> tuple[float, float]:
    """Largest travel and force of LuGre friction with a backlash spring, in and kip."""
    kf, kb, gap, ell, k0, fwd, bwd, n, s2, ef, eb, vs = row

    def spring(z: Array) -> Array:
        up, down = np.logaddexp(0, (z - gap / 2) / ell), np.logaddexp(0, -(z + gap / 2) / ell)
        return np.asarray(kf * ell * up - kb * ell * down + k0 * z)

    def force(x: Array, v: Array, z: Array) -> Array:
        return spring(z) + s2 * v

    begin = -gap / 2 - bwd / kb + start * (gap + bwd / kb + fwd / kf)
    rest = float(spring(np.array(begin)))

    def flow(t: float, y: Array) -> list[float]:
        x, v, z = y
        g = float(spring(z))
        slip = (fwd if g > 0 else bwd) * (1 + (ef if g > 0 else eb) * np.exp(-((v / vs) ** 2)))
        rate = v * (1 - 0.5 * (1 + np.sign(v * g)) * abs(g / slip) ** n)
        return [v, o.acceleration(t, x, v, g + s2 * v - rest), rate]

    return _peaks(_solved(flow, o, np.array([0.0, 0.0, begin])), force)


def lugre(o: Oscillator, row: Array) -> tuple[float, float]:
    """Largest travel and force of LuGre friction, in and kip."""
    flow, force = _bristles(o, row)
    return _peaks(_solved(flow, o, np.zeros(3)), force)


def _bristles(o: Oscillator, row: Array, change: Any = None, rest: float = 0.0) -> tuple[Any, Any]:
    s0, s1, s2, fs_f, fc_f, fs_b, fc_b, vs = row

    def rate(v: Array, z: Array) -> Array:
        forward = v >= 0
        fs, fc = np.where(forward, fs_f, fs_b), np.where(forward, fc_f, fc_b)
        g = fc + (fs - fc) * np.exp(-((v / vs) ** 2))
        return np.asarray(v - s0 * np.abs(v) * z / g)

    def force(x: Array, v: Array, z: Array) -> Array:
        slip = s0 * z + s1 * rate(v, z) + s2 * v
        return slip if change is None else change(x, slip)

    def flow(t: float, y: Array) -> list[float]:
        x, v, z = y
        pull = float(np.asarray(force(x, v, z)).ravel()[0]) - rest
        return [v, o.acceleration(t, x, v, pull), float(rate(v, z))]

    return flow, force


class Gap:
    """The gap of the three stages by the words of their rules: a play with memory of its side."""

    def __init__(self, row: Array, direction: float, start: float):
        self.k2, self.k3, self.d2 = row[7:10]
        self.width, self.ell = row[9] + row[10], row[12] / row[11]
        self.side, self.carry = direction, 0.0
        self.edge = -(start if direction > 0 else 1.0 - start) * self.width

    def force(self, x: Array, slip: Array) -> Array:
        """Force of the three stages, blended in turn, where that of slip is known; kip."""
        u = self.side * (x - self.edge - (self.width if self.side < 0 else 0.0))
        found = slip
        for share, stage in (
            (np.tanh(0.5 * np.maximum(u, 0.0) / self.ell), self.side * self.k2 * u),
            (
                expit((u - self.d2) / self.ell),
                self.side * (self.k2 * self.d2 + self.k3 * (u - self.d2)),
            ),
            (expit((u - self.width) / self.ell), slip),
        ):
            found = (1.0 - share) * found + share * stage
        return found + self.carry * (1.0 - np.tanh(0.5 * np.abs(u) / self.ell))

    def turn(self, x: float, direction: float, slip: float) -> None:
        """Turn at a place into a direction; what the force would jump by is carried on."""
        edge = min(max(self.edge, x - self.width), x)
        slipped = edge in (x, x - self.width)
        before = self.force(np.array(x), np.array(slip))
        self.edge = edge
        if slipped:
            self.side, self.carry = direction, 0.0
            self.carry = float(before - self.force(np.array(x), np.array(slip)))


def three_stage(o: Oscillator, row: Array, start: float) -> tuple[float, float]:
    """Largest travel and force of the three stages: from one turn of the motion to the next."""
    own = row[[0, 1, 2, 3, 4, 5, 6, 13]]
    direction = -1.0 if o.ground[np.flatnonzero(o.ground)[0]] > 0 else 1.0
    gap = Gap(row, direction, start)
    rest = float(gap.force(np.zeros(()), np.zeros(())))
    t, y, top = 0.0, np.zeros(3), [0.0, 0.0]
    while t < o.end - 1e-12:
        flow, force = _bristles(o, own, gap.force, rest)

        def turn(t: float, y: Array, way: float = direction) -> float:
            return float(way * y[1])

        turn.terminal, turn.direction = True, -1.0  # type: ignore[attr-defined]
        found = _solved(flow, o, y, t, turn)
        top = [max(a, b) for a, b in zip(top, _peaks(found, force), strict=True)]
        t, y = float(found.t[-1]), found.y[:, -1]
        direction = -direction
        gap.turn(float(y[0]), direction, float(own[0] * y[2]))  # at rest: no viscous force
        y = np.array([y[0], 1e-9 * direction, y[2]])
    return top[0], top[1]


def _solved(flow: Any, o: Oscillator, y: Array, begin: float = 0.0, event: Any = None) -> Any:
    return solve_ivp(
        flow,
        (begin, o.end),
        y,
        method="LSODA",
        rtol=RTOL,
        atol=1e-11,
        max_step=o.step,
        events=event,
    )


def _peaks(found: Any, force: Any) -> tuple[float, float]:
    x, v, z = found.y
    return float(np.max(np.abs(x))), float(np.max(np.abs(force(x, v, z))))
