"""From a finished run to what its report shows: bands, checks, tables and the verdict."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import contraction, log_if_positive, measure
from mfd_bayes.calibration.predictive import PredictiveCheck, check_predictive, replicate
from mfd_bayes.population.scores import score
from mfd_bayes.quantities import UNITS, law_unit
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.views import (
    CampaignView,
    Check,
    Fan,
    Interval,
    LawView,
    Marginal,
    Row,
    ScoreRow,
    TestView,
    TruthRow,
)
from mfd_bayes.run import Run, TestResult

Array = NDArray[np.float64]

PROBABILITIES = (0.5, 0.95)
"""Equal-tailed bands that are drawn."""

INFORMED = 0.5
"""Share of the prior's variance that the data must remove from a parameter to inform it."""

EXTREME = 0.005
"""A posterior predictive p-value nearer than this to 0 or 1 is extreme."""

SCALE_ONLY = frozenset({"gamma1", "gamma2"})
_LENGTH = "autocorrelation times kept"
_SAMPLING = ("R-hat", "bulk ESS", "tail ESS", _LENGTH)
_SCALE_NOTE = "not identifiable: only ℓ = γ2/γ1 reaches the force"
_CORNER = ("Fc_fwd", "Fc_bwd", "sigma0", "k2", "k3", "d2", "d3", "ell")


def assess(run: Run) -> CampaignView:
    """Everything that the report of a run shows."""
    manifest = run.manifest
    tests = [_calibrated(run, test) for test in run.tests.values()]
    tests += [_held_out(run, name, trace) for name, trace in run.held_out.items()]
    order = list(manifest["tests"])
    tests.sort(key=lambda view: order.index(view.id))
    law_rows = _law_rows(run)
    checks = [check for view in tests for check in view.checks]
    checks += _convergence_checks("population", law_rows, manifest["effort"])
    failures = {
        name: entry["error"] for name, entry in manifest["tests"].items() if entry.get("error")
    }
    checks += [Check(n, "calibration", "finished", 0.0, "finished", "fail") for n in failures]
    verdict = "fail" if any(check.verdict == "fail" for check in checks) else "pass"
    return CampaignView(
        title=manifest["title"],
        verdict=verdict,
        sentence=_sentence(manifest, checks, len(run.tests)),
        actuation_unit=run.actuation_unit,
        tests=tuple(tests),
        failures=failures,
        laws=_law_views(run),
        law_rows=law_rows,
        checks=tuple(checks),
        scores=tuple(view.score for view in tests),
        truth=_truth_rows(manifest, tests, law_rows),
        provenance=_provenance(manifest),
        remarks=_remarks(run, tests),
    )


def _calibrated(run: Run, test: TestResult) -> TestView:
    posterior, facts = test.posterior, test.stored.facts
    values = test.stored.values()
    replicas = replicate(posterior, values, np.random.default_rng(0))
    gap = float(np.median(values["d2"] + values["d3"])) if posterior.model.has_gap else None
    rows = _rows(test, values)
    checks = _convergence_checks(test.id, rows, run.manifest["effort"])
    checks.append(_length_check(test.id, facts, run.manifest["effort"]))
    checks += [_predictive(test.id, c) for c in check_predictive(posterior, replicas, gap)]
    checks += _notes(test.id, rows, facts)
    informed = {row.name: row.contraction >= INFORMED for row in rows}
    return TestView(
        id=test.id,
        role="calibrate",
        actuation=_actuation(run, test.trace),
        trace=test.trace,
        first=posterior.first,
        device=_fan("device", replicas.force),
        observation=_fan("observation", replicas.observed),
        rows=tuple(rows),
        marginals=_marginals(test, values, rows),
        chains={name: _by_step(test, name) for name in posterior.names},
        corner=tuple(name for name in _CORNER if informed.get(name)),
        checks=tuple(checks),
        score=_score(test.id, "calibrate", test.trace, replicas.observed, posterior.first),
    )


def _held_out(run: Run, name: str, trace: Trace) -> TestView:
    band = run.predict(trace, kind="observation", draws=800)
    return TestView(
        id=name,
        role="validate",
        actuation=_actuation(run, trace),
        trace=trace,
        first=0,
        device=None,
        observation=_fan("observation", band.draws),
        rows=(),
        marginals=(),
        chains={},
        corner=(),
        checks=(),
        score=_score(name, "validate", trace, band.draws, 0),
    )


