"""Golden arrays of forces and log densities: a rebuilt package computes the same numbers.

An array's name is its path: part, model, motion, what it is. `MFD_BAYES_GOLDEN=1` writes the arrays
anew, where a change of the numbers is meant.
"""

import os
from pathlib import Path

import numpy as np
import pytest

import mfd_bayes as mb

FILE = Path(__file__).parent / "data" / "golden.npz"
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
TOLERANCE, OF_BACKLASH = 1e-9, 2e-4  # steps of the latter's forces are solved by iteration


def values_of(n):
    """Vectors of parameters around VALUES by name, (n,) each; the first is VALUES."""
    rng = np.random.default_rng(52)
    values = {
        k: v * np.exp(0.15 * rng.normal(size=n) * (np.arange(n) > 0)) for k, v in VALUES.items()
    }
    for side in ("fwd", "bwd"):
        values[f"Fs_{side}"] = values[f"Fc_{side}"] * (1.0 + values[f"static_excess_{side}"])
    values["beta"] = np.minimum(values["beta"], 0.95)
    return values | {"gamma2": values["ell"] * values["gamma1"]}


def theta_of(model, n):
    """Parameters of a model in its order, (n, p)."""
    values = values_of(n)
    return np.stack([values[name] for name in MODELS[model].parameters], axis=1)


def motions():
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


def varying(t):
    """An actuation that changes, ksi."""
    return 1.0 + 0.4 * np.sin(1.9 * t) + 0.02 * t


def earthquakes(data):
    """Real earthquake records of the band brake, whole."""
    names = ("ImperialValleyDBE", "KocaeliDBE")
    return {name: mb.read_record(data / f"2023_36lb_{name}.csv") for name in names}


def forces(data):
    """Forces of all models, of synthetic motions and of real earthquakes, by their paths."""
    for name, model in MODELS.items():
        theta = theta_of(name, 3)
        for motion, (t, x) in motions().items():
            for kind, actuation in {"constant": 1.0, "varying": varying(t)}.items():
                trace = mb.Trace.from_arrays(t, x, actuation=actuation)
                for start, w0 in STARTS.items():
                    key = f"forces/{name}/{motion}/{kind}_actuation/{start}/kip"
                    yield key, model.force(theta, trace, w0)[:, ::2]  # of the whole motion
    for quake, record in earthquakes(data).items():
        at_64 = record.trace(rate=64.0)
        yield f"records/{quake}/displacement_at_64Hz/in", at_64.displacement
        yield f"records/{quake}/force_at_64Hz/kip", at_64.force
        for rate, trace in {"64Hz": at_64, "all_samples": record.trace()}.items():
            changing = 0.036 * varying(trace.time)
            columns = slice(None, None, max(1, trace.samples // 1000))
            for kind, actuation in {"constant": 0.036, "varying": changing}.items():
                moved = mb.Trace.from_arrays(trace.time, trace.displacement, actuation=actuation)
                for name, model in MODELS.items():
                    key = f"forces/{name}/{quake}_{rate}/{kind}_actuation/start_0.2/kip"
                    yield key, model.force(theta_of(name, 2), moved, 0.2)[:, columns]


def measured(motion):
    """A record that is computed here: force of the three stages and correlated noise."""
    t, x = motions()[motion]
    trace = mb.Trace.from_arrays(t, x, actuation=1.0)
    force = MODELS["three_stage"].force(theta_of("three_stage", 1), trace, VALUES["start"])[0]
    noise = 0.06 * np.random.default_rng(7).normal(size=t.size)
    noise[0] = 0.0
    for i in range(1, t.size):
        noise[i] += 0.8 * noise[i - 1]
    return mb.Trace.from_arrays(t, x, actuation=1.0, force=force + VALUES["offset"] + noise)


def densities(data):
    """Log densities of fixed parameters, for every noise and model, by their paths."""
    values = values_of(5)
    records = {motion: (measured(motion), "mfd") for motion in ("full_cycles", "many_turns")}
    records |= {name: (r.trace(rate=64.0), "brfd") for name, r in earthquakes(data).items()}
    for motion, (trace, priors) in records.items():
        for name in MODELS:
            for noise in NOISES:
                posterior = mb.Posterior(trace, priors=priors, noise=noise, model=name)
                q = posterior.coordinates({key: values[key] for key in posterior.names})
                key = f"densities/{name}/{motion}/{noise}"
                yield f"{key}/coordinates", q
                yield f"{key}/log_prob", posterior.log_prob(q)[:, None]
                yield f"{key}/log_likelihood", posterior.log_likelihood(q)[:, None]


def difference(actual, expected):
    """Largest difference of two arrays over the largest number of its row; infinite: not alike."""
    if actual is None or expected is None or actual.shape != expected.shape:
        return np.inf
    if not np.array_equal(np.isfinite(actual), np.isfinite(expected)):
        return np.inf
    undefined = ~np.isfinite(expected)
    if not np.array_equal(actual[undefined], expected[undefined], equal_nan=True):
        return np.inf
    scale = np.max(np.abs(np.where(undefined, 0.0, expected)), axis=-1, keepdims=True, initial=0.0)
    deviation = np.abs(np.where(undefined, 0.0, actual - np.where(undefined, 0.0, expected)))
    return float(np.max(deviation / np.where(scale > 0.0, scale, 1.0), initial=0.0))


@pytest.mark.slow
def test_forces_and_densities_are_the_golden_ones(data_folder):
    actual = dict(forces(data_folder)) | dict(densities(data_folder))
    if os.environ.get("MFD_BAYES_GOLDEN"):
        np.savez_compressed(FILE, **actual)
    expected = dict(np.load(FILE))
    for key in sorted(actual | expected):
        allowed = OF_BACKLASH if key.startswith("forces/backlash/") else TOLERANCE
        assert difference(actual.get(key), expected.get(key)) <= allowed, key
