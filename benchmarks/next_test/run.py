"""Do predicted reductions of a band come true? Synthetic campaigns with and without the next test.

    python -m benchmarks.next_test.run > benchmarks/next_test/honest.txt

makes campaigns whose devices differ as the priors allow, asks for the next test, simulates the
recommended, the median and the worst candidate from the truth, infers the population again with
each, and compares: a minute a campaign (--quick: one). Finished campaigns are kept in --out. Closed
forms of the expected reduction are in tests/planning.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from mfd_bayes.applications.next_test.study import Study, advise
from mfd_bayes.calibration.noises import find_noise
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.campaign import synthetic
from mfd_bayes.campaign.candidate import Candidate, Limits, harmonic_of, parse_goal
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.population.bands import Predictor
from mfd_bayes.population.inference import InferenceSettings, infer_population
from mfd_bayes.records.trace import Harmonic, Trace

WHICH = ("best", "median", "worst")
CYCLES, FREQUENCY, RATE = 2.0, 1.0, 50.0
BASE = [Candidate(p, FREQUENCY, 1.0, CYCLES) for p in (0.4, 0.5, 0.6)]
"""Tests that were made; actuation in ksi, amplitude in in."""
CHOICE = [
    Candidate(p, FREQUENCY, amplitude, CYCLES)
    for p in (0.4, 0.5, 0.6, 0.8, 1.0, 1.25, 1.5, 2.0)
    for amplitude in (0.15, 1.0)
]
"""Tests to choose from."""
GOAL = parse_goal("band at 1500 psi, 1 Hz, 1 in", "ksi")
LAWS = {"Fc_fwd": "power", "Fc_bwd": "power", "sigma0": "affine"}


def medians(p, exponents=(1.0, 1.0)):
    """As in the demo, s, in, kip; slip forces K p^b."""
    slip = {"Fc_fwd": 1.3 * p ** exponents[0], "Fc_bwd": 1.65 * p ** exponents[1]}
    return synthetic._MEDIANS | slip | {"sigma0": 15.0 + 15.0 * p}


@dataclass(frozen=True)
class Truth:
    """A device: exponents of its slip forces, and the scatter of its tests in these and the gap.

    Both differ between devices, as the priors have them; all else is the same in all tests of a
    device, which the priors prefer.
    """

    exponents: tuple[float, float]
    scatter: float

    @classmethod
    def draw(cls, rng):
        """Exponents about 1 with the laws' own sd of a half, between 0.4 and 1.6."""
        exponents = np.clip(1.0 + 0.5 * rng.standard_normal(2), 0.4, 1.6)
        scatter = np.clip(abs(0.1 * rng.standard_normal()), 0.005, 0.2)
        return cls(tuple(exponents.tolist()), float(scatter))

    def record(self, candidate, rng):
        """A record of a test."""
        values = {}
        for name, median in medians(candidate.actuation, self.exponents).items():
            sd = self.scatter if name in ("Fc_fwd", "Fc_bwd", "d2") else 0.0
            values[name] = np.array([median * np.exp(sd * rng.standard_normal())])
        start = rng.uniform(0.1, 0.9, 1)
        motion = Harmonic(candidate.amplitude, candidate.frequency, candidate.cycles)
        ideal = motion.trace(candidate.actuation)
        time = np.arange(0.0, ideal.time[-1], 1.0 / RATE)
        displacement = np.interp(time, ideal.time, ideal.displacement)
        trace, model = Trace.from_arrays(time, displacement, candidate.actuation), ThreeStage()
        force = model.force(model.theta(values | {"gamma1": np.ones(1)}), trace, start)[0]
        force = force + 0.02 * rng.standard_normal()
        force = force + find_noise("ou").draw(rng, time, values)[0]
        return Trace.from_arrays(time, displacement, candidate.actuation, force)