def _fan(kind: str, draws: Array) -> Fan:
    tails = [0.5 * (1.0 - p) for p in PROBABILITIES]
    levels = [0.5, *tails, *(1.0 - t for t in tails)]
    median, *bounds = np.quantile(draws, levels, axis=0)
    n = len(tails)
    intervals = (Interval(p, bounds[i], bounds[n + i]) for i, p in enumerate(PROBABILITIES))
    return Fan(kind, median, tuple(intervals))


def _score(name: str, role: str, trace: Trace, draws: Array, first: int) -> ScoreRow:
    found = score(draws[:, first:], np.asarray(trace.force)[first:])
    half, most, nearly = found.coverage
    return ScoreRow(name, role, half, most, nearly, found.width, found.crps, found.rrse)


def _actuation(run: Run, trace: Trace) -> str:
    level, unit = trace.reference_actuation, run.actuation_unit
    text = f"{1000 * level:.4g} {'psi' if unit == 'ksi' else 'lbf'}"
    return f"{text} (mean of a history)" if trace.varying else text


def _rows(test: TestResult, values: Mapping[str, Array]) -> list[Row]:
    """Table I of one test: every parameter with its uncertainty and convergence."""
    prior = _prior_values(test)
    facts = test.stored.facts
    rows = []
    for name, draws in values.items():
        shrunk = float("nan")
        if name not in SCALE_ONLY:
            before, after = log_if_positive(prior[name], draws)
            shrunk = float(contraction(np.array([before.std()]), after[:, None])[0])
        note = _SCALE_NOTE if name in SCALE_ONLY else ""
        if shrunk < INFORMED:
            note = "the data do not inform it: the posterior is about the prior"
        lower, median, upper = np.quantile(draws, [0.025, 0.5, 0.975])
        r_hat, bulk, tail = facts["convergence"].get(name, (np.nan, np.nan, np.nan))
        rows.append(
            Row(
                subject=test.id,
                name=name,
                unit=UNITS[name],
                mean=float(draws.mean()),
                sd=float(draws.std()),
                lower=float(lower),
                median=float(median),
                upper=float(upper),
                r_hat=r_hat,
                ess_bulk=bulk,
                ess_tail=tail,
                contraction=shrunk,
                note=note,
            )
        )
    return rows


def _prior_values(test: TestResult, n: int = 2000) -> dict[str, Array]:
    """Prior draws of every stored quantity, derived ones too."""
    posterior = test.posterior
    drawn = posterior.draw_prior(np.random.default_rng(0), n)
    theta = posterior.theta(drawn)
    return drawn | dict(zip(posterior.model.parameters, theta.T, strict=True))


def _marginals(
    test: TestResult, values: Mapping[str, Array], rows: list[Row]
) -> tuple[Marginal, ...]:
    prior = _prior_values(test)
    shrunk = {row.name: row.contraction for row in rows}
    sampled = test.posterior.names
    return tuple(Marginal(n, UNITS[n], prior[n], values[n], shrunk[n]) for n in sampled)


def _by_step(test: TestResult, name: str) -> Array:
    """Mean over walkers at each kept step, (chain, step)."""
    draws = test.draws[name].to_numpy()
    walkers = test.stored.facts["walkers"]
    mean: Array = draws.reshape(len(draws), walkers, -1).mean(axis=1)
    return mean


def _convergence_checks(subject: str, rows: Any, effort: Mapping[str, Any]) -> list[Check]:
    checks = []
    for row in rows:
        if not np.isfinite(row.r_hat):
            continue
        for name, value, limit, good in (
            ("R-hat", row.r_hat, f"<= {effort['r_hat']:g}", row.r_hat <= effort["r_hat"]),
            ("bulk ESS", row.ess_bulk, f">= {effort['ess']:g}", row.ess_bulk >= effort["ess"]),
            ("tail ESS", row.ess_tail, f">= {effort['ess']:g}", row.ess_tail >= effort["ess"]),
        ):
            checks.append(Check(subject, name, row.name, value, limit, "pass" if good else "fail"))
    return checks


