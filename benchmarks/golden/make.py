"""Does a rebuilt package compute the same numbers? Golden arrays of forces and densities.

    python -m benchmarks.golden.make --check     # minutes: makes them again, and compares
    python -m benchmarks.golden.make             # makes golden.npz beside this file

No test holds these to the last digits. `--only forces` takes one part (and keeps the rest of the
file). An array's name is its path: part, model, motion, what it is. Printed for each part is
the largest difference, divided by the largest number of the same row. Exit status 1: an array
differs by more than --tolerance (forces of backlash: 2e-4), or is not there. Real records are
looked for in --data.
"""

from benchmarks.common import data_folder, finish  # isort: skip  (one thread, before numpy)

import argparse
import sys
import time
from pathlib import Path

import numpy as np

import mfd_bayes as mb

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
BACKLASH = 2e-4  # tolerance of its forces: its steps are solved by iteration
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


PARTS = {part.__name__: part for part in (forces, densities)}


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
    parts = {key.split("/")[0] for key in new}
    failed = [key for key in old if key not in new and key.split("/")[0] in parts]
    for part in sorted(parts):
        keys = [key for key in new if key in old and key.startswith(f"{part}/")]
        apart = {key: difference(new[key], old[key]) for key in keys}
        worst = max(keys, key=apart.__getitem__)
        print(f"{part}: {len(keys)} arrays, largest difference {apart[worst]:.1e}, of {worst}")
        for key, off in apart.items():
            iterated = key.startswith("forces/backlash/")
            if off > (max(BACKLASH, given.tolerance) if iterated else given.tolerance):
                failed.append(f"{key}: {off:.1e}")
    finish(failed)


if __name__ == "__main__":
    main()
