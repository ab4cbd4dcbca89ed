"""The whole report: every test, the laws, the verdict, and the origin of the run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import (
    TAIL_SHARE,
    Identifiability,
    contraction,
    effective_size,
    find_directions,
    find_pairs,
    log_if_positive,
    replicate,
)
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import SCALED, units
from mfd_bayes.calibration.result import TestResult
from mfd_bayes.errors import MfdError, StoreError
from mfd_bayes.evaluation import checks, sensitivity
from mfd_bayes.evaluation.assessment import (
    CALIBRATION,
    COVERAGE,
    FREE_EXPONENT,
    LOOP_ESTIMATE,
    MODES,
    PREDICTIVE,
    REPORT,
    SAMPLING,
    SCATTER,
    Check,
    Judgement,
)
from mfd_bayes.evaluation.checks import (
    SCALE_NOTE,
    contradicted_order,
    convergence_checks,
    exponent_checks,
    outlying_tests,
    scatter_checks,
    uncommon_device_values,
)
from mfd_bayes.evaluation.laws import (
    convergence_rows,
    drift_rows,
    law_choices,
    law_rows,
    law_score_rows,
    law_views,
)
from mfd_bayes.evaluation.properties import (
    applicable,
    device_properties,
    measured_of,
    of_parameters,
    properties_of,
    property_rows,
)
from mfd_bayes.evaluation.scores import Row, Rows, fan_of, score, score_record, spread_of
from mfd_bayes.evaluation.views import (
    INFORMED,
    NOT_INFORMED,
    CampaignView,
    LeftOutView,
    Marginal,
    TestView,
)
from mfd_bayes.jobs.local import several_processes
from mfd_bayes.messages import Message, counted, join
from mfd_bayes.population.bands import PredictionOptions
from mfd_bayes.population.design import Design
from mfd_bayes.population.peaks import SIDES
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.findings import CheckStatus, Finding, Fitness
from mfd_bayes.runs.manifest import CampaignCrossValidation, Manifest
from mfd_bayes.runs.run import Run, prediction_conditions, sequence_of
from mfd_bayes.runs.unit_system import SI, both_systems

MAX_PLOTTED_DRAWS = 2000
"""Most draws of a quantity in figures."""

HELD_OUT_DRAWS = 800

_CORNER = (
    *("Fc_fwd", "Fc_bwd", "sigma0", "k2", "k3", "d2", "d3"),
    *("k_fwd", "k_bwd", "gap", "n", "ell"),
)
"""Quantities of the corner plot, in its order."""


def assess(run: Run, jobs: int = 1) -> CampaignView:
    """Everything that the report of a run shows, by one process or several."""
    tests, lost = views_of_tests(run, jobs)
    table, laws = law_rows(run), law_views(run)
    manifest, levels = run.manifest, convergence_rows(run.population, table)
    failures = {name: entry.error for name, entry in manifest.tests.items() if entry.error}
    missing = [(name, CALIBRATION, "finished") for name in failures]
    missing += [(name, REPORT, "shown") for name in lost]
    checks = (
        *(check for view in tests for check in view.checks),
        *convergence_checks("population", table, manifest.effort),
        *convergence_checks("population", levels, manifest.effort),
        *exponent_checks(manifest.free_exponents),
        *scatter_checks(run),
        *(Check(*key, 0.0, 1.0, CheckStatus.FAIL) for key in missing),
    )
    warnings = (
        *(warning for warning in manifest.warnings if warning.stage == "records"),
        *outlying_tests(run),
        *uncommon_device_values(run),
        *contradicted_order(run),
    )
    judged = judge([*run.tests, *failures], checks, warnings)
    left_out = (
        Message("Test {test} is left out of the report: {why}.", {"test": name, "why": reason})
        for name, reason in lost.items()
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
    make = partial(_attempt, partial(calibrated_view, run.manifest))
    views = [make] * len(run.tests)
    # each test is sent by itself: the records of all need not be held in every process
    tests = enumerate(replace(test, _backend=None) for test in run.tests.values())
    with several_processes(views, jobs) as evaluate:
        outcomes = dict(zip(run.tests, evaluate(tests), strict=True))
    for name, trace in run.held_out.items():
        outcomes[name] = _attempt(partial(held_out_view, run, name), trace)
    test_views, lost = [], {}
    for name in (name for name in run.manifest.tests if name in outcomes):
        view = outcomes[name]
        if isinstance(view, TestView):
            test_views.append(with_joint(run, view))
        else:
            lost[name] = str(view)
    return test_views, lost


def _attempt(make: Callable[[Any], TestView], argument: Any) -> TestView | MfdError:
    """A view, or why it cannot be made; a stored file that cannot be used is no fault of a test."""
    try:
        with np.errstate(all="ignore"):  # what is not finite is refused by name
            return make(argument)
    except StoreError:
        raise
    except MfdError as error:
        return error


def verdicts(view: CampaignView) -> dict[str, str]:
    """Verdict of the campaign with its sentence in the campaign's units, and of every test."""
    names = dict.fromkeys(check.test for check in view.checks)
    uses = {name: use_of((), [c for c in view.checks if c.test == name]) for name in names}
    uses |= {judged.subject: judged.use for judged in view.judgements}
    sentence = join(view.sentences, " ").to_text(view.system)
    summary = {"campaign": view.verdict, "sentence": sentence}
    return summary | uses | summary  # tests may have these names too


