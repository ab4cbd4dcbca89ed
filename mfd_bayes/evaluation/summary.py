"""The whole report: every test, the laws, the verdict, and the origin of the run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import contraction, log_if_positive
from mfd_bayes.calibration.identifiability import identify
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.predictive import replicate
from mfd_bayes.calibration.priors import units
from mfd_bayes.calibration.result import TestResult, moves, quantiles_of
from mfd_bayes.errors import MfdError, StoreError
from mfd_bayes.evaluation import checks
from mfd_bayes.evaluation.checks import convergence_checks, exponent_checks
from mfd_bayes.evaluation.crossvalidate import left_out_view
from mfd_bayes.evaluation.drift import drift_rows
from mfd_bayes.evaluation.laws import law_choices, law_rows, law_score_rows, law_views
from mfd_bayes.evaluation.outliers import contradicted_order, outlying_tests, uncommon_device_values
from mfd_bayes.evaluation.properties import (
    Peaks,
    device_properties,
    kept,
    measured_of,
    measured_properties,
    of_parameters,
    peaks_of,
    properties_of,
    property_rows,
)
from mfd_bayes.evaluation.scores import fan_of, score, score_record, spread_of
from mfd_bayes.evaluation.verdict import judge, remarks, use_of, verdict_sentences
from mfd_bayes.evaluation.views import (
    CALIBRATION,
    REPORT,
    CampaignView,
    Check,
    Marginal,
    Row,
    Rows,
    TestView,
)
from mfd_bayes.jobs.local import in_turn, several_processes
from mfd_bayes.messages import Message, join
from mfd_bayes.population.bands import Forecast
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.manifest import Manifest, Use, Verdict
from mfd_bayes.runs.run import Run
from mfd_bayes.runs.unit_system import SI, US, both_systems

Array = NDArray[np.float64]

MAX_PLOTTED_DRAWS = 2000
"""Most draws of a quantity in figures."""

HELD_OUT_DRAWS = 800

FAR_APART = 0.25
"""A median alone and one in the joint posterior that differ by less, a share, do not disagree."""

_CORNER = (
    *("Fc_fwd", "Fc_bwd", "sigma0", "k2", "k3", "d2", "d3"),
    *("k_fwd", "k_bwd", "gap", "n", "ell"),
)
_FIRST = ("gap", "k3", "k2", "Fs_fwd", "Fs_bwd")
"""Quantities that matter most in design come first, after the slip forces."""


def assess(run: Run, jobs: int = 1) -> CampaignView:
    """Everything that the report of a run shows, by one process or several."""
    tests, lost = views_of_tests(run, jobs)
    table, laws = law_rows(run), law_views(run)
    manifest = run.manifest
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


def views_of_tests(run: Run, jobs: int = 1) -> tuple[list[TestView], dict[str, str]]:
    """Views of all tests, in the order of the campaign; and why others cannot be shown.

    Several processes make those of calibrated tests.
    """
    make = partial(_attempt, partial(calibrated_view, run.manifest, peaks_of(run)))
    views = [make] * len(run.tests)
    # each test is sent by itself: the records of all need not be held in every process
    tests = enumerate(replace(test, extras=None) for test in run.tests.values())
    with several_processes(views, jobs) as in_processes:
        made = dict(zip(run.tests, (in_processes or in_turn(views))(tests), strict=True))
    for name, trace in run.held_out.items():
        made[name] = _attempt(partial(held_out_view, run, name), trace)
    shown, lost = [], {}
    for name in (name for name in run.manifest.tests if name in made):
        view = made[name]
        if isinstance(view, TestView):
            shown.append(with_joint(run, view))
        else:
            lost[name] = str(view)
    return shown, lost


def _attempt(make: Callable[[Any], TestView], given: Any) -> TestView | MfdError:
    """A view, or why it cannot be made; a stored file that cannot be used is no fault of a test."""
    try:
        with np.errstate(all="ignore"):  # what is not finite is refused by name
            return make(given)
    except StoreError:
        raise
    except MfdError as error:
        return error


def verdicts(view: CampaignView) -> dict[str, str]:
    """Verdict of the campaign with its sentence in the campaign's units, and of every test."""
    order, uses = [*Use], dict[str, Use]()
    for check in view.checks:
        use = {Verdict.WARNING: Use.WITH_CARE, Verdict.FAIL: Use.NOT_USABLE}.get(check.status)
        worst = use or Use.USABLE, uses.get(check.test, Use.USABLE)
        uses[check.test] = max(worst, key=order.index)
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


