"""What every model is: its quantities, the force of a record, and the force step by step."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from math import inf
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import FitError, MfdError, UnitError, real_number, real_numbers
from mfd_bayes.friction.quantities import LIMITS, QUANTITIES, Parameter, Quantity
from mfd_bayes.records.trace import Trace, check_trace, vertex_of_turn, vertices
from mfd_bayes.units import DAMPER, Axes, axis_of, convert, in_place_of

Array = NDArray[np.float64]

LAW_NAMES = ("proportional", "affine", "power", "compare")
"""Laws by which a parameter may follow the actuation."""


def named_columns(values: Mapping[str, ArrayLike], names: Iterable[str]) -> dict[str, Array]:
    """Some of the quantities that are given by name, as numbers."""
    if isinstance(values, type) or not hasattr(values, "keys"):
        kind = type(values).__name__
        raise FitError(f"values must be a mapping from names of quantities to numbers, got {kind}")
    required = tuple(names)
    if missing := [name for name in required if name not in values]:
        raise FitError(f"values by name lack {', '.join(missing)}")
    return {name: real_numbers(name, values[name], FitError) for name in required}


def named_vectors(values: Mapping[str, ArrayLike], names: Iterable[str]) -> dict[str, Array]:
    """As `named_columns`, each (n,), of the same n."""
    columns = named_columns(values, names)
    size = max((column.size for column in columns.values()), default=0)
    for name, column in columns.items():
        if column.shape != (size,):
            raise FitError(f"values of {name} must have shape ({size},), got {column.shape}")
    return columns


def columns_in_order(name: str, table: ArrayLike, names: tuple[str, ...]) -> Array:
    """Numbers of an array as they are; of a table with named columns those of `names`, (n, p)."""
    by_name: Any = table
    if not hasattr(table, "columns"):
        return real_numbers(name, table, FitError)
    if missing := [column for column in names if column not in by_name.columns]:
        raise FitError(
            f"{name} is a table, whose columns are taken by their names: it lacks "
            f"{', '.join(missing)}"
        )
    columns = [real_numbers(f"column {c} of {name}", by_name[c], FitError) for c in names]
    return np.column_stack(columns)


Columns = dict[str, Array]
Rows = NDArray[np.intp]
Scales = Mapping[str, ArrayLike] | None

PIECE = 1 << 15  # size of a piece's arrays, in numbers: they stay in the cache

REPEATED, ROWS = 1e-9, 1e-4
"""Shares of a force by which it may differ once more, and where other rows stand beside it."""
BESIDE, STEPPED = 1e-4, 0.05
"""A change of all parameters, and the least share of the forces that must change with it."""

_NONE: Mapping[str, str] = MappingProxyType({})
OTHERS = MappingProxyType({"in": "inch", "kip": "klbf"})
_FORCE = " force"  # where the memory of a user's own model keeps it; no name of theirs begins so


class Model:
    r"""A force model. A user's own gives `name`, `parameters` and `force`; the rest has defaults.

        class Viscous(mb.Model):
            name = "viscous"
            parameters = (
                mb.Parameter("c", "kip", follows_actuation=True),
                mb.Parameter("alpha", symbol=r"\alpha"),
            )

            def force(self, theta, trace, scales):
                c, alpha = theta[:, :1] * scales["c"], theta[:, 1:]
                return c * np.sign(trace.velocity) * np.abs(trace.velocity) ** alpha

    `force` takes theta, (n, p), in the units of `parameters`, and a `Trace`, and gives (n, T) in
    the unit of `response`. Where it takes `scales` too, these are the factors of the parameters
    that follow the actuation, (n, T) or (1, T) each by name: without it, only a constant actuation
    can be computed. Where it takes `start`, that is the place in the gap at the first sample, (n,).

    To stand in a building it gives `start(theta)`, a dict of arrays (…, n), and
    `step(state, displacement, velocity, dt)`, which gives the force, (n,), and the new dict, and
    leaves the old one as it is; `scales` may be taken as well. The step to the first sample has
    dt = 0.

    Attributes
    ----------
    name : str
        In campaign files.
    parameters : tuple of Parameter
        Of a class; of an object, their names, which are theta's columns.
    motion, response : str
        What the model takes and gives, with units: "strain" and "stress, MPa" (see `axes.UNITS`
        for those that need no unit). `trace.displacement` holds the first, and `force` gives the
        second, in these units.
    rate_independent : bool
        Whether time does not matter: samples are then numbered, `trace.time` is their number.
    quantities : tuple of Quantity
        All that it knows by name. Those that are sampled are so in this order.
    positive : frozenset of str
        Parameters that must not be 0.
    has_gap : bool
        Whether `start`, the place in the gap at the first sample, matters.
    keeps_prior : tuple of str
        Sampled quantities that do not reach the force by themselves: they are not part of q.
    laws : mapping of str to str
        Sampled quantities that follow the actuation, and the law of each by default.
    laws_from : mapping of str to str
        Those among them whose law, where a campaign gives none, is that of another name.
    tied_laws : mapping of str to str
        Names whose law in a campaign must be that of one of `laws`, since they follow it.
    slip_forces : tuple of str
        Parameters that are the friction force in slip, forward and backward.
    source : str
        "file.py:Class" of a model that `models.find_model` has read from a file.
    """

    name: ClassVar[str]
    parameters: ClassVar[Any]
    motion: ClassVar[Any] = DAMPER.motion
    response: ClassVar[Any] = DAMPER.response
    rate_independent: ClassVar[bool] = False
    quantities: ClassVar[tuple[Quantity, ...]] = ()
    positive: ClassVar[frozenset[str]] = frozenset()
    has_gap: ClassVar[bool] = False
    nonidentifiable: ClassVar[tuple[str, ...]] = ()
    laws: ClassVar[Mapping[str, str]] = _NONE
    laws_from: ClassVar[Mapping[str, str]] = _NONE
    shared_laws: ClassVar[Mapping[str, str]] = _NONE
    slip_forces: ClassVar[tuple[str, ...]] = ()
    source: ClassVar[str] = ""

    own: ClassVar[Mapping[str, Callable[..., Any]]] = MappingProxyType({})
    """The `force`, `start` and `step` of a user's own class, which this class's own call."""

    def __init_subclass__(cls) -> None:
        """Read what the class declares; its `force`, `start` and `step` are called by ours."""
        super().__init_subclass__()
        namespace = dict(vars(cls))
        label = _where(cls)
        for key, default in (("motion", DAMPER.motion), ("response", DAMPER.response)):
            if key in namespace:
                try:
                    setattr(cls, key, axis_of(namespace[key], default))
                except UnitError as error:
                    raise FitError(f"{label}, {key}: {error}") from error
        if cls.motion.name == cls.response.name:
            raise FitError(f"{label}: motion and response are both {cls.motion.name!r}")
        if "quantities" in namespace:
            cls.parameters = namespace.get("parameters", tuple(q.name for q in cls.quantities))
        elif "parameters" in namespace and not isinstance(namespace["parameters"], property):
            _declare(cls, namespace["parameters"], label)
        functions: dict[str, Any] = {
            n: namespace[n] for n in ("force", "start", "step") if n in namespace
        }
        parent: type[Any] = cls.__mro__[1]
        ours = parent.compute_force is not Model.compute_force  # it has no functions of a user's
        if functions and (ours or not all(map(callable, functions.values()))):
            raise FitError(
                f"{label}: {next(iter(functions))} must be a function of a class on top of "
                "Model; one "
                f"on top of {parent.__name__} gives compute_force, begin, advance and total"
            )
        cls.own = {**cls.own, **functions}
        for name in functions:
            delattr(cls, name)

    @property
    def actuated(self) -> tuple[str, ...]:
        """Parameters that `scales` may hold: those that follow the actuation."""
        return (*self.laws, *self.shared_laws)

    @cached_property
    def standard_names(self) -> frozenset[str]:
        """Quantities that are those of the package's models: what a user's own calls so may differ.

        That `sigma0` is a stiffness or `d2` a part of the gap is known of these names alone.
        """
        return frozenset(q.name for q in self.quantities if QUANTITIES.get(q.name) is q)

    @property
    def axes(self) -> Axes:
        """What motion and response are, and whether time matters."""
        return Axes(self.motion, self.response, not self.rate_independent)

    @property
    def where(self) -> str:
        """The class and its file, for messages."""
        return _where(type(self))

    # --- a record

    def force(
        self,
        theta: ArrayLike,
        trace: Trace,
        start: ArrayLike | None = None,
        *,
        scales: Scales = None,
    ) -> Array:
        """Force of every parameter vector, (n, T), kip.

        Parameters
        ----------
        theta : (n, p)
            Columns as in `parameters`, internal units, at the trace's reference actuation.
        trace : Trace
        start : (n,) or scalar, 1, optional
            Travel in the gap at the first sample over the gap's width; ½ when left out.
        scales : mapping of (n, T) or (1, T), optional
            Factors along the record of the parameters that follow the actuation. When left
            out and the actuation varies, friction forces are in proportion to it.

        Raises
        ------
        FitError
            When a shape, a name or a value does not fit, or the force is too large for a number.
        """
        return self._finite("force", theta, trace, start, scales)

    def check_force(self, theta: Array, shifted: Array, trace: Trace) -> None:
        """Refuse a force that is no smooth function of one parameter vector alone.

        Parameters
        ----------
        theta : (n, p)
            Different vectors; that of the first must give finite numbers.
        shifted : (n, p)
            The same, a little changed.
        trace : Trace

        Raises
        ------
        FitError
            When the same vectors give another force once more, in another order or alone, or those
            beside them the same.
        """
        self.force(theta[:1], trace)

        def force(rows: Array) -> Array:
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                return self.force_unbounded(rows, trace)

        base, again = force(theta), force(theta)
        turned, single = (
            force(theta[::-1])[::-1],
            np.concatenate([force(row[None]) for row in theta]),
        )
        size = np.max(np.abs(base), axis=1, keepdims=True, where=np.isfinite(base), initial=0.0)
        state = "for the same parameters: it must not keep a state or draw random numbers"
        row = "every row of theta must be computed by itself"
        for result, share, wrong in (
            (again, REPEATED, state),
            (turned, ROWS, f"where the rows of theta stand in another order: {row}"),
            (single, ROWS, f"where a row of theta stands alone: {row}"),
            (force(theta), REPEATED, state),
        ):
            if not np.all(np.isclose(result, base, 0.0, share * size, equal_nan=True)):
                raise FitError(f"{self.where} gives another force {wrong}")
        ends = (f(base, axis=1, keepdims=True) for f in (np.min, np.max))
        interior = np.all([base != end for end in (0.0, *ends)], axis=0)  # a limit may be fixed
        masks = interior, base != 0.0, np.ones(base.shape, dtype=bool)
        telling = next(mask for mask in masks if mask.any())
        if np.mean((force(shifted) != base)[telling]) < STEPPED:
            raise FitError(
                f"{self.where} gives the same force for parameters that differ by "
                f"{BESIDE:.2%}: it must not round, or cast to whole numbers"
            )

    def force_unbounded(
        self, theta: ArrayLike, trace: Trace, start: ArrayLike | None = None, scales: Scales = None
    ) -> Array:
        """As `force`, but infinite or NaN where it is too large for a number: for densities."""
        return self._computed("force", theta, trace, start, scales)

    def travel(self, theta: ArrayLike, trace: Trace, start: ArrayLike | None = None) -> Array:
        """Travel since the last slip, or turn, of every parameter vector, (n, T), in."""
        return self._finite("travel", theta, trace, start, None)

    def end(
        self, theta: ArrayLike, trace: Trace, start: ArrayLike | None = None, scales: Scales = None
    ) -> Array:
        """Place in the gap at the last sample of every parameter vector, (n,), 1.

        0 is where the device slips backward, 1 where it slips forward: there it stays while it
        slips. Without a gap it is ½, which is without effect. `start_at` makes a `start` of it.
        """
        return self._finite("end", theta, trace, start, scales)

    def stages(
        self, theta: ArrayLike, trace: Trace, start: ArrayLike | None = None
    ) -> NDArray[np.int8] | None:
        """Stage of every parameter vector at each sample, (n, T); None without a gap.

        1 slip, 2 stick, 3 build-up, 4 in the gap, where the model tells it from stick.
        """
        return None

    def start_at(
        self,
        position: Array,
        trace: Trace,
        previous_theta: ArrayLike | None = None,
        theta: ArrayLike | None = None,
    ) -> Array:
        """`start` of a motion that begins at a place in the gap, as `end` has it, (n,), 1.

        `previous_theta` and `theta`, (n, p), are the parameters of the motion that ended there
        and of `trace`, which begins, where they differ.
        """
        return position

    def _computed(
        self, kind: str, theta: ArrayLike, trace: Trace, start: ArrayLike | None, scales: Scales
    ) -> Array:
        """The force, travel or end of every vector, (n, …)."""
        check_trace(trace, FitError)
        if not (trace.timed or self.rate_independent):
            raise FitError(
                f"the model {self.name} needs the time of each sample, and the trace has none"
            )
        c = self.columns(theta)
        n = next(iter(c.values())).size if c else len(np.atleast_2d(np.asarray(theta)))
        w0, factors = _start(start, n), {}
        if scales is not None:
            shapes = ((n, trace.samples), (1, trace.samples))
            factors = {k: f.T for k, f in _factors(scales, shapes, self.actuated).items()}
        elif trace.varying:
            level = np.asarray(trace.actuation)[:, None]
            factors = self.proportional(level, trace.reference_actuation)
        if n == 0:
            return np.empty(0 if kind == "end" else (0, trace.samples))
        values: Array = getattr(self, f"compute_{kind}")(c, trace, w0, factors)
        return values.T

    def _finite(self, kind: str, *args: Any) -> Array:
        """As `_computed`, if all of it is finite."""
        try:
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                values = self._computed(kind, *args)
        except (ArithmeticError, IndexError) as error:  # of a place that is not a number
            message = f"the {kind} is no finite number for these parameters"
            raise FitError(message) from error
        finite = np.isfinite(values)
        if not finite.all():
            vector = self.vectors(args[0])[np.argwhere(~finite)[0, 0]]
            listing = ", ".join(
                f"{n} = {v:.4g}" for n, v in zip(self.parameters, vector, strict=True)
            )
            of = f" of {self.where}" if self.own else ""
            raise FitError(f"the {kind}{of} is no finite number with {listing}")
        return values

    # --- what a model computes: columns (n,), place in the gap (n,), factors (T, n) or (T, 1)

    def compute_force(self, c: Columns, trace: Trace, start: Array, factors: Columns) -> Array:
        """Force along a record, (T, n), kip; of a user's own class, that of its `force`."""
        if "force" not in self.own:
            raise FitError(f"{self.where} has no force")
        theta = np.stack([c[name] for name in self.parameters], axis=1)
        scales = {name: factors.get(name, np.ones((1, 1))).T for name in self.actuated}
        options = {"start": start, "scales": scales}
        force = self._call("force", theta, trace, varies=bool(factors), **options)
        return self._checked("force", force, (start.size, trace.samples)).T

    def compute_travel(self, c: Columns, trace: Trace, start: Array, factors: Columns) -> Array:
        """Travel since the last turn along a record, (T, n), in."""
        path = trace.path
        turns = np.concatenate([path.displacement[:1], path.displacement[path.turning_points]])
        since_turn = np.abs(trace.displacement - turns[path.stretch])
        return np.broadcast_to(since_turn[:, None], (trace.samples, start.size))

    def compute_end(self, c: Columns, trace: Trace, start: Array, factors: Columns) -> Array:
        """Place in the gap at the last sample, (n,)."""
        if self.has_gap:
            raise FitError(f"the model {self.name} does not say where in its gap a motion ends")
        return np.full(start.size, 0.5)

    # --- quantities

    def theta(self, values: Mapping[str, Array]) -> Array:
        """Parameters in their order, (n, p), of values by name, (n,) each."""
        return np.stack(list(named_vectors(values, self.parameters).values()), axis=1)

    def composed(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Parameters that are computed from several of the sampled quantities."""
        return ()

    def gap(self, values: Mapping[str, Array]) -> Array | None:
        """Width of the gap, (n,), in, of values by name; None without a gap."""
        return None

    def slip_to_slip(self, values: Mapping[str, Array]) -> Array | None:
        """Travel from slip to slip, (n,), in: about what is read off a loop as its gap."""
        return self.gap(values)

    def unloaded(self, values: Mapping[str, Array]) -> tuple[Array, Array, Array] | None:
        """Part of the range of `start` in which a device bears little load; None: all of it.

        Its lower and upper end, and the length over which the load grows there, (n,), 1, each.
        """
        return None

    def vectors(self, theta: ArrayLike) -> Array:
        """Theta as numbers, (n, p); of a table with named columns, those of `parameters`."""
        values = columns_in_order("theta", theta, self.parameters)
        width = len(self.parameters)
        if values.ndim != 2 or values.shape[1] != width:
            raise FitError(
                f"theta must have shape (n, {width}) for {self.name}, got {values.shape}"
            )
        return values

    def columns(self, theta: ArrayLike) -> Columns:
        """Theta's columns by name, (n,) each, within the limits of their quantities."""
        values = np.array(self.vectors(theta).T, order="C")  # not the caller's
        columns = dict(zip(self.parameters, values, strict=True))
        limits = {quantity.name: (quantity.lower, quantity.upper) for quantity in self.quantities}
        ends = np.array([limits.get(name, LIMITS["real"]) for name in columns])
        zero = np.array([name in self.positive for name in columns])
        valid = (values >= ends[:, :1]) & (values <= ends[:, 1:]) & np.isfinite(values)
        valid &= ~(zero[:, None] & (values == 0.0))
        if not valid.all():
            row, vector = np.argwhere(~valid)[0]
            low, high = ends[row]
            span = f" and at least {low:g}" if np.isfinite(low) else ""
            span = f" and in [{low:g}, {high:g}]" if np.isfinite(high) else span
            span = " and positive" if zero[row] else span
            name, value = self.parameters[row], values[row, vector]
            raise FitError(f"parameter {name} must be finite{span}, got {value}")
        return columns

    def proportional(self, actuation: Array, reference: float | None) -> Columns:
        """Factors of the parameters that are in proportion to the actuation, by name.

        Those whose law is proportional follow it, and what is tied to them: one test cannot tell
        the slope of another law.
        """
        names = [n for n in self.actuated if self.laws.get(n, "proportional") == "proportional"]
        return dict.fromkeys(names, actuation / (reference or 1.0))

    # --- step by step

    def start(
        self,
        theta: ArrayLike,
        start: ArrayLike | None = None,
        *,
        direction: ArrayLike | None = None,
        reference_actuation: float | None = None,
    ) -> State:
        """State of every parameter vector before the first sample of a motion.

        Parameters
        ----------
        theta, start
            As in `force`.
        direction : int or (n,), optional
            +1 or -1, that of the first motion; by default that of the first velocity.
        reference_actuation : float, ksi or kip, optional
            Actuation to which theta belongs; by default that of the first step with one.

        Raises
        ------
        FitError
            When a shape or a value does not fit, or the model cannot be stepped in time.
        """
        if type(self).advance is Model.advance and "step" not in self.own:
            raise FitError(f"the model {self.name} has no step in time, which a building needs")
        constants, n = self.constants(self.columns(theta)), len(self.vectors(theta))
        memory = {"start": _start(start, n)}
        if direction is not None:
            way = np.asarray(direction)
            if way.dtype.kind not in "iuf" or way.shape not in ((), (n,)) or (abs(way) != 1).any():
                raise FitError(f"direction must be 1 or -1, got {direction}")
            memory["direction"] = np.broadcast_to(way.astype(np.float64), (n,))
        if reference_actuation is not None:
            reference_actuation = real_number(
                "reference_actuation", reference_actuation, FitError, (0.0, inf), exclusive=True
            )
        nowhere = np.full(n, np.nan)
        return State(self, constants, memory, nowhere, np.zeros(n), {}, reference_actuation)

    def step(
        self,
        state: State,
        displacement: float,
        velocity: float,
        dt: float,
        actuation: float | None = None,
        *,
        scales: Scales = None,
    ) -> tuple[Array, State]:
        """Force of every parameter vector at the next sample of one motion, and the state there.

        It equals `force` on the same samples, velocities and actuation if the trace has no
        reversal smaller than its hysteresis (`hysteresis=0` makes it so): while a reversal
        happens, it is not known whether it will stay that small.

        Parameters
        ----------
        state : State
            From `start` or the previous step; it is not changed and may be used again.
        displacement, velocity : float, in, in/s
        dt : float, s
            Time since the previous sample; any number at the first, where it does not matter.
        actuation : float, ksi or kip, optional
            Friction is proportional to it; when left out, theta is used unchanged. To get
            a record's `force`, give the record's `reference_actuation` to `start`.
        scales : mapping of (n,), (1,) or a number, optional
            Factors of the parameters that follow the actuation, used instead of it.

        Returns
        -------
        (n,), kip, and the new state

        Raises
        ------
        FitError
            When a number is not finite, dt not positive, the actuation negative, or a name
            or a value in `scales` does not fit.
        """
        if not (isinstance(state, State) and state.model == self):
            kind = type(state).__name__
            raise FitError(
                f"state must come from start or step of {self.name}; this {kind} does not"
            )
        n = state.displacement.size
        x = np.full(n, real_number("displacement of a step", displacement, FitError))
        v = np.full(n, real_number("velocity of a step", velocity, FitError))
        dt = real_number("dt of a step", dt, FitError, (0.0, inf), exclusive=state.begun)
        factors: Columns = {}
        if actuation is not None:
            level = real_number("actuation of a step", actuation, FitError, (0.0, inf))
            state = replace(state, reference=state.reference or level or None)
            if level != state.reference:
                factors = self.proportional(np.full(n, level), state.reference)
        if scales is not None:
            checked = _factors(scales, ((), (1,), (n,)), self.actuated)
            factors = {name: np.broadcast_to(f, (n,)).copy() for name, f in checked.items()}
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            state = state.step(x, v, dt, factors)
            return state.force, state

    # --- what a model computes of a step; all arrays have the n dampers as their last axis

    def constants(self, c: Columns) -> dict[str, Any]:
        """What theta's columns give: `State.constants`."""
        return dict(c)

    def begin(self, state: State, start: Array, direction: Array | None) -> Columns:
        """Memory of the dampers of a state at its first sample.

        `start` is their place in the gap, (n,), and `direction` ±1, (n,), where that is known.
        """
        theta = np.stack([state.constants[name] for name in self.parameters], axis=1)
        memory = self._call("start", theta) if "start" in self.own else {}
        state = replace(state, memory=self._memory(memory, start.size))
        dt = np.zeros(start.size)
        return self.advance(state, state.displacement, state.velocity, dt, state.scales)

    def advance(
        self, state: State, displacement: Array, velocity: Array, dt: Array, scales: Columns
    ) -> Columns:
        """Memory after a straight way of each damper to a sample, all (n,)."""
        n = displacement.size
        factors = {name: scales.get(name, np.ones(n)) for name in self.actuated}
        memory = {name: value for name, value in state.memory.items() if name != _FORCE}
        args = memory, displacement, velocity, dt
        answer = self._call("step", *args, varies=bool(scales), scales=factors)
        if not (isinstance(answer, tuple) and len(answer) == 2):
            raise FitError(f"the step of {self.where} must give the force and the new state")
        return self._memory(answer[1], n) | {_FORCE: self._checked("step", answer[0], (n,))}

    def total(self, state: State) -> Array:
        """Force of each damper of a state, (n,), kip."""
        return state.memory[_FORCE]

    # --- a user's own class

    def _call(self, name: str, *args: Any, varies: bool = False, **options: Any) -> Any:
        """What a function of a user's own class gives, with the options that it takes."""
        function = self.own[name]
        if varies and not _takes(function, "scales"):
            raise FitError(
                f"the actuation changes, and the {name} of {self.where} does not take scales, the "
                f"factors of {', '.join(self.actuated)}"
            )
        accepted = {key: value for key, value in options.items() if _takes(function, key)}
        try:
            return function(self, *args, **accepted)
        except MfdError:
            raise
        except (Exception, SystemExit) as error:  # nor may it end the command in silence
            kind = type(error).__name__
            raise FitError(f"the {name} of {self.where} failed with {kind}: {error}") from error

    def _checked(self, name: str, values: Any, shape: tuple[int, ...]) -> Array:
        """Numbers of a shape that a function of a user's own class has given."""
        numbers = real_numbers(f"the {name} of {self.where}", values, FitError)
        if (kind := np.asarray(values).dtype).kind in "biu":
            raise FitError(
                f"the {name} of {self.where} must give floats, got values of type {kind}"
            )
        if numbers.shape != shape:
            raise FitError(
                f"the {name} of {self.where} must give an array of shape {shape}, one force for "
                f"each vector{' and sample' * (len(shape) - 1)}; got {numbers.shape}"
            )
        return numbers

    def _memory(self, memory: Any, n: int) -> Columns:
        """State of a user's own class, a dict of (…, n)."""
        if not isinstance(memory, Mapping):
            raise FitError(f"the state of {self.where} must be a dict of arrays (…, {n})")
        checked = {}
        for key, values in memory.items():
            label = f"{key} in the state of {self.where}"
            checked[str(key)] = numbers = real_numbers(label, values, FitError).view()
            numbers.flags.writeable = False  # a step leaves the old state as it is
            if numbers.shape[-1:] != (n,):
                raise FitError(
                    f"{label} must have {n} values on its last axis, one for each damper; got the "
                    f"shape {numbers.shape}"
                )
        return checked


@dataclass(frozen=True, eq=False)
class State:
    """n dampers at a sample of their motions; a step makes a new state and leaves this one.

    Attributes
    ----------
    model : Model
    constants : dict
        What theta gives, by name: arrays whose last axis is the dampers, and what all share.
    memory : dict of (..., n)
        What the dampers remember between two samples.
    displacement, velocity : (n,), in, in/s
        At the sample; displacements are NaN before the first.
    scales : dict of (n,)
        Factors at the sample of the parameters that follow the actuation; 1 where there is none.
    reference : float, ksi or kip, or None
        Actuation that theta belongs to.
    """

    model: Model
    constants: dict[str, Any]
    memory: Columns
    displacement: Array
    velocity: Array
    scales: Columns
    reference: float | None = None

    @cached_property
    def force(self) -> Array:
        """Force of each damper, (n,), kip."""
        return self.model.total(self)

    @property
    def begun(self) -> bool:
        """Whether there was a sample."""
        return not np.isnan(self.displacement[:1]).all()

    def step(
        self,
        displacement: Array,
        velocity: Array,
        dt: float,
        scales: Mapping[str, Array] | None = None,
    ) -> Self:
        """State at the next sample of each damper's motion; all arguments but dt are (n,).

        A motion that turns before the sample goes there through its vertex, as in `Trace.path`.
        This state may be stepped again: that is what equilibrium iterations do.
        `scales` has the factors of the parameters that follow the actuation, (n,).
        """
        later = dict(scales or {})
        if not self.begun:
            initial = replace(self, displacement=displacement, velocity=velocity, scales=later)
            start, direction = self.memory["start"], self.memory.get("direction")
            return replace(initial, memory=self.model.begin(initial, start, direction))
        state, remaining = self, np.full(displacement.size, dt)
        (rows,) = (self.velocity * velocity < 0).nonzero()
        if rows.size:
            ends = self.displacement[rows], displacement[rows]
            share, vertex, regular = vertex_of_turn(dt, *ends, self.velocity[rows], velocity[rows])
            rows, share, vertex = rows[regular], share[regular], vertex[regular]
        if rows.size:
            turning = self.chosen(rows)
            vertex_scales = {
                name: np.where(share < 0.5, turning.scales.get(name, 1.0), factor[rows])
                for name, factor in later.items()
            }
            turning = turning._moved(vertex, np.zeros(rows.size), share * dt, vertex_scales)
            state = self.replaced(rows, turning)
            remaining[rows] *= 1.0 - share
        return state._moved(displacement, velocity, remaining, later)

    def _moved(self, displacement: Array, velocity: Array, dt: Array, scales: Columns) -> Self:
        """State after a straight way of each damper, in its own time, (n,) s."""
        memory = self.model.advance(self, displacement, velocity, dt, scales)
        return replace(
            self, memory=memory, displacement=displacement, velocity=velocity, scales=scales
        )

    def chosen(self, rows: Rows) -> Self:
        """The state of some of the dampers."""

        def of(arrays: Mapping[str, Any]) -> dict[str, Any]:
            return {k: v[..., rows] if isinstance(v, np.ndarray) else v for k, v in arrays.items()}

        motion = self.displacement[rows], self.velocity[rows]
        fields = of(self.constants), of(self.memory), *motion, of(self.scales)
        return type(self)(self.model, *fields, self.reference)

    def replaced(self, rows: Rows, subset: Self) -> Self:
        """The same with the state of some of the dampers replaced, after the same samples.

        That is how only those are stepped again that are not in equilibrium yet.
        """

        def with_rows(array: Array, values: Array | float) -> Array:
            array = array.copy()
            array[..., rows] = values
            return array

        ones = np.ones(self.displacement.size)
        return replace(
            self,
            memory={k: with_rows(v, subset.memory[k]) for k, v in self.memory.items()},
            displacement=with_rows(self.displacement, subset.displacement),
            velocity=with_rows(self.velocity, subset.velocity),
            scales={
                k: with_rows(self.scales.get(k, ones), subset.scales.get(k, 1.0))
                for k in {**self.scales, **subset.scales}
            },
        )


# --- what a class declares


def _where(cls: type) -> str:
    """A class and its file, for messages: "class Viscous of my_damper.py"."""
    try:
        return f"class {cls.__name__} of {Path(inspect.getfile(cls)).name}"
    except (OSError, TypeError):  # of a notebook
        return f"class {cls.__name__}"


def _declare(cls: type[Model], declared: Any, label: str) -> None:
    """Turn a class's parameters into quantities, laws and names."""
    listed = isinstance(declared, Sequence) and not isinstance(declared, str)
    if not (listed and declared and all(isinstance(p, Parameter) for p in declared)):
        raise FitError(
            f"{label}: parameters must be a tuple of Parameter, such as "
            f"(Parameter('k', 'kip/in'),), got {declared!r:.60}"
        )
    names = tuple(parameter.name for parameter in declared)
    for p in declared:
        word = isinstance(p.name, str) and re.fullmatch(r"[A-Za-z]\w*", p.name)
        if not word:
            wrong = "the name must be a word of letters, digits and _"
        elif p.name in ("start", "offset") or p.name.startswith("noise_"):
            wrong = "the name is that of a quantity of every record"
        elif p.prior not in LIMITS:
            wrong = f"prior must be {' or '.join(LIMITS)}, got {p.prior!r:.60}"
        elif p.law not in ("", *LAW_NAMES):
            wrong = f"follows_actuation must be True, False or one of {', '.join(LAW_NAMES)}"
            wrong += f", got {p.law!r:.60}"
        else:
            wrong = f"there are two parameters {p.name!r}" if names.count(p.name) > 1 else ""
        try:
            convert(p.unit, p.unit)
        except UnitError as error:
            wrong = wrong or str(error)
        if wrong:
            raise FitError(f"{label}, parameter {p.name!r}: {wrong}")
    cls.parameters, cls.quantities = names, tuple(parameter.quantity for parameter in declared)
    if not Axes(cls.motion, cls.response).of_damper:
        # "in" and "kip" would be those of motion and response
        cls.quantities = tuple(
            replace(q, kind=q.kind if (unit := in_place_of(q.unit, OTHERS)) == q.unit else unit)
            for q in cls.quantities
        )
    cls.laws = {parameter.name: parameter.law for parameter in declared if parameter.law}


@cache
def _takes(function: Callable[..., Any], name: str) -> bool:
    """Whether a function takes an argument of that name."""
    parameters = inspect.signature(function).parameters
    return name in parameters or any(p.kind is p.VAR_KEYWORD for p in parameters.values())


# --- arguments


def _start(start: ArrayLike | None, n: int) -> Array:
    """Place in the gap at the first sample, (n,), checked; its middle where none is given."""
    if start is None:
        return np.full(n, 0.5)
    w0 = real_numbers("start", start, FitError)
    if w0.shape not in ((), (n,)) or not np.all((w0 >= 0) & (w0 <= 1)):
        raise FitError(f"start must be a fraction of the gap in [0, 1] with shape ({n},)")
    return np.broadcast_to(w0, (n,)).copy()  # a state must not change with the caller's array


def _factors(scales: Any, shapes: tuple[tuple[int, ...], ...], names: tuple[str, ...]) -> Columns:
    """Factors by name, checked: names, shapes, and that they are finite and not negative."""
    if not isinstance(scales, Mapping):
        kind = type(scales).__name__
        raise FitError(f"scales must be a mapping from names of parameters to factors, got {kind}")
    factors = {}
    for name, values in scales.items():
        factor = factors[name] = real_numbers(f"scales of {name}", values, FitError)
        if name not in names or factor.shape not in shapes:
            expected = " or ".join(map(str, shapes))
            raise FitError(
                f"scales may hold {' and '.join(names)} with shape {expected}, "
                f"got {name} with {factor.shape}"
            )
        if not np.all(np.isfinite(factor) & (factor >= 0)):
            raise FitError(f"scales of {name} must be finite and not negative")
    return factors


def through_vertices(trace: Trace) -> tuple[Array, Array, Rows, Rows]:
    """Motion of a trace with the vertex of every turn, however small: no hysteresis matters.

    Time, s, and displacement, in, (P,); the sample of the trace at or beside each, (P,); and which
    of them are the trace's, (T,).
    """
    t, x, samples = trace.time, trace.displacement, np.arange(trace.samples)
    index, share, vertex = vertices(t, x, trace.velocity)
    position = index + 1
    return (
        np.insert(t, position, t[index] + share * (t[position] - t[index])),
        np.insert(x, position, vertex),
        np.insert(samples, position, np.where(share < 0.5, index, position)),
        samples + np.searchsorted(position, samples, side="right"),
    )
