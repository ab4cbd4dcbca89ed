"""Mean and bounding properties of a device, for design."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.evaluation.measurement import gains_of
from mfd_bayes.evaluation.properties import (
    Array,
    applicable,
    properties_of,
    without_noise,
)
from mfd_bayes.evaluation.scores import Rows
from mfd_bayes.population.bands import KIND_NAMES, Band
from mfd_bayes.population.design import LEVELS, levels_of, setting_of, with_zeros
from mfd_bayes.population.peaks import of_mean
from mfd_bayes.records.cycles import PROPERTIES, cycle_values
from mfd_bayes.records.loops import find_loops
from mfd_bayes.records.record import NO_ACTUATION
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.run import Run, actuation_level

Index = NDArray[np.intp]

# --- for design

ANOTHER = "another_device"
"""Another device of the same make: known where the calibrated tests are of several devices."""

BASES: Mapping[str, str] = {
    "mean": KIND_NAMES["mean"],
    "new_test": KIND_NAMES["new_test"],
    ANOTHER: "another device of the same make",
    "observation": KIND_NAMES["observation"],
}
"""What bounds are about, in the order of tables; kinds of prediction but for `ANOTHER`."""

DESIGN_DRAWS = 1000  # draws of each basis: few would leave the bounds to chance
NOT_KNOWN = "not known: the calibrated tests are of one device"

_OF_DESIGN = sorted((p for p in PROPERTIES.values() if p.design), key=lambda p: p.design)
NEW = "\x00another"  # a session or a device that no campaign can declare


def design_rows(run: Run, trace: Trace, probability: float = 0.95) -> Rows:
    """Mean and bounding properties under a motion and an actuation, by property, then by basis.

    "This device tested again" is a test of one of the calibrated devices in one of the declared
    sessions, "another device" a test of a new one, in a new session where there are several. With
    one device the latter is not known.
    """
    draws = with_gains(run, drawn_properties(run, trace, places_of(run)))
    return bounds_of(draws, probability, f"from {len(run.devices)} devices")


def drawn_properties(
    run: Run, trace: Trace, places: Sequence[tuple[str, str]]
) -> dict[str, dict[str, Array]]:
    """Draws of the properties of a motion by basis of `BASES`, then by name, (n,) each.

    `places` are session and device of the tests. The mean property has the mean excess of
    measured peaks, as uncertain as it is, the others its scatter too. All are as the tests'
    instruments read them. Energies of the cycles at full stroke, "energy", are (n, L).
    """
    peaks, axes, properties = run.peaks, run.manifest.axes, {}

    def draw(kind: str, session: str, device: str, draws: int) -> Band:
        how: dict[str, Any] = {"session": session, "device": device, "draws": draws}
        return run.predict(trace, kind, **how)

    n = n_draws(places)
    bands = {k: [draw(k, *pair, n) for pair in places] for k in KIND_NAMES if k in BASES}
    if len(run.devices) > 1:
        session = NEW if len(sessions_of(run)) > 1 else sessions_of(run)[0]
        bands[ANOTHER] = [draw("new_test", session, NEW, DESIGN_DRAWS)]
    for basis, several in bands.items():
        excess = of_mean(peaks) if basis == "mean" else peaks
        quiet = bands["new_test"] if basis == "observation" else several
        band_properties = []
        for band, test in zip(several, quiet, strict=True):
            cycles, smooth = cycle_values(trace, band.draws), without_noise(band, test)
            values = properties_of(trace, band.draws, excess, smooth=smooth, cycles=cycles)
            energies = cycles["energy"][:, find_loops(trace).strong]
            band_properties.append(applicable(values, axes) | {"energy": energies})
        properties[basis] = {
            name: np.concatenate([values[name] for values in band_properties])
            for name in band_properties[0]
        }
    return properties


def draw_index(run: Run, trace: Trace, places: Sequence[tuple[str, str]]) -> Index:
    """Numbers of the population's draws behind those of `drawn_properties`, (n,), in their order.

    Those of another device, which are of one place, have none here.
    """
    level = trace.reference_actuation
    if not run.manifest.axes.actuated:
        level = actuation_level(run, NO_ACTUATION)
    # as `Predictor.draw` begins, whose seed is 0 in every place
    index = run.population.draw_index(n_draws(places), level, np.random.default_rng(0))
    return np.tile(index, len(places))


def with_gains(
    run: Run, draws: Mapping[str, Mapping[str, Array]]
) -> dict[str, Mapping[str, Array]]:
    """Draws of `drawn_properties` with the uncertainty of the instruments' gains."""
    return {
        basis: gains_of(run, len(next(iter(of_basis.values())))).applied(of_basis)
        for basis, of_basis in draws.items()
    }


def bounds_of(draws: Mapping[str, Mapping[str, Array]], probability: float, note: str = "") -> Rows:
    """Bounds of draws (n,) by basis and property; "mean" has the nominal values.

    A basis of `BASES` that is missing is not known, and its bounds are NaN. The `note` is of
    another device.
    """
    rows = []
    for quantity in _OF_DESIGN:
        name = quantity.name
        mean = draws["mean"].get(name, np.empty(0))
        if not np.any(np.isfinite(mean)):  # the motion has no full cycle
            continue
        for basis in BASES:
            values = draws.get(basis, {}).get(name, np.empty(0))
            if basis in draws and not np.any(np.isfinite(values)):
                continue
            basis_note = note if basis == ANOTHER else ""
            rows.append(
                {"name": name, "unit": quantity.unit, "basis": basis, "of": BASES[basis]}
                | bounds(mean, values, probability)
                | {"note": basis_note if basis in draws else NOT_KNOWN}
            )
    return tuple(rows)


def bounds(mean: Array, drawn: Array, probability: float) -> dict[str, float]:
    """Nominal value, the mean of draws of any shape; equal-tailed bounds of others, and factors.

    `lower_ratio` and `upper_ratio` are the bounds over the nominal value. What is not finite is
    left out, and NaN where nothing remains.
    """
    mean, drawn = mean[np.isfinite(mean)], drawn[np.isfinite(drawn)]
    tail, nan = 0.5 * (1.0 - probability), float("nan")
    nominal = float(mean.mean()) if mean.size else nan
    lower, upper = np.quantile(drawn, [tail, 1.0 - tail]).tolist() if drawn.size else (nan, nan)
    factors = [bound / nominal if nominal else nan for bound in (lower, upper)]
    names = ("nominal", "lower", "upper", "lower_ratio", "upper_ratio")
    return dict(zip(names, (nominal, lower, upper, *factors), strict=True))


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


def n_draws(places: Sequence[tuple[str, str]]) -> int:
    """Draws of the bands behind the bounds, for each session and device.

    A band with as many, of one session and device, has the same draws as the bounds.
    """
    return DESIGN_DRAWS // len(places) + 10


def places_of(run: Run) -> tuple[tuple[str, str], ...]:
    """Session and device of the calibrated tests, each pair once."""
    devices = run.manifest.settings.devices
    return tuple(dict.fromkeys((run.session(name), devices[name]) for name in run.tests))


def sessions_of(run: Run) -> tuple[str, ...]:
    """Sessions of the calibrated tests; "" where none are declared."""
    return tuple(dict.fromkeys(run.session(name) for name in run.tests))
