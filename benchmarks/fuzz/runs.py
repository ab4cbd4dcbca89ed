"""Run folders that are damaged, with hashes computed again as a stranger could, and readers."""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fuzz.mutations import Rng
from benchmarks.fuzz.seeds import FORCE, MOTION, TIME, priors, texts
from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import PriorFile, units
from mfd_bayes.calibration.result import load_result
from mfd_bayes.evaluation.crossvalidate import Fold, read_predictions
from mfd_bayes.evaluation.laws import law_rows, law_views
from mfd_bayes.evaluation.properties import peaks_of
from mfd_bayes.evaluation.summary import assess, build_summary, verdicts
from mfd_bayes.evaluation.test_summary import calibrated_view, held_out_view
from mfd_bayes.evaluation.views import CampaignView
from mfd_bayes.pipeline.plan import Options, Plan, effort_of, plan_campaign
from mfd_bayes.population.design import design_of
from mfd_bayes.population.discrepancy import KNOTS, Residual, TravelBasis
from mfd_bayes.population.laws import LAW_NAMES
from mfd_bayes.population.population import LawDraws, Population
from mfd_bayes.population.settings import Setting, setting_of
from mfd_bayes.population.starts import Starts
from mfd_bayes.population.storage import load_population, save_population
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.tables import report_tables
from mfd_bayes.runs.folder import Existing, hash_stored, prepare_folder
from mfd_bayes.runs.manifest import read_manifest
from mfd_bayes.runs.run import Run, open_run
from mfd_bayes.store.files import json_text, write_json
from mfd_bayes.store.netcdf import CalibratedTest, load_trace, save_test, save_trace

LAWS = {"Fc_fwd": "power", "Fc_bwd": "proportional", "sigma0": "affine"}
MANIFEST = "manifest.json"

_TEST = """
[[test]]
id = "{id}"
file = "a.csv"
actuation = "{actuation} psi"
role = "{role}"
"""