def _length_check(subject: str, facts: Mapping[str, Any], effort: Mapping[str, Any]) -> Check:
    """Whether the chains are long against their own memory."""
    slowest, time = max(facts["autocorrelation"].items(), key=lambda item: item[1])
    lengths = (facts["steps"] - facts["discarded"]) / time
    good = lengths >= effort["length"]
    verdict = "pass" if good else "fail"
    return Check(subject, _LENGTH, slowest, lengths, f">= {effort['length']:g}", verdict)


def _predictive(subject: str, check: PredictiveCheck) -> Check:
    good = EXTREME <= check.p_value <= 1.0 - EXTREME
    return Check(
        subject,
        "posterior predictive p-value",
        f"{check.name} (observed {check.observed:.3g}, expected {check.expected:.3g})",
        check.p_value,
        f"in [{EXTREME:g}, {1 - EXTREME:g}]",
        "pass" if good else "fail",
    )


def _notes(subject: str, rows: list[Row], facts: Mapping[str, Any]) -> list[Check]:
    notes = [
        Check(subject, "prior variance removed", r.name, r.contraction, f">= {INFORMED:g}", "note")
        for r in rows
        if np.isfinite(r.contraction) and r.contraction < INFORMED
    ]
    if facts["modes"] > 1:
        notes.append(Check(subject, "modes found", "posterior", facts["modes"], "1", "note"))
    return notes


def _law_rows(run: Run) -> tuple[Row, ...]:
    """Table II: slopes and intercepts, the laws' shapes, and the scatter of each group."""
    population = run.population
    unit = run.actuation_unit
    found = dict(population.slopes)
    for name, shape in population.shapes.items():
        power = population.pooling.laws[name] == "power"
        found[f"exponent_{name}" if power else f"share_{name}"] = (
            shape if power else 1.0 / (1.0 + np.exp(-shape))
        )
    found |= {f"scatter_{group}": tau for group, tau in population.scatters.items()}
    rows = []
    for name, draws in found.items():
        chains = draws.reshape(len(draws), population.walkers, -1, 1).swapaxes(1, 2)
        converged = measure(chains)
        lower, median, upper = np.quantile(draws, [0.025, 0.5, 0.975])
        rows.append(
            Row(
                subject="population",
                name=name,
                unit=law_unit(name, unit),
                mean=float(draws.mean()),
                sd=float(draws.std()),
                lower=float(lower),
                median=float(median),
                upper=float(upper),
                r_hat=converged.worst_r_hat,
                ess_bulk=float(converged.ess_bulk[0]),
                ess_tail=float(converged.ess_tail[0]),
                contraction=float("nan"),
            )
        )
    return tuple(rows)


def _law_views(run: Run) -> tuple[LawView, ...]:
    population = run.population
    pooling = population.pooling
    levels = [test.trace.reference_actuation for test in run.tests.values()]
    grid = np.linspace(0.0, 1.15 * max(levels), 60)
    rng = np.random.default_rng(0)
    views = []
    for name, law in pooling.laws.items():
        medians = population.median(name, grid).reshape(-1, grid.size)
        pick = np.linspace(0, len(medians) - 1, 4000).astype(np.intp)
        group = pooling.member[pooling.names.index(name)]
        scatter = population.scatter[..., group].reshape(-1)[pick]
        swing = np.exp(scatter * rng.standard_normal(pick.size))[:, None]
        tested = []
        for test in run.tests.values():
            low, mid, high = np.quantile(test.draws[name].to_numpy(), [0.025, 0.5, 0.975])
            level = test.trace.reference_actuation
            tested.append((test.id, level, float(low), float(mid), float(high)))
        views.append(
            LawView(
                name=name,
                unit=UNITS[name],
                law=law,
                actuation=grid,
                median=_fan("device", medians[pick]),
                new_test=_fan("new_test", medians[pick] * swing),
                tested=tuple(tested),
            )
        )
    return tuple(views)


