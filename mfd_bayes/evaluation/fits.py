"""One test in the report: bands, parameters, checks and scores."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import contraction, log_if_positive
from mfd_bayes.calibration.identifiability import Identifiability, identify
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.predictive import replicate
from mfd_bayes.calibration.quantities import units
from mfd_bayes.calibration.result import TestResult
from mfd_bayes.evaluation.bands import fan_of, score_of, spread_of
from mfd_bayes.evaluation.checks import (
    INFORMED,
    NOT_INFORMED,
    CheckedTest,
    checks_of_test,
)
from mfd_bayes.evaluation.derived_rows import calibrated_rows, held_out_rows
from mfd_bayes.evaluation.noises import noise_rows, with_others
from mfd_bayes.evaluation.read_off import reading_rows
from mfd_bayes.evaluation.views import Marginal, Row, TestView
from mfd_bayes.population.bands import Forecast
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.manifest import Manifest
from mfd_bayes.runs.run import Run
from mfd_bayes.runs.unit_system import US
from mfd_bayes.store.netcdf import StoredTest

Array = NDArray[np.float64]

SCALE_ONLY = frozenset({"gamma1", "gamma2"})
SCALE_NOTE = "not identifiable: only ℓ = γ2/γ1 reaches the force"
LEAST = 0.005
"""Share of the draws from which a mode is told of."""

SHOWN, FEWER, MANY = 2000, 1000, 100
"""Most draws of a quantity in figures; the same in a run of more than so many tests."""

_ALIKE: WeakValueDictionary[bytes, Array] = WeakValueDictionary()
"""Draws by their bytes, as long as a view holds them."""

_CORNER = (
    *("Fc_fwd", "Fc_bwd", "sigma0", "k2", "k3", "d2", "d3"),
    *("k_fwd", "k_bwd", "gap", "n", "ell"),
)


def calibrated_view(manifest: Manifest, test: TestResult) -> TestView:
    """A test that was fitted."""
    posterior, stored = test.posterior, test.stored
    values = stored.values()
    replicas = replicate(posterior, values, np.random.default_rng(0))
    prior = _prior_values(test)
    noises = noise_rows(test.id, posterior, values, stored.facts)
    rows = with_others(_rows(test.id, stored, prior), noises)
    known = _identifiability(posterior, stored, prior)
    tolerances = manifest.settings.tolerances
    readings = reading_rows(test.id, posterior, values, tolerances)
    checked = CheckedTest(
        test, stored, rows, replicas, known, manifest.effort, tolerances, readings, noises
    )
    stage, travel = _stages(test, values)
    informed = {row.name for row in rows if row.contraction >= INFORMED}
    most = SHOWN if len(manifest.tests) <= MANY else FEWER
    return TestView(
        id=test.id,
        role="calibrate",
        actuation=US.actuation(test.trace, manifest.settings.actuation_unit),
        trace=test.trace,
        first=posterior.first,
        device=fan_of("this_test", replicas.force),
        observation=fan_of("observation", replicas.observed),
        rows=tuple(rows),
        marginals=_marginals(test, values, prior, rows, most),
        chains={name: _by_step(stored, name) for name in posterior.names},
        corner=tuple(name for name in _CORNER if name in informed),
        checks=checks_of_test(checked),
        score=score_of(test.id, "calibrate", test.trace, replicas.observed, posterior.first),
        identifiability=known,
        derived=calibrated_rows(manifest, test, replicas),
        readings=readings,
        noises=noises,
        modes=_modes(stored.facts),
        stage=stage,
        travel=travel,
    )


def _modes(facts: Mapping[str, Any]) -> tuple[Mapping[str, float], ...]:
    """Medians and share of each mode with draws, the largest first; empty with one mode."""
    shares = np.atleast_2d(facts.get("mode_shares", [[]])).mean(axis=0)
    kept = [k for k in np.argsort(-shares).tolist() if shares[k] >= LEAST]
    values = facts.get("mode_values", [])
    if len(kept) < 2 or len(values) != len(shares):  # as earlier versions wrote it
        return ()
    return tuple({**values[k], "share": float(shares[k])} for k in kept)


def held_out_view(run: Run, name: str, trace: Trace) -> TestView:
    """A test that was predicted from the others."""
    session = run.session(name)
    before = run.sequence.before(name, trace, Forecast(draws=800, session=session))
    asked: dict[str, Any] = {"draws": 800, "session": session, "after": before or ""}
    band = run.predict(trace, "observation", explain=True, **asked)
    damper = run.predict(trace, kind="new_test", **asked)
    return TestView(
        id=name,
        role="validate",
        actuation=US.actuation(trace, run.actuation_unit),
        trace=trace,
        first=0,
        observation=fan_of("observation", band.draws),
        score=score_of(name, "validate", trace, band.draws, 0),
        derived=held_out_rows(run, name, trace, damper),
        shares=band.explained,
        begun=before.words if before else "",
    )


def _stages(
    test: TestResult, values: Mapping[str, Array]
) -> tuple[NDArray[np.int8] | None, Array | None]:
    """Stage, and travel in the gap, at each sample for the posterior medians."""
    posterior = test.posterior
    medians = {name: np.atleast_1d(np.median(draws)) for name, draws in values.items()}
    at = posterior.theta(medians), posterior.trace, medians.get("start")
    stage = posterior.model.stages(*at)
    if stage is None:
        return None, None
    return stage[0], posterior.model.travel(*at)[0]


def _rows(test: str, stored: StoredTest, prior: Mapping[str, Array]) -> list[Row]:
    """Table I of one test: every parameter with its uncertainty and convergence."""
    rows = []
    for name, draws in stored.values().items():
        shrunk = float("nan")
        if name not in SCALE_ONLY and np.ptp(prior[name]) > 0:  # what is fixed has no spread
            before, after = log_if_positive(prior[name], draws)
            shrunk = float(contraction(np.array([before.std()]), after[:, None])[0])
        note = SCALE_NOTE if name in SCALE_ONLY else ""
        if shrunk < INFORMED:
            note = NOT_INFORMED
        r_hat, bulk, tail = stored.facts["convergence"].get(name, (np.nan, np.nan, np.nan))
        rows.append(
            Row(
                subject=test,
                name=name,
                unit=units()[name],
                **spread_of(draws),
                # None, for JSON has no infinity: walkers that never moved, or too few draws
                r_hat=np.inf if r_hat is None else r_hat,
                ess_bulk=0.0 if bulk is None else bulk,
                ess_tail=0.0 if tail is None else tail,
                contraction=shrunk,
                note=note,
            )
        )
    return rows


def _prior_values(test: TestResult, n: int = 2000) -> dict[str, Array]:
    """Prior draws of every stored quantity."""
    posterior = test.posterior
    drawn = posterior.draw_prior(np.random.default_rng(0), n)
    theta = posterior.theta(drawn)
    return drawn | dict(zip(posterior.model.parameters, theta.T, strict=True))


def _identifiability(
    posterior: Posterior, stored: StoredTest, prior: Mapping[str, Array]
) -> Identifiability:
    values = {name: stored.draws[name].to_numpy() for name in posterior.names}
    densities = (stored.stats[name].to_numpy() for name in ("log_prior", "log_likelihood"))
    return identify(posterior, values, prior, *densities)


def _marginals(
    test: TestResult,
    values: Mapping[str, Array],
    prior: Mapping[str, Array],
    rows: list[Row],
    most: int,
) -> tuple[Marginal, ...]:
    shrunk = {row.name: row.contraction for row in rows}
    sampled = test.posterior.names
    return tuple(
        Marginal(n, units()[n], _once(_some(prior[n], most)), _some(values[n], most), shrunk[n])
        for n in sampled
    )


def sharing_priors(view: TestView) -> TestView:
    """A test that another process has made, with the prior draws that others of this one hold."""
    marginals = (replace(m, prior=_once(m.prior)) for m in view.marginals)
    return replace(view, marginals=tuple(marginals))


def _once(draws: Array) -> Array:
    """One array for all that are alike: the prior is the same in many tests."""
    return _ALIKE.setdefault(draws.tobytes(), draws)


def _some(draws: Array, most: int) -> Array:
    """At most so many of the draws, evenly spaced; single precision saves memory."""
    step = -(-len(draws) // most)
    return np.asarray(draws[::step], dtype=np.float32)


def _by_step(stored: StoredTest, name: str) -> Array:
    """Mean over walkers at each kept step, (chain, step)."""
    draws = stored.draws[name].to_numpy()
    walkers = stored.facts["walkers"]
    mean: Array = draws.reshape(len(draws), walkers, -1).mean(axis=1)
    return mean
