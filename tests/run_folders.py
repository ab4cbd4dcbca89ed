"""Finished run folders that no sampler has seen, and in which files two folders differ."""

import json
import re
import tempfile
from dataclasses import asdict
from functools import cache
from pathlib import Path

import h5py
import numpy as np

from mfd_bayes.applications.comparison.crossvalidation import Fold
from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import find_priors, units
from mfd_bayes.pipeline.options import RunOptions
from mfd_bayes.pipeline.plan import Plan, plan_campaign
from mfd_bayes.population.design import LAW_NAMES, design_of, setting_of
from mfd_bayes.population.population import (
    KNOTS,
    InitialGapPrior,
    LawDraws,
    Population,
    Residual,
    TravelBasis,
    save_population,
)
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.folder import hash_stored
from mfd_bayes.store.files import write_json
from mfd_bayes.store.netcdf import save_test, save_trace

TIME = np.arange(60) * 0.05
MOTION = np.sin(2 * np.pi * TIME)
FORCE = 2.0 * np.sign(np.cos(2 * np.pi * TIME))
RECORD = "time_s,displacement_in,force_kip\n" + "".join(
    f"{t:.6g},{x:.6g},{f:.6g}\n" for t, x, f in zip(TIME, MOTION, FORCE, strict=True)
)
PRIORS = find_priors("mfd").read_text(encoding="utf-8")

BUILDING = """
[building]
[[storey]]
weight = "20 kip"
stiffness = "8 kip/in"
[[damper]]
storey = 1
actuation = "800 psi"
"""
LAWS = {"Fc_fwd": "power", "Fc_bwd": "proportional", "sigma0": "affine"}

_TEST = """
[[test]]
id = "{id}"
file = "a.csv"
actuation = "{actuation} psi"
role = "{role}"
"""


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
        (folder / "own.toml").write_text(PRIORS, encoding="utf-8")
        (folder / "a.csv").write_text(RECORD)
        return plan_campaign(folder / "campaign.toml", RunOptions(effort="quick"))


def write_run(folder: Path, *, small: bool) -> Path:
    """A finished run folder with its hashes, which is written."""
    plan = plan_of(small=small)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "priors.toml").write_text(PRIORS, encoding="utf-8")
    rng = np.random.default_rng(1)
    settings = []
    for task in plan.tasks:
        posterior = Posterior(task.trace, plan.priors, task.noise, task.model, initial=task.initial)
        path = folder / "tests" / task.id / "posterior.nc"
        _write_posterior(path, posterior, rng)
        settings.append(setting_of(task.trace))
    save_trace(folder / "tests/c/record.nc", Trace.from_arrays(TIME, MOTION, 0.7, FORCE), {})
    _write_population(folder / "population.nc", plan.priors, posterior.names, settings, rng)
    score = {"coverage": [0.5, 0.9, 0.95], "width": 1.0, "interval_score": 1.2}
    score |= {"crps": 0.1, "rrse": 0.2}
    predictions = [{"part": "a", "test": "a", "score": score, "fitted": score}]
    fold = Fold("a", "test_1.json", ("a",), ("b",), "quick", 1)
    stored = {"key": asdict(fold), "predictions": predictions}
    write_json(folder / "crossvalidation" / fold.file, stored)
    names = [p.relative_to(folder).as_posix() for p in folder.rglob("*.*") if p.suffix != ".json"]
    metadata = _about(plan, predictions) | {"files": hash_stored(folder, names)}
    write_json(folder / "manifest.json", {**plan.manifest.content, **metadata})
    return folder


def _write_posterior(path, posterior, rng):
    flat = posterior.sample_prior(24, rng)
    theta = posterior.theta(flat)
    flat |= {name: theta[:, k] for k, name in enumerate(posterior.model.parameters)}
    density = posterior.log_prior(posterior.coordinates(flat)).reshape(2, 12)
    stats = dict.fromkeys(("lp", "log_prior", "log_likelihood"), density)
    facts = {"model": posterior.model.name, "noise": posterior.noise.name, "initial": "sample"}
    facts |= {"test": path.parent.name, "seed": [1, 2], "walkers": 6, "steps": 300}
    facts |= {"discarded": 100, "modes": 2, "mode_shares": [[0.4, 0.6], [0.5, 0.5]]}
    facts["autocorrelation"] = dict.fromkeys(posterior.names, 10.0)
    facts["convergence"] = {name: [1.0, 500.0, 500.0] for name in flat}
    values = {name: draws.reshape(2, 12) for name, draws in flat.items()}
    predictive = np.zeros((2, 1, 60))
    save_test(path, values, units(), stats, posterior.trace, predictive, facts)


