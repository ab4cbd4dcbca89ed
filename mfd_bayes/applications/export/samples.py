"""Joint samples of a new device for quoFEM, OpenSees and CSV."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mfd_bayes.applications.buildings import draw_device
from mfd_bayes.applications.export.c_source import write_source
from mfd_bayes.applications.export.fmu import write_fmu
from mfd_bayes.applications.export.options import ExportOptions
from mfd_bayes.applications.export.sets import check_model, middle_level, parameter_sets
from mfd_bayes.errors import CampaignError, StoreError
from mfd_bayes.friction.bouc_wen import BoucWen
from mfd_bayes.friction.model import Model
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.folder import POPULATION, check_folder, check_outputs
from mfd_bayes.runs.run import Run, actuation_level, open_run
from mfd_bayes.runs.tested_range import Range, extrapolation_messages, extrapolations
from mfd_bayes.store.files import read_json, remove_file, write_json, write_text

Array = NDArray[np.float64]

TABLES = ("quofem", "opensees", "csv")  # forms of --to that are tables of draws
FITS = 24  # draws to which a material is fitted
ABOUT = "about.json"
_MADE_BY = "mfd_bayes export"


def export(options: ExportOptions) -> tuple[list[str], list[str]]:
    """Write the samples of a new device; what was written, and reasons to trust it less."""
    folder, is_fmu = options.folder, options.to == "fmu"
    path = folder if folder.suffix == ".fmu" else folder / "damper.fmu"
    if is_fmu:
        check_outputs([path], [], force=options.force)
    else:
        check_folder(folder, force=options.force)
    run = open_run(options.out, trust=options.trust_model)
    level = middle_level(run)
    actuated = run.manifest.axes.actuated
    if options.actuation:
        if not actuated:
            raise CampaignError("--actuation: the campaign's tests have none; leave it out")
        level = actuation_level(run, options.actuation)
    reach = [Range("actuation", run.actuation_unit, level, level)] if actuated else []
    exceedances = extrapolations(run.tested, reach)
    far = extrapolation_messages(exceedances, run.system)
    if far and not options.extrapolate:
        raise CampaignError(f"{far}; give --extrapolate to export it all the same")
    remarks = [extrapolation.sentence(run.system) for extrapolation in exceedances]
    draws = options.draws or (1000 if options.to in TABLES else 100)
    if options.to not in TABLES:
        check_model(run, f"--to {options.to}")
        sets = parameter_sets(run, level, draws, options.seed, extrapolate=options.extrapolate)
        if is_fmu:
            return write_fmu(run, sets, path, options.fmi), remarks
        return write_source(run, sets, folder), remarks
    units, samples = _samples(run, level, draws, options.seed)
    facts: dict[str, object] = {
        "made_by": _MADE_BY,
        **({"actuation": {"value": level, "unit": run.actuation_unit}} if actuated else {}),
        "variables": units,
        "draws": draws,
        "seed": options.seed,
        "kind": "new_test",
        "population_sha256": (run.manifest.files or {}).get(POPULATION),
    } | ({"remarks": remarks} if remarks else {})
    facts = _without_others(folder, facts)
    if options.to == "csv":
        sentences = _write_csv(folder, units, samples)
    elif options.to == "quofem":
        sentences = _write_quofem(folder, list(units), samples)
    else:
        sentences = _write_opensees(folder, run, samples[:FITS], facts)
    write_json(folder / ABOUT, facts)
    return sentences, remarks


def _samples(run: Run, level: float, draws: int, seed: int) -> tuple[dict[str, str], Array]:
    """Units of a new device's parameters, and start in its gap, by name, and their draws (n, m)."""
    model = next(iter(run.tests.values())).posterior.model
    theta, start = draw_device(run.population, model, level, run.actuation_unit, draws, seed)
    unit_of = {q.name: q.unit for q in model.quantities}
    units = {name: unit_of.get(name, "1") for name in model.parameters}
    if not model.has_gap:
        return units, theta
    return units | {"start": "1"}, np.column_stack([theta, start])


def _without_others(folder: Path, facts: dict[str, object]) -> dict[str, object]:
    """What is said about the samples, of all their forms in the folder.

    Where an earlier export is of other samples, its files are removed: nothing would say what they
    are.
    """
    try:
        earlier = read_json(folder / ABOUT)
    except StoreError:  # there is none
        return facts
    if earlier.get("made_by") != _MADE_BY:
        return facts
    if all(earlier.get(key) == value for key, value in facts.items()):
        of_fits = ("misfit", "misfit_of_tests", "best", "amplitude_in")
        return facts | {key: earlier[key] for key in of_fits if key in earlier}
    names = ["samples.csv", "randomVariables.json", "dakotaTab.out"]
    for key, kind in (("variables", "txt"), ("misfit", "tcl")):
        words = earlier.get(key)
        if isinstance(words, dict):
            names += [f"{word}.{kind}" for word in words if re.fullmatch(r"\w+", word)]
    for name in names:
        remove_file(folder / name)
    return facts


