"""Mean and bounding properties of a device for design, with property modification factors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.cycles import UNITS, derive_from_force, derive_from_parameters
from mfd_bayes.friction.model import Model
from mfd_bayes.population.bands import Band
from mfd_bayes.population.design import LEVELS
from mfd_bayes.population.settings import KIND_NAMES, NESTED, levels_of, setting_of, with_zeros
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.run import Run

Array = NDArray[np.float64]

ANOTHER = "another_device"
"""Another device of the same make: known where the sessions of a campaign are devices."""

BASES: Mapping[str, str] = {
    "device": KIND_NAMES["device"],
    "new_test": KIND_NAMES["new_test"],
    ANOTHER: "another device of the same make",
    "observation": KIND_NAMES["observation"],
}
"""What bounds are about, in the order of tables; kinds of prediction but for `ANOTHER`."""

DRAWS = 1000
"""Draws of each basis: few would leave the bounds to chance."""

NOT_KNOWN = "not known: no sessions of several devices are declared"

_OF_DEVICE = ("energy_per_cycle", "c_eq", "peak_fwd", "peak_bwd", "gap")
_OF_RECORD = ("energy_per_cycle", "c_eq", "peak_fwd", "peak_bwd")
_NEW = "\x00another"  # a session that no campaign can declare
_SLIP = {"slip_fwd": "kip", "slip_bwd": "kip"}


@dataclass(frozen=True)
class DesignRow:
    """Bounds of one property on one basis, in `unit`.

    Attributes
    ----------
    basis : str
        A key of `BASES`.
    name, unit : str
    nominal : float
        Mean of the mean property: what every factor is relative to.
    lower, upper : float
        Each is exceeded with a probability of half of what the interval leaves.
    probability : float
        Of the interval between the bounds.
    note : str
        Why the bounds are not known.
    """

    basis: str
    name: str
    unit: str
    nominal: float
    lower: float
    upper: float
    probability: float
    note: str = ""

    @property
    def lambda_min(self) -> float:
        """Lower bound over the nominal value."""
        return self.lower / self.nominal if self.nominal else float("nan")

    @property
    def lambda_max(self) -> float:
        """Upper bound over the nominal value."""
        return self.upper / self.nominal if self.nominal else float("nan")


def design_rows(run: Run, trace: Trace, probability: float = 0.95) -> tuple[DesignRow, ...]:
    """Mean and bounding properties under a motion and an actuation, by property, then by basis.

    Parameters
    ----------
    run : Run
    trace : Trace
        With its actuation.
    probability : float
        Of the interval between lower and upper bound.

    Raises
    ------
    FitError
        When the trace has no actuation, or the probability is not between 0 and 1.
    """
    model = next(iter(run.tests.values())).posterior.model
    drawn = {
        basis: _properties(band, trace, model)
        for basis, band in _bands(run, trace, probability).items()
    }
    return bounds_of(drawn, probability)


def design_warnings(run: Run) -> tuple[str, ...]:
    """Why bounds may be too narrow, in sentences."""
    settings = with_zeros([setting_of(test.trace) for test in run.tests.values()])
    count = len(levels_of(settings))
    if count >= LEVELS:
        return ()
    return (
        f"the calibrated tests have {count} level{'' if count == 1 else 's'} of actuation, and "
        f"fewer than {LEVELS} do not show how far levels lie from a law: bounds at an actuation "
        "that was not tested are too narrow",
    )


def bounds_of(
    drawn: Mapping[str, Mapping[str, Array]], probability: float
) -> tuple[DesignRow, ...]:
    """Bounds of draws (n,) by basis and property; "device" has the nominal values.

    A basis of `BASES` that is missing is not known, and its bounds are NaN.
    """
    tail = 0.5 * (1.0 - probability)
    rows = []
    for name, mean in drawn["device"].items():
        nominal = float(np.mean(mean))
        if not np.isfinite(nominal):  # the motion has no full cycle
            continue
        for basis in BASES:
            values = drawn.get(basis, {}).get(name)
            empty = DesignRow(
                *(basis, name, _unit(name), nominal, np.nan, np.nan, probability),
                note=NOT_KNOWN if basis not in drawn else "",
            )
            if values is not None:
                lower, upper = (float(q) for q in np.quantile(values, [tail, 1.0 - tail]))
                rows.append(replace(empty, lower=lower, upper=upper))
            elif empty.note:
                rows.append(empty)
    return tuple(rows)


def draws_of(run: Run) -> int:
    """Draws of the bands behind the bounds, for each session.

    A band with as many, without sessions, has the same draws as the bounds.
    """
    return DRAWS // len(sessions_of(run)) + 10


def sessions_of(run: Run) -> tuple[str, ...]:
    """Sessions of the calibrated tests; "" where none are declared."""
    return tuple(dict.fromkeys(run.session(name) for name in run.tests))


def _unit(name: str) -> str:
    return _SLIP.get(name) or UNITS[name]


def _bands(run: Run, trace: Trace, probability: float) -> dict[str, tuple[Band, ...]]:
    """Predictions of every basis; several where tests of several sessions are meant.

    "This device tested again" is a test in one of the declared sessions, "another device" one in
    a session that was not. Without sessions the latter is not known.
    """
    sessions, size = sessions_of(run), draws_of(run)
    told = len(sessions) > 1
    found = {
        kind: tuple(
            run.predict(trace, kind, probability, session=session, draws=size)
            for session in sessions
        )
        for kind in NESTED
    }
    if told:
        found[ANOTHER] = (run.predict(trace, "new_test", probability, session=_NEW, draws=DRAWS),)
    return found


def _properties(bands: Iterable[Band], trace: Trace, model: Model) -> dict[str, Array]:
    """Properties of the draws of bands, by name, (n,) each; NaN where there is no full cycle."""
    parts = [_of_band(band, trace, model) for band in bands]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _of_band(band: Band, trace: Trace, model: Model) -> dict[str, Array]:
    found = derive_from_force(band.draws, trace)
    if band.kind == "observation":
        return {name: found[name] for name in _OF_RECORD}
    theta = model.theta(band.values)
    columns = (model.parameters.index(name) for name in model.slip_forces)
    slip = dict(zip(_SLIP, (theta[:, column] for column in columns), strict=False))
    found |= derive_from_parameters(model, band.values)
    return slip | {name: found[name] for name in _OF_DEVICE if name in found}
