"""Golden numbers: what the package computes today, to compare a rebuilt one with.

    python -m benchmarks.golden.make             # makes golden.npz beside this file
    python -m benchmarks.golden.make --check     # makes them again, and compares

`--only forces,draws` makes some parts, and keeps the rest of the file. All is asked through the
public edge: `import mfd_bayes as mb`, and commands. An array's name is its path: part, model,
motion, what it is. `--check` prints for each array the largest difference, divided by the largest
number of the same row (of its last axis; a column of a table is a row of its own for each cell).
Exit status 1: one differs by more than --tolerance, or is not there. Real records are looked for
in --data (MFD_BAYES_DATA, ../shared/data); what needs them is left out where they are absent.
"""

from __future__ import annotations

import os

# Read when numpy is imported, and by the commands that are started here.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

import mfd_bayes as mb
from benchmarks.common import PROJECT, data_folder

FILE = Path(__file__).with_name("golden.npz")
MODELS = {
    "three_stage": mb.ThreeStage(),
    "backlash": mb.BacklashLuGre(),
    "lugre": mb.LuGre(),
    "bouc_wen": mb.BoucWen(),
}
NOISES = ("ou", "staged", "iid", "student_t")
STARTS = {"start_unknown": None, "start_0.2": 0.2, "start_0.9": 0.9}
VALUES = {
    "sigma0": 60.0, "sigma1": 0.02, "sigma2": 0.01, "v_s": 0.5,
    "Fc_fwd": 2.0, "Fc_bwd": 1.5, "static_excess_fwd": 0.2, "static_excess_bwd": 0.15,
    "k2": 0.5, "k3": 30.0, "d2": 0.1, "d3": 0.08, "gamma1": 1.0, "ell": 0.005,
    "k_fwd": 40.0, "k_bwd": 35.0, "gap": 0.15, "k_0": 0.3, "n": 2.0,
    "k": 30.0, "alpha": 0.01, "Fy_fwd": 2.0, "Fy_bwd": 1.5, "beta": 0.7, "exponent": 2.0, "c": 0.01,
    "start": 0.4, "offset": 0.05, "noise_sd": 0.1, "noise_time": 0.05, "noise_dof": 8.0,
    "noise_build": 0.3, "noise_fade": 0.2, "noise_build_time": 0.02,
}  # fmt: skip
"""Parameters of every model by name, in kip, in and s."""
CAMPAIGN_MOTION = "1 in, 0.5 Hz, 3 cycles"
BUILDING = """[building]
title = "Two storeys"
damping = { kind = "rayleigh", ratio = "2 %", modes = [1, 2] }
[[storey]]
weight = "30 kip"
height = "144 in"
stiffness = "40 kip/in"
[[storey]]
weight = "25 kip"
height = "144 in"
stiffness = "30 kip/in"
[[damper]]
storey = 1
actuation = "1000 psi"
[[damper]]
storey = 2
actuation = "800 psi"
brace = "500 kip/in"
"""

Arrays = dict[str, np.ndarray]


def values_of(n: int) -> dict[str, np.ndarray]:
    """Vectors of parameters around VALUES by name, (n,) each; the first is VALUES."""
    rng = np.random.default_rng(52)
    values = {
        k: v * np.exp(0.15 * rng.normal(size=n) * (np.arange(n) > 0)) for k, v in VALUES.items()
    }
    for side in ("fwd", "bwd"):
        values[f"Fs_{side}"] = values[f"Fc_{side}"] * (1.0 + values[f"static_excess_{side}"])
    values["beta"] = np.minimum(values["beta"], 0.95)
    return values | {"gamma2": values["ell"] * values["gamma1"]}


def theta_of(model: str, n: int) -> np.ndarray:
    """Parameters of a model in its order, (n, p)."""
    values = values_of(n)
    return np.stack([values[name] for name in MODELS[model].parameters], axis=1)