def _truth_rows(manifest: Manifest, tests: list[TestView], table: Rows) -> Rows:
    """The true values of a synthetic campaign, each beside its posterior.

    Noise is left out where a record was low-passed: it is not the noise that was added.
    """
    if not manifest.truth:
        return ()
    filtered = {name for name, entry in manifest.tests.items() if entry.filtered}
    filtered |= {"population"} if filtered else set()
    truths = {**manifest.truth.tests, "population": manifest.truth.population}
    return tuple(
        {key: row[key] for key in ("test", "name", "unit")}
        | {"truth": float(value)}
        | {key: row[key] for key in ("lower", "median", "upper")}
        | {"inside": row["lower"] <= value <= row["upper"], "informed": not row["note"]}
        for row in (*(row for view in tests for row in view.rows), *table)
        if not ("noise" in row["name"] and row["test"] in filtered)
        and (value := truths.get(row["test"], {}).get(row["name"])) is not None
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
    facts |= {f"draws of {name}": how for name, how in manifest.reweighed.items()}
    for number, machine in enumerate(manifest.machines):
        name = f"machine {number + 1}" if number else "machine"
        facts[name] = ", ".join(f"{component} {words}" for component, words in machine.items())
    return facts | {f"SHA-256 of {name}": digest for name, digest in manifest.inputs.items()}


# --- one test


def calibrated_view(manifest: Manifest, test: TestResult) -> TestView:
    """A test that was fitted.

    The model has seen the record as filtered: its peaks have beside them what the filter took from
    this very record, and no correction that was learned, so that the checks are of the model.
    """
    posterior, stored, trace = test.posterior, test.stored, test.trace
    values, facts, settings = stored.values(), stored.facts, manifest.settings
    replicas = replicate(posterior, values, np.random.default_rng(0))
    prior_draws = posterior.sample_prior(2000, 0)
    theta = posterior.theta(prior_draws)
    prior = prior_draws | dict(zip(posterior.model.parameters, theta.T, strict=True))
    rows = _parameters(test, values, prior, facts["convergence"])
    measured = measured_of(manifest, test.id)
    properties = properties_of(trace, replicas.observed, smooth=replicas.force)
    for side, sign in SIDES.items():
        filtered = float(np.max(sign * np.asarray(trace.force)))
        filter_loss = max(0.0, getattr(measured, f"largest_{side}") - filtered)
        properties[f"peak_{side}"] = properties[f"peak_{side}"] + filter_loss
    scores = _score(test.id, "calibrate", trace, replicas.observed, posterior.first)
    arguments = test.id, posterior, replicas, measured, properties, settings.tolerances
    predictive = checks.predictive_checks(*arguments)
    level = trace.reference_actuation
    derived = properties | of_parameters(posterior.model, replicas.values, level, settings)
    derived = applicable(derived, manifest.axes)
    by_name = {row["name"]: row for row in rows}
    identifiability = _identify(posterior, stored.posterior.arrays, prior, by_name)
    informed = {name for name, row in by_name.items() if row["contraction"] >= INFORMED}
    medians = {name: np.atleast_1d(np.median(draws)) for name, draws in values.items()}
    inputs = posterior.theta(medians), trace, medians.get("start")
    stage = posterior.model.stages(*inputs)
    return TestView(
        id=test.id,
        role="calibrate",
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
        chains=len(stored.posterior.arrays["offset"]),
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
        derived=property_rows(test.id, "calibrate", trace, derived, measured.of_test()),
        loop_estimates=checks.loop_estimates(predictive, properties),
        modes=_modes(facts),
        stage=None if stage is None else stage[0],
        travel=None if stage is None else posterior.model.travel(*inputs)[0],
        sensitivity=sensitivity.test_rows(test, stored),
    )


def held_out_view(run: Run, name: str, trace: Trace) -> TestView:
    """A test that was predicted from the others."""
    how: dict[str, Any] = {"draws": HELD_OUT_DRAWS, **prediction_conditions(run, name)}
    ending = sequence_of(run).before(name, trace, PredictionOptions(**how))
    how["after"] = ending or ""
    band = run.predict(trace, "observation", **how)
    properties = device_properties(run, trace, band, run.predict(trace, "new_test", **how))
    measured = measured_of(run.manifest, name).of_test()
    return TestView(
        id=name,
        role="validate",
        trace=trace,
        first=0,
        observation=fan_of("observation", band.draws),
        score=_score(name, "validate", trace, band.draws, 0),
        derived=property_rows(
            name, "validate", trace, applicable(properties, run.manifest.axes), measured
        ),
        shares=band.variance_shares,
        begun=ending.words if ending else "",
    )


def _score(name: str, role: str, trace: Trace, draws: Array, start_index: int) -> Row:
    """Scores of force draws (n, T) against the force of a record, from sample `start_index` on."""
    scores = score(draws[:, start_index:], np.asarray(trace.force)[start_index:])
    return {"test": name, "role": role} | score_record(scores)


def _identify(
    posterior: Posterior,
    values: Mapping[str, Array],
    prior: Mapping[str, Array],
    rows: Mapping[str, Row],
) -> Identifiability:
    """What the data of a test say about its sampled parameters, by draws (chain, draw) of each.

    `rows` have their bulk ESS, which has been measured when they were sampled.
    Everything is on the scale on which each prior is sampled, the logarithm for most: there
    the priors are independent, and a prior raised to a power widens about its median.
    """
    names = posterior.names
    draws = np.stack([posterior.priors[n].coordinate(values[n]) for n in names])
    width = np.array([posterior.priors[n].coordinate(prior[n]).std() for n in names])
    size = min(float(rows[name]["ess_bulk"]) for name in names)
    if not size > 0.0:  # walkers of too few steps: that of whole chains
        size = float(np.min(np.nan_to_num([*map(effective_size, draws)], nan=0.0)))
    flat = draws.reshape(len(names), -1).T
    return Identifiability(find_directions(names, width, flat, size), find_pairs(names, flat))


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
            prior_draws, posterior_draws = log_if_positive(prior[name], draws)
            shrunk = float(contraction(np.array([prior_draws.std()]), posterior_draws[:, None])[0])
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
                "note": NOT_INFORMED if shrunk < INFORMED else note,
                **dict.fromkeys(("joint_lower", "joint_median", "joint_upper"), np.nan),
                "joint_conflict": False,
            }
        )
    return tuple(rows)


