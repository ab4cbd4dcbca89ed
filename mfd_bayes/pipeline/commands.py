"""The order of the stages, one function for each command."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from mfd_bayes.assessment import assess, fails, verdicts
from mfd_bayes.assessment.derived_rows import predicted_rows
from mfd_bayes.assessment.prior_check import prior_fan, share_inside
from mfd_bayes.assessment.views import (
    IDENTIFIABILITY,
    CampaignView,
    Check,
    DerivedRow,
    Fan,
    Interval,
    LeftOutView,
)
from mfd_bayes.calibration.prior_files import load_priors
from mfd_bayes.campaign.draft import Draft, campaign_text, doubts, draft_campaign, gaps
from mfd_bayes.campaign.file import load_campaign
from mfd_bayes.campaign.synthetic import write_campaign
from mfd_bayes.errors import CampaignError, MfdError, RecordError, StoreError
from mfd_bayes.jobs.dispatch import Workplace, check_workers
from mfd_bayes.jobs.job import State, Step
from mfd_bayes.pipeline.calibration import calibrate
from mfd_bayes.pipeline.plan import Options, Plan, plan_campaign
from mfd_bayes.population.predict import Band
from mfd_bayes.population.setting import setting_of
from mfd_bayes.records.faults import find_faults
from mfd_bayes.records.inspection import Inspection, inspect_record, same_record
from mfd_bayes.records.record import read_record
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.tables import (
    CROSSVALIDATION,
    bands_csv,
    comparison_csv,
    predicted_csv,
)
from mfd_bayes.runs.folder import MANIFEST, check_links, discard, sweep
from mfd_bayes.runs.lock import alone_in
from mfd_bayes.runs.manifest import read_begun
from mfd_bayes.runs.run import Run, open_run
from mfd_bayes.runs.verdict import Verdict
from mfd_bayes.store.files import write_bytes, write_json, write_text
from mfd_bayes.units import parse_actuation
from mfd_bayes.validation.folds import fold_id, folds_of, parts_of, run_folds
from mfd_bayes.validation.models import Comparison, check_cycles, check_models, compare_runs

__all__ = [
    "CampaignView",
    "Check",
    "Comparison",
    "Inspection",
    "MfdError",
    "Options",
    "Plan",
    "Question",
    "Step",
    "calibrate_campaign",
    "check",
    "compare",
    "crossvalidate",
    "demo",
    "doubts",
    "effort_of",
    "fails",
    "find_warnings",
    "gaps",
    "init",
    "inspect",
    "plan_campaign",
    "predict",
    "prior_check",
    "report",
]

Observe = Callable[[Step], None]


def calibrate_campaign(
    campaign: Path, out: Path, options: Options, observe: Observe
) -> CampaignView:
    """Calibrate a campaign into a folder and write its report.

    Raises
    ------
    MfdError
        When something cannot be used; nothing is written then.
    """
    calibrate(campaign, out, options, observe)
    return report(out, observe, jobs=options.jobs)


def effort_of(out: Path, asked: str | None, *, resume: bool) -> str:
    """Effort that is asked for, or else that of the run which is resumed, or "standard".

    Parameters
    ----------
    out : Path
        A run folder, or one that holds a run folder for each model.
    asked : str or None
    resume : bool
    """
    if asked is not None:
        return asked
    found = sorted(out.glob(f"*/{MANIFEST}"))
    for path in [out / MANIFEST, *found] if resume else ():
        if path.is_file():
            return str(read_begun(path.parent)["effort"]["name"])
    return "standard"


def crossvalidate(
    campaign: Path, out: Path, by: str, options: Options, observe: Observe
) -> CampaignView:
    """Calibrate a campaign, then predict every part of it from all the others.

    Parameters
    ----------
    campaign, out : Path
        As of `calibrate_campaign`; OUT/crossvalidation.csv is written besides.
    by : {"test", "level", "session"}
        What a part is.
    options : Options
    observe : callable

    Raises
    ------
    MfdError
        When something cannot be used, or there are too few parts; nothing is written then.
    """
    plan = plan_campaign(campaign, options)
    parts = _check_parts(plan, by)
    for name in (*(task.id for task in plan.tasks), *map(fold_id, parts)):
        observe(Step(name, State.WAITING))
    _leave_out_parts(calibrate(campaign, out, options, observe), by, options, observe)
    return report(out, observe, jobs=options.jobs)


def _check_parts(plan: Plan, by: str) -> Collection[str]:
    """Refuse what cannot be cross-validated before anything is sampled; names of the parts."""
    sessions = {test.id: test.session for test in plan.campaign.tests}
    settings = {task.id: setting_of(task.trace, sessions[task.id]) for task in plan.tasks}
    return parts_of(settings, by, plan.campaign.actuation_unit, plan.campaign.path)


def _leave_out_parts(run: Run, by: str, options: Options, observe: Observe) -> None:
    """Predict every part of a run from the others, and keep the scores in its manifest."""
    with alone_in(run.folder):
        try:
            found = run_folds(run, folds_of(run, by, options.effort), options, observe)
            stored = {"by": by, "predictions": [asdict(prediction) for prediction in found]}
            write_json(run.folder / MANIFEST, run.manifest | {"crossvalidation": stored})
        finally:
            sweep(run.folder)


def compare(
    campaign: Path,
    out: Path,
    models: Sequence[str],
    options: Options,
    observe: Observe,
    by: str = "",
) -> tuple[Comparison, dict[str, LeftOutView]]:
    """Calibrate a campaign once for each model into OUT/MODEL, and compare what they predict.

    Parameters
    ----------
    campaign : Path
    out : Path
        OUT/comparison.csv is written last.
    models : sequence of str
        Two or more of "three_stage", "lugre" and "bouc_wen".
    options : Options
        Its own `model` does not count.
    observe : callable
    by : {"", "test", "level", "session"}
        What is left out of each run in turn besides, as by `crossvalidate`.

    Returns
    -------
    Comparison, and how each model predicted what was left out, by model

    Raises
    ------
    MfdError
        When something cannot be used under one of the models; nothing is written then.
    """
    chosen = check_models(models)
    for model in chosen:
        plan = plan_campaign(campaign, replace(options, model=model))
        if by:
            _check_parts(plan, by)
        for task in plan.tasks:
            check_cycles(task)
            observe(Step(f"{model}/{task.id}", State.WAITING))
        if (out / model).exists() and not (options.resume or options.force):
            raise StoreError(
                f"{out / model} exists: give --resume to finish it or --force to replace it"
            )
    runs: dict[str, Run] = {}
    left_out: dict[str, LeftOutView] = {}
    for model in chosen:
        tell = _named(observe, model)
        runs[model] = calibrate(campaign, out / model, replace(options, model=model), tell)
        if by:
            _leave_out_parts(runs[model], by, options, tell)
    observe(Step("comparison", "leaving out one cycle after another"))
    found = compare_runs(runs)
    write_text(out / "comparison.csv", comparison_csv(found.rows))
    observe(Step("comparison", State.DONE))
    for model in chosen:
        manifest = read_begun(out / model)
        write_json(out / model / MANIFEST, manifest | {"comparison": asdict(found)})
        view = report(out / model, _named(observe, model), jobs=options.jobs)
        if by and view.left_out:
            left_out[model] = view.left_out
    return found, left_out


def _named(observe: Observe, model: str) -> Observe:
    """Observe the steps of one model's run, by its name."""
    return lambda step: observe(replace(step, id=f"{model}/{step.id}"))


