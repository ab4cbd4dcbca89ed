"""The response of a building whose dampers are the device of a run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import chain
from os import PathLike, fspath
from typing import TYPE_CHECKING

import numpy as np

from mfd_bayes.errors import MOST_DRAWS, BuildingError, path_of, real_number, whole_number
from mfd_bayes.jobs.job import Step
from mfd_bayes.response.analysis import Response, response_of
from mfd_bayes.response.building import (
    FEWEST as FEWEST_DRAWS,
    KINDS,
    Building,
    bound_dampers,
    draw_dampers,
    read_building,
)
from mfd_bayes.response.ground import Ground, parse_ground, read_ground
from mfd_bayes.runs.tested_range import MARGIN, Span, departures
from mfd_bayes.units import actuation_kind

if TYPE_CHECKING:
    from mfd_bayes.runs.run import Run

Grounds = Iterable[Ground | str | PathLike[str]] | Ground | str | PathLike[str]


def respond(
    run: Run,
    building: Building | str | PathLike[str],
    grounds: Grounds,
    kind: str,
    draws: int,
    seed: int,
    tolerance: float,
    jobs: int,
    observe: Callable[[Step], None],
) -> Response:
    """Response of a building with the device of a run as its dampers; see `Run.respond`."""
    if kind not in KINDS:
        raise BuildingError(f"unknown kind {kind!r}: expected one of {', '.join(KINDS)}")
    whole_number("draws", draws, FEWEST_DRAWS, BuildingError, MOST_DRAWS)
    whole_number("seed", seed, 0, BuildingError)
    whole_number("jobs", jobs, 0, BuildingError)
    tolerance = real_number("tolerance", tolerance, BuildingError, (0.0, 1.0), inside=True)
    built = building if isinstance(building, Building) else read_building(building)
    motions = grounds_of(grounds)
    for device in built.devices:
        where = f"the actuation of the damper at {device.name}"
        check_kind(where, device.unit, run.actuation_unit)
    model, bounds = run.predictor.model, {}
    dampers = draw_dampers(run.population, model, built, kind, draws, seed)
    if dampers.count and (model.slip_forces or model.laws):
        bounds = bound_dampers(run.population, model, built, dampers, seed)
    if not model.slip_forces:  # by which forces are judged to be in equilibrium
        typical = np.median([run.manifest.tests[name].peak_force for name in run.tests])
        dampers, *few = (
            replace(one, slip=np.full_like(one.slip, typical))
            for one in (dampers, *bounds.values())
        )
        bounds = dict(zip(bounds, few, strict=True))
    response = response_of(built, motions, dampers, tolerance, bounds, jobs, observe)
    remarks = [*chain.from_iterable(beyond_tests(run, response))]
    remarks += [run.caution] if run.caution else []
    remarks += _short_histories(built, motions)
    if dampers.count and run.population.design.dependence:
        remarks.append(
            "quantities that depend on speed, amplitude, date, cycles or temperature are taken at "
            "those of the typical, or the latest, test"
        )
    return replace(response, remarks=(*remarks, *response.faults))


def grounds_of(grounds: Grounds, *, unit: str = "", meant: bool = False) -> list[Ground]:
    """Ground motions of what is given; `unit` and `meant` are as in `read_ground`."""
    motions = []
    for given in [grounds] if isinstance(grounds, Ground | str | PathLike) else grounds:
        if isinstance(given, Ground):
            motions.append(given)
            continue
        path_of("a ground motion", given, BuildingError)
        path, step, own = parse_ground(fspath(given), of="ground")
        motions.append(read_ground(path, step=step, unit=own or unit, meant=meant))
    if not motions:
        raise BuildingError("give at least one ground motion")
    return motions


def check_kind(where: str, unit: str, expected: str) -> None:
    """Refuse an actuation whose internal unit is of another kind than the tests had."""
    if unit != expected:
        raise BuildingError(f"{where} must be {actuation_kind(expected)}, as in the campaign")


def _short_histories(building: Building, grounds: Sequence[Ground]) -> list[str]:
    """Actuation histories that do not go on for as long as a ground motion, in sentences."""
    sentences = []
    for device in building.devices:
        if device.history is None:
            continue
        begin, end = device.history[0][[0, -1]].tolist()
        for ground in grounds:
            last = float(ground.time[-1])
            if begin > MARGIN * last or end < (1 - MARGIN) * last:
                sentences.append(
                    f"the actuation of the damper at {device.name} is known from {begin:.4g} s to "
                    f"{end:.4g} s, and the ground motion {ground.name} goes on to {last:.4g} s: "
                    "the first and the last actuation are taken to stay"
                )
    return sentences


def beyond_tests(run: Run, response: Response) -> list[list[str]]:
    """Where the dampers leave what was tested: sentences of each ground motion, then of all.

    The stroke is that of the damper which travels most, in the median draw.
    """

    def sentences(name: str, unit: str, low: float, high: float, of: str = "") -> list[str]:
        outside = departures(run.tested, [Span(name, unit, low, high)])
        return [f"{of}beyond the tests: {each.sentence(run.system)}" for each in outside]

    if not response.dampers.count:
        return [[]]
    beyond = []
    for g, ground in enumerate(response.grounds):
        travel = response.travel[response.usable(g), g]
        stroke = 2.0 * float(np.median(travel.max(axis=1))) if len(travel) else np.nan
        beyond.append(sentences("stroke", "in", stroke, stroke, f"{ground.name}: "))
    levels = np.concatenate(
        [
            [device.actuation] if device.history is None else device.history[1]
            for device in response.building.devices
        ]
    )
    return [*beyond, sentences("actuation", run.actuation_unit, levels.min(), levels.max())]
