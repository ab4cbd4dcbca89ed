"""Synthetic campaigns whose next test is advised, simulated from the truth, and calibrated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from mfd_bayes.calibration.posterior import Posterior, PriorFile, find_noise, load_priors
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.planning.candidate import Candidate, Goal, Limits, harmonic_of, parse_goal
from mfd_bayes.planning.study import Advice, Study, advise
from mfd_bayes.population.bands import Predictor
from mfd_bayes.population.inference import InferenceSettings, infer_population
from mfd_bayes.records.trace import Harmonic, Trace

BASE = (0.4, 0.5, 0.6)
"""Actuation of the tests that were made, ksi; 1 Hz, 1 in, two cycles."""

LEVELS = (0.4, 0.5, 0.6, 0.8, 1.0, 1.25, 1.5, 2.0)
AMPLITUDES = (0.15, 1.0)

GOAL = parse_goal("band at 1500 psi, 1 Hz, 1 in", "ksi")

CYCLES, FREQUENCY, RATE = 2.0, 1.0, 50.0

LAWS = {"Fc_fwd": "power", "Fc_bwd": "power", "sigma0": "affine"}

_MEDIANS = {
    "sigma1": 0.02,
    "sigma2": 0.015,
    "static_excess_fwd": 0.18,
    "static_excess_bwd": 0.12,
    "k2": 0.6,
    "k3": 20.0,
    "d2": 0.09,
    "d3": 0.07,
    "ell": 0.02,
    "v_s": 0.4,
    "noise_sd": 0.03,
    "noise_time": 0.1,
}
"""As in the demo, s, in, kip."""


@dataclass(frozen=True)
class Truth:
    """A device: slip forces K p^b, and the scatter of its tests in slip force and gap.

    Exponents and scatter differ between devices, as the priors have them; all else is the same in
    all tests of a device, which the priors prefer.
    """

    exponents: tuple[float, float]
    scatter: float

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Truth:
        """Exponents about 1 with the laws' own sd of a half, between 0.4 and 1.6."""
        one = np.clip(1.0 + 0.5 * rng.standard_normal(2), 0.4, 1.6)
        scatter = float(np.clip(abs(0.1 * rng.standard_normal()), 0.005, 0.2))
        return cls((float(one[0]), float(one[1])), scatter)

    def record(self, candidate: Candidate, rng: np.random.Generator) -> Trace:
        """A record of a test."""
        values = {
            name: np.array([median * np.exp(self._scatter(name) * rng.standard_normal())])
            for name, median in self._medians(candidate.actuation).items()
        }
        start = rng.uniform(0.1, 0.9, 1)
        motion = Harmonic(candidate.amplitude, candidate.frequency, candidate.cycles)
        whole = motion.trace(candidate.actuation)
        time = np.arange(0.0, whole.time[-1], 1.0 / RATE)
        place = np.interp(time, whole.time, whole.displacement)
        trace = Trace.from_arrays(time, place, candidate.actuation)
        model = ThreeStage()
        force = model.force(model.theta(values | {"gamma1": np.ones(1)}), trace, start)[0]
        force = force + 0.02 * rng.standard_normal()
        force = force + find_noise("ou").draw(rng, time, values)[0]
        return Trace.from_arrays(time, place, candidate.actuation, force)

    def _scatter(self, name: str) -> float:
        return self.scatter if name in ("Fc_fwd", "Fc_bwd", "d2") else 0.0

    def _medians(self, p: float) -> dict[str, float]:
        forward, backward = (p**b for b in self.exponents)
        friction = {"Fc_fwd": 1.3 * forward, "Fc_bwd": 1.65 * backward}
        return _MEDIANS | friction | {"sigma0": 15.0 + 15.0 * p}


@dataclass(frozen=True, eq=False)
class Campaign:
    """Tests of a device, and what was inferred of them."""

    traces: Mapping[str, Trace]
    predictor: Predictor
    tests: Sequence[Candidate]


def calibrated(traces: Sequence[Trace], seed: int) -> Campaign:
    """Population of some tests, by the inference of `mfd-bayes calibrate` with little effort.

    The tests are not sampled one by one first: the inference uses their likelihoods, and takes
    from their draws only where it begins to look.
    """
    priors = load_priors("mfd")
    tests = {f"t{k}": _test(trace, priors) for k, trace in enumerate(traces)}
    settings = InferenceSettings(LAWS, "ksi", "quick", (seed, 0))
    population = infer_population(tests, priors, settings).population
    done = tuple(harmonic_of(trace) for trace in traces)
    some = next(iter(tests.values())).posterior
    predictor = Predictor(population, some.model, some.noise)
    return Campaign(dict(zip(tests, traces, strict=True)), predictor, done)


def _test(trace: Trace, priors: PriorFile) -> Any:
    """What the inference asks of a calibrated test."""
    posterior = Posterior(trace, priors, "ou", "three_stage")
    p = trace.reference_actuation
    begin = _MEDIANS | {"Fc_fwd": 1.3 * p, "Fc_bwd": 1.65 * p, "sigma0": 15.0 + 15.0 * p}
    begin |= {"offset": 0.0, "start": 0.5, "gamma1": 1.0}
    values = {name: np.array([value]) for name, value in begin.items()}
    return SimpleNamespace(
        posterior=posterior,
        trace=trace,
        intervals={},
        stored=SimpleNamespace(values=lambda: values),
    )


def candidates() -> list[Candidate]:
    """Tests to choose from."""
    return [Candidate(p, FREQUENCY, a, CYCLES) for p in LEVELS for a in AMPLITUDES]


def advice_of(campaign: Campaign, goal: Goal = GOAL, seed: int = 0) -> Advice:
    """Advice on the next test of a campaign."""
    return advise(campaign.predictor, campaign.tests, goal, candidates(), Limits(), seed=seed)


def width_of(campaign: Campaign, goal: Goal = GOAL) -> float:
    """Mean width of the goal's bands as a campaign knows it."""
    return Study(campaign.predictor, campaign.tests, goal, draws=4000, seed=1).goals.width
