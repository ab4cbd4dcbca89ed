"""How does slip begin on fast motion and in earthquakes? Mechanisms by records left out by kind.

    python -m benchmarks.slip.run > benchmarks/slip/slip.txt

takes 25 minutes of a core (--quick: the fast fit of three models, half a minute). Each mechanism of
mechanisms.py, `three_stage` and `backlash` are fitted by least squares to raw force, with the start
in the gap of each record; all other records are predicted. RRSE is the root of the squared error
over that of the mean. The start of a record left out is either fitted, as all its own, or unknown:
then the mean square over `STARTS` is taken. Where another tension or session is predicted, slip
forces (and sigma0) are fitted to one record of it first. Peaks are the 0.1 and 99.9 % quantiles of
force over those measured, energy is that of the whole record. No bar: this is a question, and
docs/pages/slip.md has the answer.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import multiprocessing
import time

import numpy as np
import pandas as pd
from scipy.optimize import least_squares
from scipy.special import expit

from benchmarks.slip import mechanisms
from mfd_bayes.friction.models import find_model
from mfd_bayes.records.trace import Trace
from mfd_bayes.units import convert

SAMPLES = 2800
RESTARTS = 3
LIMIT = 5.0  # of a coordinate
PENALTY = 0.003  # per unit of a coordinate, beside an RRSE
STARTS = np.linspace(0.02, 0.98, 25)

GUESS = {
    "k_f": 30, "k_b": 30, "width": 0.25, "rounding": 0.02, "k_gap": 0.3, "F_f": 3.3, "F_b": 4.3,
    "drag": 0.005, "e_f": 0.05, "e_b": 0.05, "v_0": 1.0, "sharpness": 7, "delay": 0.01,
    "healing_time": 0.2, "wear_in": 0.02, "damping": 0.03, "beta_f": 0.5, "beta_b": 0.5,
    "wrap": 0.7, "k_fwd": 30, "k_bwd": 30, "gap": 0.25, "k_0": 0.3, "Fc_fwd": 3.3, "Fc_bwd": 4.3,
    "n": 7, "sigma2": 0.005, "static_excess_fwd": 0.05, "static_excess_bwd": 0.05, "v_s": 1.0,
    "Fs_fwd": 0.05, "Fs_bwd": 0.05, "gamma1": 1.0, "gamma2": 0.02, "sigma0": 60, "sigma1": 0.02,
    "k2": 0.5, "k3": 30, "d2": 0.12, "d3": 0.1, "ell": 0.02,
}  # fmt: skip
"""Where the fits begin; of static friction, its excess over kinetic."""
AT_LEAST_ONE = ("n", "sharpness")  # 1 is added
FRACTIONS = ("beta_f", "beta_b")
LEVELS = ("F_f", "F_b", "Fc_fwd", "Fc_bwd", "sigma0")
KINETIC, STATIC = ("Fc_fwd", "Fc_bwd"), ("Fs_fwd", "Fs_bwd")
OFFSET = 0.05  # kip, unit of the offset's coordinate

FAST = ["36lb_0.50Hz_1.5in", "36lb_1.00Hz_1.0in"]
SLOW = [f"36lb_{name}" for name in ("0.10Hz_1.0in_SI", "0.25Hz_0.5in", "0.25Hz_1.0in")]
SLOW += ["36lb_0.25Hz_1.5in"]
HALF = ["36lb_0.50Hz_0.5in", "36lb_0.50Hz_1.0in", "36lb_0.50Hz_1.5in"]
QUAKES = ["36lb_ImperialValleyDBE", "36lb_KocaeliDBE"]
HARMONIC = [*SLOW, *HALF, "36lb_1.00Hz_1.0in"]
FITS = {"fast": FAST, "to 0.5 Hz": [*SLOW, *HALF], "harmonic": HARMONIC}
TENSIONS = (20, 25, 35, 80)
THIRTY = ["0.25Hz_0.5in", "0.25Hz_1.5in", "0.50Hz_0.5in", "0.50Hz_1.0in", "0.50Hz_1.5in"]
THIRTY = [f"30lb_{name}" for name in (*THIRTY, "1.00Hz_1.0in")]


def read(data):
    """Time, displacement and force of the records by id, s, in and kip, with all their samples."""
    records = {}
    for row in common.listed(data):
        if row["kind"] == "semi-active" or row["tension_lbf"] == "0":
            continue
        table = pd.read_csv(data / "brfd" / row["file"])
        t, x, f = table.iloc[:, :3].to_numpy().T.copy()
        if row["id"].endswith("_SI"):
            x, f = x * convert("m", "in"), f * convert("N", "kip")
        records[row["id"]] = t, x, f
    return records


def thinned(records):
    """The records with `SAMPLES` of their samples."""
    picks = {
        k: np.linspace(0, r[0].size - 1, SAMPLES).round().astype(int) for k, r in records.items()
    }
    return {k: tuple(column[picks[k]] for column in r) for k, r in records.items()}


class Batch:
    """Force of one model for vectors of coordinates, each on a record of its own."""

    def __init__(self, model, names):
        self.model, self.names = model, names
        self.guess = np.array([GUESS[name] for name in names], dtype=float)
        if isinstance(model, mechanisms.Contact):
            self.guess[names.index("damping")] = 0.01
        self.fraction = np.isin(names, FRACTIONS)

    def values(self, coordinates):
        """Parameters of coordinates, (m, p)."""
        grown = self.guess * np.exp(coordinates)
        grown += np.isin(self.names, AT_LEAST_ONE)
        return np.where(self.fraction, 0.98 * expit(coordinates), grown)

    def force(self, coordinates, records, start):
        """Force, (SAMPLES, m), kip, of m vectors on m records."""
        theta = self.values(coordinates)
        if "Fs_fwd" in self.names:  # static friction over kinetic
            kinetic, static = (np.isin(self.names, names) for names in (KINETIC, STATIC))
            theta[:, static] = theta[:, kinetic] * (1 + theta[:, static])
        if isinstance(self.model, mechanisms.Mechanism):
            t, x = (np.stack([record[i] for record in records], axis=1) for i in (0, 1))
            with np.errstate(all="ignore"):
                return self.model.along(dict(zip(self.names, theta.T, strict=True)), x, t, start)
        force = np.empty((SAMPLES, start.size))
        for t, x, _ in {id(record): record for record in records}.values():
            rows = [k for k, record in enumerate(records) if record[1] is x]
            trace = Trace.from_arrays(t, x, actuation=1.0)
            with np.errstate(all="ignore"):
                force[:, rows] = self.model.force_unbounded(theta[rows], trace, start[rows]).T
        return force


MODELS = {m.name: m for m in mechanisms.ALL}
NAMES = ("three_stage", "backlash", *MODELS)


def mechanism(name):
    """One of NAMES."""
    model = MODELS[name]() if name in MODELS else find_model(name)
    return Batch(model, tuple(model.parameters))


def fit(force, records, first, rng, free=None):
    """Least squares over records: coordinates, offset and starts; `free` of the coordinates."""
    size, count = len(force.names), len(records)
    free = np.arange(size) if free is None else np.asarray(free)
    weight = 1 / np.array([np.sqrt(SAMPLES) * record[2].std() for record in records])
    measured = np.stack([record[2] for record in records], axis=1)

    def whole(q):
        coordinates = first.copy()
        coordinates[free] = q[: free.size]
        return coordinates, q[free.size] * OFFSET, expit(q[free.size + 1 :])

    def residuals(q):
        coordinates, offset, start = whole(q)
        f = force.force(np.tile(coordinates, (count, 1)), records, start) + offset
        error = np.nan_to_num((f - measured) * weight, nan=1.0, posinf=1.0, neginf=-1.0)
        return np.concatenate([error.T.ravel(), PENALTY * q])

    def jacobian(q, step=1e-3):
        coordinates, _, start = whole(q)
        moved = np.tile(coordinates, (free.size + 2, 1))
        moved[np.arange(free.size), free] += step
        starts = np.tile(start, (free.size + 2, 1))
        starts[free.size] = expit(q[free.size + 1 :] + step)
        f = force.force(np.repeat(moved, count, axis=0), records * (free.size + 2), starts.ravel())
        f = f.reshape(SAMPLES, free.size + 2, count)
        slope = np.nan_to_num((f[:, :-1] - f[:, -1:]) / step * weight, posinf=0.0, neginf=0.0)
        table = np.zeros((count, SAMPLES, q.size))
        table[:, :, : free.size] = slope[:, : free.size].transpose(2, 0, 1)
        table[:, :, free.size] = OFFSET * weight[:, None]
        for k in range(count):
            table[k, :, free.size + 1 + k] = slope[:, free.size, k]
        return np.concatenate([table.reshape(-1, q.size), PENALTY * np.eye(q.size)])

    best = None
    for attempt in range(RESTARTS):
        q = np.concatenate([first[free], np.zeros(1 + count)])
        q += (0.0 if attempt == 0 else 0.4) * rng.normal(size=q.size)
        bounds = (-LIMIT, LIMIT)
        now = least_squares(residuals, q, jacobian, bounds, max_nfev=40, ftol=1e-5, x_scale=1.0)
        best = now if best is None or now.cost < best.cost else best
    return whole(best.x)


def by_start(force, coordinates, offset, record):
    """Force for each of STARTS on a record, (SAMPLES, starts), and the RRSE of each."""
    rows = np.tile(coordinates, (STARTS.size, 1))
    f = force.force(rows, [record] * STARTS.size, STARTS) + offset
    return f, np.sqrt(np.square(f - record[2][:, None]).mean(axis=0)) / record[2].std()


def shown(force, coordinates, offset, record):
    """RRSE with the start fitted and unknown, peaks forward and backward, energy, on a record."""
    f, error = by_start(force, coordinates, offset, record)
    _, x, measured = record
    best = f[:, np.nanargmin(error)]
    peaks = np.quantile(best, (0.999, 0.001)) / np.quantile(measured, (0.999, 0.001))
    energy = np.trapezoid(best, x) / np.trapezoid(measured, x)
    return np.nanmin(error), np.sqrt(np.nanmean(np.square(error))), *peaks, energy


def study(task):
    """What one model, fitted to one set of records, predicts of all others, by record."""
    name, label, records, seed = task
    rng, began = np.random.default_rng([seed, NAMES.index(name)]), time.process_time()
    force = mechanism(name)
    fitted = [records[key] for key in FITS[label]]
    coordinates, offset, _ = fit(force, fitted, np.zeros(len(force.names)), rng)
    rows = {key: shown(force, coordinates, offset, records[key]) for key in (*HARMONIC, *QUAKES)}
    if label == "harmonic":
        levels = [k for k, parameter in enumerate(force.names) if parameter in LEVELS]
        twins = {f"{t}lb_0.50Hz_1.0in": [f"{t}lb_1.00Hz_1.0in"] for t in TENSIONS}
        for twin, others in (twins | {"30lb_0.25Hz_1.0in": THIRTY}).items():
            moved, shift, _ = fit(force, [records[twin]], coordinates, rng, levels)
            rows |= {key: shown(force, moved, shift, records[key]) for key in others}
    values = dict(zip(force.names, force.values(coordinates), strict=True))
    return name, label, rows, values, time.process_time() - began


GROUPS = {
    "fast": {"fitted": FAST, "slow": SLOW, "0.5 Hz": HALF[:2], "earthquakes": QUAKES},
    "to 0.5 Hz": {"fitted": FITS["to 0.5 Hz"], "1 Hz": ["36lb_1.00Hz_1.0in"]},
    "harmonic": {
        "fitted": HARMONIC,
        "slow, fitted": SLOW,
        "Imperial Valley": QUAKES[:1],
        "Kocaeli": QUAKES[1:],
        "2022, 1 Hz": [f"{t}lb_1.00Hz_1.0in" for t in TENSIONS],
        "30 lb": THIRTY,
    },
}
LEFT_OUT = {"1 Hz": "to 0.5 Hz"} | dict.fromkeys(
    ("Imperial Valley", "Kocaeli", "2022, 1 Hz", "30 lb"), "harmonic"
)
"""Groups of records that were left out of a fit, and of which."""


def main():
    options = common.begin(common.parser_of(__doc__, data=True, jobs=2))
    records = thinned(read(options.data))
    names = ("three_stage", "backlash", "self_energising") if options.quick else NAMES
    labels = ("fast",) if options.quick else tuple(FITS)
    tasks = [(name, label, records, options.seed) for label in labels for name in names]
    with multiprocessing.Pool(options.jobs) as pool:
        results = {r[:2]: r[2:] for r in pool.imap(study, tasks, chunksize=1)}
    for label in labels:
        for group, keys in GROUPS[label].items():
            print(f"\nfitted: {label}; shown: {group} ({len(keys)})")
            head = "RRSE  start unknown   peak fwd   peak bwd   energy"
            print(f"{'':16}  {head}")
            for name in names:
                mean = np.mean([results[name, label][0][key] for key in keys], axis=0)
                print(f"{name:16} {mean[0]:5.3f} {mean[1]:14.3f} {mean[2]:10.2f} "
                      f"{mean[3]:10.2f} {mean[4]:8.2f}")  # fmt: skip
    if not options.quick:
        print("\nRRSE left out   " + "".join(f"{group:>16}" for group in LEFT_OUT))
        for name in names:
            means = [
                np.mean([results[name, label][0][key][0] for key in GROUPS[label][group]])
                for group, label in LEFT_OUT.items()
            ]
            print(f"    {name:16}" + "".join(f"{mean:12.3f}    " for mean in means))
    print()
    for (name, label), (_, values, seconds) in results.items():
        listing = ", ".join(f"{key} {value:.3g}" for key, value in values.items())
        print(f"{name}, {label}, {seconds:.0f} s: {listing}")


if __name__ == "__main__":
    main()
