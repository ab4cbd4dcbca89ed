"""The response of a building whose dampers are the device of a run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from os import PathLike, fspath

import numpy as np

from mfd_bayes.errors import BuildingError
from mfd_bayes.friction.model import Model
from mfd_bayes.jobs.job import Step
from mfd_bayes.population.population import Population
from mfd_bayes.records.numbers import real_number, whole_number
from mfd_bayes.records.regular import path_of
from mfd_bayes.response.analysis import Analysis
from mfd_bayes.response.building import Building, read_building
from mfd_bayes.response.device_draws import Choice, bound_dampers, draw_dampers
from mfd_bayes.response.ground import Ground, parse_ground, read_ground
from mfd_bayes.response.result import Response
from mfd_bayes.response.step_refinement import Accuracy
from mfd_bayes.runs.systems import System
from mfd_bayes.runs.tested import MARGIN, Departure, Span
from mfd_bayes.units import actuation_kind


@dataclass(frozen=True, eq=False)
class Source:
    """The calibrated device that the dampers are: what a run knows of it."""

    population: Population
    model: Model
    actuation_unit: str
    tested: tuple[Span, ...]
    system: System
    use: str = ""
    """What its run may be used for, in a sentence, unless it is usable without more."""


Grounds = Iterable[Ground | str | PathLike[str]] | Ground | str | PathLike[str]


def respond_of_run(
    source: Source,
    building: Building | str | PathLike[str],
    grounds: Grounds,
    *,
    draws: int = 300,
    seed: int = 1,
    kind: str = "new_test",
    tolerance: float = 0.01,
    jobs: int = 1,
    observe: Callable[[Step], None] = lambda step: None,
) -> Response:
    """Response of a building with the device of a run as its dampers.

    Parameters
    ----------
    building : Building or path
        As `read_building` reads it.
    grounds : Ground or path, or several
        Paths as `read_ground` reads them; "FILE:0.01s" gives the step of a file without one.
    draws, seed : int
    kind : {"new_test", "device"}
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
        When the building or a ground motion cannot be used, or the actuation is of another kind
        than the run's.
    """
    choice = Choice(kind, draws, seed)
    whole_number("jobs", jobs, 0, BuildingError)
    tolerance = real_number("tolerance", tolerance, BuildingError, (0.0, 1.0), inside=True)
    if not callable(observe):
        raise BuildingError(f"observe must be a function, got {observe!r}")
    built = building if isinstance(building, Building) else read_building(building)
    moved = grounds_of(grounds)
    check_actuation(source, built)
    dampers = draw_dampers(source.population, source.model, built, choice)
    bounds = (
        bound_dampers(source.population, source.model, built, dampers, choice)
        if dampers.count and (source.model.slip_forces or source.model.laws)
        else {}
    )
    accuracy = Accuracy(tolerance=tolerance)
    found = Analysis(built, moved, dampers, accuracy, bounds).respond(jobs, observe)
    beyond = beyond_tests(source.tested, source.system, source.actuation_unit, found)
    remarks = [
        *chain.from_iterable(beyond),
        *([source.use] if source.use else []),
        *uncovered(built, moved),
    ]
    if dampers.count and source.population.design.dependence:
        remarks.append(
            "quantities that depend on speed or amplitude are taken at those of the typical test"
        )
    return replace(found, remarks=(*remarks, *found.faults))


def grounds_of(grounds: Grounds, *, unit: str = "", meant: bool = False) -> list[Ground]:
    """Ground motions of what is given; `unit` and `meant` are as in `read_ground`.

    Raises
    ------
    BuildingError
        When there is none, or one is neither a ground motion nor a path of one.
    """
    if isinstance(grounds, Ground | str | PathLike):
        grounds = [grounds]
    elif isinstance(grounds, bytes | Mapping) or not isinstance(grounds, Iterable):
        raise BuildingError(
            f"grounds must be a Ground or a path, or several of them, got {type(grounds).__name__}"
        )
    found = [one if isinstance(one, Ground) else _read(one, unit, meant) for one in grounds]
    if not found:
        raise BuildingError("give at least one ground motion")
    return found


def _read(given: str | PathLike[str], unit: str, meant: bool) -> Ground:
    path_of("a ground motion", given, BuildingError)
    path, step, own = parse_ground(fspath(given), of="ground")
    return read_ground(path, step=step, unit=own or unit, meant=meant)


def check_actuation(source: Source, building: Building) -> None:
    """Refuse dampers that are actuated by another kind of quantity than the tests were."""
    for device in building.devices:
        where = f"the actuation of the damper at {device.name}"
        check_kind(where, device.unit, source.actuation_unit)


def check_kind(where: str, unit: str, wanted: str) -> None:
    """Refuse an actuation whose internal unit is of another kind than the tests had."""
    if unit != wanted:
        raise BuildingError(f"{where} must be {actuation_kind(wanted)}, as in the campaign")


def uncovered(building: Building, grounds: Sequence[Ground]) -> Iterator[str]:
    """Actuation histories that do not go on for as long as a ground motion, in sentences."""
    for device in building.devices:
        if device.history is None:
            continue
        begin, end = (float(device.history[0][i]) for i in (0, -1))
        for ground in grounds:
            last = float(ground.time[-1])
            if begin > MARGIN * last or end < (1 - MARGIN) * last:
                yield (
                    f"the actuation of the damper at {device.name} is known from {begin:.4g} s to "
                    f"{end:.4g} s, and the ground motion {ground.name} goes on to {last:.4g} s: "
                    "the first and the last actuation are taken to stay"
                )


def beyond_tests(
    tested: Sequence[Span], system: System, unit: str, response: Response
) -> list[list[str]]:
    """Where the dampers leave what was tested: sentences of each ground motion, then of all.

    The stroke is that of the damper which travels most, in the median draw.
    """
    known = {span.name: span for span in tested}

    def sentences(asked: Span, name: str = "") -> list[str]:
        own = known.get(asked.name)
        if own is None or (
            own.lowest * (1 - MARGIN) <= asked.lowest
            and asked.highest <= own.highest * (1 + MARGIN)
        ):
            return []
        return [f"{name}beyond the tests: {Departure(asked, own).sentence(system)}"]

    if not response.dampers.count:
        return [[]]
    found = []
    for g, ground in enumerate(response.grounds):
        travel = response.travel[response.usable(g), g]
        stroke = 2.0 * float(np.median(travel.max(axis=1))) if len(travel) else np.nan
        span = Span("stroke", "in", stroke, stroke)
        found.append(sentences(span, f"{ground.name}: ") if len(travel) else [])
    levels = [
        float(end)
        for device in response.building.devices
        for along in [device.actuation if device.history is None else device.history[1]]
        for end in (np.min(along), np.max(along))
    ]
    return [*found, sentences(Span("actuation", unit, min(levels), max(levels)))]
