"""The command `predict`: what it writes and prints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mfd_bayes.applications.prediction.comparison import Compared, compare
from mfd_bayes.applications.prediction.options import PredictOptions
from mfd_bayes.campaign.guesses import guess_columns
from mfd_bayes.campaign.schema import CampaignFile
from mfd_bayes.console import figures, print_rows, say, warn
from mfd_bayes.errors import CampaignError, StoreError
from mfd_bayes.evaluation.bounds import design_rows, design_warnings, n_draws, places_of
from mfd_bayes.evaluation.properties import predicted_rows
from mfd_bayes.evaluation.scores import Rows, fan_of_band, width_sentence
from mfd_bayes.population.bands import DRAWS, KIND_NAMES, Band
from mfd_bayes.records.readers import read_table
from mfd_bayes.records.record import Record, Source, parse_window, read_record
from mfd_bayes.records.trace import Trace, parse_sine
from mfd_bayes.reporting.tables import _by_column, _csv, convert_rows
from mfd_bayes.runs.folder import check_outputs
from mfd_bayes.runs.model_average import ModelAverage
from mfd_bayes.runs.run import actuation_level, open_run
from mfd_bayes.runs.stated import stated_actuation, stated_conditions
from mfd_bayes.runs.tested_range import extrapolation_messages
from mfd_bayes.runs.unit_system import UnitSystem
from mfd_bayes.store.files import remove_file, write_bytes, write_text
from mfd_bayes.units import Axes, parse_quantity, percent

MOST = 40_000
"""Most samples of a motion that is predicted as it is; more would take gigabytes."""


@dataclass(frozen=True, eq=False)
class Answer:
    """A prediction: its band, kip; its derived quantities in the units of `system`.

    `compared` is None where no measured force was to be compared, `design` empty where mean and
    bounding properties were not asked for. `judged` says which measured values lie outside their
    intervals, and `disagrees` whether the prediction does not hold for the record.
    """

    band: Band
    derived: Rows
    system: UnitSystem
    compared: Compared | None
    design: Rows
    judged: str
    disagrees: bool

    @property
    def name(self) -> str:
        """What the band is about, in the words of design."""
        return KIND_NAMES[self.band.kind]


def run_predict(options: PredictOptions) -> None:
    """Predict a force, and print what there is to say of it and where its tables are."""
    answer = predict(options)
    band = answer.band
    warn(map(answer.system.text, band.remarks))
    say(
        f"{band.interval} {percent(band.probability)} % band of kind {band.kind} "
        f"({answer.name}), from {band.source}: {options.bands}"
        f"{f' and {options.picture}' if options.figures else ''}"
    )
    if answer.compared is not None:
        say(answer.compared.sentence(answer.system))
        if answer.judged:
            warning = "warning: " if answer.disagrees else ""
            say(f"{warning}{answer.judged}", err=answer.disagrees)
    if options.explain and band.variance_shares:
        if not options.quiet:
            ordered = sorted(band.variance_shares.items(), key=lambda item: -item[1])
            rows = [(name, f"{100 * share:.0f} %") for name, share in ordered]
            print_rows("What makes the band wide", ("source", "share of the variance"), rows)
        say(width_sentence(band.variance_shares))
    if answer.design:
        _print_design(answer.design, band.probability)
    if not options.quiet:
        title = answer.system.text("Derived quantities, of the damper without offset and noise")
        low, high = (f"{percent(0.5 * (1 + side * band.probability))} %" for side in (-1, 1))
        keys = ("mean", "sd", "lower", "median", "upper", "measured")
        print_rows(
            title,
            ("quantity", "unit", "mean", "sd", low, "50 %", high, "measured"),
            [(r["name"], r["unit"], *figures(r[key] for key in keys)) for r in answer.derived],
            folded=0,
            caption="; ".join(f"{r['name']} {r['note']}" for r in answer.derived if r["note"]),
        )
        say(f"look next at {options.beside('derived.csv')}")


def predict(options: PredictOptions) -> Answer:
    """Force band for a motion and an actuation, and derived quantities; both are written."""
    check_options(options)
    run, *other_runs = (
        open_run(folder, trust=options.trust_model) for folder in (options.out, *options.others)
    )
    options = replace(options, actuation=stated_actuation(run, options.actuation))
    conditions = stated_conditions(options)
    run, *other_runs = (
        replace(member, conditions=conditions, units=options.units) for member in (run, *other_runs)
    )
    source = ModelAverage((run, *other_runs)) if other_runs else run
    level = actuation_level(run, options.actuation)
    motion, remarks, record = _motion_of(options, run.manifest.settings, run.system.axes)
    measured = replace(motion, actuation=level)  # with its force, if the file has one
    trace = replace(measured, force=None)
    test_name = options.test if options.test in run.tests else ""
    far = extrapolation_messages(run.extrapolations(trace, test_name), run.system)
    if far and not options.extrapolate:
        raise CampaignError(f"{far}; give --extrapolate to predict it all the same")
    target = measured if options.compare else trace
    design: Rows = ()
    request = measured if options.condition_on else trace, options.kind, options.probability
    how: dict[str, Any] = {
        "simultaneous": options.simultaneous,
        "condition_on": _window(options),
        "after": options.after,
        "session": options.session,
    }
    if not other_runs:
        how |= {"test": options.test, "device": options.device}
        # without sessions the tables of --design are then of the same draws
        how["draws"] = max(n_draws(places_of(run)), DRAWS) if options.design else DRAWS
    band = source.predict(*request, **how)
    compared_with = record if options.compare else None
    context = options.after, measured, options.device, options.session
    rows = predicted_rows(source, trace, band, compared_with, *context)
    if options.design:
        remarks += design_warnings(run)
        design = design_rows(run, trace, options.probability)
        if run.manifest.standard is not None:
            from mfd_bayes.applications.properties import standard_bounds

            design = (*design, *standard_bounds(run, trace.reference_actuation, design))
    band = replace(band, remarks=(*band.remarks, *remarks))
    compared, judged, disagrees = None, "", False
    if target.force is not None:
        compared = compare(band, target)
        judged, disagrees = compared.judged(rows)
    answer = Answer(
        band,
        convert_rows(rows, run.system),
        run.system,
        compared,
        convert_rows(design, run.system),
        judged,
        disagrees,
    )
    _write(options, target, answer, measured)
    return answer


def check_options(options: PredictOptions) -> None:
    """Refuse options that exclude each other, and to write over what exists, but for `force`."""
    if options.bands.suffix.lower() == ".png":
        raise StoreError(f"{options.bands} must not end in .png: the picture goes beside the table")
    for option, value, which in (
        ("--condition-on", _window(options), "the one whose first part is given"),
        ("--after", options.after, "one that follows another"),
        ("--session", options.session, "one of a session"),
    ):
        if value and options.design:
            raise CampaignError(
                f"--design cannot be combined with {option}: its properties are those of any test, "
                f"not of {which}"
            )
    for option in ("test", "explain", "design", "device"):
        if options.others and getattr(options, option):
            raise CampaignError(
                f"--{option} cannot be combined with --with: it is of one model alone"
            )
    names = ("history.png", "derived.csv", "design.csv")
    outputs = [options.bands, options.picture, *map(options.beside, names)]
    check_outputs(outputs, [options.motion] if options.motion else [], force=options.force)


def _window(options: PredictOptions) -> tuple[float, float] | None:
    """The time in which the measured force is used, s; None where none is."""
    text = options.condition_on
    numbered = text.replace(" to ", "").replace(" ", "").isdigit()
    return parse_window(text, of="--condition-on", timed=not numbered) if text.strip() else None


def _motion_of(
    options: PredictOptions, settings: CampaignFile, axes: Axes
) -> tuple[Trace, tuple[str, ...], Record | None]:
    """Motion that is asked for, a remark where it had to be thinned, and its record, if any.

    Its actuation is that of the command, whatever columns its file has.
    """
    if (options.motion is None) == (not options.sine):
        raise CampaignError("give one motion: --motion FILE, or --sine '1 in, 0.5 Hz, 3 cycles'")
    if options.motion is None:
        if options.compare or options.rate or options.condition_on:
            raise CampaignError(
                "--compare, --condition-on and --rate need a --motion file, not --sine"
            )
        return parse_sine(options.sine, axes).trace(0.0), (), None
    columns = motion_columns(options.motion, settings, axes)
    record = read_record(options.motion, columns, actuation=options.actuation, axes=axes)
    listing = ", ".join(f"{axes.name(role)}: {n} [{u}]" for role, (n, u) in record.columns.items())
    read = (f"columns read from {options.motion.name}: {listing}",) if columns else ()
    option = f"--condition-on {options.condition_on!r}" if options.condition_on else ""
    needs = "--compare" if options.compare else option
    if needs and record.force is None:
        raise CampaignError(
            f"{needs} needs a column of the {axes.response.name} in {options.motion}"
        )
    if options.rate and not axes.timed:
        raise CampaignError("--rate: samples are numbered, the model is rate-independent")
    if options.rate:
        rate = parse_quantity(options.rate, "rate", of="--rate")
        return _thinned(record, rate, _window(options)), read, record
    if record.time.size <= MOST:
        return record.trace(), read, record
    rate = record.rate * MOST / record.time.size
    remark = (
        f"the motion has {record.time.size} samples, more than the {MOST} that are predicted at "
        f"once: the band is given at {rate:.4g} Hz; --rate sets another"
    )
    return _thinned(record, rate, _window(options)), (*read, remark), record


def motion_columns(path: Path, settings: CampaignFile, axes: Axes) -> dict[str, Source] | None:
    """The campaign's columns that a file has, else those that init would take; None by its names.

    Of what init would only guess at from the numbers, or that lacks its unit, nothing is taken.
    """
    table = read_table(path)
    timed = bool(table.called("time"))
    stated = {r: c for r, c in settings.columns.given.items() if r != "actuation"}
    columns = {r: c.source for r, c in stated.items() if c.key in table.names or c.name is None}
    if not axes.of_damper:
        return columns or None
    if columns.keys() >= {"time", "displacement"} and not (columns["time"].rate and timed):
        return columns
    if {role for role in ("time", "displacement") if table.called(role)} == {
        "time",
        "displacement",
    }:
        return None
    roles = ("time", "displacement", "force")
    guesses = {r: g for r, g in guess_columns(table, axes).items() if r in roles}
    sure = {r: g.source for r, g in guesses.items() if g.unit and not g.doubts}
    return sure if sure.keys() >= {"time", "displacement"} else None


def _thinned(record: Record, rate: float, window: tuple[float, float] | None) -> Trace:
    """Record at a rate; what is known of its force in a window does not depend on the rest.

    The filter before the thinning would mix both: inside the window it sees the force at the
    window's ends instead of that beyond them.
    """
    trace = record.trace(rate)
    if window is None or record.force is None or trace.force is None:
        return trace
    begin, end = window
    mask = (record.time >= begin) & (record.time <= end)
    if not np.any(mask):  # which the prediction refuses
        return trace
    force = np.interp(record.time, record.time[mask], record.force[mask])
    window_trace = replace(record, force=force).trace(rate)
    in_window = (trace.time >= begin) & (trace.time <= end)
    return replace(trace, force=np.where(in_window, np.asarray(window_trace.force), trace.force))


def _write(options: PredictOptions, trace: Trace, answer: Answer, measured: Trace) -> None:
    """Write the tables and the pictures of a prediction; `measured` has a given part's force."""
    band, system = answer.band, answer.system
    actuated = system.axes.actuated
    title = system.text("Predicted force") + f" at {options.actuation}" * actuated
    head = [f"actuation {options.actuation}"] * actuated
    if answer.compared is not None:
        head.append(f"compared: {answer.compared.sentence(system)}")
        head += [answer.judged] if answer.judged else []
    write_text(options.bands, bands_csv(trace, band, head, system))
    level = options.actuation if actuated else ""
    derived = predicted_csv(answer.derived, level, options.probability, system.axes.response.name)
    write_text(options.beside("derived.csv"), derived)
    if answer.design:
        design = design_csv(answer.design, level, options.probability)
        write_text(options.beside("design.csv"), design)
    else:
        remove_file(options.beside("design.csv"))  # it is of an earlier prediction
    if not options.figures:
        remove_file(options.picture)
        remove_file(options.beside("history.png"))
        return
    from mfd_bayes.reporting.figures import draw_history, draw_loops, to_png

    fan = fan_of_band(band)
    window = band.conditioning.window if band.conditioning else None
    history = trace
    if band.conditioning is not None:
        title += f", given {options.condition_on}"
        if trace.force is None:  # the force of the given part alone
            force = np.where(band.conditioning.holds(band.time), np.asarray(measured.force), np.nan)
            history = replace(trace, force=force)
    loops = draw_loops(title, trace, [fan], system)
    write_bytes(options.picture, to_png(loops))
    figure = draw_history(title, history, [fan], system, given=window)
    write_bytes(options.beside("history.png"), to_png(figure))


