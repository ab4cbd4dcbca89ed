"""The real records: campaign files, least-squares fits of LuGre, and semi-active tension."""

from __future__ import annotations

import csv
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import optimize, signal

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.friction.lugre import LuGre
from mfd_bayes.population.inference import infer_population
from mfd_bayes.records.record import read_record
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.run import Run

HEADER = """\
[campaign]
title = "Banded rotary friction device, {session}"
priors = "brfd"
noise = "{noise}"
model = "{model}"

[columns]
time = {{ name = "time_s", unit = "s" }}
displacement = {{ name = "displacement_in", unit = "in" }}
force = {{ name = "force_kip", unit = "kip" }}

[laws]
Fc_fwd = "{law}"
Fc_bwd = "{law}"
Fs_fwd = "{law}"
Fs_bwd = "{law}"
"""

TEST = """
[[test]]
id = "{id}"
file = "{file}"
actuation = "{tension} lbf"
role = "{role}"
"""

SI = """\
columns = { time = { name = "time_s" }, displacement = { name = "displacement_m" }, \
force = { name = "force_N" } }
"""


DEPENDENCE = """
[dependence]
Fc_fwd = {covariates}
Fc_bwd = {covariates}
"""


@dataclass(frozen=True)
class Kind:
    """What is chosen of a campaign besides its records; `dependence` is that of friction."""

    noise: str
    model: str
    dependence: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """In names of folders; that of the three stages alone is the noise's."""
        model = () if self.model == "three_stage" else (self.model,)
        return "_".join((self.noise, *model, *self.dependence))


def lay_out(source: Path, folder: Path, session: str, kind: Kind) -> Path:
    """Copy the records of a session, or of one tension of 2023, and write their campaign file.

    The whole session of 2023-04 has tests at zero tension, and laws with residual friction.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with (source / "manifest.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    law = "affine" if session == "2023-04" else "power"
    text = HEADER.format(session=session, noise=kind.noise, law=law, model=kind.model)
    if kind.dependence:
        text += DEPENDENCE.format(covariates=list(kind.dependence)).replace("'", '"')
    for row in rows:
        if row["session"] != session and f"{row['tension_lbf']}lb" != session:
            continue
        if session.endswith("lb") and row["session"] != "2023-04":
            continue
        shutil.copyfile(source / row["file"], folder / row["file"])
        text += TEST.format(
            id=row["file"].removesuffix(".csv").split("_", 1)[1],
            file=row["file"],
            tension=row["tension_lbf"],
            role="validate" if row["kind"] == "earthquake" else "calibrate",
        )
        if row["file"].endswith("_SI.csv"):
            text += SI
    campaign = folder / "campaign.toml"
    if not campaign.is_file() or campaign.read_text(encoding="utf-8") != text:
        campaign.write_text(text, encoding="utf-8")
    return campaign


def lugre_error(trace: Trace, inside: np.ndarray | slice = slice(None)) -> float:
    """Mean absolute error of LuGre alone, fitted to the record by least squares, kip."""
    posterior = Posterior(trace, load_priors("brfd"), "iid", LuGre())
    rng = np.random.default_rng(0)
    drawn = posterior.coordinates(posterior.draw_prior(rng, 2000))
    free = [i for i, name in enumerate(posterior.names) if name != "noise_sd"]

    def residual(q: np.ndarray) -> np.ndarray:
        full = drawn[0].copy()
        full[free] = q
        return posterior.residual(full[None])[0]

    squares = np.array([np.sum(posterior.residual(q[None]) ** 2) for q in drawn[:400]])
    best = None
    for start in drawn[np.argsort(squares)[:4]]:
        fit = optimize.least_squares(residual, start[free], max_nfev=80)
        if best is None or fit.cost < best.cost:
            best = fit
    return float(np.mean(np.abs(residual(best.x)[inside])))


def join(runs: dict, effort: str):
    """Population of several sessions' tests, and the posterior of one of them."""
    tests = {f"{s} {name}": t for s, run in runs.items() for name, t in run.tests.items()}
    some = next(iter(runs.values()))
    sessions = {"36lb": "2023-04", "30lb": "2023-04"}
    named = {key: sessions.get(s := key.split(" ")[0], s) for key in tests}
    settings = replace(some.manifest.settings.inference(effort, (1, 3)), sessions=named)
    inference = infer_population(tests, some.priors, settings)
    return inference.population, next(iter(tests.values())).posterior


