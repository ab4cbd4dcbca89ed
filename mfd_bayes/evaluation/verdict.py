"""The whole report: every test, the laws, the verdict, and the origin of the run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial

from mfd_bayes.evaluation.checks import CALIBRATION, convergence_checks, exponent_checks
from mfd_bayes.evaluation.contradicted import contradicted_starts
from mfd_bayes.evaluation.judgement import judge, use_of
from mfd_bayes.evaluation.law_choices import law_choices
from mfd_bayes.evaluation.laws import law_rows, law_views
from mfd_bayes.evaluation.left_out import left_out_view
from mfd_bayes.evaluation.noises import noise_findings
from mfd_bayes.evaluation.odd_tests import odd_tests
from mfd_bayes.evaluation.sentences import remarks, verdict_sentence
from mfd_bayes.evaluation.shown import unshown, views_of_tests, with_lost
from mfd_bayes.evaluation.views import (
    CampaignView,
    Check,
    LawView,
    Row,
    TestView,
    TruthRow,
)
from mfd_bayes.jobs.parallel import meanwhile
from mfd_bayes.runs.findings import Finding
from mfd_bayes.runs.manifest import Manifest
from mfd_bayes.runs.run import Run
from mfd_bayes.runs.systems import SI, systems_beside
from mfd_bayes.runs.verdict import Use, Verdict


def assess(run: Run, jobs: int = 1) -> CampaignView:
    """Everything that the report of a run shows, by one process or several."""
    with meanwhile(jobs) as beside:
        rows, laws = beside(partial(law_rows, run)), beside(partial(law_views, run))
        tests, lost = views_of_tests(run, jobs, beside)
        return put_together(run, tests, rows(), laws(), lost)


def put_together(
    run: Run,
    tests: list[TestView],
    table: tuple[Row, ...],
    laws: tuple[LawView, ...],
    lost: Mapping[str, str] | None = None,
) -> CampaignView:
    """The report of a run from the views of its tests and laws, and from its manifest.

    `lost` are the tests that cannot be shown, and why.
    """
    manifest = run.manifest
    lost = lost or {}
    failures = {name: entry.error for name, entry in manifest.tests.items() if entry.error}
    checks = (*_all_checks(manifest, tests, table, failures), *unshown(lost))
    warnings = (*_warnings(run), *noise_findings(tests))
    judged = judge([*run.tests, *failures], checks, warnings)
    whole = use_of(judged, checks)
    compared = manifest.comparison
    return CampaignView(
        title=manifest.title,
        verdict=whole,
        sentence=with_lost(verdict_sentence(manifest, checks, judged), lost),
        actuation_unit=run.actuation_unit,
        tests=tuple(tests),
        failures={**failures, **lost},
        laws=laws,
        law_rows=table,
        checks=checks,
        scores=tuple(view.score for view in tests),
        truth=_truth_rows(manifest, tests, table),
        provenance=_provenance(manifest),
        remarks=remarks(run, tests),
        common=run.population.common if table else (),
        law_choices=law_choices(manifest.law_scores, manifest.settings.laws),
        left_out=left_out_view(manifest.crossvalidation),
        comparison=compared.rows if compared else (),
        comparison_sentence=compared.sentence if compared else "",
        judgements=judged,
        warnings=warnings,
        metric=run.system.name == SI.name,
        systems=systems_beside(run.system),
        tested=run.tested,
    )


def _all_checks(
    manifest: Manifest, tests: list[TestView], table: tuple[Row, ...], failures: Iterable[str]
) -> tuple[Check, ...]:
    """Checks of tests and laws, and one that fails for each test without a result."""
    return (
        *(check for view in tests for check in view.checks),
        *convergence_checks("population", table, manifest.effort),
        *exponent_checks(manifest.free_exponents),
        *(Check(n, CALIBRATION, "finished", 0.0, "finished", Verdict.FAIL) for n in failures),
    )


def _warnings(run: Run) -> tuple[Finding, ...]:
    """Warnings about the records, and tests that stand apart or contradict the one before."""
    before = [found for found in run.manifest.warnings if found.stage == "records"]
    return (*before, *odd_tests(run), *contradicted_starts(run))


def fails(view: CampaignView) -> bool:
    """Whether a run must not be used: a check failed, or something is wrong with a test."""
    return view.verdict == Use.NOT_USABLE


def verdicts(view: CampaignView) -> dict[str, str]:
    """Verdict of the campaign with its sentence, and of every subject of a check."""
    found: dict[str, str] = {}
    for check in view.checks:
        worse = {Verdict.CARE: Use.WITH_CARE, Verdict.FAIL: Use.NOT_USABLE}.get(check.verdict)
        if worse != Use.WITH_CARE or found.get(check.subject) != Use.NOT_USABLE:
            found[check.subject] = worse or found.get(check.subject, Use.USABLE)
    found |= {judged.subject: judged.use for judged in view.judgements}
    whole = {"campaign": view.verdict, "sentence": view.sentence}
    return whole | found | whole  # tests may have these names too


def _truth_rows(
    manifest: Manifest, tests: list[TestView], table: tuple[Row, ...]
) -> tuple[TruthRow, ...]:
    """The true values of a synthetic campaign, each beside its posterior."""
    known = _truths(manifest)
    rows = [*(row for view in tests for row in view.rows), *table]
    return tuple(
        TruthRow(
            subject=row.subject,
            name=row.name,
            unit=row.unit,
            truth=float(value),
            lower=row.lower,
            median=row.median,
            upper=row.upper,
            inside=bool(row.lower <= value <= row.upper),
            informed=not row.note,
        )
        for row in rows
        if (value := known.get(row.subject, {}).get(row.name)) is not None
    )


def _truths(manifest: Manifest) -> dict[str, dict[str, float | None]]:
    """True values by subject and name; empty for real tests.

    Noise is left out where a record was low-passed: it is not the noise that was added.
    """
    truth = manifest.truth
    if not truth:
        return {}
    known = {"population": dict(truth.population)}
    for name, values in truth.tests.items():
        filtered = manifest.tests[name].filtered
        known[name] = {k: v for k, v in values.items() if not (filtered and "noise" in k)}
        if filtered:
            for noise in ("scatter_noise_sd", "scatter_noise_time"):
                known["population"].pop(noise, None)
    return known


def _provenance(manifest: Manifest) -> dict[str, str]:
    effort = manifest.effort
    facts = {
        "command": manifest.command,
        "started": manifest.started,
        "finished": manifest.finished,
        "seed": str(manifest.seed),
        "effort": f"{effort.name}: {effort.ensembles} ensembles, at most {effort.limit} steps each",
        "model and noise": f"{manifest.settings.model}, {manifest.settings.noise}",
        "priors": manifest.settings.priors,
        "platform": manifest.platform,
        "versions": ", ".join(f"{k} {v}" for k, v in manifest.versions.items()),
    }
    for number, machine in enumerate(manifest.machines):
        name = f"machine {number + 1}" if number else "machine"
        facts[name] = ", ".join(f"{part} {words}" for part, words in machine.items())
    for name, digest in manifest.inputs.items():
        facts[f"SHA-256 of {name}"] = digest
    return facts
