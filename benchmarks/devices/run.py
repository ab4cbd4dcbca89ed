"""Three devices of a user's own: is the truth inside as often as promised?

    python -m benchmarks.devices.run FOLDER [--campaigns 20] [--first 0]

A viscous damper, a seal that a pressure drives, and a rotation device, each one file. For each
campaign four tests are simulated, whose parameters scatter about known medians, and calibrated by
the steps of `mfd-bayes calibrate --effort quick`. Counted is how often the 50 and 95 % intervals
hold the medians of the population, the parameters of each test, and the response of a fifth test
that was never fitted. devices.txt: what it printed.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

import mfd_bayes as mb
from mfd_bayes.friction.models import find_model
from mfd_bayes.pipeline.calibrate import calibrate
from mfd_bayes.pipeline.plan import Options, plan_campaign
from mfd_bayes.records.trace import Trace

HEAD = "import numpy as np\nimport mfd_bayes as mb\n\n\n"
MODELS = {
    "viscous": """class Device(mb.Model):
    name = "viscous"
    parameters = (mb.Parameter("c", "kip"), mb.Parameter("alpha"))

    def force(self, theta, trace):
        c, alpha = theta.T[:, :, None]
        return c * np.sign(trace.velocity) * np.abs(trace.velocity) ** alpha
""",
    "seal": """class Device(mb.Model):
    name = "seal"
    parameters = (mb.Parameter("slip", "kip", follows_actuation=True), mb.Parameter("v0", "in/s"))

    def force(self, theta, trace, scales):
        slip, v0 = theta.T[:, :, None]
        return slip * scales["slip"] * np.tanh(trace.velocity / v0)
""",
    "rotation": """class Device(mb.Model):
    name = "joint"
    motion, response = "rotation", "moment, kN*m"
    rate_independent = True
    parameters = (mb.Parameter("k", "kN*m/rad"), mb.Parameter("m", "kN*m"))

    def force(self, theta, trace):
        k, m = theta.T[:, :, None]
        return k * trace.displacement + m * np.tanh(np.gradient(trace.displacement) / 1e-4)
