"""Mean and bounding properties of a device for design, with property modification factors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.evaluation.properties import NO_FACTOR, UNITS, kept, peaks_of, properties_of
from mfd_bayes.evaluation.views import Rows
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


def design_rows(run: Run, trace: Trace, probability: float = 0.95) -> Rows:
    """Mean and bounding properties under a motion and an actuation, by property, then by basis.

    "This device tested again" is a test of one of the calibrated devices in one of the declared
    sessions, "another device" a test of a new one, in a new session where there are several. With
    one device the latter is not known. The mean property has the mean of the factor between the
    model's peak and the measured one, the others its scatter too.
    """
    places, n, peaks = places_of(run), n_draws(run), peaks_of(run)

    def draw(kind: str, session: str, device: str, draws: int = n) -> Band:
        how: dict[str, Any] = {"session": session, "device": device, "draws": draws}
        return run.predict(trace, kind, probability, **how)

    bands = {kind: [draw(kind, *place) for place in places] for kind in KIND_NAMES if kind in BASES}
    if len(run.devices) > 1:
        session = NEW if len(sessions_of(run)) > 1 else sessions_of(run)[0]
        bands[ANOTHER] = [draw("new_test", session, NEW, DRAWS)]
    drawn = {}
    for basis, several in bands.items():
        parts = []
        for number, band in enumerate(several):
            smooth = band.draws
            if basis == "observation":
                test = bands["new_test"][number]
                smooth = test.draws + np.asarray(test.values["offset"])[:, None]
            factor = NO_FACTOR if basis == "device" else peaks
            parts.append(properties_of(trace, band.draws, factor, smooth=smooth))
        drawn[basis] = {name: np.concatenate([p[name] for p in parts]) for name in PROPERTIES}
    for side, factor_of in peaks.items():
        drawn["device"][f"peak_{side}"] *= factor_of.expected
    drawn = {basis: kept(of, run.manifest.axes) for basis, of in drawn.items()}
    return bounds_of(drawn, probability, f"from {len(run.devices)} devices")


def bounds_of(drawn: Mapping[str, Mapping[str, Array]], probability: float, note: str = "") -> Rows:
    """Bounds of draws (n,) by basis and property; "device" has the nominal values.

    A basis of `BASES` that is missing is not known, and its bounds are NaN. `lambda_min` and
    `lambda_max` are the bounds over the nominal value. The `note` is of another device.
    """
    tail, rows = 0.5 * (1.0 - probability), []
    for name, mean in drawn["device"].items():
        finite = mean[np.isfinite(mean)]
        if not finite.size:  # the motion has no full cycle
            continue
        nominal = float(np.mean(finite))
        for basis in BASES:
            lower = upper = np.nan
            if basis in drawn:
                values = drawn[basis].get(name, np.empty(0))
                values = values[np.isfinite(values)]
                if not values.size:
                    continue
                lower, upper = np.quantile(values, [tail, 1.0 - tail]).tolist()
            rows.append(
                {"name": name, "unit": UNITS[name], "basis": basis, "of": BASES[basis]}
                | {"nominal": nominal, "lower": lower, "upper": upper}
                | {"lambda_min": lower / nominal if nominal else np.nan}
                | {"lambda_max": upper / nominal if nominal else np.nan}
                | {"note": (note if basis == ANOTHER else "") if basis in drawn else NOT_KNOWN}
            )
    return tuple(rows)


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
