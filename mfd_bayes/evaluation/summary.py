"""The whole report: every test, the laws, the verdict, and the origin of the run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np

from mfd_bayes.errors import MfdError, StoreError
from mfd_bayes.evaluation.checks import CALIBRATION, REPORT, convergence_checks, exponent_checks
from mfd_bayes.evaluation.crossvalidate import left_out_view
from mfd_bayes.evaluation.drift import drift_rows
from mfd_bayes.evaluation.laws import law_choices, law_rows, law_views
from mfd_bayes.evaluation.outliers import (
    contradicted_order,
    outlying_tests,
    uncommon_device_values,
)
from mfd_bayes.evaluation.properties import peaks_of
from mfd_bayes.evaluation.test_summary import (
    calibrated_view,
    held_out_view,
    sharing_priors,
    with_joint,
)
from mfd_bayes.evaluation.verdict import judge, remarks, use_of, verdict_sentences
from mfd_bayes.evaluation.views import CampaignView, Check, LawView, Row, TestView, TruthRow
from mfd_bayes.jobs.parallel import Meanwhile, in_turn, meanwhile, several_processes, when_wanted
from mfd_bayes.messages import Message, join
from mfd_bayes.runs.manifest import Manifest
from mfd_bayes.runs.run import Run
from mfd_bayes.runs.unit_system import SI, both_systems
from mfd_bayes.runs.verdict import Finding, Use, Verdict

Given = TypeVar("Given")


def assess(run: Run, jobs: int = 1) -> CampaignView:
    """Everything that the report of a run shows, by one process or several."""
    with meanwhile(jobs) as background:
        rows, laws = background(partial(law_rows, run)), background(partial(law_views, run))
        tests, lost = views_of_tests(run, jobs, background)
        return build_summary(run, tests, rows(), laws(), lost)


def views_of_tests(
    run: Run, jobs: int = 1, background: Meanwhile = when_wanted
) -> tuple[list[TestView], dict[str, str]]:
    """Views of all tests, in the order of the campaign; and why others cannot be shown.

    Parameters
    ----------
    run : Run
    jobs : int
        Processes that make those of calibrated tests.
    background : Meanwhile
        Makes those of the other tests.

    Raises
    ------
    StoreError
        When a stored file cannot be used: that is no fault of one test.
    """
    others = {
        name: background(partial(_attempt, partial(held_out_view, run, name), trace))
        for name, trace in run.held_out.items()
    }
    make = partial(_attempt, partial(calibrated_view, run.manifest, peaks_of(run)))
    views = [make] * len(run.tests)
    # each test is sent by itself: the records of all need not be held in every process
    tests = enumerate(replace(test, extras=None) for test in run.tests.values())
    with several_processes(views, jobs) as in_processes:
        made = list((in_processes or in_turn(views))(tests))
    found = {
        name: sharing_priors(with_joint(run, view)) if isinstance(view, TestView) else view
        for name, view in zip(run.tests, made, strict=True)
    }
    found |= {name: view() for name, view in others.items()}
    names = [name for name in run.manifest.tests if name in found]
    shown = [view for name in names if isinstance(view := found[name], TestView)]
    return shown, {name: str(e) for name in names if isinstance(e := found[name], MfdError)}


def _attempt(make: Callable[[Given], TestView], given: Given) -> TestView | MfdError:
    """A view, or why it cannot be made."""
    try:
        with np.errstate(all="ignore"):  # what is not finite is refused by name
            return make(given)
    except StoreError:
        raise
    except MfdError as error:
        return error


def build_summary(
    run: Run,
    tests: list[TestView],
    table: tuple[Row, ...],
    laws: tuple[LawView, ...],
    lost: Mapping[str, str] | None = None,
) -> CampaignView:
    """The report of a run from the views of its tests and laws, and from its manifest.

    `lost` are the tests that cannot be shown, and why.
    """
    manifest, lost = run.manifest, lost or {}
    failures = {name: entry.error for name, entry in manifest.tests.items() if entry.error}
    checks = _all_checks(manifest, tests, table, failures, lost)
    before = [warning for warning in manifest.warnings if warning.stage == "records"]
    results = (*outlying_tests(run), *uncommon_device_values(run), *contradicted_order(run))
    warnings: tuple[Finding, ...] = (*before, *results)
    judged = judge([*run.tests, *failures], checks, warnings)
    left_out = (
        Message("Test {test} is left out of the report: {why}.", {"test": name, "why": why})
        for name, why in lost.items()
    )
    compared = manifest.comparison
    return CampaignView(
        title=manifest.title,
        verdict=use_of(judged, checks),
        sentences=(*left_out, *verdict_sentences(manifest, checks, judged)),
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
        systems=both_systems(run.system),
        tested=run.tested,
        drifts=drift_rows(run) if table else (),
    )


def _all_checks(
    manifest: Manifest,
    tests: list[TestView],
    table: tuple[Row, ...],
    failures: Iterable[str],
    lost: Iterable[str],
) -> tuple[Check, ...]:
    """Checks of tests and laws, and one that fails for each test without a result or a view."""
    missing = [(name, CALIBRATION, "finished") for name in failures]
    missing += [(name, REPORT, "shown") for name in lost]
    return (
        *(check for view in tests for check in view.checks),
        *convergence_checks("population", table, manifest.effort),
        *exponent_checks(manifest.free_exponents),
        *(Check(*key, 0.0, 1.0, Verdict.FAIL) for key in missing),
    )


def is_whole(view: CampaignView) -> bool:
    """Whether a report shows every test that it could."""
    return all(check.check != REPORT for check in view.checks)


def fails(view: CampaignView) -> bool:
    """Whether a run must not be used: a check failed, or something is wrong with a test."""
    return view.verdict == Use.NOT_USABLE


def verdicts(view: CampaignView) -> dict[str, str]:
    """Verdict of the campaign with its sentence in the campaign's units, and of every test."""
    uses: dict[str, str] = {}
    for check in view.checks:
        worse = {Verdict.WARNING: Use.WITH_CARE, Verdict.FAIL: Use.NOT_USABLE}.get(check.status)
        if worse != Use.WITH_CARE or uses.get(check.test) != Use.NOT_USABLE:
            uses[check.test] = worse or uses.get(check.test, Use.USABLE)
    uses |= {judged.subject: judged.use for judged in view.judgements}
    sentence = join(view.sentences, " ").to_text(view.systems[view.metric].words)
    whole = {"campaign": view.verdict, "sentence": sentence}
    return whole | uses | whole  # tests may have these names too