def run_files(*, small: bool) -> dict[str, bytes]:
    """A run folder that no sampler has seen: draws of the prior, and a population of them."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "out"
        write_run(folder, small=small)
        files = [path for path in folder.rglob("*") if path.is_file()]
        return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


@cache
def plan_of(*, small: bool) -> Plan:
    """Plan of the run: a and b are calibrated, or a alone, and c is held out."""
    model, noise, names = ("lugre", "iid", "a") if small else ("three_stage", "ou", "ab")
    head = f'[campaign]\ntitle = "Brake 7"\npriors = "own.toml"\nmodel = "{model}"\n'
    head += f'noise = "{noise}"\narea = "1.5 in^2"\n\n[laws]\n'
    head += "".join(f'{name} = "{law}"\n' for name, law in LAWS.items())
    head += 'Fs_fwd = "power"\n'
    tests = [(name, 500 * (i + 1), "calibrate") for i, name in enumerate(names)]
    tests.append(("c", 700, "validate"))
    keys = ("id", "actuation", "role")
    entries = [_TEST.format(**dict(zip(keys, test, strict=True))) for test in tests]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "campaign.toml").write_text(head + "".join(entries))
        (folder / "own.toml").write_bytes(priors())
        (folder / "a.csv").write_bytes(texts()[0])
        return plan_campaign(folder / "campaign.toml", Options(effort="quick"))


def write_run(folder: Path, *, small: bool = False) -> None:
    """Write a finished run folder with its hashes."""
    plan = plan_of(small=small)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "priors.toml").write_bytes(priors())
    rng = np.random.default_rng(1)
    under = []
    for task in plan.tasks:
        posterior = Posterior(task.trace, plan.priors, task.noise, task.model, start=task.start)
        path = folder / "tests" / task.id / "posterior.nc"
        _write_posterior(path, posterior, rng)
        under.append(setting_of(task.trace))
    save_trace(folder / "tests/c/record.nc", Trace.from_arrays(TIME, MOTION, 0.7, FORCE), {})
    _write_population(folder / "population.nc", plan.priors, posterior.names, under, rng)
    score = {"coverage": [0.5, 0.9, 0.95], "width": 1.0, "interval_score": 1.2}
    score |= {"crps": 0.1, "rrse": 0.2}
    predictions = [{"part": "a", "test": "a", "score": score, "fitted": score}]
    stored = {"key": asdict(_fold()), "predictions": predictions}
    write_json(folder / "crossvalidation" / _fold().file, stored)
    names = [p.relative_to(folder).as_posix() for p in folder.rglob("*.*") if p.suffix != ".json"]
    about = _about(plan, predictions) | {"files": hash_stored(folder, names)}
    write_json(folder / MANIFEST, {**plan.manifest.content, **about})


def _write_posterior(path: Path, posterior: Posterior, rng: Rng) -> None:
    flat = posterior.draw_prior(rng, 24)
    theta = posterior.theta(flat)
    flat |= {name: theta[:, k] for k, name in enumerate(posterior.model.parameters)}
    density = posterior.log_prior(posterior.coordinates(flat)).reshape(2, 12)
    stats = dict.fromkeys(("lp", "log_prior", "log_likelihood"), density)
    facts = {"model": posterior.model.name, "noise": posterior.noise.name, "start": "sample"}
    facts |= {"test": path.parent.name, "seed": [1, 2], "walkers": 6, "steps": 300}
    facts |= {"discarded": 100, "modes": 2, "mode_shares": [[0.4, 0.6], [0.5, 0.5]]}
    facts["autocorrelation"] = dict.fromkeys(posterior.names, 10.0)
    facts["convergence"] = {name: [1.0, 500.0, 500.0] for name in flat}
    values = {name: draws.reshape(2, 12) for name, draws in flat.items()}
    predictive = np.zeros((2, 1, 60))
    save_test(path, CalibratedTest(values, units(), stats, posterior.trace, predictive, facts))


def _write_population(
    path: Path, priors: PriorFile, names: Sequence[str], under: list[Setting], rng: Rng
) -> None:
    design = design_of(priors, names, under, LAWS)
    begin = design.free.size + len(design.effects)
    h = rng.normal(-2.0, 0.2, size=(12, begin + len(design.shapes)))
    choice = np.tile([LAW_NAMES.index(law) for law in design.laws.values()], (12, 1))
    draws = {"h": h[:, :begin], "z": 0.1 * rng.normal(size=(12, design.quantity.size))}
    draws |= dict(zip(("share", "exponent"), design.law_shapes(h[:, begin:], choice), strict=True))
    zeros = np.zeros(2 * KNOTS)
    learned = 0.01 * rng.normal(size=zeros.size), 1e-4 * np.eye(zeros.size), zeros
    population = Population(
        design=design,
        draws=LawDraws(**{name: values.reshape(2, 6, -1) for name, values in draws.items()}),
        choice=choice.reshape(2, 6, -1),
        law_weights={name: {law: 1.0} for name, law in design.laws.items()},
        alternatives=LawDraws(**draws),
        alternative_weight=np.full(12, 1.0 / 12.0),
        residual=Residual(TravelBasis(1.0, 2.0), *learned, 1.0, 0.3, 0.2, 0.01, 0.01),
        starts=Starts(),
        priors=priors.parameters,
        actuation_unit="ksi",
        walkers=6,
        convergence=Convergence(np.ones(2), np.full(2, 500.0), np.ones(2)),
    )
    save_population(path, population)


def _about(plan: Plan, predictions: list[dict[str, Any]]) -> dict[str, Any]:
    """What a manifest holds once the run is finished, with everything that may be in it."""
    done = {"status": "done", "seconds": 1.0}
    tests = {
        name: entry | (done if entry["role"] == "calibrate" else {"status": "held out"})
        for name, entry in plan.manifest.content["tests"].items()
    }
    law = {"quantity": "Fc_fwd", "elpd": 2.0, "se": 1.0, "weight": 0.5}
    compared = {"subject": "a", "cycles": 6, "elpd": 2.0, "elpd_se": 1.0, "p_loo": 3.0}
    compared |= {"worst_k": 0.5, "bad": 0.0, "unsettled": 0.0, "difference": 0.0}
    compared |= {"difference_se": 0.0, "rrse": 0.1, "log_evidence": 2.0}
    compared |= {"log_evidence_se": 0.1, "evidence_k": 0.4, "evidence_trusted": True}
    return {
        "status": "finished",
        "finished": "2026-01-01T00:01:00+00:00",
        "tests": tests,
        "verdicts": {"campaign": "not usable", "sentence": "Not.", "a": "not usable"},
        "truth": {"population": {"scatter_offset": 0.02}, "tests": {"a": {"Fc_fwd": 1.0}}},
        "law_scores": [
            law | {"law": "power", "levels": [1.0, 1.0]},
            law | {"law": "affine", "levels": [0.5, 0.2]},
        ],
        "free_exponents": {"Fc_bwd": [0.9, 1.0, 1.1]},
        "dependence_scores": [law | {"covariate": "velocity", "difference": 3.0}],
        "population_sampler": {"accepted": {"h": 0.3}, "sweeps": 240},
        "crossvalidation": {"by": "test", "predictions": predictions},
        "comparison": {
            "rows": [compared | {"model": model} for model in ("lugre", "bouc_wen")],
            "sentence": "The records do not tell them apart.",
        },
        "seconds": 1.0,
    }


def _fold() -> Fold:
    return Fold("a", "test_1.json", ("a",), ("b",), "quick", 1)


def seal(files: dict[str, bytes]) -> dict[str, bytes]:
    """The files with a manifest whose hashes are theirs."""
    manifest = json.loads(files[MANIFEST])
    manifest["files"] = {
        name: hashlib.sha256(files[name]).hexdigest() for name in manifest["files"]
    }
    return files | {MANIFEST: json.dumps(manifest).encode()}


def read_report(path: Path) -> object:
    """All that `check` and `report` compute from a run folder, without figures."""
    out = next(folder for folder in path.parents if (folder / MANIFEST).is_file())
    run = open_run(out)
    view = assess(run)
    written = json_text(run.manifest.changed(verdicts=verdicts(view)).content)
    tables = report_tables(view)
    return [len(text.encode()) for text in (written, *tables.values())]


def read_shown(path: Path) -> object:
    """A manifest, and the report of the tests that there were before it was changed."""
    before, view = _opened(path.parent)
    run = replace(before, manifest=read_manifest(path.parent))
    shown = build_summary(run, list(view.tests), view.law_rows, view.laws)
    return json_text(run.manifest.content), verdicts(shown), report_tables(shown)


@cache
def _opened(out: Path) -> tuple[Run, CampaignView]:
    """The run as it was before anything in it was changed: a worker lays all out in one place."""
    run = open_run(out)
    return run, assess(run)


def read_posterior(path: Path) -> object:
    """A test's posterior, as a report shows it."""
    run, _ = _opened(path.parents[2])
    return calibrated_view(run.manifest, peaks_of(run), load_result("a", path, run.priors))


def read_held_out(path: Path) -> object:
    """The record of a test that is predicted, as a report shows it."""
    return held_out_view(_opened(path.parents[2])[0], "c", load_trace(path)[0])


def read_population(path: Path) -> object:
    """The population, as a report shows it and as it predicts."""
    run = replace(_opened(path.parent)[0])
    run.__dict__["population"] = load_population(path, run.priors)
    return law_rows(run), law_views(run), run.predict(run.held_out["c"], "observation", draws=20)


def read_resumed(path: Path) -> object:
    """A run folder, as `--resume` reads it."""
    plan = plan_of(small=True)
    effort_of(path.parent, None, resume=True)
    home = plan.campaign.folder
    resumed = prepare_folder(plan.manifest, home, path.parent, Existing.RESUMED)
    return json_text(resumed.manifest.content), resumed.before and resumed.before.content.keys()


def read_fold(path: Path) -> object:
    """Stored predictions of a part that was left out."""
    out, fold = path.parents[1], _fold()
    return fold.stored(out), list(read_predictions(out, [fold]))
