"""The whole report: every test, the laws, the verdict with its reason, and where it is from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from mfd_bayes.assessment.checks import (
    INFORMED,
    PREDICTIVE,
    SAMPLING,
    convergence_checks,
    standing_checks,
)
from mfd_bayes.assessment.fits import SCALE_NOTE, calibrated_view, held_out_view
from mfd_bayes.assessment.law_choices import law_choices
from mfd_bayes.assessment.laws import law_rows, law_views
from mfd_bayes.assessment.left_out import left_out_view
from mfd_bayes.assessment.systems import SI, system_of
from mfd_bayes.assessment.views import (
    STANDING,
    CampaignView,
    Check,
    LawView,
    Row,
    TestView,
    TruthRow,
)
from mfd_bayes.runs.run import Run
from mfd_bayes.runs.verdict import Verdict
from mfd_bayes.validation.models import ComparisonRow


def assess(run: Run) -> CampaignView:
    """Everything that the report of a run shows."""
    tests = [calibrated_view(run, test) for test in run.tests.values()]
    tests += [held_out_view(run, name, trace) for name, trace in run.held_out.items()]
    order = list(run.manifest["tests"])
    tests.sort(key=lambda view: order.index(view.id))
    return put_together(run, tests, law_rows(run), law_views(run))


def put_together(
    run: Run, tests: list[TestView], table: tuple[Row, ...], laws: tuple[LawView, ...]
) -> CampaignView:
    """The report of a run whose tests and laws are known, with what its manifest says."""
    manifest = run.manifest
    checks = [check for view in tests for check in view.checks]
    checks += convergence_checks("population", table, manifest["effort"])
    checks += standing_checks(manifest.get("free_exponents", {}))
    failures = {
        name: entry["error"] for name, entry in manifest["tests"].items() if entry.get("error")
    }
    checks += [Check(n, "calibration", "finished", 0.0, "finished", Verdict.FAIL) for n in failures]
    compared = manifest.get("comparison", {})
    verdict = Verdict.of(all(check.verdict != Verdict.FAIL for check in checks))
    return CampaignView(
        title=manifest["title"],
        verdict=verdict,
        sentence=_sentence(manifest, checks, len(run.tests)),
        actuation_unit=run.actuation_unit,
        tests=tuple(tests),
        failures=failures,
        laws=laws,
        law_rows=table,
        checks=tuple(checks),
        scores=tuple(view.score for view in tests),
        truth=_truth_rows(manifest, tests, table),
        provenance=_provenance(manifest),
        remarks=_remarks(run, tests),
        law_choices=law_choices(manifest.get("law_scores", ()), manifest["settings"]["laws"]),
        left_out=left_out_view(manifest.get("crossvalidation")),
        comparison=tuple(ComparisonRow(**row) for row in compared.get("rows", ())),
        comparison_sentence=compared.get("sentence", ""),
        metric=system_of(entry.get("unit", "in") for entry in manifest["tests"].values()) is SI,
    )


def fails(view: CampaignView) -> tuple[Check, ...]:
    """The checks that failed."""
    return tuple(check for check in view.checks if check.verdict == Verdict.FAIL)


def verdicts(view: CampaignView) -> dict[str, str]:
    """Verdict of the campaign with its sentence, and of every subject of a check."""
    found: dict[str, str] = {check.subject: Verdict.PASS for check in view.checks}
    found |= {check.subject: Verdict.FAIL for check in fails(view)}
    return {"campaign": view.verdict, "sentence": view.sentence} | found


def _truth_rows(
    manifest: Mapping[str, Any], tests: list[TestView], table: tuple[Row, ...]
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
            for noise in ("scatter_noise_sd", "scatter_noise_time"):
                known["population"].pop(noise, None)
    rows = [row for view in tests for row in view.rows] + list(table)
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
    failed = [check for check in checks if check.verdict == Verdict.FAIL]
    sampling = [c for c in failed if c.name in SAMPLING]
    lost = [c for c in failed if c.name == "calibration"]
    effort = manifest["effort"]
    limits = f"R-hat <= {effort['r_hat']:g}, bulk and tail ESS >= {effort['ess']:g}"
    parts = []
    if lost:
        parts.append(f"{len(lost)} test(s) could not be calibrated")
    if sampling:
        where: dict[str, list[str]] = {}
        for c in sampling:
            where.setdefault(c.subject, []).append(f"{c.name} of {c.target}")
        told = (
            f"{subject} ({names[0]}{f' and {len(names) - 1} more' if names[1:] else ''})"
            for subject, names in sorted(where.items())
        )
        parts.append(
            f"the sampling fell short of its targets ({limits}, and chains that are long enough) "
            f"in {', '.join(told)}: do not use these figures, give a larger --effort or look at "
            "the test"
        )
    else:
        tests = "the calibrated test" if calibrated == 1 else f"all {calibrated} calibrated tests"
        parts.append(f"{tests} and the laws converged ({limits})")
    predictive = [c for c in failed if c.name == PREDICTIVE]
    total = sum(c.name == PREDICTIVE for c in checks)
    if predictive:
        often = Counter(c.target.split(" (")[0].split(",")[0] for c in predictive)
        what = ", ".join(f"{name} ({count})" for name, count in often.most_common(4))
        parts.append(
            f"{len(predictive)} of {total} predictive checks are extreme, so the model does not "
            f"reproduce everything: {what}"
        )
    else:
        parts.append(f"none of {total} predictive checks is extreme")
    bent = [c for c in failed if c.name == STANDING]
    if bent:
        what = ", ".join(f"{c.target.split(' (')[0]}: exponent {c.value:.2f}" for c in bent)
        parts.append(
            f"the proportional law is not supported ({what}, not 1): do not extrapolate with it"
        )
    text = "; ".join(parts) + "."
    return text[0].upper() + text[1:]


def _remarks(run: Run, tests: list[TestView]) -> tuple[str, ...]:
    remarks = []
    if run.manifest.get("truth"):
        remarks.append(
            "The tests are synthetic: they were computed from a stated truth, with stated noise; "
            "where a record was low-passed for the fit, the noise has no truth to compare with."
        )
    if not run.hashed:
        remarks.append(
            "An older version of this program wrote the run, without hashes of its files: that "
            "they are as they were written is not known."
        )
    weak: Counter[str] = Counter()
    for view in tests:
        weak.update(r.name for r in view.rows if r.contraction < INFORMED)
    if weak:
        names = ", ".join(f"{name} ({count})" for name, count in weak.most_common())
        remarks.append(f"Not informed by the data (number of tests): {names}.")
    remarks += _identifiability_remarks(tests)
    if any("gamma1" in {r.name for r in view.rows} for view in tests):
        remarks.append("gamma1 and gamma2 are " + SCALE_NOTE + "; gamma1 keeps its prior.")
    remarks += _dependence_remarks(run.manifest)
    levels = {round(t.trace.reference_actuation, 9) for t in run.tests.values()}
    if len(levels) < 2:
        remarks.append(
            "All calibrated tests are at one actuation: the laws beyond it rest on their form."
        )
    return tuple(remarks)


def _dependence_remarks(manifest: Mapping[str, Any]) -> list[str]:
    """Quantities that predict tests left out better if they follow speed or stroke."""
    asked = manifest["settings"].get("dependence") or {}
    remarks = []
    for score in manifest.get("dependence_scores", ()):
        name, covariate, gain = score["quantity"], score["covariate"], score["difference"]
        if covariate and covariate not in asked.get(name, ()) and gain > max(score["se"], 1.0):
            remarks.append(
                f"Tests that are left out are predicted better if {name} follows the {covariate} "
                f"(elpd {gain:+.1f} ± {score['se']:.1f} over tests): try it under [dependence]."
            )
    return remarks


def _identifiability_remarks(tests: list[TestView]) -> list[str]:
    """How many directions the data inform, and which parameters trade off most often."""
    found = [view.identifiability for view in tests if view.identifiability is not None]
    if not found:
        return []
    informed = sorted({f.directions.informed for f in found})
    span = f"{informed[0]} to {informed[-1]}" if len(informed) > 1 else f"{informed[0]}"
    total = len(found[0].directions.names)
    remarks = [f"The data of a test inform {span} of {total} directions in parameter space."]
    pairs = Counter(f"{pair.first} and {pair.second}" for f in found for pair in f.pairs)
    if pairs:
        names = ", ".join(f"{name} ({count})" for name, count in pairs.most_common(4))
        remarks.append(
            f"Parameters that trade off, so that their combination is known better than either "
            f"(number of tests): {names}{', and others' if len(pairs) > 4 else ''}."
        )
    return remarks


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
