"""The response of a building from a finished run, written as a folder with a page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.campaign.campaign import load_campaign
from mfd_bayes.errors import BuildingError, MfdError, UnitError
from mfd_bayes.jobs.job import Step
from mfd_bayes.pipeline.outputs import check_folder
from mfd_bayes.pipeline.response_files import write_response
from mfd_bayes.reporting.response import ResponseView, sweep_sentence
from mfd_bayes.response.building import Building, example_building, read_building
from mfd_bayes.response.ground import Ground, example_ground, parse_acceleration
from mfd_bayes.response.result import Response
from mfd_bayes.response.sweep import Sweep, check_goal, parse_sweep, sweep_of
from mfd_bayes.response.variance_shares import Shares, variance_shares
from mfd_bayes.runs.manifest import unchanged
from mfd_bayes.runs.response import beyond_tests, check_kind, grounds_of
from mfd_bayes.runs.run import Run, open_run
from mfd_bayes.runs.unit_system import SI, SYSTEMS, System
from mfd_bayes.runs.verdict import Use
from mfd_bayes.store.files import write_text

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Query:
    """What is asked of a building.

    Attributes
    ----------
    building : Path
    grounds : tuple of str
        Files, each perhaps with ":0.01s" for its step and ":g" for its unit.
    folder : Path
        Of the page and the tables.
    kind, draws, seed
        As in `Run.respond`.
    unit : str
        Of the accelerations of files that do not say it.
    scale : float, optional
        Factor of every ground motion.
    peak : str
        Peak to which every ground motion is scaled instead, such as "0.3 g".
    sweep : str
        Such as 'actuation="500 psi to 1500 psi"'.
    quantity, goal : str
        What the sweep makes small: drift or acceleration; mean, q90 or passing.
    """

    building: Path
    grounds: tuple[str, ...]
    folder: Path
    kind: str = "new_test"
    draws: int = 300
    seed: int = 1
    unit: str = ""
    scale: float | None = None
    peak: str = ""
    sweep: str = ""
    quantity: str = "drift"
    goal: str = "mean"
    tolerance: float = 0.01
    jobs: int = 0
    units: str = ""
    force: bool = False


@dataclass(frozen=True, eq=False)
class Found:
    """The response, the sweep if one was asked for, and the page."""

    response: Response
    sweep: Sweep | None
    view: ResponseView
    page: Path


def init_building(path: Path, *, force: bool = False) -> Path:
    """Write a first building file, and an artificial ground motion, ground.AT2, beside it.

    Raises
    ------
    BuildingError
        When one exists and `force` is not given; nothing is written then.
    """
    target = path / "building.toml" if path.is_dir() or path.suffix != ".toml" else path
    ground = target.with_name("ground.AT2")
    texts = {target: _with_actuation(example_building(), target.parent), ground: example_ground()}
    for place in texts:
        if place.exists() and not force:
            raise BuildingError(f"{place} exists: give --force to replace it")
    for place, text in texts.items():
        write_text(place, text)
    return target


def _with_actuation(text: str, folder: Path) -> str:
    """The text of a building with an actuation of the campaign beside it, if there is one."""
    try:
        tests = load_campaign(folder / "campaign.toml").tests
    except MfdError:  # none, or one that is not complete
        return text
    levels = [test.actuation for test in tests if test.actuation]
    return text.replace('"1000 psi"', f'"{levels[len(levels) // 2]}"') if levels else text


@dataclass(frozen=True, eq=False)
class Prepared:
    """What a query asks for, read and checked: nothing is computed yet."""

    query: Query
    run: Run
    building: Building
    grounds: tuple[Ground, ...]
    levels: tuple[Array, str] | None


def prepare(out: Path, query: Query) -> Prepared:
    """Run, building and ground motions of a query.

    Raises
    ------
    MfdError
        When the run, the building or a ground motion cannot be used, or the folder is not this
        command's.
    """
    check_folder(query.folder, force=query.force)
    if not query.sweep and (query.quantity, query.goal) != (Query.quantity, Query.goal):
        raise BuildingError("--minimise and --by say what a sweep makes small: give --sweep too")
    levels = parse_sweep(query.sweep) if query.sweep else None
    building = read_building(query.building)
    grounds = _grounds(query)
    run = replace(open_run(out), units=query.units)
    if levels is not None:
        check_kind("--sweep: the actuation", levels[1], run.actuation_unit)
        if not building.devices:
            raise BuildingError(f"--sweep needs a [[damper]] in {query.building}")
        check_goal(query.quantity, query.goal, building.limits)
    return Prepared(query, run, building, tuple(grounds), levels)


def respond(asked: Prepared, observe: Callable[[Step], None]) -> Found:
    """Response of a building with the device of a run; page and tables are written.

    Raises
    ------
    MfdError
        When every draw diverged, or something cannot be written.
    """
    query, run, levels = asked.query, asked.run, asked.levels
    system = SYSTEMS[run.system.name == "si"]

    def answer(of: Building, told: str = "") -> Response:
        return run.respond(
            *(of, asked.grounds, query.draws, query.seed),
            kind=query.kind,
            tolerance=query.tolerance,
            jobs=query.jobs,
            observe=lambda step: observe(replace(step, id=f"{told}{step.id}")),
        )

    with unchanged(run.folder, run.manifest):
        response = answer(asked.building)
        sweep = None
        if levels is not None:
            each = [
                answer(
                    asked.building.at_level(level),
                    f"{system.words([level], levels[1], actuation=True)}, ",
                )
                for level in levels[0].tolist()
            ]
            sweep, told = _swept(levels, each, query)
            response = replace(response, remarks=(*response.remarks, *told))
    view = view_of(run, response, sweep, query, system)
    write_response(query.folder, response, sweep, view, system)
    return Found(response, sweep, view, query.folder / "report.html")


def _swept(
    levels: tuple[Array, str], each: list[Response], query: Query
) -> tuple[Sweep | None, tuple[str, ...]]:
    """The sweep, if it says anything, and what is to be remarked of it."""
    try:
        sweep = sweep_of(levels, each, query.quantity, query.goal, query.seed)
    except BuildingError as error:  # the response at the file's own actuation is there
        return None, (str(error),)
    return sweep, sweep.remarks


def _grounds(query: Query) -> list[Ground]:
    meant = query.scale is not None or bool(query.peak)
    grounds = grounds_of(list(query.grounds), unit=query.unit, meant=meant)
    scale = 1.0 if query.scale is None else query.scale
    if not (np.isfinite(scale) and scale > 0):
        raise BuildingError(f"--scale must be positive, got {scale}")
    if query.peak:
        if query.scale is not None:
            raise BuildingError("give either --scale or --peak")
        try:
            peak = parse_acceleration(query.peak)
        except UnitError as error:
            raise BuildingError(f"--peak: {error}") from error
        if not peak > 0:
            raise BuildingError(f"--peak must be positive, got {query.peak!r}")
        return [ground.with_peak(peak) for ground in grounds]
    return [g if scale == 1.0 else g.scaled(scale) for g in grounds]


def view_of(
    run: Run, response: Response, sweep: Sweep | None, query: Query, system: System
) -> ResponseView:
    """What the page shows of a response."""
    several = len(response.grounds) > 1
    title = f"{response.building.title}: response with dampers"
    count = len(response.building.devices)
    about = (
        f"{response.draws} draws of kind {query.kind} of the device in "
        f"{run.folder.resolve().name}, {count} damper{'' if count == 1 else 's'}, "
        f"{len(response.grounds)} ground "
        f"motion{'s' if several else ''}, fundamental period "
        f"{response.building.modes.periods[0]:.3g} s."
    )
    imbalance = np.max(response.imbalance, where=~response.unstable, initial=0.0)
    shares = (
        Shares(name, ground.name, variance_shares(response, name, g))
        for name in ("drift", "acceleration")
        for g, ground in enumerate(response.grounds)
    )
    beyond, use = beyond_tests(run, response), run.caution
    told = {*chain.from_iterable(beyond), use}
    mark = _mark(response, alone=any(beyond), use=run.use)
    return ResponseView(
        title,
        about,
        mark,
        tuple(_verdict(response, system, beyond, use)),
        tuple(remark for remark in response.remarks if remark not in told),
        tuple(response.rows()),
        tuple(response.limits()),
        tuple(one for one in shares if one.shares),
        "" if sweep is None else sweep_sentence(sweep, run.tested, system),
        tuple(ground.name for ground in response.grounds),
        count,
        system is SI,
        {
            "run": str(run.folder),
            "building": str(query.building),
            "ground motions": "; ".join(ground.words for ground in response.grounds),
            "kind, draws, seed": f"{query.kind}, {query.draws}, {query.seed}",
            "tolerance of peaks": f"{query.tolerance:g}",
            "largest energy not accounted for": f"{imbalance:.1e} of the input",
            "mfd_bayes": run.manifest.versions.get("mfd_bayes", ""),
        },
        _headline(mark, alone=any(beyond), use=run.use),
    )


def _mark(response: Response, *, alone: bool, use: str) -> str:
    """Word of the verdict's colour: by the draws that are not settled, the tests and the run."""
    bad = float(np.mean(response.unstable | response.unsettled))
    if bad > 0.1 or response.unstable.mean() > 0.01 or use == Use.NOT_USABLE:
        return "fail"
    return "care" if bad or alone or use == Use.WITH_CARE else "pass"