def _write_csv(folder: Path, units: dict[str, str], samples: Array) -> list[str]:
    """One table with a header."""
    head = [
        name if unit == "1" else f"{name}_{unit.replace('*', '_').replace('/', '_per_')}"
        for name, unit in units.items()
    ]
    lines = [",".join(head), *(",".join(f"{v:.9g}" for v in row) for row in samples)]
    write_text(folder / "samples.csv", "\n".join(lines) + "\n")
    return [f"{len(samples)} joint samples of {len(units)} variables: {folder / 'samples.csv'}"]


def _write_quofem(folder: Path, names: list[str], samples: Array) -> list[str]:
    """A column per variable without a header, the group of all, and dakotaTab.out."""
    for name, column in zip(names, samples.T, strict=True):
        write_text(folder / f"{name}.txt", "\n".join(f"{v:.12g}" for v in column) + "\n")
    kind = {"variableClass": "Uncertain", "inputType": "Dataset", "distribution": "Discrete"}
    variables = [
        {"name": name, **kind, "refCount": 1, "value": f"RV.{name}", "dataDir": f"{name}.txt"}
        for name in names
    ]
    group = [f"{{{','.join(names)}}}"]
    write_json(
        folder / "randomVariables.json", {"randomVariables": variables, "RVdataGroup": group}
    )
    lines = ["%eval_id interface " + " ".join(names)]
    for i, row in enumerate(samples, start=1):
        lines.append(f"{i} NO_ID " + " ".join(f"{v:.12g}" for v in row))
    write_text(folder / "dakotaTab.out", "\n".join(lines) + "\n")
    return [
        f"{len(samples)} joint samples of {len(names)} variables: a file each in {folder}",
        f"their group, which keeps the correlation: {folder / 'randomVariables.json'}; "
        f"all in one: {folder / 'dakotaTab.out'}",
    ]


def _write_opensees(folder: Path, run: Run, samples: Array, facts: dict[str, object]) -> list[str]:
    """Materials fitted to each draw's loops; their misfits are added to `facts`."""
    model = next(iter(run.tests.values())).posterior.model
    stroke = max((s.highest for s in run.tested if s.name == "stroke"), default=2.0)
    theta, start = samples[:, : len(model.parameters)], samples[:, -1]
    motions = [replace(test.trace, force=None) for test in run.tests.values()]
    fits = equivalents(model, theta, start, 0.5 * stroke, motions)
    sentences = []
    for name, (commands, misfit, of_tests) in fits.items():
        lines = [f"# {name} fitted to the predicted loops of draw i; kip, in, s", *commands]
        write_text(folder / f"{name}.tcl", "\n".join(lines) + "\n")
        low, middle, high = np.quantile(misfit, [0.05, 0.5, 0.95])
        sentences.append(
            f"{name}: misfit (rms over the rms force of the predicted loop) {100 * middle:.3g} % "
            f"({100 * low:.3g} to {100 * high:.3g} %) over {misfit.size} draws; in the motions of "
            f"the tests {100 * np.median(of_tests):.3g} % ({100 * of_tests.min():.3g} to "
            f"{100 * of_tests.max():.3g} %): {folder / (name + '.tcl')}"
        )
    best = min(fits, key=lambda name: float(np.median(fits[name][1])))
    facts["misfit"] = {name: misfit.tolist() for name, (_, misfit, _) in fits.items()}
    facts["misfit_of_tests"] = {
        name: dict(zip(run.tests, np.median(of_tests, axis=0).tolist(), strict=True))
        for name, (_, _, of_tests) in fits.items()
    }
    facts["best"] = best
    facts["amplitude_in"] = 0.5 * stroke
    return [
        *sentences,
        f"the best of them: {best}; a gap and its retracing cannot be modelled by one material: "
        "for the model's own force give --to c, and step it in a loop (examples/opensees)",
    ]


# --- the materials of OpenSees that come closest to the loops of a device

SAMPLES = 400
CYCLES = (0.25, 0.5, 1.0, 1.0)
"""Amplitudes of the cycles to which materials are fitted, over the largest."""

PERIOD = 4.0  # of a cycle, s