def semi_active_tests(source: Path) -> list[tuple[str, str, Trace]]:
    """Name, session and trace of each semi-active record."""
    with (source / "manifest.csv").open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["kind"] == "semi-active"]
    return [
        (Path(row["file"]).stem[8:], row["session"], semi_active_trace(source / row["file"]))
        for row in rows
    ]


def semi_active_trace(path: Path) -> Trace:
    """Record at 128 Hz with the slack end's tension, smoothed over an eighth of a second, kip."""
    motion = read_record(path).trace(128.0)
    raw = pd.read_csv(path)
    slack = np.minimum(raw["actuator_1_lbf"], raw["actuator_2_lbf"]).clip(lower=1.0) / 1000.0
    rate = 1.0 / float(np.median(np.diff(raw["time_s"])))
    window = 2 * int(rate / 16.0) + 1
    smooth = signal.medfilt(slack.to_numpy(), window)
    tension = np.interp(motion.time, raw["time_s"], smooth)
    return Trace.from_arrays(
        motion.time, motion.displacement, tension, motion.force, motion.velocity
    )


def least_squares(tests: dict[str, Posterior]) -> np.ndarray:
    """One parameter vector for all tests by least squares, each with its own start and offset.

    Returns the coordinates of the tests' posteriors, with the mean offset and the start in the
    middle of the gap: what a user would predict a new test by. Posteriors have independent noise.
    """
    posteriors = list(tests.values())
    names = posteriors[0].names
    own = [names.index(name) for name in ("start", "offset")]
    shared = [i for i in range(len(names)) if i not in own and names[i] != "noise_sd"]
    drawn = posteriors[0].coordinates(posteriors[0].draw_prior(np.random.default_rng(0), 3000))
    middle = drawn.mean(axis=0)

    def points(q: np.ndarray, j: int) -> np.ndarray:
        full = np.repeat(middle[None], len(q), axis=0)
        full[:, shared] = q[:, : len(shared)]
        full[:, own] = q[:, len(shared) + 2 * j : len(shared) + 2 * j + 2]
        return full

    def residual(q: np.ndarray) -> np.ndarray:
        found = [p.residual(points(q[None], j))[0] for j, p in enumerate(posteriors)]
        return np.concatenate([*found, 0.05 * (q - start)])

    def jacobian(q: np.ndarray) -> np.ndarray:
        around = q + 1e-4 * np.vstack([np.eye(len(q)), np.zeros(len(q))])
        parts = [p.residual(points(around, j)) for j, p in enumerate(posteriors)]
        slopes = [((part[:-1] - part[-1]) / 1e-4).T for part in parts]
        return np.concatenate([*slopes, 0.05 * np.eye(len(q))])

    squares = sum(np.mean(p.residual(drawn) ** 2, axis=1) for p in posteriors[:2])
    best = None
    for i in np.argsort(squares)[:3]:
        start = np.concatenate([drawn[i, shared], np.tile(middle[own], len(posteriors))])
        fit = optimize.least_squares(residual, start, jacobian, max_nfev=60)
        if best is None or fit.cost < best.cost:
            best = fit
    found = middle.copy()
    found[shared] = best.x[: len(shared)]
    found[own[1]] = best.x[len(shared) :].reshape(-1, 2)[:, 1].mean()
    return found


def least_squares_error(run: Run, left_out: str) -> float:
    """RRSE of a test predicted by `least_squares` of the others."""
    plain = {
        name: Posterior(test.trace, run.priors, "iid", test.posterior.model)
        for name, test in run.tests.items()
    }
    target = plain.pop(left_out)
    residual = target.residual(least_squares(plain)[None])[0]
    force = np.asarray(target.trace.force)
    return float(np.sqrt(np.sum(residual**2) / np.sum((force - force.mean()) ** 2)))
