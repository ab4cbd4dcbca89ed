"""Response of a building with the device of a run as its dampers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from os import PathLike, fspath

import numpy as np

from mfd_bayes.applications.buildings.building import Building, read_building
from mfd_bayes.applications.buildings.dampers import FEWEST as FEWEST_DRAWS
from mfd_bayes.applications.buildings.dampers import KINDS, bound_dampers, draw_dampers
from mfd_bayes.applications.buildings.ground import Ground, parse_ground, read_ground
from mfd_bayes.applications.buildings.response import STANDARD, Response, seen_peaks
from mfd_bayes.applications.buildings.time_integration import response_of
from mfd_bayes.applications.properties import design_factors
from mfd_bayes.errors import MOST_DRAWS, BuildingError, path_of, real_number, whole_number
from mfd_bayes.friction.model import Model
from mfd_bayes.jobs.job import Step
from mfd_bayes.runs.run import Run
from mfd_bayes.runs.tested_range import MARGIN, Range, extrapolations
from mfd_bayes.units import actuation_kind

Grounds = Iterable[Ground | str | PathLike[str]] | Ground | str | PathLike[str]


def grounds_of(
    grounds: Grounds, *, unit: str = "", scale: float = 1.0, meant: bool = False
) -> list[Ground]:
    """Ground motions of what is given; `unit`, `scale` and `meant` are as in `read_ground`."""
    motions = []
    for item in [grounds] if isinstance(grounds, Ground | str | PathLike) else grounds:
        if isinstance(item, Ground):
            motions.append(item)
            continue
        path_of("a ground motion", item, BuildingError)
        path, step, suffix_unit = parse_ground(fspath(item), of="ground")
        ground = read_ground(path, step=step, unit=suffix_unit or unit, scale=scale, meant=meant)
        motions.append(ground)
    if not motions:
        raise BuildingError("give at least one ground motion")
    return motions


def check_kind(label: str, unit: str, expected: str) -> None:
    """Refuse an actuation whose internal unit is of another kind than the tests had."""
    if unit != expected:
        raise BuildingError(f"{label} must be {actuation_kind(expected)}, as in the campaign")


def _short_histories(building: Building, grounds: Sequence[Ground]) -> list[str]:
    """Actuation histories that do not go on for as long as a ground motion, in sentences."""
    sentences = []
    for device in building.devices:
        if device.history is None:
            continue
        begin, end = device.history[0][[0, -1]].tolist()
        for ground in grounds:
            t_end = float(ground.time[-1])
            if begin > MARGIN * t_end or end < (1 - MARGIN) * t_end:
                sentences.append(
                    f"the actuation of the damper at {device.name} is known from {begin:.4g} s to "
                    f"{end:.4g} s, and the ground motion {ground.name} goes on to {t_end:.4g} s: "
                    "the first and the last actuation are taken to stay"
                )
    return sentences


def beyond_tests(run: Run, response: Response) -> list[list[str]]:
    """Where the dampers leave what was tested: sentences of each ground motion, then of all.

    The stroke is that of the damper which travels most, in the median draw.
    """

    def sentences(name: str, unit: str, low: float, high: float, of: str = "") -> list[str]:
        exceedances = extrapolations(run.tested, [Range(name, unit, low, high)])
        return [
            f"{of}beyond the tests: {extrapolation.sentence(run.system)}"
            for extrapolation in exceedances
        ]

    if not response.dampers.count:
        return [[]]
    messages = []
    for g, ground in enumerate(response.grounds):
        travel = response.travel[response.usable(g), g]
        stroke = 2.0 * float(np.median(travel.max(axis=1))) if len(travel) else np.nan
        messages.append(sentences("stroke", "in", stroke, stroke, f"{ground.name}: "))
    levels = np.concatenate(
        [
            [device.actuation] if device.history is None else device.history[1]
            for device in response.building.devices
        ]
    )
    return [*messages, sentences("actuation", run.actuation_unit, levels.min(), levels.max())]


def _on_parameters(
    model: Model, factors: Mapping[str, tuple[float, float]]
) -> tuple[Mapping[str, float], Mapping[str, float]]:
    """Smallest and largest factor on each slip force and stiffness of a model.

    `factors` are those on properties, by name; empty where there are none.
    """
    ends = []
    for end in (0, 1):
        of_slip = {
            name: factors[slip][end]
            for name in model.slip_forces
            if (slip := f"slip_{name.rpartition('_')[2]}") in factors
        }
        of_stiffness = {
            q.name: factors["effective_stiffness"][end]
            for q in model.quantities
            if q.kind == "stiffness" and "effective_stiffness" in factors
        }
        ends.append(of_stiffness | of_slip)
    return ends[0], ends[1]


def respond(
    run: Run,
    building: Building | str | PathLike[str],
    grounds: Grounds,
    draws: int = 300,
    seed: int = 1,
    *,
    kind: str = "new_test",
    tolerance: float = 0.01,
    jobs: int = 1,
    observe: Callable[[Step], None] = lambda step: None,
) -> Response:
    """Response of a building with the device of a run as its dampers.

    Parameters
    ----------
    run : Run
    building : Building or path
        As `read_building` reads it.
    grounds : Ground or path, or several
        Paths as `read_ground` reads them; "FILE:0.01s" gives the step of a file without one.
    draws : int
    seed : int
    kind : {"new_test", "mean"}
        With each damper's scatter from test to test, or the mean property alone.
    tolerance : float
        Largest estimated error of a draw's drift, relative; steps are shortened until then.
    jobs : int
        Processes; the result does not depend on them.

    Returns
    -------
    Response
        `drift` (draw, ground, storey), in, and others.

    Raises
    ------
    BuildingError
        When the building or a ground motion cannot be used, or the actuation is of another
        kind than the run's.
    """
    if kind not in KINDS:
        raise BuildingError(f"unknown kind {kind!r}: expected one of {', '.join(KINDS)}")
    whole_number("draws", draws, FEWEST_DRAWS, BuildingError, MOST_DRAWS)
    whole_number("seed", seed, 0, BuildingError)
    whole_number("jobs", jobs, 0, BuildingError)
    tolerance = real_number("tolerance", tolerance, BuildingError, (0.0, 1.0), exclusive=True)
    built = building if isinstance(building, Building) else read_building(building)
    motions = grounds_of(grounds)
    for device in built.devices:
        label = f"the actuation of the damper at {device.name}"
        check_kind(label, device.unit, run.actuation_unit)
    model, bounds = run.predictor.model, {}
    dampers = draw_dampers(run.population, model, built, kind, draws, seed)
    if dampers.count and (model.slip_forces or model.laws):
        bounds = bound_dampers(run.population, model, built, dampers, seed)
        levels = {device.level for device in built.devices}
        factors = {level: _on_parameters(model, design_factors(run, level)) for level in levels}
        if all(map(any, factors.values())):
            ends = bound_dampers(run.population, model, built, dampers, seed, factors)
            bounds |= dict(zip(STANDARD, ends.values(), strict=True))
    if not model.slip_forces:  # by which forces are judged to be in equilibrium
        typical = np.median([run.manifest.tests[name].peak_force for name in run.tests])
        dampers, *references = (
            replace(group, slip=np.full_like(group.slip, typical))
            for group in (dampers, *bounds.values())
        )
        bounds = dict(zip(bounds, references, strict=True))
    response = response_of(built, motions, dampers, tolerance, bounds, jobs, observe)
    response = seen_peaks(response, run.peaks, seed, scatter=kind == "new_test")
    remarks = [*chain.from_iterable(beyond_tests(run, response))]
    remarks += [run.caution] if run.caution else []
    remarks += _short_histories(built, motions)
    if dampers.count and run.population.design.dependence:
        remarks.append(
            "quantities that depend on speed, amplitude, date, cycles or temperature are taken "
            "at those of the typical, or the latest, test"
        )
    return replace(response, remarks=(*remarks, *response.faults))
