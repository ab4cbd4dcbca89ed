"""What every friction model is: its quantities, and the force that they give."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import wraps
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.friction.columns import columns_in_order, named_vectors
from mfd_bayes.friction.quantity import Quantity
from mfd_bayes.records.motion import vertices
from mfd_bayes.records.numbers import real_numbers
from mfd_bayes.records.trace import Trace, check_trace

Array = NDArray[np.float64]
Columns = dict[str, Array]

_NONE: Mapping[str, str] = MappingProxyType({})


class Model:
    """A friction model. One of one's own gives `name`, `quantities` and `force`.

    Attributes
    ----------
    name : str
        In campaign files.
    quantities : tuple of Quantity
        All that it knows by name. Those that are sampled are so in this order.
    parameters : tuple of str
        Names of theta's columns; those of all quantities where not given.
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
    """

    name: ClassVar[str]
    quantities: ClassVar[tuple[Quantity, ...]]
    positive: ClassVar[frozenset[str]] = frozenset()
    has_gap: ClassVar[bool] = False
    keeps_prior: ClassVar[tuple[str, ...]] = ()
    laws: ClassVar[Mapping[str, str]] = _NONE
    laws_from: ClassVar[Mapping[str, str]] = _NONE
    tied_laws: ClassVar[Mapping[str, str]] = _NONE
    slip_forces: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls) -> None:
        """Let what every model computes of a trace take empty batches, and give numbers alone."""
        super().__init_subclass__()
        for name in ("force", "travel", "end"):
            if name in cls.__dict__:
                setattr(cls, name, _checked(cls.__dict__[name]))

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of theta's columns."""
        return tuple(quantity.name for quantity in self.quantities)

    @property
    def actuated(self) -> tuple[str, ...]:
        """Parameters that `scales` may hold: those that follow the actuation."""
        return (*self.laws, *self.tied_laws)

    def force(
        self,
        theta: ArrayLike,
        trace: Trace,
        start: ArrayLike | None = None,
        *,
        scales: Mapping[str, Array] | None = None,
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
        raise NotImplementedError

    def force_unbounded(
        self,
        theta: ArrayLike,
        trace: Trace,
        start: ArrayLike | None = None,
        *,
        scales: Mapping[str, Array] | None = None,
    ) -> Array:
        """As `force`, but infinite or NaN where it is too large for a number: for densities."""
        own = getattr(type(self).force, "__wrapped__", type(self).force)
        found: Array = own(self, theta, trace, start, scales=scales)
        return found

    def travel(self, theta: ArrayLike, trace: Trace, start: ArrayLike | None = None) -> Array:
        """Travel since the last slip, or turn, of every parameter vector, (n, T), in."""
        check_trace("trace", trace, FitError)
        n = _count(self.columns(theta))
        check_start(start, n)
        path = trace.path
        turns = np.concatenate([path.displacement[:1], path.displacement[path.turning_points]])
        since_turn = np.abs(trace.displacement - turns[path.stretch])
        return np.broadcast_to(since_turn, (n, trace.samples))

    def end(
        self,
        theta: ArrayLike,
        trace: Trace,
        start: ArrayLike | None = None,
        *,
        scales: Mapping[str, Array] | None = None,
    ) -> Array:
        """Place in the gap at the last sample of every parameter vector, (n,), 1.

        0 is where the device slips backward, 1 where it slips forward: there it stays while it
        slips. Without a gap it is ½, which is without effect. `start_at` makes a `start` of it.

        Parameters
        ----------
        theta, trace, start, scales
            As in `force`.

        Raises
        ------
        FitError
            When a shape or a value does not fit, or the model has a gap and does not say this.
        """
        if self.has_gap:
            raise FitError(f"the model {self.name} does not say where in its gap a motion ends")
        check_trace("trace", trace, FitError)
        n = _count(self.columns(theta))
        check_start(start, n)
        self.factors(trace, n, scales)
        return np.full(n, 0.5)

    def start_at(
        self,
        place: Array,
        trace: Trace,
        before: ArrayLike | None = None,
        theta: ArrayLike | None = None,
    ) -> Array:
        """`start` of a motion that begins at a place in the gap, as `end` has it, (n,), 1.

        Parameters
        ----------
        place : (n,), 1
        trace : Trace
            The motion that begins there.
        before, theta : (n, p), optional
            Parameters of the motion that ended there, and of the one that begins, where they
            differ.
        """
        return place

    def stages(
        self, theta: ArrayLike, trace: Trace, start: ArrayLike | None = None
    ) -> NDArray[np.int8] | None:
        """Stage of every parameter vector at each sample, (n, T); None without a gap.

        1 slip, 2 stick, 3 build-up, 4 in the gap, where the model tells it from stick.
        """
        return None

    def theta(self, values: Mapping[str, Array]) -> Array:
        """Parameters in their order, (n, p), of values by name, (n,) each."""
        return np.stack(list(named_vectors(values, self.parameters).values()), axis=1)

    def composed(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Parameters that are computed from several of the sampled quantities."""
        return ()

    def gap(self, values: Mapping[str, Array]) -> Array | None:
        """Width of the gap, (n,), in, of values by name; None without a gap."""
        return None

    def crossing(self, values: Mapping[str, Array]) -> Array | None:
        """Travel from slip to slip, (n,), in: what is read off a loop as its gap."""
        return self.gap(values)

    def unloaded(self, values: Mapping[str, Array]) -> tuple[Array, Array, Array] | None:
        """Part of the range of `start` in which a device bears little load; None: all of it.

        Parameters
        ----------
        values : mapping of str to (n,)
            Quantities by name.

        Returns
        -------
        lower, upper, edge : (n,), 1, each
            Its ends, and the length over which the load grows there.
        """
        return None

    def vectors(self, theta: ArrayLike) -> Array:
        """Theta as numbers, (n, p), or a FitError that says what does not fit.

        Of a table with named columns, such as a DataFrame, those of `parameters` are taken.
        """
        values = columns_in_order("theta", theta, self.parameters)
        width = len(self.parameters)
        if values.ndim != 2 or values.shape[1] != width:
            raise FitError(
                f"theta must have shape (n, {width}) for {self.name}, got {values.shape}"
            )
        return values

    def columns(self, theta: ArrayLike) -> Columns:
        """Theta's columns by name, (n,) each, within the limits of their quantities.

        Raises
        ------
        FitError
            When the shape does not fit, or a value lies outside its limits.
        """
        values = np.array(self.vectors(theta).T, order="C")  # not the caller's
        columns = dict(zip(self.parameters, values, strict=True))
        known = {quantity.name: (quantity.least, quantity.most) for quantity in self.quantities}
        limits = np.array([known.get(name, (-np.inf, np.inf)) for name in columns])
        zero = np.array([name in self.positive for name in columns])
        good = (values >= limits[:, :1]) & (values <= limits[:, 1:]) & np.isfinite(values)
        good &= ~(zero[:, None] & (values == 0.0))
        if not good.all():
            row, vector = np.argwhere(~good)[0]
            name, (least, most) = self.parameters[row], limits[row]
            words = "positive" if zero[row] else "not negative" if least == 0.0 else ""
            words = f"in [{least:g}, {most:g}]" if np.isfinite(most) else words
            words = words or (f"at least {least:g}" if np.isfinite(least) else "")
            words = f"finite and {words}" if words else "finite"
            raise FitError(f"parameter {name} must be {words}, got {values[row, vector]}")
        return columns

    def factors(self, trace: Trace, n: int, scales: Mapping[str, ArrayLike] | None) -> Columns:
        """Factors of the parameters that follow the actuation, by name; none where it is constant.

        (T, n) or (T, 1) each, at the samples. Without `scales` those whose law is proportional
        follow it, and what is tied to them: one test cannot tell the slope of another law.

        Raises
        ------
        FitError
            When a name, a shape or a value in `scales` does not fit.
        """
        if scales is not None:
            shapes = ((n, trace.samples), (1, trace.samples))
            return {k: f.T for k, f in check_scales(scales, shapes, self.actuated).items()}
        if not trace.varying:
            return {}
        return self.proportional(np.asarray(trace.actuation)[:, None], trace.reference_actuation)

    def proportional(self, actuation: Array, reference: float | None) -> Columns:
        """Factors of the parameters that are in proportion to the actuation, by name."""
        names = [n for n in self.actuated if self.laws.get(n, "proportional") == "proportional"]
        return dict.fromkeys(names, actuation / (reference or 1.0))


def _count(columns: Columns) -> int:
    """Number of vectors n of some columns."""
    return next(iter(columns.values())).size


def _checked(compute: Callable[..., Array]) -> Callable[..., Array]:
    """A model's method of theta and a trace that takes no vector too, and gives finite numbers.

    The method itself is its `__wrapped__`.
    """

    @wraps(compute)
    def found(model: Any, theta: ArrayLike, trace: Trace, *args: Any, **options: Any) -> Array:
        vectors = columns_in_order("theta", theta, model.parameters)
        check_trace("trace", trace, FitError)
        if vectors.ndim == 2 and len(vectors) == 0:
            return compute(model, np.ones((1, vectors.shape[1])), trace)[:0]
        try:
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                values = compute(model, vectors, trace, *args, **options)
        except (ArithmeticError, IndexError) as error:  # of a place that is not a number
            what = f"the {compute.__name__} is no finite number for these parameters"
            raise FitError(what) from error
        finite = np.isfinite(values)
        if not finite.all():
            at = int(np.argmin(finite.reshape(len(values), -1).all(axis=1)))
            raise FitError(f"the {compute.__name__} of parameter vector {at} is no finite number")
        return values

    return found


def check_start(start: ArrayLike | None, n: int) -> Array:
    """Place in the gap at the first sample, (n,), checked; its middle where none is given.

    Raises
    ------
    FitError
        When it is no fraction of the gap, or its shape does not fit.
    """
    if start is None:
        return np.full(n, 0.5)
    w0 = real_numbers("start", start, FitError)
    if w0.shape not in ((), (n,)) or not np.all((w0 >= 0) & (w0 <= 1)):
        raise FitError(f"start must be a fraction of the gap in [0, 1] with shape ({n},)")
    return np.broadcast_to(w0, (n,)).copy()  # a state must not change with the caller's array


def check_scales(
    scales: Any, shapes: tuple[tuple[int, ...], ...], names: tuple[str, ...]
) -> Columns:
    """Factors by name, checked: names, shapes, and that they are finite and not negative.

    Raises
    ------
    FitError
        When one does not fit.
    """
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


def through_vertices(
    trace: Trace,
) -> tuple[Array, Array, NDArray[np.intp], NDArray[np.intp]]:
    """Motion of a trace with the vertex of every turn, however small: no hysteresis matters.

    Returns
    -------
    time, displacement : (P,), s, in
    nearest : (P,), int
        The sample of the trace at or beside each.
    samples : (T,), int
        Which of them are the trace's.
    """
    t, x, every = trace.time, trace.displacement, np.arange(trace.samples)
    left, share, vertex = vertices(t, x, trace.velocity)
    at = left + 1
    return (
        np.insert(t, at, t[left] + share * (t[at] - t[left])),
        np.insert(x, at, vertex),
        np.insert(every, at, np.where(share < 0.5, left, at)),
        every + np.searchsorted(at, every, side="right"),
    )