def _write_population(path, priors, names, settings, rng):
    design = design_of(priors, names, settings, LAWS)
    begin = design.free.size + len(design.effects)
    h = rng.normal(-2.0, 0.2, size=(12, begin + len(design.shapes)))
    choice = np.tile([LAW_NAMES.index(law) for law in design.laws.values()], (12, 1))
    share, exponent = design.law_shapes(h[:, begin:], choice)
    draws = {"h": h[:, :begin], "z": 0.1 * rng.normal(size=(12, design.quantity.size))}
    draws |= {"share": share, "exponent": exponent}
    draws["knots"] = 0.01 * rng.normal(size=(12, 2 * KNOTS))
    watched = np.full(h.shape[1] + design.tabled.size, 500.0)
    zeros = np.zeros(2 * KNOTS)
    population = Population(
        design=design,
        draws=LawDraws(**{name: values.reshape(2, 6, -1) for name, values in draws.items()}),
        choice=choice.reshape(2, 6, -1),
        law_weights={name: {law: 1.0} for name, law in design.laws.items()},
        alternatives=LawDraws(**draws),
        alternative_weight=np.full(12, 1.0 / 12.0),
        residual=Residual(TravelBasis(1.0, 2.0), zeros, zeros, 1.0, 0.3, 0.2, 0.01, 0.01),
        starts=InitialGapPrior(),
        priors=priors.parameters,
        actuation_unit="ksi",
        walkers=6,
        convergence=Convergence(watched / 500.0, watched, watched),
    )
    save_population(path, population)


def _about(plan, predictions):
    """What a manifest holds once the run is finished, with everything that may be in it."""
    status = {"status": "done", "seconds": 1.0}
    tests = {
        name: entry | (status if entry["role"] == "calibrate" else {"status": "held out"})
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
        "crossvalidation": {"by": "test", "predictions": predictions},
        "comparison": {
            "rows": [compared | {"model": model} for model in ("lugre", "bouc_wen")],
            "sentence": "The records do not tell them apart.",
        },
        "seconds": 1.0,
    }


def content(path):
    """What of a file is to be the same in every run: all but times, and the command's words."""
    if path.suffix == ".nc":
        with h5py.File(path) as file:
            names: list[str] = []
            file.visit(names.append)
            datasets = {n: file[n] for n in names if isinstance(file[n], h5py.Dataset)}
            return {name: np.asarray(item[()]).tobytes() for name, item in datasets.items()}
    if path.name == "manifest.json":
        manifest = json.loads(path.read_text())
        for key in ("command", "started", "finished", "seconds"):
            manifest.pop(key, None)
        for entry in manifest["tests"].values():
            entry.pop("seconds", None)
        return manifest | {"files": sorted(manifest["files"])}  # posteriors hold their wall times
    if path.name == "assessment.json":  # of the manifest and the posteriors, by their hashes
        stored = json.loads(path.read_text())
        return stored | {"manifest": "", "files": sorted(stored["files"])}
    if path.name == "report.html":
        return re.sub(r"<dt>(command|started|finished)</dt><dd>[^\n]*</dd>", "", path.read_text())
    return path.read_bytes()


def files(folder: Path) -> set[str]:
    """Every file of a folder, hidden ones too."""
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def differing(folder: Path, reference: Path) -> list[str]:
    """Files of a run folder whose content differs from the reference's; without hidden files."""

    def same(name):
        try:
            return content(folder / name) == content(reference / name)
        except (OSError, ValueError, KeyError):
            return False

    return [n for n in sorted(files(folder)) if not Path(n).name.startswith(".") and not same(n)]
