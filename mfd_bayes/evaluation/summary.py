"""The whole report: every test, the laws, the verdict, and the origin of the run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np

from mfd_bayes.errors import MfdError, StoreError
from mfd_bayes.evaluation.checks import convergence_checks, exponent_checks
from mfd_bayes.evaluation.crossvalidate import left_out_view
from mfd_bayes.evaluation.drift import drift_rows
from mfd_bayes.evaluation.laws import law_choices, law_rows, law_score_rows, law_views
from mfd_bayes.evaluation.outliers import (
    contradicted_order,
    outlying_tests,
    uncommon_device_values,
)
from mfd_bayes.evaluation.properties import peaks_of
from mfd_bayes.evaluation.test_summary import (
    calibrated_view,
    held_out_view,
    with_joint,
)
from mfd_bayes.evaluation.verdict import judge, remarks, use_of, verdict_sentences
from mfd_bayes.evaluation.views import (
    CALIBRATION,
    REPORT,
    CampaignView,
    Check,
    LawView,
    Rows,
    TestView,
)
from mfd_bayes.jobs.parallel import Meanwhile, in_turn, meanwhile, several_processes, when_wanted
from mfd_bayes.messages import Message, join
from mfd_bayes.runs.manifest import Manifest
from mfd_bayes.runs.run import Run
from mfd_bayes.runs.unit_system import SI, both_systems
from mfd_bayes.runs.verdict import Use, Verdict

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

    Several processes make those of calibrated tests, `background` the others.
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
    all_tests = {
        name: with_joint(run, view) if isinstance(view, TestView) else view
        for name, view in zip(run.tests, made, strict=True)
    } | {name: view() for name, view in others.items()}
    shown, lost = [], {}
    for name in run.manifest.tests:
        view = all_tests.get(name)
        if isinstance(view, TestView):
            shown.append(view)
        elif view is not None:
            lost[name] = str(view)
    return shown, lost


def _attempt(make: Callable[[Given], TestView], given: Given) -> TestView | MfdError:
    """A view, or why it cannot be made; a stored file that cannot be used is no fault of a test."""
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
    table: Rows,
    laws: tuple[LawView, ...],
    lost: Mapping[str, str] | None = None,
) -> CampaignView:
    """The report of a run from the views of its tests and laws, and from its manifest.

    `table` are the constants of the laws, `lost` the tests that cannot be shown, and why.
    """
    manifest, lost = run.manifest, lost or {}
    failures = {name: entry.error for name, entry in manifest.tests.items() if entry.error}
    missing = [(name, CALIBRATION, "finished") for name in failures]
    missing += [(name, REPORT, "shown") for name in lost]
    checks = (
        *(check for view in tests for check in view.checks),
        *convergence_checks("population", table, manifest.effort),
        *exponent_checks(manifest.free_exponents),
        *(Check(*key, 0.0, 1.0, Verdict.FAIL) for key in missing),
    )
    warnings = (
        *(warning for warning in manifest.warnings if warning.stage == "records"),
        *outlying_tests(run),
        *uncommon_device_values(run),
        *contradicted_order(run),
    )
    judged = judge([*run.tests, *failures], checks, warnings)
    left_out = (
        Message("Test {test} is left out of the report: {why}.", {"test": name, "why": why})
        for name, why in lost.items()
    )
    scores = law_score_rows(manifest.law_scores, manifest.settings.laws)
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
        truth=_truth_rows(manifest, tests, table),
        provenance=_provenance(manifest),
        remarks=remarks(run, tests),
        common=run.population.common if table else (),
        law_scores=scores,
        law_choices=law_choices(scores, manifest.settings.laws),
        left_out=left_out_view(manifest.crossvalidation),
        comparison=manifest.comparison,
        judgements=judged,
        warnings=warnings,
        metric=run.system.name == SI.name,
        systems=both_systems(run.system),
        tested=run.tested,
        drifts=drift_rows(run) if table else (),
        model=run.model,
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
    sentence = join(view.sentences, " ").to_text(view.system)
    whole = {"campaign": view.verdict, "sentence": sentence}
    return whole | uses | whole  # tests may have these names too


def _truth_rows(manifest: Manifest, tests: list[TestView], table: Rows) -> Rows:
    """The true values of a synthetic campaign, each beside its posterior.

    Noise is left out where a record was low-passed: it is not the noise that was added.
    """
    if not manifest.truth:
        return ()
    truths: dict[str, dict[str, float | None]] = {"population": dict(manifest.truth.population)}
    for name, values in manifest.truth.tests.items():
        filtered = manifest.tests[name].filtered
        truths[name] = {k: v for k, v in values.items() if not (filtered and "noise" in k)}
        if filtered:
            for noise in ("scatter_noise_sd", "scatter_noise_time"):
                truths["population"].pop(noise, None)
    return tuple(
        {key: row[key] for key in ("test", "name", "unit")}
        | {"truth": float(value)}
        | {key: row[key] for key in ("lower", "median", "upper")}
        | {"inside": row["lower"] <= value <= row["upper"], "informed": not row["note"]}
        for row in (*(row for view in tests for row in view.rows), *table)
        if (value := truths.get(row["test"], {}).get(row["name"])) is not None
    )


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
    return facts | {f"SHA-256 of {name}": digest for name, digest in manifest.inputs.items()}