def with_joint(run: Run, view: TestView) -> TestView:
    """A fitted test with each parameter's interval in the joint posterior of all tests.

    Alone and together disagree where the intervals do not overlap.
    """
    if not view.rows or not sequence_of(run).pooled(view.id):
        return view
    values, model = sequence_of(run).values(view.id), run.tests[view.id].posterior.model
    joint = {**values} | dict(zip(model.parameters, model.theta(values).T, strict=True))
    rows = []
    for row in view.rows:
        name, draws = row["name"], joint.get(row["name"])
        if draws is None or name in checks.SCALE_ONLY or not np.ptp(draws) > 0.0:
            rows.append(row)
            continue
        low, middle, high = np.quantile(draws, [0.025, 0.5, 0.975]).tolist()
        is_disjoint = name in (*model.parameters, "ell") and (
            low > row["upper"] or high < row["lower"]
        )
        together = {"joint_lower": low, "joint_median": middle, "joint_upper": high}
        rows.append(row | together | {"joint_conflict": bool(is_disjoint)})
    return replace(view, rows=tuple(rows))


def _modes(facts: Mapping[str, Any]) -> tuple[Mapping[str, float], ...]:
    """Medians and share of each mode with draws, the largest first; empty with one mode."""
    shares = np.atleast_2d(facts.get("mode_shares", [[]])).mean(axis=0)
    modes = [k for k in np.argsort(-shares).tolist() if shares[k] >= checks.SMALLEST_MODE]
    values = facts.get("mode_values", [])
    if len(modes) < 2 or len(values) != len(shares):
        return ()
    return tuple({**values[k], "share": float(shares[k])} for k in modes)