def _print_design(rows: Rows, probability: float) -> None:
    """Print mean and bounding properties with their factors."""
    tail, keys = (
        50.0 * (1.0 - probability),
        ("nominal", "lower", "upper", "lower_ratio", "upper_ratio"),
    )
    notes = "; ".join(dict.fromkeys(f"{r['of']}, {r['note']}" for r in rows if r["note"]))
    print_rows(
        "Mean and bounding properties",
        ("property", "of", "unit", "nominal", "lower", "upper", "over nominal", ""),
        [
            (*(r["name"], r["of"], r["unit"]), *figures((r[key] for key in keys), 3))
            for r in rows
            if not r["note"]
        ],
        folded=2,
        caption=f"Each bound is exceeded with a probability of {tail:g} %, but for those "
        f"of a standard; last, the bounds over the nominal value. {notes}",
    )


# --- tables


def predicted_csv(rows: Rows, actuation: str, probability: float, force: str = "force") -> str:
    """Derived quantities of a prediction, with intervals of this probability."""
    head = (
        f"derived quantities of the device, without offset and noise, of kind {rows[0]['role']}: "
        f"equal-tailed {percent(probability)} % intervals",
        f"{actuation and f'actuation {actuation}; '}measured: of the {force} in the motion's file, "
        "as it is",
    )
    return _csv(head, _by_column("prediction", rows))