def _truth_rows(
    manifest: Manifest, tests: list[TestView], table: tuple[Row, ...]
) -> tuple[TruthRow, ...]:
    """The true values of a synthetic campaign, each beside its posterior."""
    truths = _truths(manifest)
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
        if (value := truths.get(row.subject, {}).get(row.name)) is not None
    )


def _truths(manifest: Manifest) -> dict[str, dict[str, float | None]]:
    """True values by subject and name; empty for real tests.

    Noise is left out where a record was low-passed: it is not the noise that was added.
    """
    truth = manifest.truth
    if not truth:
        return {}
    truths = {"population": dict(truth.population)}
    for name, values in truth.tests.items():
        filtered = manifest.tests[name].filtered
        truths[name] = {k: v for k, v in values.items() if not (filtered and "noise" in k)}
        if filtered:
            for noise in ("scatter_noise_sd", "scatter_noise_time"):
                truths["population"].pop(noise, None)
    return truths


def _provenance(manifest: Manifest) -> dict[str, str]:
    effort = manifest.effort
    facts = {
        "command": manifest.command,
        "started": manifest.started,
        "finished": manifest.finished,
        "seed": str(manifest.seed),
        "effort": f"{effort.name}: {effort.ensembles} ensembles, at most {effort.limit} steps each",
        "model and noise": f"{manifest.settings.model}, {manifest.settings.noise}",
        "priors": manifest.priors,
        "platform": manifest.platform,
        "versions": ", ".join(f"{k} {v}" for k, v in manifest.versions.items()),
    }
    for number, machine in enumerate(manifest.machines):
        name = f"machine {number + 1}" if number else "machine"
        facts[name] = ", ".join(f"{part} {words}" for part, words in machine.items())
    for name, digest in manifest.inputs.items():
        facts[f"SHA-256 of {name}"] = digest
    return facts
