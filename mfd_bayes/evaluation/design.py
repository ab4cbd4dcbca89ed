"""Mean and bounding properties of a device for design, with property modification factors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.evaluation.properties import NO_FACTOR, UNITS, peaks_of, properties_of
from mfd_bayes.population.bands import Band
from mfd_bayes.population.design import LEVELS
from mfd_bayes.population.settings import KIND_NAMES, levels_of, setting_of, with_zeros
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.run import Run

Array = NDArray[np.float64]

ANOTHER = "another_device"
"""Another device of the same make: known where the calibrated tests are of several devices."""

BASES: Mapping[str, str] = {
    "device": KIND_NAMES["device"],
    "new_test": KIND_NAMES["new_test"],
    ANOTHER: "another device of the same make",
    "observation": KIND_NAMES["observation"],
}
"""What bounds are about, in the order of tables; kinds of prediction but for `ANOTHER`."""

DRAWS = 1000
"""Draws of each basis: few would leave the bounds to chance."""

NOT_KNOWN = "not known: the calibrated tests are of one device"

PROPERTIES = (
    *("slip_fwd", "slip_bwd", "energy_per_cycle", "effective_stiffness", "effective_damping"),
    *("c_eq", "peak_fwd", "peak_bwd", "gap"),
)
NEW = "\x00another"  # a session or a device that no campaign can declare


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
        Why the bounds are not known, or from how many devices they are.
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

    "This device tested again" is a test of one of the calibrated devices in one of the declared
    sessions, "another device" a test of a new one, in a new session where there are several. With
    one device the latter is not known. The mean property has the mean of the factor between the
    model's peak and the measured one, the others its scatter too.

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
    places, n, peaks = places_of(run), n_draws(run), peaks_of(run)

    def draw(kind: str, session: str, device: str, draws: int = n) -> Band:
        how: dict[str, Any] = {"session": session, "device": device, "draws": draws}
        return run.predict(trace, kind, probability, **how)

    bands = {kind: [draw(kind, *place) for place in places] for kind in KIND_NAMES if kind in BASES}
    smooth = {kind: bands[kind] for kind in ("device", "new_test")}
    if len(run.devices) > 1:
        session = NEW if len(sessions_of(run)) > 1 else sessions_of(run)[0]
        bands[ANOTHER] = [draw("new_test", session, NEW, DRAWS)]
    drawn = {}
    for basis, several in bands.items():
        parts = []
        for number, band in enumerate(several):
            without_noise = band.draws
            if basis == "observation":
                test = smooth["new_test"][number]
                without_noise = test.draws + np.asarray(test.values["offset"])[:, None]
            factor = NO_FACTOR if basis == "device" else peaks
            parts.append(properties_of(trace, band.draws, factor, smooth=without_noise))
        drawn[basis] = {name: np.concatenate([p[name] for p in parts]) for name in PROPERTIES}
    for side, factor_of in peaks.items():
        drawn["device"][f"peak_{side}"] *= factor_of.expected
    return bounds_of(drawn, probability, f"from {len(run.devices)} devices")


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
    drawn: Mapping[str, Mapping[str, Array]], probability: float, note: str = ""
) -> tuple[DesignRow, ...]:
    """Bounds of draws (n,) by basis and property; "device" has the nominal values.

    A basis of `BASES` that is missing is not known, and its bounds are NaN. The `note` says of
    how many devices another one is known.
    """
    tail = 0.5 * (1.0 - probability)
    rows = []
    for name, mean in drawn["device"].items():
        finite = mean[np.isfinite(mean)]
        if not finite.size:  # the motion has no full cycle
            continue
        head = name, UNITS[name], float(np.mean(finite))
        for basis in BASES:
            if basis not in drawn:
                rows.append(DesignRow(basis, *head, np.nan, np.nan, probability, NOT_KNOWN))
                continue
            values = drawn[basis].get(name, np.empty(0))
            values = values[np.isfinite(values)]
            if values.size:
                lower, upper = np.quantile(values, [tail, 1.0 - tail]).tolist()
                about = note if basis == ANOTHER else ""
                rows.append(DesignRow(basis, *head, lower, upper, probability, about))
    return tuple(rows)


def n_draws(run: Run) -> int:
    """Draws of the bands behind the bounds, for each session and device.

    A band with as many, of one session and device, has the same draws as the bounds.
    """
    return DRAWS // len(places_of(run)) + 10


def places_of(run: Run) -> tuple[tuple[str, str], ...]:
    """Session and device of the calibrated tests, each pair once."""
    devices = run.manifest.settings.devices
    return tuple(dict.fromkeys((run.session(name), devices[name]) for name in run.tests))


def sessions_of(run: Run) -> tuple[str, ...]:
    """Sessions of the calibrated tests; "" where none are declared."""
    return tuple(dict.fromkeys(run.session(name) for name in run.tests))