def motions() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Time and displacement of motions that are computed here, s and in."""
    t = np.arange(801) / 100.0
    rng = np.random.default_rng(1952)
    f, phase = np.linspace(0.2, 5.0, 16), rng.uniform(0.0, 2.0 * np.pi, 16)
    waves = np.sin(2.0 * np.pi * f * t[:, None] + phase) / (1.0 + f)
    return {
        "full_cycles": (t, np.sin(np.pi * t + 0.3)),
        "growing_cycles": (t, 0.05 * t * np.sin(np.pi * t) + 0.012 * t * np.sin(8.2 * t + 1.0)),
        "within_the_gap": (t, 0.05 * np.sin(np.pi * t) + 0.02 * np.sin(6.9 * t + 0.4)),
        "backward_first_with_rests": (t, -0.4 * np.clip(2.0 * np.sin(1.3 * t), -1.0, 1.0)),
        "many_turns": (t, 0.4 * np.exp(-((t - 4.0) ** 2) / 5.0) * waves.sum(axis=1)),
    }


def varying(t: np.ndarray) -> np.ndarray:
    """An actuation that changes, ksi."""
    return 1.0 + 0.4 * np.sin(1.9 * t) + 0.02 * t


def earthquakes(data: Path) -> dict[str, mb.Record]:
    """Real earthquake records of the band brake, whole; none where they are absent."""
    names = ("ImperialValleyDBE", "KocaeliDBE")
    paths = {name: data / "brfd" / f"2023_36lb_{name}.csv" for name in names}
    return {name: mb.read_record(path) for name, path in paths.items() if path.is_file()}


def forces(data: Path) -> Arrays:
    """Forces of all models, of synthetic motions and of real earthquakes."""
    found: Arrays = {}
    for name, model in MODELS.items():
        theta = theta_of(name, 3)
        for motion, (t, x) in motions().items():
            for kind, actuation in {"constant": 1.0, "varying": varying(t)}.items():
                trace = mb.Trace.from_arrays(t, x, actuation=actuation)
                for start, w0 in STARTS.items():
                    key = f"forces/{name}/{motion}/{kind}_actuation/{start}/kip"
                    found[key] = model.force(theta, trace, w0)[:, ::2]  # of the whole motion
    for quake, record in earthquakes(data).items():
        at_64 = record.trace(rate=64.0)
        found[f"records/{quake}/displacement_at_64Hz/in"] = at_64.displacement
        found[f"records/{quake}/force_at_64Hz/kip"] = at_64.force
        for rate, trace in {"64Hz": at_64, "all_samples": record.trace()}.items():
            changing = 0.036 * varying(trace.time)
            kept = slice(None, None, max(1, trace.samples // 1000))
            for kind, actuation in {"constant": 0.036, "varying": changing}.items():
                moved = mb.Trace.from_arrays(trace.time, trace.displacement, actuation=actuation)
                for name, model in MODELS.items():
                    key = f"forces/{name}/{quake}_{rate}/{kind}_actuation/start_0.2/kip"
                    found[key] = model.force(theta_of(name, 2), moved, 0.2)[:, kept]
    return found


def steps(data: Path) -> Arrays:
    """Forces of all models step by step."""
    found: Arrays = {}
    for name, model in MODELS.items():
        for motion in ("growing_cycles", "many_turns"):
            t, x = motions()[motion]
            v = np.gradient(x, t)
            for kind, actuation in {"constant": np.ones(t.size), "varying": varying(t)}.items():
                for start, w0 in STARTS.items():
                    state = model.start(theta_of(name, 3), w0, reference_actuation=1.0)
                    force = []
                    for xi, vi, p in zip(x, v, actuation, strict=True):
                        now = {"displacement": xi, "velocity": vi, "dt": 0.01, "actuation": p}
                        f, state = model.step(state, **now)
                        force.append(f)
                    key = f"steps/{name}/{motion}/{kind}_actuation/{start}/kip"
                    found[key] = np.stack(force[::2], axis=1)
    return found


def measured(model: str, motion: str) -> mb.Trace:
    """A record that is computed here: force of a model and correlated noise."""
    t, x = motions()[motion]
    trace = mb.Trace.from_arrays(t, x, actuation=1.0)
    force = MODELS[model].force(theta_of(model, 1), trace, VALUES["start"])[0]
    shocks = np.random.default_rng(7).normal(size=t.size)
    left = np.zeros(t.size)
    for i in range(1, t.size):
        left[i] = 0.8 * left[i - 1] + 0.06 * shocks[i]
    return mb.Trace.from_arrays(t, x, actuation=1.0, force=force + VALUES["offset"] + left)


def densities(data: Path) -> Arrays:
    """Log densities of fixed parameters, for every noise and model."""
    found: Arrays = {}
    known = values_of(5)
    records = {m: measured("three_stage", m) for m in ("full_cycles", "many_turns")}
    records |= {name: record.trace(rate=64.0) for name, record in earthquakes(data).items()}
    for motion, trace in records.items():
        for name in MODELS:
            for noise in NOISES:
                priors = "mfd" if motion in motions() else "brfd"
                posterior = mb.Posterior(trace, priors=priors, noise=noise, model=name)
                q = posterior.coordinates({key: known[key] for key in posterior.names})
                key = f"densities/{name}/{motion}/{noise}"
                found[f"{key}/coordinates"] = q
                found[f"{key}/log_prob"] = posterior.log_prob(q)[:, None]
                found[f"{key}/log_likelihood"] = posterior.log_likelihood(q)[:, None]
    return found


def draws(data: Path) -> Arrays:
    """Draws of short fits, with two seeds, and their quantiles."""
    found: Arrays = {}
    for name, noise in {"three_stage": "ou", "backlash": "iid"}.items():
        posterior = mb.Posterior(measured(name, "full_cycles"), noise=noise, model=name)
        for seed in (1, 2):
            drawn = mb.sample(posterior, effort="quick", seed=seed)
            key = f"draws/{name}/{noise}/seed_{seed}"
            flat = drawn.theta.reshape(-1, drawn.theta.shape[-1])
            found[f"{key}/theta_every_20th"] = flat[::20].T
            found[f"{key}/theta_quantiles"] = np.quantile(flat, [0.05, 0.5, 0.95], axis=0).T
            found[f"{key}/log_prob_every_20th"] = drawn.log_prob[:, ::20]
            found[f"{key}/number_of_draws"] = np.array(drawn.log_prob.shape)
    return found


def command(*words: object) -> int:
    """Exit status of a command of the package."""
    ended = subprocess.run(
        [sys.executable, "-m", "mfd_bayes", *map(str, words)],
        env=os.environ | {"PYTHONPATH": str(PROJECT)},
        stdout=subprocess.DEVNULL,
        check=False,
    )
    return ended.returncode


def table(path: Path, name: str, *, history: bool = False) -> Arrays:
    """Columns of a CSV but for notes: numbers (T,) of a history, else (rows, 1); text (rows,)."""
    found: Arrays = {}
    for column, values in (
        pd.read_csv(path, comment="#").drop(columns="note", errors="ignore").items()
    ):
        numbers = values.dtype.kind in "fiu"
        cells = values.to_numpy(float) if numbers else values.fillna("").to_numpy(str)
        found[f"{name}/{column}"] = cells[:, None] if numbers and not history else cells
    return found


def demo(data: Path) -> Arrays:
    """The quick demo: tables, verdict, bands by Python and by the command, and a building."""
    found: Arrays = {}
    with tempfile.TemporaryDirectory() as temporary:
        home, out = Path(temporary), Path(temporary) / "out"
        found["demo/exit_status/demo"] = np.array([command("demo", out, "--quick", "-q")])
        found["demo/exit_status/check"] = np.array([command("check", out)])
        for name in ("parameters", "laws", "derived", "checks"):
            found |= table(out / f"{name}.csv", f"demo/{name}")
        run = mb.open_run(out)
        for motion in ("full_cycles", "many_turns"):
            t, x = motions()[motion]
            for kind, actuation in {"constant": 0.9, "varying": 0.9 * varying(t)}.items():
                trace = mb.Trace.from_arrays(t, x, actuation=actuation)
                for what in ("device", "new_test", "observation"):
                    band = run.predict(trace, kind=what, probability=0.95, draws=200, seed=3)
                    key = f"bands/{motion}/{kind}_actuation/{what}/lower_median_upper/kip"
                    found[key] = np.stack([band.lower, band.median, band.upper])
        for what in ("device", "new_test", "observation"):
            bands = home / f"{what}.csv"
            words = ["--sine", CAMPAIGN_MOTION, "--actuation", "900 psi", "--kind", what]
            found[f"predict_sine/{what}/exit_status"] = np.array(
                [command("predict", out, *words, "-o", bands, "-q")]
            )
            found |= table(bands, f"predict_sine/{what}", history=True)
            derived = bands.with_name(f"{what}_derived.csv")
            found |= table(derived, f"predict_sine/{what}/derived")
        found |= building(run, home, data)
    return found


def building(run: mb.Run, home: Path, data: Path) -> Arrays:
    """Peaks of a small building with dampers of a run."""
    (home / "building.toml").write_text(BUILDING, encoding="utf-8")
    t = np.arange(0.0, 8.0, 0.02)
    shaking = 0.35 * np.exp(-((t - 3.0) ** 2) / 4.0) * (np.sin(9.0 * t) + 0.5 * np.sin(23.0 * t))
    rows = zip(t, shaking, strict=True)
    text = "time_s,acceleration_g\n" + "".join(f"{a:.2f},{b:.6f}\n" for a, b in rows)
    (home / "artificial.csv").write_text(text, encoding="utf-8")
    grounds = {"artificial": home / "artificial.csv"}
    if (quake := data / "ground_motions" / "el_centro.AT2").is_file():
        grounds["el_centro"] = quake
    found: Arrays = {}
    for name, ground in grounds.items():
        answer = run.respond(home / "building.toml", [ground], draws=12, seed=1)
        for what in ("drift", "acceleration", "force", "travel", "energy", "base_shear"):
            peaks = np.asarray(getattr(answer, what))
            found[f"building/{name}/{what}"] = peaks.reshape(len(peaks), -1)
    return found


PARTS = {part.__name__: part for part in (forces, steps, densities, draws, demo)}


def difference(new: np.ndarray, old: np.ndarray) -> float:
    """Largest difference of two arrays over the largest number of its row; infinite: not alike."""
    if new.shape != old.shape:
        return np.inf
    if old.dtype.kind not in "fiu" or new.dtype.kind not in "fiu":
        return 0.0 if np.array_equal(new, old) else np.inf
    off = ~np.isfinite(old)
    if not np.array_equal(new[off], old[off], equal_nan=True) or np.any(~np.isfinite(new[~off])):
        return np.inf
    apart = np.abs(np.where(off, 0.0, new) - np.where(off, 0.0, old))
    scale = np.max(np.abs(np.where(off, 0.0, old)), axis=-1, keepdims=True, initial=0.0)
    return float(np.max(apart / np.where(scale > 0.0, scale, 1.0), initial=0.0))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=data_folder(), help="holds brfd/")
    parser.add_argument("--check", action="store_true", help="compare, and write nothing")
    parser.add_argument("--only", default=",".join(PARTS), help="some parts, with commas between")
    parser.add_argument("--tolerance", type=float, default=1e-9, help="largest difference, 1e-9")
    given = parser.parse_args()
    new: Arrays = {}
    for name in given.only.split(","):
        began = time.perf_counter()
        made = PARTS[name](given.data)
        new |= made
        print(f"{name}: {len(made)} arrays, {time.perf_counter() - began:.0f} s", file=sys.stderr)
    old = dict(np.load(FILE)) if FILE.is_file() else {}
    if not given.check:
        whole = given.only == parser.get_default("only")
        np.savez_compressed(FILE, **(new if whole else old | new))
        return
    firsts = {key.split("/")[0] for key in new}
    apart = {key: difference(new[key], old[key]) for key in new if key in old}
    missing = [key for key in old if key not in new and key.split("/")[0] in firsts]
    for key, value in sorted(apart.items()):
        print(f"{value:9.1e}  {key}")
    for first in sorted(firsts):
        all_of = [value for key, value in apart.items() if key.split("/")[0] == first]
        print(f"{max(all_of, default=0.0):9.1e}  largest of {len(all_of)} arrays of {first}")
    for words, keys in {
        "no longer there": missing,
        "new": [k for k in new if k not in old],
    }.items():
        print("".join(f"{words}: {key}\n" for key in keys), end="")
    sys.exit(1 if missing or any(value > given.tolerance for value in apart.values()) else 0)


if __name__ == "__main__":
    main()