# --- one test


def calibrated_view(manifest: Manifest, peaks: Peaks, test: TestResult) -> TestView:
    """A test that was fitted; `peaks` are the factors of the run."""
    posterior, stored, trace = test.posterior, test.stored, test.trace
    values, facts, settings = stored.values(), stored.facts, manifest.settings
    replicas = replicate(posterior, values, np.random.default_rng(0))
    drawn = posterior.draw_prior(np.random.default_rng(0), 2000)
    theta = posterior.theta(drawn)
    prior = drawn | dict(zip(posterior.model.parameters, theta.T, strict=True))
    rows = _parameters(test, values, prior, facts["convergence"])
    draws = {name: stored.draws[name].to_numpy() for name in posterior.names}
    identifiability = identify(posterior, draws, prior)
    measured = measured_of(manifest, test.id)
    properties = properties_of(trace, replicas.observed, peaks, smooth=replicas.force)
    scores = _score(test.id, "calibrate", trace, replicas.observed, posterior.first)
    arguments = test.id, posterior, replicas, measured, properties, settings.tolerances
    predictive = checks.predictive_checks(*arguments)
    level = trace.reference_actuation
    derived = properties | of_parameters(posterior.model, replicas.values, level, settings)
    derived = kept(derived, manifest.axes)
    by_name = {row["name"]: row for row in rows}
    informed = {name for name, row in by_name.items() if row["contraction"] >= checks.INFORMED}
    medians = {name: np.atleast_1d(np.median(draws)) for name, draws in values.items()}
    at = posterior.theta(medians), trace, medians.get("start")
    stage = posterior.model.stages(*at)
    return TestView(
        id=test.id,
        role="calibrate",
        actuation=US.actuation(trace, settings.actuation_unit) if manifest.axes.actuated else "",
        trace=trace,
        first=posterior.first,
        device=fan_of("this_test", replicas.force),
        observation=fan_of("observation", replicas.observed),
        rows=rows,
        marginals=tuple(
            Marginal(
                name,
                by_name[name]["unit"],
                _some(prior[name]),
                _some(values[name]),
                by_name[name]["contraction"],
            )
            for name in posterior.names
        ),
        chains=stored.draws.sizes["chain"],
        corner=tuple(name for name in _CORNER if name in informed),
        checks=(
            *checks.convergence_checks(test.id, rows, manifest.effort),
            checks.length_check(test.id, facts, manifest.effort),
            *predictive,
            *checks.coverage_checks(scores, settings.tolerances),
            *checks.slip_checks(test.id, posterior, values, measured),
            *checks.notes(test.id, rows, facts),
            checks.directions_check(test.id, identifiability.directions),
        ),
        score=scores,
        identifiability=identifiability,
        derived=property_rows(test.id, "calibrate", trace, derived, measured_properties(measured)),
        loop_estimates=checks.loop_estimates(predictive, properties),
        noises=noise_rows(test.id, posterior, values, facts),
        modes=_modes(facts),
        stage=None if stage is None else stage[0],
        travel=None if stage is None else posterior.model.travel(*at)[0],
    )


def held_out_view(run: Run, name: str, trace: Trace) -> TestView:
    """A test that was predicted from the others."""
    how: dict[str, Any] = {"draws": HELD_OUT_DRAWS, **run.place(name)}
    before = run.sequence.before(name, trace, Forecast(**how))
    how["after"] = before or ""
    seen = run.predict(trace, "observation", explain=True, **how)
    drawn = device_properties(run, trace, seen, run.predict(trace, "new_test", **how))
    measured = measured_properties(measured_of(run.manifest, name))
    return TestView(
        id=name,
        role="validate",
        actuation=US.actuation(trace, run.actuation_unit) if run.manifest.axes.actuated else "",
        trace=trace,
        first=0,
        observation=fan_of("observation", seen.draws),
        score=_score(name, "validate", trace, seen.draws, 0),
        derived=property_rows(name, "validate", trace, kept(drawn, run.manifest.axes), measured),
        shares=seen.explained,
        begun=before.words if before else "",
    )


def _score(name: str, role: str, trace: Trace, draws: Array, first: int) -> Row:
    """Scores of force draws (n, T) against the force of a record, from sample `first` on."""
    scores = score(draws[:, first:], np.asarray(trace.force)[first:])
    return {"test": name, "role": role} | score_record(scores)