def _truth_rows(
    manifest: Mapping[str, Any], tests: list[TestView], law_rows: tuple[Row, ...]
) -> tuple[TruthRow, ...]:
    """Synthetic truth beside each posterior, for the quantities whose truth is known.

    The noise of a record that was low-passed is no longer the noise that it was made with.
    """
    truth = manifest.get("truth")
    if not truth:
        return ()
    known = {"population": dict(truth["population"])}
    for name, values in truth["tests"].items():
        entry = manifest["tests"][name]
        filtered = entry["rate"] < 0.999 * entry["record_rate"]
        known[name] = {k: v for k, v in values.items() if not (filtered and "noise" in k)}
        if filtered:
            known["population"].pop("scatter_noise", None)
    rows = [row for view in tests for row in view.rows] + list(law_rows)
    found = []
    for row in rows:
        value = known.get(row.subject, {}).get(row.name)
        if value is None:
            continue
        found.append(
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
        )
    return tuple(found)


def _sentence(manifest: Mapping[str, Any], checks: list[Check], calibrated: int) -> str:
    """The verdict with its reason."""
    failed = [check for check in checks if check.verdict == "fail"]
    sampling = [c for c in failed if c.name in _SAMPLING]
    lost = [c for c in failed if c.name == "calibration"]
    effort = manifest["effort"]
    limits = f"R-hat <= {effort['r_hat']:g}, bulk and tail ESS >= {effort['ess']:g}"
    parts = []
    if lost:
        parts.append(f"{len(lost)} test(s) could not be calibrated")
    if sampling:
        where = ", ".join(sorted({c.subject for c in sampling}))
        parts.append(f"the sampling fell short of {limits} in {where}: do not use these figures")
    else:
        parts.append(f"all {calibrated} calibrated tests and the laws converged ({limits})")
    predictive = [c for c in failed if c.name == "posterior predictive p-value"]
    total = sum(c.name == "posterior predictive p-value" for c in checks)
    if predictive:
        often = Counter(c.target.split(" (")[0].split(",")[0] for c in predictive)
        what = ", ".join(f"{name} ({count})" for name, count in often.most_common(4))
        parts.append(
            f"{len(predictive)} of {total} predictive checks are extreme, so the model does not "
            f"reproduce everything: {what}"
        )
    else:
        parts.append(f"none of {total} predictive checks is extreme")
    text = "; ".join(parts) + "."
    return text[0].upper() + text[1:]


def _remarks(run: Run, tests: list[TestView]) -> tuple[str, ...]:
    remarks = []
    if run.manifest.get("truth"):
        remarks.append(
            "The tests are synthetic: they were computed from a stated truth, with stated noise; "
            "where a record was low-passed for the fit, the noise has no truth to compare with."
        )
    weak: Counter[str] = Counter()
    for view in tests:
        weak.update(r.name for r in view.rows if r.contraction < INFORMED)
    if weak:
        names = ", ".join(f"{name} ({count})" for name, count in weak.most_common())
        remarks.append(f"Not informed by the data (number of tests): {names}.")
    if any("gamma1" in {r.name for r in view.rows} for view in tests):
        remarks.append("gamma1 and gamma2 are " + _SCALE_NOTE + "; gamma1 keeps its prior.")
    levels = {round(t.trace.reference_actuation, 9) for t in run.tests.values()}
    if len(levels) < 2:
        remarks.append(
            "All calibrated tests are at one actuation: the laws beyond it rest on their form."
        )
    return tuple(remarks)


def _provenance(manifest: Mapping[str, Any]) -> dict[str, str]:
    effort = manifest["effort"]
    facts = {
        "command": manifest["command"],
        "started": manifest["started"],
        "finished": manifest["finished"],
        "seed": str(manifest["seed"]),
        "effort": f"{effort['name']}: {effort['ensembles']} ensembles, at most "
        f"{effort['limit']} steps each",
        "model and noise": f"{manifest['settings']['model']}, {manifest['settings']['noise']}",
        "priors": manifest["settings"]["priors"],
        "platform": manifest["platform"],
        "versions": ", ".join(f"{k} {v}" for k, v in manifest["versions"].items()),
    }
    for name, digest in manifest["inputs"].items():
        facts[f"SHA-256 of {name}"] = digest
    return facts


def fails(view: CampaignView) -> tuple[Check, ...]:
    """The checks that failed."""
    return tuple(check for check in view.checks if check.verdict == "fail")