def _some(draws: Array) -> Array:
    """At most so many draws as figures show, evenly spaced; single precision saves memory."""
    return np.asarray(draws[:: -(-len(draws) // MAX_PLOTTED_DRAWS)], dtype=np.float32)


# --- the verdict

MILD = 3.0
"""Misfit, in tolerances, of a fault of a record that does not spoil it."""

_SPOILS, _LOST, _UNREACHED, _UNLIKE = 1000.0, 2000.0, 500.0, 100.0

_HINTS = {
    "residual rms": "the noise model is not that of the record, or the model lacks something",
    "lag-one residual correlation": "the noise model is not that of the record",
    "energy": (
        "the area of the loop is not the model's: the device changes during the test, or parts of "
        "the record differ"
    ),
    "peak force": "spikes at build-up that the model does not have, or a force that drifts",
    "force at mid-gap": "the gap is not as in the model",
    "coverage": "the bands are too narrow for this record",
}

MOST_NAMED = 4
"""Most tests that the verdict names with their reasons."""


def judge(
    tests: Iterable[str], checks: Sequence[Check], findings: Sequence[Finding]
) -> tuple[Judgement, ...]:
    """Judgement of each test from its checks and warnings, the one to believe least first.

    Misfit is counted in tolerances: 1 where the model misses a figure by as much as its tolerance.
    What is wrong with the record itself counts more than any misfit.
    """
    judged = [
        _judge(
            name, [c for c in checks if c.test == name], [f for f in findings if f.subject == name]
        )
        for name in tests
    ]
    return tuple(sorted(judged, key=lambda j: -j.misfit))


def _judge(test: str, checks: Sequence[Check], findings: Sequence[Finding]) -> Judgement:
    of_fit = [c for c in checks if c.check in (PREDICTIVE, COVERAGE)]
    missed = [c for c in of_fit if c.status in (CheckStatus.WARNING, CheckStatus.FAIL)]
    missed.sort(key=lambda check: -misfit_of(check))
    reasons: list[tuple[float, Message]] = []
    for number, finding in enumerate(sorted(findings, key=lambda f: not f.spoils)):
        message = finding.message
        if missed and number == 0 and finding.spoils and finding.name != "time unit":
            message = join([missed[0].message, message], ": ")  # no clock changes an energy
        reasons.append((_SPOILS if finding.spoils else MILD, message))
    reasons += [*_of_sampler(checks), *_of_slip(checks)]
    spoiled = any(f.spoils for f in findings)
    fit_missed = bool(missed) and not spoiled
    if fit_missed:
        reasons.append((misfit_of(missed[0]), _miss(missed)))
    failed = {c.check for c in checks if c.status == CheckStatus.FAIL}
    wrong = spoiled or bool(failed - set(SAMPLING))
    use = (
        Fitness.NOT_USABLE if wrong or failed else Fitness.WITH_CARE if reasons else Fitness.USABLE
    )
    reasons.sort(key=lambda reason: -reason[0])
    worst_misfit = max(map(misfit_of, of_fit), default=0.0)
    misfit = sum(size for size, _ in reasons) if reasons else min(worst_misfit, 1.0)
    if reasons and not fit_missed:  # else the worst misfit is one of the reasons
        misfit += worst_misfit
    notes = tuple(_of_modes(c) for c in checks if c.check == MODES and c.status == CheckStatus.NOTE)
    return Judgement(test, use, tuple(message for _, message in reasons), misfit, wrong, notes)


def misfit_of(check: Check) -> float:
    """Size of a miss over its tolerance; of a band, only what is missing inside."""
    size = -check.difference if check.check == COVERAGE else abs(check.difference)
    return max(float(size / check.tolerance), 0.0) if np.isfinite(check.tolerance) else 0.0


def _of_sampler(checks: Sequence[Check]) -> Iterator[tuple[float, Message]]:
    """Sampling that did not reach its targets, a test that was lost, and several modes."""
    names = {check.check for check in checks}
    if CALIBRATION in names:
        yield _LOST, Message("it could not be calibrated")
    if REPORT in names:
        yield _LOST, Message("it could not be shown in the report")
    short = [c for c in checks if c.check in SAMPLING and c.status == CheckStatus.FAIL]
    if short:
        suffix = f" and {len(short) - 1} more" if short[1:] else ""
        shortfall = f"{short[0].check} of {short[0].feature}{suffix}"
        text = "the sampling did not reach its targets ({first})"
        yield _UNREACHED, Message(text, {"first": shortfall})
    for check in checks:
        if check.check == MODES and check.status == CheckStatus.WARNING:
            yield MILD, _of_modes(check)


def _of_modes(check: Check) -> Message:
    shares = check.feature.removeprefix("posterior")
    text = f"{check.observed:.0f} different sets of parameters explain it{{held}}"
    return Message(text, {"held": shares})


def _of_slip(checks: Sequence[Check]) -> Iterator[tuple[float, Message]]:
    """Slip forces that are far from the measured ones, and whether the band is usable."""
    far = [c for c in checks if c.check == LOOP_ESTIMATE and c.status == CheckStatus.FAIL]
    if not far:
        return
    bands = [c for c in checks if c.check == COVERAGE]
    holds = bands and all(c.status in (CheckStatus.PASS, CheckStatus.NOTE) for c in bands)
    use = "its band is usable, its parameters are not" if holds else "do not use its parameters"
    advice = Message(f"{use}: a slip force is not the measured one, the noise stands in for it")
    details = (Message("{feature} {expected}, measured {observed}", c.message.values) for c in far)
    yield _UNLIKE, join([advice, join(details, ", ")], ": ")


def _miss(missed: Sequence[Check]) -> Message:
    """The worst miss with its likely cause, and how many others there are."""
    worst = missed[0]
    cause = next((text for name, text in _HINTS.items() if worst.feature.startswith(name)), "")
    if worst.feature.startswith("energy") and worst.observed < 0.0:
        cause = "the sign of the force or of the displacement is probably swapped"
    suffix = f"; {len(missed) - 1} more" if missed[1:] else ""
    sizes = f" ({abs(worst.difference):.0%} off, tolerance {worst.tolerance:.0%}): {cause}{suffix}"
    return join([worst.message, Message(sizes)], "")


def use_of(judged: Iterable[Judgement], checks: Iterable[Check]) -> Fitness:
    """What the whole run may be used for: as its worst test, check or law."""
    statuses, uses = {check.status for check in checks}, {j.use for j in judged}
    if CheckStatus.FAIL in statuses or Fitness.NOT_USABLE in uses:
        return Fitness.NOT_USABLE
    return (
        Fitness.WITH_CARE
        if CheckStatus.WARNING in statuses or Fitness.WITH_CARE in uses
        else Fitness.USABLE
    )


def verdict_sentences(
    manifest: Manifest, checks: Sequence[Check], judged: Sequence[Judgement]
) -> tuple[Message, ...]:
    """What a run may be used for, and why: a sentence each, the worst first."""
    failed = [check for check in checks if check.status == CheckStatus.FAIL]
    wrong = [j for j in judged if j.wrong]
    careful = [j for j in judged if j.use == Fitness.WITH_CARE]
    sentences = []
    for lead, group in (("Something is wrong with", wrong), ("To be used with care:", careful)):
        if group:
            sentences.append(Message(f"{lead} {len(group)} of {counted(len(judged), 'test')}."))
            for j in group[:MOST_NAMED]:
                head = Message("{test}: ", {"test": j.subject})
                sentences.append(join([head, join(j.reasons, "; "), Message(".")], ""))
            if group[MOST_NAMED:]:
                sentences.append(Message(f"And {len(group) - MOST_NAMED} more."))
    if all(j.use == Fitness.USABLE for j in judged):
        count = len(judged)
        subject = {1: "The test is", 2: "Both tests are"}.get(count, f"All {count} tests are")
        sentences.append(Message(f"{subject} reproduced within tolerance."))
    lost = {check.test for check in failed if check.check == CALIBRATION}
    advice = "correct what is wrong first" if wrong else "give a larger --effort"
    sentences.append(_of_sampling(failed, manifest, len(judged) - len(lost), advice))
    if len(judged) > 1 and judged[0].use != Fitness.USABLE:
        worst, second = judged[:2]
        addition = "" if second.misfit < worst.misfit else " (as little as {second})"
        names = {"worst": worst.subject, "second": second.subject}
        sentences.append(Message(f"The test to believe least is {{worst}}{addition}.", names))
    bent = [c for c in checks if c.check == FREE_EXPONENT and c.status == CheckStatus.WARNING]
    if bent:
        data = ", ".join(f"{c.feature}: exponent {c.observed:.2f}" for c in bent)
        text = f"The proportional law is not supported ({data}, not 1): do not extrapolate with it."
        sentences.append(Message(text))
    scattered = [c for c in checks if c.check == SCATTER]
    if scattered:
        data = ", ".join(
            f"{c.feature}: {c.observed:.0%}, the priors expect about {c.expected:.0%}"
            for c in scattered
        )
        text = (
            f"Tests at one actuation scatter more than expected ({data}): the actuation, a unit or "
            "the file of a test may be wrong, or the law does not hold."
        )
        sentences.append(Message(text))
    return tuple(sentences)


def _of_sampling(
    failed: Sequence[Check], manifest: Manifest, calibrated: int, advice: str
) -> Message:
    """Whether the sampling reached its targets, and what to do where it did not."""
    effort, laws = manifest.effort, "laws" if manifest.axes.actuated else "population"
    limits = f"R-hat <= {effort.r_hat:g}, bulk and tail ESS >= {effort.ess:g}, or "
    limits += f"{TAIL_SHARE * effort.ess:g} for tails of the population that Table II does not show"
    failures: dict[str, list[str]] = {}
    for c in failed:
        if c.check in SAMPLING:
            failures.setdefault(c.test, []).append(f"{c.check} of {c.feature}")
    if not failures:
        tests = "The calibrated test" if calibrated == 1 else f"All {calibrated} calibrated tests"
        return Message(f"{tests} and the {laws} converged ({limits}).")
    names = ", ".join(
        f"{test} ({failure}{f' and {len(remainder)} more' if remainder else ''})"
        for test, (failure, *remainder) in sorted(failures.items())
    )
    return Message(
        f"The sampling did not reach its targets ({limits}, and chains that are long enough) in "
        f"{{names}}: do not use these figures, but {advice}.",
        {"names": names},
    )


# --- remarks


def remarks(run: Run, tests: Sequence[TestView]) -> tuple[Message, ...]:
    """Sentences that a reader must know besides the verdict."""
    rows, texts = [row for view in tests for row in view.rows], []
    if run.manifest.truth:
        texts.append(
            "The tests are synthetic: they were computed from known parameters with known noise. "
            "Where a record was low-passed for the fit, the true noise of that record is not known."
        )
    if SCALED in run.priors.title:
        texts.append(
            "The scales of the priors were read off the records of this campaign: the data are "
            "used there for orders of magnitude, and once more in the calibration."
        )
    texts += [
        f"{name}: the {role} is made of {text}."
        for name, entry in run.manifest.tests.items()
        for role, text in entry.derived.items()
    ]
    if weak := _counted(row["name"] for row in rows if row["contraction"] < INFORMED):
        texts.append(f"Parameters that the data do not determine (number of tests): {weak}.")
    texts += _of_identifiability(tests)
    if disjoint := _counted(row["name"] for row in rows if row["joint_conflict"]):
        texts.append(
            "Parameters whose interval in a test alone does not overlap that in the joint "
            f"posterior of all tests, which predictions use (number of tests): {disjoint}."
        )
    if "gamma1" in run.model.standard_names & {row["name"] for row in rows}:
        texts.append(f"gamma1 and gamma2 are {SCALE_NOTE}; gamma1 keeps its prior.")
    followed = run.population.design.dependence
    texts += [
        f"Tests that were held out are predicted better if {s.quantity} depends on {s.covariate} "
        f"(elpd {s.difference:+.1f} ± {s.se:.1f} over tests): try it under [dependence]."
        for s in run.manifest.dependence_scores
        if s.covariate
        and s.covariate not in followed.get(s.quantity, ())
        and s.difference > max(s.se, 1.0)
    ]
    texts += zero_pressure_sentences(run.population.design, run.tests)
    levels = {round(t.trace.reference_actuation, 9) for t in run.tests.values()}
    if len(levels) < 2 and run.manifest.axes.actuated:
        texts.append(
            "All calibrated tests are at one actuation: at any other actuation, predictions rest "
            "only on the form of the laws."
        )
    return tuple(Message("{text}", {"text": text}) for text in texts)


def _counted(names: Iterable[str], limit: int | None = None) -> str:
    """Names with how often each is there, the most frequent first."""
    return ", ".join(f"{name} ({times})" for name, times in Counter(names).most_common(limit))


def _of_identifiability(tests: Sequence[TestView]) -> list[str]:
    """How many directions the data inform, and which parameters trade off most often."""
    identified = [view.identifiability for view in tests if view.identifiability is not None]
    if not identified:
        return []
    informed = sorted({f.directions.informed for f in identified})
    span = f"{informed[0]} to {informed[-1]}" if len(informed) > 1 else f"{informed[0]}"
    texts = [
        f"The model has {len(identified[0].directions.names)} parameters for each test, but a test "
        f"determines only {span} combinations of them better than the prior does."
    ]
    pairs = [f"{pair.first} and {pair.second}" for f in identified for pair in f.pairs]
    if pairs:
        texts.append(
            "Parameters that trade off, so that their combination is known better than each of "
            f"them (number of tests): {_counted(pairs, 4)}"
            f"{', and others' if len(set(pairs)) > 4 else ''}."
        )
    return texts


def zero_pressure_sentences(design: Design, tests: Iterable[str]) -> list[str]:
    """Which laws learn nothing from the tests at zero actuation; `tests` in the design's order."""
    settings = zip(tests, design.settings, strict=False)
    zeros = ", ".join(name for name, setting in settings if setting.actuation == 0)
    columns = zip(design.names, design.informs.T, strict=True)
    uninformed = [name for name, informs in columns if not informs.all()]
    if not zeros or not uninformed:
        return []
    laws = ", ".join(f"{name} ({design.laws[name]})" for name in uninformed)
    return [
        f"A law without an intercept has no value at zero actuation: from {zeros} nothing is "
        f"learned about {laws}. The laws affine and residual_power would learn from it."
    ]


Array = NDArray[np.float64]


def left_out_view(scores: CampaignCrossValidation | None) -> LeftOutView | None:
    """Scores of a cross-validation that the manifest holds; None without one."""
    if scores is None:
        return None
    rows: list[Row] = []
    for prediction in scores.predictions:
        held_out, fitted = prediction.score, prediction.fitted
        rows.append(
            {"part": prediction.part, "test": prediction.test}
            | score_record(held_out)
            | {"fitted_width": fitted.width, "fitted_crps": fitted.crps}
            | {"width_ratio": held_out.width / fitted.width if fitted.width > 0 else np.nan}
            | {"crps_ratio": held_out.crps / fitted.crps if fitted.crps > 0 else np.nan}
            | {
                "simultaneous_95": np.nan
                if prediction.simultaneous is None
                else float(prediction.simultaneous)
            }
        )
    names = [name for name in rows[0] if name not in ("part", "test")]
    mean = {name: float(np.mean([row[name] for row in rows])) for name in names}
    sources = "the others" if scores.by == "test" else f"those of the other {scores.by}s"
    is_covered = [row["simultaneous_95"] for row in rows]
    history = (
        " The 95 % bands of whole histories hold the whole force of "
        f"{sum(is_covered):.0f} of {len(is_covered)} tests."
    )
    sentence = (
        f"Of {len(rows)} tests, each predicted from {sources}, the 95 % bands hold "
        f"{100 * mean['coverage_95']:.1f} % of the force, the 50 % bands "
        f"{100 * mean['coverage_50']:.1f} %; they are on average {mean['width_ratio']:.1f} times "
        f"as wide as those of the fitted tests.{history if np.all(np.isfinite(is_covered)) else ''}"
    )
    return LeftOutView(scores.by, tuple(rows), {"part": "", "test": "mean"} | mean, sentence)