def demo(out: Path, options: Options, observe: Observe) -> CampaignView:
    """Write a synthetic campaign under OUT/campaign, calibrate it, and report on it.

    Raises
    ------
    StoreError
        When the folder exists and is not to be replaced.
    """
    check_workers(options)
    check_links(out, ["campaign"])
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        if not options.force:
            raise StoreError(f"{out} exists: give --force to replace it")
        discard(out)
    truth = write_campaign(out / "campaign", options.seed)
    options = replace(options, force=False, resume=False)
    calibrate(out / "campaign" / "campaign.toml", out, options, observe, {"truth": truth})
    return report(out, observe, jobs=options.jobs)


def report(
    out: Path, observe: Observe = lambda _: None, *, jobs: int = 0, pdf: bool = False
) -> CampaignView:
    """Make the tables, figures and pages of a finished run from what is stored.

    Figures of many tests are drawn by so many processes, 0 for as many as there are processors.

    Raises
    ------
    StoreError
        When the folder is no finished run.
    ReportError
        When a PDF is asked for and no browser can print it; nothing is written then.
    """
    from mfd_bayes.reporting.pdf import find_browser
    from mfd_bayes.reporting.publication import publish

    if pdf:
        find_browser()
    observe(Step("report", "checks and bands"))
    run = open_run(out)
    view = assess(run)
    write_json(out / MANIFEST, run.manifest | {"verdicts": verdicts(view)})
    if view.left_out is None:  # of tests that have changed since
        (out / CROSSVALIDATION).unlink(missing_ok=True)
    publish(view, out, Workplace(jobs).processes, observe, pdf=pdf)
    return view


def check(out: Path) -> CampaignView:
    """Convergence and predictive checks of a finished run, and what is to be noted besides."""
    view = assess(open_run(out))
    told = [c for c in view.checks if c.name not in IDENTIFIABILITY or c.verdict != Verdict.PASS]
    return replace(view, checks=tuple(told))


@dataclass(frozen=True)
class Question:
    """A prediction that is asked for.

    Attributes
    ----------
    motion : Path
        A file with time and displacement.
    actuation : str
        Such as "1000 psi".
    kind : {"device", "new_test", "observation"}
    probability : float
    bands : Path
        CSV to write; a PNG and the derived quantities go beside it.
    compare : bool
        Whether the force that the motion's file holds is shown beside the prediction.
    """

    motion: Path
    actuation: str
    kind: str
    probability: float
    bands: Path
    compare: bool = False

    @property
    def derived(self) -> Path:
        """CSV of the derived quantities."""
        return self.bands.with_name(f"{self.bands.stem}_derived.csv")