def _headline(mark: str, *, alone: bool, use: str) -> str:
    """The verdict in a few words."""
    if mark == "fail":
        return "✗ The run is not usable" if use == Use.NOT_USABLE else "✗ Not settled"
    if alone:
        return "! Answered, but beyond the tests"
    return "! Answered, with care" if mark == "care" else "✓ Answered"


def _verdict(response: Response, system: System, beyond: list[list[str]], use: str) -> list[str]:
    """The answer in sentences, verdict first; beside each, where it lies beyond the tests."""
    found = []
    ratios = bool(np.all(np.isfinite(response.building.heights)))
    for g, ground in enumerate(response.grounds):
        used = response.usable(g)
        values = (response.drift_ratio if ratios else response.drift)[used, g]
        if not len(values):
            found.append(f"{ground.name}: every draw diverged.")
            continue
        by, unit = (100.0, "%") if ratios else (system.factor("in"), system.length)
        low, middle, high = by * np.quantile(values.max(axis=1), [0.025, 0.5, 0.975])
        bare = response.bare.drift[0, g]
        without = by * float(np.max(bare / response.building.heights if ratios else bare))
        found.append(
            f"{ground.name}: the largest storey drift is {middle:.3g} {unit} (95 % band "
            f"{low:.3g} to {high:.3g} {unit}); without dampers {without:.3g} {unit}."
        )
        found += [f"{sentence}." for sentence in (beyond[g] if response.dampers.count else [])]
    found += [f"{sentence}." for sentence in beyond[-1]]
    found += [use] if use else []
    for one in (limit for limit in response.limits() if np.isfinite(limit.probability)):
        found.append(
            f"{one.ground}: the limit of the {one.quantity} is exceeded with a probability of "
            f"{100 * one.probability:.3g} % (standard error {100 * one.error:.2g} %)."
        )
    return found
