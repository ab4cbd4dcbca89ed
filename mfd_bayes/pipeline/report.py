"""The report of a finished run."""

from __future__ import annotations

from dataclasses import replace

from mfd_bayes.applications.properties.datasheet import datasheet
from mfd_bayes.applications.properties.harmonic import parse_condition
from mfd_bayes.applications.properties.page import TABLES, standard_view
from mfd_bayes.errors import MfdError, ReportError
from mfd_bayes.evaluation.assessment import write_assessment
from mfd_bayes.evaluation.sensitivity import JointDensity, law_rows
from mfd_bayes.evaluation.summary import assess, verdicts
from mfd_bayes.evaluation.views import CampaignView
from mfd_bayes.jobs.job import Observe, Step, Workplace
from mfd_bayes.jobs.local import get_ready
from mfd_bayes.reporting.options import ReportOptions
from mfd_bayes.reporting.page import Addition, check_forms
from mfd_bayes.reporting.tables import CROSSVALIDATION
from mfd_bayes.runs.folder import alone_in, check_places
from mfd_bayes.runs.manifest import read_manifest
from mfd_bayes.runs.run import Run, open_run, rewrite_manifest
from mfd_bayes.runs.unit_system import SI, named_system


def report(
    options: ReportOptions, observe: Observe = lambda _: None, *, jobs: int = 0
) -> CampaignView:
    """Write the tables, figures and report of a finished run, from its stored results."""
    folder = options.out
    check_forms(options, tuple(read_manifest(folder).tests))  # no lock for what is no finished run
    if Workplace(jobs).processes > 1:
        get_ready("mfd_bayes.reporting.figures")
    with alone_in(folder):
        check_places(folder)
        run = open_run(folder, trust=options.trust_model)
        return write_report(run, observe, jobs=jobs, options=options)


def write_report(
    run: Run, observe: Observe, *, jobs: int, options: ReportOptions | None = None
) -> CampaignView:
    """Write the tables, figures and report of an open run, whose folder must be locked."""
    from mfd_bayes.reporting.page import publish

    options = options or ReportOptions(run.folder)
    try:
        conditions = [
            parse_condition(text, run.actuation_unit, run.system.axes) for text in options.at
        ]
    except MfdError as error:
        raise ReportError(f"--at: {error}") from error
    processes = Workplace(jobs).processes
    observe(Step("report", "checks and bands"))
    system = named_system(options.units, run.system)
    # once, and of these tests: what an earlier report has stored may be of others
    run = run.with_peaks()
    view = replace(assess(run, processes), metric=system.name == SI.name)
    additions: list[Addition] = []
    if options.next_test:
        from mfd_bayes.applications.next_test.advice import AdviceInWords
        from mfd_bayes.applications.next_test.next_test import next_test

        observe(Step("report", "which test next"))
        advice = AdviceInWords(next_test(run), view.system, view.actuation_unit)
        additions = [advice.section()]
    run = rewrite_manifest(run, verdicts=verdicts(view), warnings=view.warnings)
    if view.left_out is None:  # a table that an earlier cross-validation wrote
        (run.folder / CROSSVALIDATION).unlink(missing_ok=True)
    observe(Step("report", "data sheet"))
    shown = replace(run, units=system.name)
    joint = JointDensity.of(run)
    view = replace(view, sensitivity=law_rows(run, joint))
    sheet = datasheet(shown, conditions, joint) if run.tests else None
    if run.tests and (standard := standard_view(shown)):
        additions.append(standard.section())
    else:  # tables of a standard that an earlier campaign named
        for name in TABLES:
            (run.folder / name).unlink(missing_ok=True)
    publish(view, options, processes, observe, sheet, additions)
    write_assessment(run.folder, view, run.manifest.files, run.system)
    return view