def predict(out: Path, question: Question) -> tuple[Band, tuple[DerivedRow, ...]]:
    """Force band for a motion and an actuation, and what derives from it, written as files.

    Raises
    ------
    MfdError
        When the run, the motion, the actuation, the kind or the probability cannot be used.
    """
    if question.bands.suffix.lower() == ".png":
        raise StoreError(
            f"{question.bands} must not end in .png: the picture goes beside the table"
        )
    run = open_run(out)
    level, unit = parse_actuation(question.actuation, of="--actuation")
    if unit != run.actuation_unit:
        raise CampaignError(
            f"--actuation {question.actuation!r} must be a "
            f"{'pressure' if run.actuation_unit == 'ksi' else 'force'}, as in the campaign"
        )
    record = read_record(question.motion)
    motion = record.trace(gap=run.priors.gap)
    trace = Trace.from_arrays(motion.time, motion.displacement, level, velocity=motion.velocity)
    band = run.predict(trace, question.kind, question.probability)
    drawn = replace(trace, force=motion.force if question.compare else None)
    rows = predicted_rows(run, drawn, band)
    write_text(question.bands, bands_csv(trace, band, question.actuation))
    write_text(question.derived, predicted_csv(rows, question.actuation, question.probability))
    from mfd_bayes.reporting.figures import draw_loops, to_png

    fan = Fan(band.kind, band.median, (Interval(band.probability, band.lower, band.upper),))
    title = f"Predicted force at {question.actuation}"
    png = to_png(draw_loops(title, drawn, [fan]))
    write_bytes(question.bands.with_suffix(".png"), png)
    return band, rows


def init(folder: Path, *, force: bool = False) -> tuple[Path, Draft]:
    """Write a first campaign.toml of the test files in a folder: its path, and what it says.

    Raises
    ------
    MfdError
        When the folder holds no test, or a campaign.toml that is not to be replaced; nothing is
        written then.
    """
    path = folder / "campaign.toml"
    if path.exists() and not force:
        raise CampaignError(f"{path} exists: give --force to replace it")
    draft = draft_campaign(folder)
    write_text(path, campaign_text(draft))
    return path, draft


def inspect(path: Path, folder: Path) -> list[tuple[Inspection, Path]]:
    """What a test file, or every test of a campaign, holds; with a PNG each in `folder`.

    Raises
    ------
    MfdError
        When the file cannot be read or used.
    """
    if path.suffix.lower() == ".toml":
        campaign = load_campaign(path)
        gap = load_priors(campaign.priors, campaign.folder).gap
        found = [
            (inspect_record(t.id, t.read(), gap), f"{path.stem}_{t.id}") for t in campaign.tests
        ]
    else:
        found = [(inspect_record(path.name, read_record(path)), path.stem)]
    from mfd_bayes.reporting.figures import draw_inspection, to_png

    pictures = []
    for inspection, name in found:
        picture = folder / f"{name}_inspect.png"
        title = f"{inspection.name}: as read"
        figure = draw_inspection(title, inspection.trace, inspection.loops, inspection.faults)
        write_bytes(picture, to_png(figure))
        pictures.append((inspection, picture))
    return pictures


def find_warnings(plan: Plan) -> list[tuple[str, str]]:
    """What would spoil a fit of each test of a campaign: test's id and sentence."""
    gap = plan.priors.gap
    found: list[tuple[str, str]] = []
    known: dict[str, Trace] = {}
    for test in plan.campaign.tests:
        trace = test.read().trace()
        found += [(test.id, fault.sentence) for fault in find_faults(trace, gap)]
        twin = next((name for name, other in known.items() if same_record(trace, other)), None)
        if twin is not None:
            found.append((test.id, f"same record as {twin}: it would count twice"))
        known[test.id] = trace
    return found


def prior_check(path: Path, folder: Path) -> list[tuple[str, float, Path]]:
    """Prior predictive loops beside the data of every test, with a PNG each in `folder`.

    Returns
    -------
    list of (test's id, share of the measured force inside the 95 % prior band, picture)

    Raises
    ------
    MfdError
        When the campaign, its priors or a record cannot be used.
    """
    campaign = load_campaign(path)
    priors = load_priors(campaign.priors, campaign.folder)
    from mfd_bayes.reporting.figures import draw_loops, to_png

    found = []
    for test in campaign.tests:
        trace = test.read().trace(campaign.rate, gap=priors.gap)
        if trace.force is None:
            raise RecordError(f"test {test.id!r} of {path} has no force to compare with")
        fan = prior_fan(campaign, priors, trace)
        picture = folder / f"{path.stem}_{test.id}_prior.png"
        figure = draw_loops(f"{test.id}: data over what the priors allow", trace, [fan])
        write_bytes(picture, to_png(figure))
        found.append((test.id, share_inside(fan, trace), picture))
    return found
