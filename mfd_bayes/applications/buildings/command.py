"""The command `respond`: what it writes and prints."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.applications.buildings.building import Building, read_building
from mfd_bayes.applications.buildings.ground import Ground, parse_acceleration
from mfd_bayes.applications.buildings.options import RespondOptions
from mfd_bayes.applications.buildings.respond import beyond_tests, check_kind, grounds_of, respond
from mfd_bayes.applications.buildings.response import (
    REFERENCES,
    REST,
    STANDARD,
    Response,
    Row,
    Sweep,
    check_goal,
    parse_sweep,
    sweep_of,
    variance_shares,
)
from mfd_bayes.console import say, warn
from mfd_bayes.errors import BuildingError, UnitError
from mfd_bayes.jobs.job import Step
from mfd_bayes.jobs.progress import show_progress
from mfd_bayes.messages import counted
from mfd_bayes.population.design import SAME_LEVEL
from mfd_bayes.reporting.page import Units, picture, render_page
from mfd_bayes.reporting.symbols import unit_text
from mfd_bayes.reporting.tables import escape_tex, to_csv
from mfd_bayes.runs.findings import Fitness
from mfd_bayes.runs.folder import check_folder
from mfd_bayes.runs.run import Run, open_run
from mfd_bayes.runs.tested_range import Range
from mfd_bayes.runs.unit_system import SI, SYSTEMS, UnitSystem
from mfd_bayes.store.files import json_text, remove_file, write_bytes, write_text
from mfd_bayes.units import GRAVITY

if TYPE_CHECKING:
    import pandas as pd


Array = NDArray[np.float64]


def run_respond(options: RespondOptions) -> None:
    """Compute the response of a building with the device of a run; write and print it."""
    check_folder(options.folder, force=options.force)
    chosen = options.quantity, options.statistic
    if not options.sweep and chosen != (RespondOptions.quantity, RespondOptions.statistic):
        raise BuildingError(
            "--minimise and --statistic say what a sweep makes small: give --sweep too"
        )
    swept = parse_sweep(options.sweep) if options.sweep else None
    building = read_building(options.building)
    grounds = _grounds(options)
    run = replace(open_run(options.out, trust=options.trust_model), units=options.units)
    if swept is not None:
        check_kind("--sweep: the actuation", swept[1], run.actuation_unit)
        if not building.devices:
            raise BuildingError(f"--sweep needs a [[damper]] in {options.building}")
        check_goal(*chosen, building.limits)
    for ground in () if options.quiet else grounds:
        say(ground.words)
    with show_progress(quiet=options.quiet) as observe:
        view = _write_view(options, run, building, grounds, swept, observe)
    warn(view.remarks)
    for sentence in view.verdict:
        say(sentence)
    if view.sweep:
        say(view.sweep)
    if not options.quiet:
        say(f"look next at {options.folder / 'report.html'}")


def _grounds(options: RespondOptions) -> list[Ground]:
    """Ground motions as they are scaled."""
    scale = 1.0 if options.scale is None else options.scale
    if not (np.isfinite(scale) and scale > 0):
        raise BuildingError(f"--scale must be positive, got {scale}")
    if options.peak and options.scale is not None:
        raise BuildingError("give either --scale or --peak")
    meant = bool(options.peak)  # which replaces the file's
    grounds = grounds_of(list(options.grounds), unit=options.unit, scale=scale, meant=meant)
    if not options.peak:
        return grounds
    try:
        peak = parse_acceleration(options.peak)
    except UnitError as error:
        raise BuildingError(f"--peak: {error}") from error
    if not peak > 0:
        raise BuildingError(f"--peak must be positive, got {options.peak!r}")
    return [ground.with_peak(peak) for ground in grounds]


def _write_view(
    options: RespondOptions,
    run: Run,
    building: Building,
    grounds: Sequence[Ground],
    swept: tuple[Array, str] | None,
    observe: Callable[[Step], None],
) -> ResponseView:
    """Response of a building with the device of a run; page and tables are written."""
    system = SYSTEMS[run.system.name == "si"]

    def response_of(building: Building, prefix: str = "") -> Response:
        return respond(
            *(run, building, tuple(grounds), options.draws, options.seed),
            kind=options.kind,
            tolerance=options.tolerance,
            jobs=options.jobs,
            observe=lambda step: observe(replace(step, id=f"{prefix}{step.id}")),
        )

    sweep, remarks = None, tuple[str, ...]()
    response = response_of(building)
    if swept is not None:
        levels, unit = swept
        each = [
            response_of(
                building.at_level(level), f"{system.words([level], unit, actuation=True)}, "
            )
            for level in levels.tolist()
        ]
        try:
            sweep = sweep_of(swept, each, options.quantity, options.statistic, options.seed)
            remarks = sweep.remarks
        except BuildingError as error:  # the response at the file's own actuation is there
            remarks = (str(error),)
    response = replace(response, remarks=(*response.remarks, *remarks))
    view = view_of(run, response, sweep, options, system)
    write_response(options.folder, response, sweep, view, system)
    return view


def view_of(
    run: Run, response: Response, sweep: Sweep | None, options: RespondOptions, system: UnitSystem
) -> ResponseView:
    """What the page shows of a response."""
    dampers, grounds, rows = len(response.building.devices), response.grounds, response.rows()
    if not rows and sweep is None:
        raise BuildingError(
            f"every draw diverged under {', '.join(ground.name for ground in grounds)}: there is "
            "no response to write; expected ground motions, and a building, that its dampers can "
            "bear"
        )
    summary = (
        f"{response.draws} draws of kind {options.kind} of the device in "
        f"{run.folder.resolve().name}, {counted(dampers, 'damper')}, "
        f"{counted(len(grounds), 'ground motion')}, fundamental period "
        f"{response.building.modes.periods[0]:.3g} s."
    )
    shares: list[Row] = [
        {"quantity": name, "ground": ground.name, "shares": variance_shares(response, name, g)}
        for name in ("drift", "acceleration")
        for g, ground in enumerate(grounds)
    ]
    extrapolations, caution = beyond_tests(run, response), run.caution
    stated = {*chain.from_iterable(extrapolations), caution}
    mark, headline = _mark(response, extrapolated=any(extrapolations), use=run.use)
    imbalance = np.max(response.imbalance, where=~response.unstable, initial=0.0)
    facts = {
        "run": str(run.folder),
        "building": str(options.building),
        "ground motions": "; ".join(ground.words for ground in grounds),
        "kind, draws, seed": f"{options.kind}, {options.draws}, {options.seed}",
        "tolerance of peaks": f"{options.tolerance:g}",
        "largest energy not accounted for": f"{imbalance:.1e} of the input",
        "mfd_bayes": run.manifest.versions.get("mfd_bayes", ""),
    }
    return ResponseView(
        title=f"{response.building.title}: response with dampers",
        about=summary,
        mark=mark,
        headline=headline,
        verdict=_verdict(response, system, extrapolations, caution, shares),
        remarks=[remark for remark in response.remarks if remark not in stated],
        rows=rows,
        limits=response.limits(),
        shares=[row for row in shares if row["shares"]],
        sweep="" if sweep is None else sweep_sentence(sweep, run.tested, system),
        grounds=[ground.name for ground in grounds],
        dampers=dampers,
        metric=system is SI,
        provenance=facts,
    )


def _mark(response: Response, *, extrapolated: bool, use: str) -> tuple[str, str]:
    """Word of the verdict's colour, and the verdict in a few words.

    They rest on the draws that are not settled, on the tests and on the run.
    """
    bad = float(np.mean(response.unstable | response.unsettled))
    if use == Fitness.NOT_USABLE:
        return "fail", "✗ The run is not usable"
    if response.unstable.mean() > 0.01:
        return "fail", "✗ Some draws diverged"
    if bad > 0.1:
        return "fail", f"✗ Drifts may be off by more than {100.0 * response.tolerance:.2g} %"
    if extrapolated:
        return "care", "! Answered, but beyond the tests"
    if bad or use == Fitness.WITH_CARE:
        return "care", "! Answered, with care"
    return "pass", "✓ Answered"


def _verdict(
    response: Response,
    system: UnitSystem,
    extrapolations: list[list[str]],
    use: str,
    shares: Sequence[Row],
) -> list[str]:
    """The answer in sentences, verdict first; beside each, where it lies beyond the tests."""
    sentences = []
    ratios = bool(np.all(np.isfinite(response.building.heights)))
    factor, unit = (100.0, "%") if ratios else (system.factor("in"), system.length)
    scale = factor / response.building.heights if ratios else factor
    for g, ground in enumerate(response.grounds):
        values = (response.drift_ratio if ratios else response.drift)[response.usable(g), g]
        if not len(values):
            sentences.append(f"{ground.name}: every draw diverged.")
            continue
        low, middle, high = factor * np.quantile(values.max(axis=1), [0.025, 0.5, 0.975])
        bare = float(np.max(response.bare.drift[0, g] * scale))
        sentences.append(
            f"{ground.name}: the largest storey drift is {middle:.3g} {unit} (95 % band "
            f"{low:.3g} to {high:.3g} {unit}); without dampers {bare:.3g} {unit}."
        )
        ends = {
            name: float(np.max(response.references[name].drift[0, g] * scale))
            for name in ("lower", "upper")
            if name in response.references and not response.references[name].unstable[0, g]
        }
        if ends:
            named = ", ".join(f"{name} {end:.3g} {unit}" for name, end in ends.items())
            label = f"{ground.name}: with all dampers at their bound, {named}"
            sentences.append(f"{label}{_not_bounding(ends, middle)}.")
        at_factors = [
            float(np.max(response.references[name].drift[0, g] * scale))
            for name in STANDARD
            if name in response.references and not response.references[name].unstable[0, g]
        ]
        if len(at_factors) == len(STANDARD):
            low, high = at_factors
            sentences.append(
                f"{ground.name}: with all dampers at the standard's λ_min {low:.3g} {unit}, at its "
                f"λ_max {high:.3g} {unit}."
            )
        if of_drift := shares[g]["shares"]:
            remainder = of_drift[REST]
            source, share = max(
                ((name, share) for name, share in of_drift.items() if name != REST),
                key=lambda pair: pair[1],
            )
            suffix = (
                f"; {100 * remainder:.0f} % is of no single source" if remainder > share else ""
            )
            sentences.append(
                f"{ground.name}: {100 * share:.0f} % of the variance of the largest drift is "
                f"{source}{suffix}."
            )
        sentences += (
            [f"{sentence}." for sentence in extrapolations[g]] if response.dampers.count else []
        )
    sentences += _at_rest(response, scale, unit, system)
    sentences += [f"{sentence}." for sentence in extrapolations[-1]]
    sentences += [use] if use else []
    for limit in response.limits():
        if limit["draws"]:
            low, high = (100 * end for end in limit["interval"])
            sentences.append(
                f"{limit['ground']}: the limit of the {limit['quantity']} is exceeded in "
                f"{limit['passed']} of {limit['draws']} draws: a probability of "
                f"{100 * limit['probability']:.3g} % (95 % interval {low:.3g} to {high:.3g} %)."
            )
    return sentences


def _not_bounding(ends: Mapping[str, float], median: float) -> str:
    """What to say of drifts with all dampers at a bound between which the median does not lie."""
    if len(ends) < 2 or min(ends.values()) <= median <= max(ends.values()):
        return ""
    side = "below" if max(ends.values()) < median else "above"
    return f": both are {side} the median of the draws and do not bound it, use the band"


def _at_rest(response: Response, scale: Array | float, unit: str, system: UnitSystem) -> list[str]:
    """That the force of dampers at rest is subtracted, and how much it is; none where it is 0.

    `scale` takes drifts (S,), in, to what is shown in `unit`.
    """
    dampers, building = response.dampers, response.building
    if not dampers.count:
        return []
    forces = dampers.at_rest
    if not np.any(np.abs(forces) > 1e-3 * dampers.slip):
        return []
    moved = np.linalg.solve(building.stiffness, building.travels.T @ forces.T)
    drift = np.max(np.abs(scale * (building.drifts @ moved).T), axis=1)
    force, shift = np.quantile([np.abs(forces).max(axis=1), drift], 0.95, axis=1).tolist()
    return [
        "Drift is counted from the building at rest: the force that a damper holds there, in 95 % "
        f"of the draws up to {system.words([force], 'kip', 2)}, is subtracted; by itself it would "
        f"move a storey by up to {shift:.2g} {unit}."
    ]


def write_response(
    folder: Path, response: Response, sweep: Sweep | None, view: ResponseView, system: UnitSystem
) -> None:
    """Write page, tables and pictures; what an earlier response left beside them is removed."""
    from mfd_bayes.applications.buildings.figures import figures_of
    from mfd_bayes.reporting.figures import to_png

    for path in sorted(folder.glob("*")):  # files that not every response has
        if re.fullmatch(r"sweep\.(csv|png)|(history|loops)_\d+\.png", path.name):
            remove_file(path)
    head = {"title": view.title, "verdict": view.verdict, "remarks": view.remarks}
    write_text(folder / "response.json", response_json(view.rows, view.limits, head, system))
    write_text(folder / "peaks.tex", peaks_tex(view.rows, system))
    frames = {
        "peaks": peaks_frame(view.rows, system),
        "limits": limits_frame(view.limits, system),
        "shares": shares_frame(view.shares),
        "draws": draws_frame(response, system),
    } | ({} if sweep is None else {"sweep": sweep_frame(sweep, system)})
    for name, frame in frames.items():
        write_text(folder / f"{name}.csv", to_csv(frame.replace([np.inf, -np.inf], np.nan)))
    images = {}
    for target in SYSTEMS:
        for name, figure in figures_of(response, sweep, target):
            images[f"{name}_{target.name}"] = to_png(figure)
            if target is system:
                write_bytes(folder / f"{name}.png", images[f"{name}_{target.name}"])
    write_text(folder / "report.html", render_response(view, images))


# --- the page and the tables


@dataclass(frozen=True)
class ResponseView:
    """What the page shows."""

    title: str
    about: str
    mark: str  # "pass", "care" or "fail"
    headline: str  # the verdict in a few words
    verdict: list[str]
    remarks: list[str]
    rows: list[Row]  # of `Response.rows`
    limits: list[Row]  # of `Response.limits`
    shares: list[Row]  # for each quantity and ground motion
    sweep: str  # the best actuation in a sentence; empty without a sweep
    grounds: list[str]
    dampers: int
    metric: bool
    provenance: Mapping[str, object]

    @property
    def sources(self) -> list[str]:
        """All sources of variance, in their order."""
        return list(dict.fromkeys(name for row in self.shares for name in row["shares"]))


def render_response(view: ResponseView, images: Mapping[str, bytes]) -> str:
    """HTML of the page; `images` are PNGs by "profile_us", "profile_si" and so on."""
    units = Units(SYSTEMS, view.metric, _factor_and_name)
    pictures = {name: picture(name, png) for name, png in images.items()}
    return render_page("response.html.j2", units, view=view, pictures=pictures)


def shown_unit(unit: str, system: UnitSystem) -> tuple[str, float]:
    """Unit in which a quantity is shown, and the factor to it: accelerations in g."""
    if unit == "in/s^2":
        return "g", 1.0 / GRAVITY
    if unit == "1":
        return "%", 100.0
    if unit == "kip*in":
        name = "kip*in" if system.name == "us" else "kN*mm"
        return name, system.factor("kip") * system.factor("in")
    return system.unit(unit), system.factor(unit)


def _factor_and_name(unit: str, system: UnitSystem) -> tuple[float, str]:
    name, factor = shown_unit(unit, system)
    return factor, unit_text(name) or name


def _in_system(row: Row, system: UnitSystem) -> Row:
    """A row in the unit in which a system shows it."""
    unit, factor = shown_unit(row["unit"], system)
    names = ("median", "mean", "limit", *REFERENCES, *STANDARD)
    figures = {name: factor * row[name] for name in names if name in row}
    if "bands" in row:
        figures["bands"] = {p: [factor * end for end in band] for p, band in row["bands"].items()}
    return row | {"unit": unit} | figures


def peaks_frame(rows: Iterable[Row], system: UnitSystem) -> pd.DataFrame:
    """Peaks and bands, a line each."""
    import pandas as pd

    names = ("without_dampers", "plain_friction", "all_at_lower_bound", "all_at_upper_bound")
    columns = dict(zip(REFERENCES, names, strict=True)) | {n: f"all_at_{n}" for n in STANDARD}
    lines = []
    for row in rows:
        peak = _in_system(row, system)
        references = {name: peak.pop(key) for key, name in columns.items() if key in peak}
        for share, (low, high) in peak.pop("bands").items():
            peak |= {f"lower_{share}": low, f"upper_{share}": high}
        lines.append(peak | references)
    return pd.DataFrame(lines, columns=None if lines else ["quantity", "ground", "place", "unit"])


def limits_frame(limits: Iterable[Row], system: UnitSystem) -> pd.DataFrame:
    """Probabilities of passing limits."""
    import pandas as pd

    names = ["quantity", "ground", "limit", "unit", "passed", "draws", "probability"]
    ends = ("lower_95", "upper_95")
    lines = [
        _in_system(row, system) | dict(zip(ends, row["interval"], strict=True)) for row in limits
    ]
    return pd.DataFrame(lines, columns=[*names, *ends])


def shares_frame(shares: Iterable[Row]) -> pd.DataFrame:
    """Shares of variance."""
    import pandas as pd

    lines = [(r["quantity"], r["ground"], *pair) for r in shares for pair in r["shares"].items()]
    return pd.DataFrame(lines, columns=["quantity", "ground", "source", "share"])


def draws_frame(response: Response, system: UnitSystem) -> pd.DataFrame:
    """The largest of each quantity over the building, for each draw and ground motion."""
    import pandas as pd

    draw, ground = (index.ravel() for index in np.indices((response.draws, len(response.grounds))))
    names = np.array([motion.name for motion in response.grounds], dtype=object)
    columns = {
        "draw": draw,
        "ground": names[ground],
        f"drift_{system.length}": response.measure("drift") * system.factor("in"),
        "acceleration_g": response.measure("acceleration"),
        f"base_shear_{system.force}": response.measure("base_shear") * system.factor("kip"),
        "step_s": response.steps,
        "change": response.change,
        "unstable": response.unstable.astype(int),
        "settled": (~(response.unstable | response.unsettled)).astype(int),
    }
    return pd.DataFrame({name: np.ravel(values) for name, values in columns.items()})


def sweep_frame(sweep: Sweep, system: UnitSystem) -> pd.DataFrame:
    """Drift and acceleration against the actuation."""
    import pandas as pd

    unit, by_level = shown_unit(sweep.unit, system)
    measures = {"drift": (system.length, system.factor("in")), "acceleration": ("g", 1.0)}
    goal, by_score = f"{sweep.quantity}_{sweep.goal}", 1.0
    if sweep.goal != "passing":  # a probability
        of, by_score = measures[sweep.quantity]
        goal += f"_{of}"
    columns = {f"actuation_{unit}": by_level * sweep.levels, goal: by_score * sweep.scores}
    for name, (of, factor) in measures.items():
        values = factor * np.reshape(sweep.values[name], (len(sweep.levels), -1))
        low, middle, high = np.quantile(values, [0.025, 0.5, 0.975], axis=1)
        statistics = {
            "median": middle,
            "mean": values.mean(axis=1),
            "lower_95": low,
            "upper_95": high,
        }
        columns |= {
            f"{name}_{statistic}_{of}": numbers for statistic, numbers in statistics.items()
        }
    return pd.DataFrame(columns)


def response_json(rows: Iterable[Row], limits: Iterable[Row], head: Row, system: UnitSystem) -> str:
    """All rows and limits as JSON, in the units of the tables."""
    peaks, passing = ([_in_system(row, system) for row in table] for table in (rows, limits))
    return json_text({**head, "peaks": peaks, "limits": passing}, indent=2) + "\n"


def peaks_tex(rows: Iterable[Row], system: UnitSystem) -> str:
    """Peaks of the storeys as a LaTeX table in the manner of booktabs."""
    import pandas as pd

    lines = []
    for row in (_in_system(row, system) for row in rows):
        if not row["quantity"].startswith("damper"):
            low, high = row["bands"]["95"]
            quantity = f"{row['quantity']}, {row['unit']}"
            names = map(escape_tex, (quantity, row["ground"], row["place"]))
            figures = f"{row['median']:.3g}", f"{low:.3g} to {high:.3g}", f"{row['bare']:.3g}"
            lines.append((*names, *figures))
    heads = ["Quantity", "Ground", "Place", "Median", r"95\,\% band", "Without dampers"]
    table = pd.DataFrame(lines, columns=heads).style.hide(axis="index")
    text = table.to_latex(hrules=True, column_format="lllrrr")
    return f"% Peaks of the response: median and equal-tailed 95 % band.\n{text}"


_GOALS = {
    "mean": "The mean of the largest {}",
    "q90": "The 90 % quantile of the largest {}",
    "passing": "The probability that the largest {} exceeds its limit",
}


def sweep_sentence(sweep: Sweep, tested: Sequence[Range], system: UnitSystem) -> str:
    """The best actuation with its interval, and what to do where it lies at an end.

    Where several levels are best alike, it says that none of them is better. `tested` is what the
    calibrated tests cover, with their actuation.
    """

    def words(*levels: float) -> str:
        return system.words(levels, sweep.unit, 3, actuation=True)

    goal = _GOALS[sweep.goal].format(sweep.quantity)
    ties, optimum = sweep.lowest, f"smallest at {words(sweep.best)}"
    lowest = highest = sweep.best
    if ties.size > 1:
        lowest, highest = float(ties[0]), float(ties[-1])
        alike, remark = f"{ties.size} levels", f"{words(lowest, highest)}: none of them is better"
        if ties.size == np.isfinite(sweep.scores).sum():
            return f"{goal} is the same at all {alike}, {remark}."
        optimum = f"smallest at {alike} alike, {remark}"
    text = f"{goal} is {optimum} (90 % interval: {words(*sweep.interval)})."
    span = next(span for span in tested if span.name == "actuation")
    low, high = span.lowest * (1.0 - SAME_LEVEL), span.highest * (1.0 + SAME_LEVEL)
    if not low <= lowest <= highest <= high:
        return (
            f"{text} No test was made there (tests: {span.words(system)}): make one before you "
            "use this actuation."
        )
    if sweep.best not in (sweep.levels[0], sweep.levels[-1]):
        return text
    lower = sweep.best == sweep.levels[0]
    end, side = ("lower", "below") if lower else ("upper", "above")
    margin = (1.0 - SAME_LEVEL) if lower else (1.0 + SAME_LEVEL)
    if low < margin * sweep.best if lower else high > margin * sweep.best:
        return f"{text} This is the {end} end of the sweep: sweep further."
    return (
        f"{text} This is the {end} end of the sweep and of the tests: make a test {side} it before "
        "you sweep further."
    )