def calibrated(traces, seed):
    """Predictor from some tests, by the inference of `mfd-bayes calibrate` with little effort.

    The tests are not sampled one by one first: the inference uses their likelihoods, and takes
    from their draws only where it begins to look.
    """
    priors, tests = load_priors("mfd"), {}
    for k, trace in enumerate(traces):
        begin = medians(trace.reference_actuation) | {"offset": 0.0, "start": 0.5, "gamma1": 1.0}
        values = {name: np.array([value]) for name, value in begin.items()}
        posterior = Posterior(trace, priors, "ou", "three_stage")
        stored = SimpleNamespace(values=lambda values=values: values)
        fields = {"posterior": posterior, "trace": trace, "intervals": {}, "stored": stored}
        tests[f"t{k}"] = SimpleNamespace(**fields)
    settings = InferenceSettings(LAWS, "ksi", "quick", (seed, 0))
    population = infer_population(tests, priors, settings).population
    return Predictor(population, posterior.model, posterior.noise)


def width_of(predictor, traces):
    """Mean width of the goal's bands as a campaign knows it."""
    harmonics = [harmonic_of(trace) for trace in traces]
    return Study(predictor, harmonics, GOAL, draws=4000, seed=1).goals.width


def campaign(seed):
    """Predicted and realised reduction of three candidates of one campaign."""
    rng = np.random.default_rng([23, seed])
    truth = Truth.draw(rng)
    base = [truth.record(candidate, rng) for candidate in BASE]
    predictor = calibrated(base, seed)
    harmonics = [harmonic_of(trace) for trace in base]
    advice = advise(predictor, harmonics, GOAL, CHOICE, Limits(), seed=seed)
    base_width, result = width_of(predictor, base), {"seed": seed}
    rows = advice[0], advice[len(advice) // 2], advice[len(advice) - 1]
    for choice, row in zip(WHICH, rows, strict=True):
        again = [*base, truth.record(row.candidate, rng)]
        result[choice] = {
            "actuation": row.candidate.actuation,
            "amplitude": row.candidate.amplitude,
            "predicted": row.reduction,
            "realised": 1.0 - width_of(calibrated(again, 1000 + seed), again) / base_width,
        }
    return result


def show(results):
    """Print all campaigns, the slope of realised on predicted, and what the advice won."""
    print(f"{'':8s}" + "".join(f"{choice:>28s}" for choice in WHICH))
    print("campaign" + f"{'psi    in predict. realised':>28s}" * 3)
    for result in results:
        cells = "".join(
            f"  {1000 * f['actuation']:6.0f} {f['amplitude']:4.2f}  {f['predicted']:5.3f}"
            f"   {f['realised']:6.3f}"
            for f in (result[choice] for choice in WHICH)
        )
        print(f"{result['seed']:8d}{cells}")
    x, y = (
        np.array([[r[choice][name] for choice in WHICH] for r in results])
        for name in ("predicted", "realised")
    )
    pairs = zip(x.mean(axis=0), y.mean(axis=0), strict=True)
    print(f"{'mean':8s}" + "".join(f"{f'{a:5.3f}   {b:6.3f}':>28s}" for a, b in pairs) + "\n")
    rng = np.random.default_rng(0)
    again = [slope(x[rows], y[rows]) for rows in rng.integers(len(x), size=(500, len(x)))]
    error = np.std(again)
    print(f"slope of realised on predicted reduction: {slope(x, y):.2f} ± {error:.2f}")
    print(f"mean realised over mean predicted: {y.mean() / x.mean():.2f}")
    wins = int(np.sum(y[:, 0] > y[:, 1]))
    print(f"the recommended test beat the median candidate in {wins} of {len(y)} campaigns")


def slope(x, y):
    """Slope through all pairs, with an intercept."""
    return float(np.polyfit(x.ravel(), y.ravel(), 1)[0])


def main():
    parser = common.parser_of(__doc__, jobs=1, output="out_next")
    parser.add_argument("--campaigns", type=int, default=40)
    options = common.begin(parser)
    seeds = range(1, 1 + (1 if options.quick else options.campaigns))
    show(common.run_series(campaign, [(seed,) for seed in seeds], options))


if __name__ == "__main__":
    main()
