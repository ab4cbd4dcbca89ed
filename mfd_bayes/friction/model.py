"""What every friction model is: its quantities, and the force that they give."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.friction.columns import columns_in_order, named_vectors
from mfd_bayes.friction.evaluation import check_start, checked, of_trace
from mfd_bayes.friction.quantity import Quantity
from mfd_bayes.friction.yield_shares import shares_along
from mfd_bayes.records.trace import Trace, check_trace

Array = NDArray[np.float64]

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
    has_gap: ClassVar[bool] = False
    keeps_prior: ClassVar[tuple[str, ...]] = ()
    laws: ClassVar[Mapping[str, str]] = _NONE
    laws_from: ClassVar[Mapping[str, str]] = _NONE
    tied_laws: ClassVar[Mapping[str, str]] = _NONE
    slip_forces: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls) -> None:
        """Let `force` and `travel` of every model take empty batches, and give numbers alone.

        `end` takes traces alone, as both of them do.
        """
        super().__init_subclass__()
        if "force" in cls.__dict__:
            cls.force = checked(cls.force)  # type: ignore[method-assign]
        if "travel" in cls.__dict__:
            cls.travel = checked(cls.travel)  # type: ignore[method-assign]
        if "end" in cls.__dict__:
            cls.end = of_trace(cls.end)  # type: ignore[method-assign]

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of theta's columns."""
        return tuple(quantity.name for quantity in self.quantities)

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
        values = self._finite(theta)
        check_start(start, len(values))
        return travel_since_turn(values, trace)

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

    def _finite(self, theta: ArrayLike) -> Array:
        """As `vectors`, of finite numbers alone."""
        values = self.vectors(theta)
        if not np.all(np.isfinite(values)):
            raise FitError(f"theta must hold finite numbers alone for {self.name}")
        return values

    def _sound(self, theta: ArrayLike) -> int:
        """Number of vectors of theta, or a FitError that says which is none of a damper."""
        return len(self._finite(theta))

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
        n = self._sound(theta)
        check_start(start, n)
        if scales is not None:
            shares_along(scales, trace, n, (*self.laws, *self.tied_laws))
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

    def stages(
        self, theta: ArrayLike, trace: Trace, start: ArrayLike | None = None
    ) -> NDArray[np.int8] | None:
        """Stage of every parameter vector at each sample, (n, T); None without a gap.

        1 slip, 2 stick, 3 build-up, 4 in the gap, where the model tells it from stick.
        """
        return None


def travel_since_turn(theta: ArrayLike, trace: Trace) -> Array:
    """Travel since the last turning point, (n, T), in: that of a device without a gap."""
    path = trace.path
    turns = np.concatenate([path.displacement[:1], path.displacement[path.turning_points]])
    travel = np.abs(trace.displacement - turns[path.stretch])
    return np.broadcast_to(travel, (len(np.asarray(theta)), trace.samples))