def design_csv(rows: Rows, actuation: str, probability: float) -> str:
    """Mean and bounding properties with their factors, by property, then by basis."""
    head = (
        "mean and bounding properties; each bound is exceeded with a probability of "
        f"{50.0 * (1.0 - probability):g} %",
        "lower_ratio, upper_ratio: bound over the nominal value, the mean of the mean property",
        *([f"actuation {actuation}"] if actuation else []),
    )
    return _csv(head, _by_column("design", rows))


def bands_csv(trace: Trace, band: Band, notes: Sequence[str], system: UnitSystem) -> str:
    """Band of a prediction at every sample, with the measured force of the trace if it has one.

    `notes` are lines of its head, besides what the band is; the columns are in the units of
    `system`.
    """
    forces = {"force": trace.force, "lower": band.lower, "median": band.median, "upper": band.upper}
    if band.shows_simultaneous:
        forces |= dict(
            zip(("simultaneous_lower", "simultaneous_upper"), band.simultaneous, strict=True)
        )
    columns: dict[str, Any] = {
        # may be seconds since 1970
        "time_s" if system.axes.timed else "sample": [f"{time:.15g}" for time in trace.time],
        system.column("displacement", "in"): trace.displacement * system.factor("in"),
    } | {
        system.column(name, "kip"): values * system.factor("kip")
        for name, values in forces.items()
        if values is not None
    }
    head = [
        f"{band.interval} {percent(band.probability)} % band of kind {band.kind} "
        f"({KIND_NAMES[band.kind]}), for each sample by itself; from {band.source}"
    ]
    if band.shows_simultaneous:
        head.append("simultaneous: band of the whole history, of the same probability")
    if band.conditioning is not None:
        columns["conditioned"] = band.conditioning.holds(trace.time).astype(int)
        head.append(system.text("conditioned: 1 where the force was given, 0 elsewhere"))
    head += [system.text(f"warning: {remark}") for remark in band.remarks] + list(notes)
    return _csv(head, columns, 8)