""",
}
MEDIANS = {
    "viscous": {"c": 3.0, "alpha": 0.5},
    "seal": {"slip": 2.0, "v0": 0.3},
    "rotation": {"k": 800.0, "m": 4.0},
}
UNITS = {"c": " kip", "slip": " kip", "v0": " in/s", "k": " kN*m/rad", "m": " kN*m", "alpha": ""}
COLUMNS = {"rotation": ("rotation", "rad", "moment", "kN*m")}
LEVELS = {"seal": (0.5, 1.0, 1.5, 1.0, 1.2)}  # ksi; the last test is held out
FREQUENCIES = (0.25, 0.5, 1.0, 0.5, 0.4)
SCATTER, NOISE, CYCLES, PER_CYCLE = 0.08, 0.05, 2, 60


def motion(device: str, number: int) -> Trace:
    """Two cycles of a sine."""
    frequency, size = FREQUENCIES[number], 0.01 if device == "rotation" else 1.0
    time = np.arange(0.0, CYCLES / frequency, 1.0 / (PER_CYCLE * frequency))
    phase = 2.0 * np.pi * frequency * time
    speed = 2.0 * np.pi * frequency * size * np.cos(phase)
    level = LEVELS[device][number] if device in LEVELS else 0.0
    return Trace.from_arrays(time, size * np.sin(phase), level, velocity=speed)


def written(folder: Path, device: str, seed: int) -> tuple[Path, list[dict], list[np.ndarray]]:
    """A campaign; and the true parameters and the response without noise of its five tests."""
    folder.mkdir(parents=True)
    (folder / "device.py").write_text(HEAD + MODELS[device])
    model, rng = find_model("device.py:Device", folder), np.random.default_rng([seed, len(device)])
    names = list(MEDIANS[device])
    size = 6.0 if device == "rotation" else 2.0
    unit = COLUMNS.get(device, ("displacement", "in", "force", "kip"))
    lines = ["[parameters]"]
    for name, value in MEDIANS[device].items():
        median = value * np.exp(0.4 * rng.normal())
        figure = f'"{median}{UNITS[name]}"' if UNITS[name] else str(median)
        lines.append(f'{name} = {{ family = "lognormal", median = {figure}, spread = 0.5 }}')
    lines += [
        f'offset = {{ family = "normal", mean = "0 {unit[3]}", sd = "{0.01 * size} {unit[3]}" }}',
        f'noise_sd = {{ family = "half_normal", sd = "{0.2 * size} {unit[3]}" }}',
        "[scatter]",
        f"device = {{ parameters = {[*names, 'noise_sd']}, sd = 0.1 }}".replace("'", '"'),
        f'offset = {{ parameters = ["offset"], sd = "{0.01 * size} {unit[3]}" }}',
    ]
    (folder / "priors.toml").write_text("\n".join(lines) + "\n")
    text = '[campaign]\nmodel = "device.py:Device"\npriors = "priors.toml"\nnoise = "iid"\n'
    text += f'[columns]\n{unit[0]} = {{ name = "x", unit = "{unit[1]}" }}\n'
    text += f'{unit[2]} = {{ name = "y", unit = "{unit[3]}" }}\n'
    text += "" if device == "rotation" else 'time = { name = "t", unit = "s" }\n'
    truths, forces = [], []
    for number in range(5):
        trace = motion(device, number)
        median = np.array(list(MEDIANS[device].values()))
        theta = median * np.exp(SCATTER * rng.normal(size=median.size))
        level = trace.reference_actuation
        at = theta * np.where([device == "seal" and n == "slip" for n in names], level, 1.0)
        force = model.force(at[None], trace)[0]
        truths.append(dict(zip(names, at.tolist(), strict=True)))
        forces.append(force + NOISE * size * rng.normal(size=force.size))
        table = np.column_stack([trace.time, trace.displacement, forces[-1]])
        np.savetxt(folder / f"t{number}.csv", table, delimiter=",", header="t,x,y", comments="")
        if number < 4:
            text += f'[[test]]\nid = "t{number}"\nfile = "t{number}.csv"\n'
            text += f'actuation = "{1000 * level:g} psi"\n' if device == "seal" else ""
    (folder / "campaign.toml").write_text(text)
    return folder / "campaign.toml", truths, forces


def inside(draws: np.ndarray, truth: np.ndarray) -> list[np.ndarray]:
    """Whether the equal-tailed 50 and 95 % intervals of draws (n, …) hold a truth (…)."""
    found = []
    for tail in (0.25, 0.025):
        low, high = np.quantile(draws, [tail, 1.0 - tail], axis=0)
        found.append((low <= truth) & (truth <= high))
    return found


def campaign(folder: Path, device: str, seed: int) -> dict[str, list[np.ndarray]]:
    """Which truths of a campaign are inside."""
    path, truths, forces = written(folder / "campaign", device, seed)
    options = Options(effort="quick", seed=seed, jobs=1)
    calibrate(plan_campaign(path, options), folder / "out", lambda _: None)
    run = mb.open_run(folder / "out")
    found: dict[str, list[np.ndarray]] = {"medians": [], "tests": [], "response": []}
    for name, value in MEDIANS[device].items():
        draws = run.population.median(name, [1.0]).reshape(-1)
        found["medians"].append(np.array(inside(draws, np.array(value))))
        for number, test in enumerate(run.tests.values()):
            own = np.asarray(test.draws[name]).reshape(-1)
            found["tests"].append(np.array(inside(own, np.array(truths[number][name]))))
    trace = motion(device, 4)
    if device == "rotation":
        trace = mb.Trace.from_arrays(np.arange(float(trace.samples)), trace.displacement, 0.0)
    band = run.predict(trace, kind="observation", draws=1000, seed=seed)
    found["response"].append(np.mean(inside(band.draws, forces[4]), axis=1))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--campaigns", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    print("device     what       inside 50 %   inside 95 %   of")
    for device in MODELS:
        every: dict[str, list[np.ndarray]] = {}
        for seed in range(options.first, options.first + options.campaigns):
            found = campaign(options.folder / f"{device}{seed}", device, seed)
            for what, values in found.items():
                every.setdefault(what, []).extend(values)
        for what, values in every.items():
            half, most = 100.0 * np.mean(values, axis=0)
            print(f"{device:10s} {what:10s} {half:8.0f} %    {most:8.0f} %   {len(values):6d}")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