def _parameters(
    test: TestResult,
    values: Mapping[str, Array],
    prior: Mapping[str, Array],
    convergence: Mapping[str, Sequence[float | None]],
) -> Rows:
    """Table I of one test: every parameter with its uncertainty and convergence."""
    rows, kinds = [], units(test.posterior.model)
    for name, draws in values.items():
        shrunk, scale_only = float("nan"), name in checks.SCALE_ONLY
        if not scale_only and np.ptp(prior[name]) > 0:  # what is fixed has no spread
            before, after = log_if_positive(prior[name], draws)
            shrunk = float(contraction(np.array([before.std()]), after[:, None])[0])
        note = checks.SCALE_NOTE if scale_only else ""
        r_hat, bulk, tail = convergence.get(name, (np.nan, np.nan, np.nan))
        rows.append(
            {"test": test.id, "name": name, "unit": kinds[name]}
            | spread_of(draws)
            | {
                "ess_bulk": 0.0 if bulk is None else bulk,
                "ess_tail": 0.0 if tail is None else tail,
                # None, for JSON has no infinity: walkers that never moved, or too few draws
                "r_hat": np.inf if r_hat is None else r_hat,
                "contraction": shrunk,
                "note": checks.NOT_INFORMED if shrunk < checks.INFORMED else note,
                **dict.fromkeys(("joint_lower", "joint_median", "joint_upper"), np.nan),
                "disagrees": False,
            }
        )
    return tuple(rows)


def with_joint(run: Run, view: TestView) -> TestView:
    """A fitted test with each parameter's interval in the joint posterior of all tests.

    Alone and together disagree where the intervals do not overlap and the medians are far apart.
    """
    if not view.rows or not run.sequence.pooled(view.id):
        return view
    values, model = run.sequence.values(view.id), run.tests[view.id].posterior.model
    joint = {**values} | dict(zip(model.parameters, model.theta(values).T, strict=True))
    rows = []
    for row in view.rows:
        name, draws = row["name"], joint.get(row["name"])
        if draws is None or name in checks.SCALE_ONLY or not np.ptp(draws) > 0.0:
            rows.append(row)
            continue
        low, middle, high = np.quantile(draws, [0.025, 0.5, 0.975]).tolist()
        of_device = name in (*model.parameters, "ell") and row["contraction"] >= checks.INFORMED
        apart = of_device and (low > row["upper"] or high < row["lower"])
        apart = apart and abs(middle - row["median"]) > FAR_APART * abs(row["median"])
        together = {"joint_lower": low, "joint_median": middle, "joint_upper": high}
        rows.append(row | together | {"disagrees": bool(apart)})
    return replace(view, rows=tuple(rows))


def _modes(facts: Mapping[str, Any]) -> tuple[Mapping[str, float], ...]:
    """Medians and share of each mode with draws, the largest first; empty with one mode."""
    shares = np.atleast_2d(facts.get("mode_shares", [[]])).mean(axis=0)
    kept = [k for k in np.argsort(-shares).tolist() if shares[k] >= checks.SMALLEST_MODE]
    values = facts.get("mode_values", [])
    if len(kept) < 2 or len(values) != len(shares):
        return ()
    return tuple({**values[k], "share": float(shares[k])} for k in kept)


def _some(draws: Array) -> Array:
    """At most so many draws as figures show, evenly spaced; single precision saves memory."""
    return np.asarray(draws[:: -(-len(draws) // MAX_PLOTTED_DRAWS)], dtype=np.float32)


def noise_rows(
    test: str, posterior: Posterior, values: Mapping[str, Array], facts: Mapping[str, Any]
) -> Rows:
    """Every quantity of a test under its own noise and under others; empty where not checked.

    `values` are the posterior draws of all quantities, (n,) each, and `facts` those of the test.
    """
    fits = [fit for fit in facts.get("other_noises", ()) if fit["quantities"]]
    if not fits:
        return ()
    own, kinds = quantiles_of(posterior, values), {"gap": "in"} | units(posterior.model)
    first = (*posterior.model.slip_forces, *_FIRST)
    ordered = sorted(own, key=lambda name: first.index(name) if name in first else len(first))
    keys = ("lower", "median", "upper")
    return tuple(
        {"test": test, "name": name, "unit": kinds[name], "noise": posterior.noise.name}
        | dict(zip(keys, own[name], strict=True))
        | {"other": fit["noise"]}
        | {f"other_{key}": value for key, value in zip(keys, other, strict=True)}
        | {"decides": moves(own[name], other)}
        for fit in fits
        for name in ordered
        if None not in (other := fit["quantities"].get(name, [None]))
    )