Material = Callable[[Trace], Array]
"""Force of a material under a motion, (T,), kip."""


def equivalents(
    model: Model, theta: Array, start: Array, amplitude: float, motions: Sequence[Trace] = ()
) -> dict[str, tuple[list[str], Array, Array]]:
    """BoucWen and ElasticPP of OpenSees, fitted to the loops of each draw (n, p) by least squares.

    By name, a command for each draw, and the misfits, (n,): root mean square of the difference over
    that of the predicted force. The motion is four cycles of growing amplitude, up to this one, in.
    Then those in other motions, (n, m), to which they are not fitted.
    """
    time = np.linspace(0.0, PERIOD * len(CYCLES), SAMPLES + 1)
    cycle = np.minimum((time / PERIOD).astype(int), len(CYCLES) - 1)
    x = amplitude * np.array(CYCLES)[cycle] * np.sin(2.0 * np.pi / PERIOD * time)
    trace = Trace.from_arrays(time, x)

    def predicted(motion: Trace) -> Array:
        constant = replace(motion, actuation=motion.reference_actuation)
        return model.force(theta, constant, start if model.has_gap else None)

    forces, target_forces = predicted(trace), [predicted(motion) for motion in motions]
    materials = {}
    for name, fit in (("BoucWen", _bouc_wen), ("ElasticPP", _elastic_plastic)):
        commands, misfit, of_motions = [], [], []
        for i, target in enumerate(forces):
            slip = float(np.quantile(np.abs(target), 0.8))
            stiffness = slip / (0.1 * float(np.ptp(x)))
            command, material = fit(i + 1, trace, target, np.log([stiffness, slip]))
            commands.append(command)
            misfit.append(_misfit(material(trace), target))
            pairs = zip(motions, target_forces, strict=True)
            of_motions.append([_misfit(material(m), of_draws[i]) for m, of_draws in pairs])
        materials[name] = commands, np.array(misfit), np.array(of_motions)
    return materials


def _misfit(force: Array, target: Array) -> float:
    """Root mean square of the difference over that of the target."""
    return float(np.sqrt(np.mean((force - target) ** 2) / np.mean(target**2)))


def _bouc_wen(tag: int, trace: Trace, force: Array, begin: Array) -> tuple[str, Material]:
    """BoucWen: F = α k x + (1 − α) k z, ż = ẋ [A − (γ + β sgn(ẋ z)) |z|ⁿ] with A = 1."""
    model = BoucWen()

    def unpacked(q: Array) -> Array:
        """Stiffness, α, slip force, share of β, exponent."""
        return np.array([np.exp(q[0]), q[3], np.exp(q[1]), 0.5 + 0.5 * q[4], 1.0 + np.exp(q[2])])

    def fitted(q: Array, motion: Trace) -> Array:
        k, alpha, slip, beta, power = unpacked(q)
        row = np.array([[k, alpha, slip, slip, beta, power, 0.0]])
        return np.asarray(model.force(row, motion)[0])

    bounds = ([-20, -20, -6, 0.0, 0.0], [20, 20, 2.5, 0.9, 1.0])
    initial = np.array([*begin, 0.0, 0.01, 0.2])

    def off(q: Array) -> Array:
        return np.asarray(fitted(q, trace) - force)

    q = least_squares(off, initial, bounds=bounds, max_nfev=40).x
    k, alpha, slip, beta, power = unpacked(q)
    scale = (k / slip) ** power  # our z is a force, in slip forces; theirs is a displacement
    line = (
        f"uniaxialMaterial BoucWen {tag} {alpha:.6g} {k:.6g} {power:.6g} "
        f"{(1.0 - beta) * scale:.6g} {beta * scale:.6g} 1.0 0.0 0.0 0.0"
    )
    return line, partial(fitted, q)


def _elastic_plastic(tag: int, trace: Trace, force: Array, begin: Array) -> tuple[str, Material]:
    """ElasticPP: elastic until it slips."""

    def fitted(q: Array, motion: Trace) -> Array:
        k, slip = np.exp(q)
        spring, forces, previous = 0.0, [], float(motion.displacement[0])
        for x in motion.displacement.tolist():
            spring = min(max(spring + k * (x - previous), -slip), slip)
            previous = x
            forces.append(spring)
        return np.array(forces)

    def off(q: Array) -> Array:
        return np.asarray(fitted(q, trace) - force)

    q = least_squares(off, begin, max_nfev=30).x
    k, slip = np.exp(q)
    return f"uniaxialMaterial ElasticPP {tag} {k:.6g} {slip / k:.6g}", partial(fitted, q)
