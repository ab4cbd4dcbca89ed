"""One test in the report: bands, parameters, properties, checks and scores."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import contraction, log_if_positive
from mfd_bayes.calibration.identifiability import identify
from mfd_bayes.calibration.noise_sensitivity import moves, quantiles_of
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.predictive import replicate
from mfd_bayes.calibration.priors import units
from mfd_bayes.calibration.result import TestResult
from mfd_bayes.evaluation import checks
from mfd_bayes.evaluation.properties import (
    Peaks,
    device_properties,
    measured_of,
    measured_properties,
    of_parameters,
    properties_of,
    property_rows,
)
from mfd_bayes.evaluation.scores import fan_of, score_of, spread_of
from mfd_bayes.evaluation.views import Marginal, NoiseRow, Row, TestView
from mfd_bayes.population.bands import Forecast
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.manifest import Manifest
from mfd_bayes.runs.run import Run
from mfd_bayes.runs.unit_system import US
from mfd_bayes.store.netcdf import StoredTest

Array = NDArray[np.float64]

SCALE_ONLY = frozenset({"gamma1", "gamma2"})
SCALE_NOTE = "not identifiable: only ℓ = γ2/γ1 reaches the force"

MAX_PLOTTED_DRAWS, FEWER, MANY = 2000, 1000, 100
"""Most draws of a quantity in figures; the same in a run of more than so many tests."""

HELD_OUT_DRAWS = 800

FAR_APART = 0.25
"""A median alone and one in the joint posterior that differ by less, a share, do not disagree."""

_ALIKE: WeakValueDictionary[bytes, Array] = WeakValueDictionary()
"""Draws by their bytes, as long as a view holds them."""

_CORNER = (
    *("Fc_fwd", "Fc_bwd", "sigma0", "k2", "k3", "d2", "d3"),
    *("k_fwd", "k_bwd", "gap", "n", "ell"),
)
_FIRST = ("gap", "k3", "k2", "Fs_fwd", "Fs_bwd")
"""Quantities that matter most in design come first, after the slip forces."""


def calibrated_view(manifest: Manifest, peaks: Peaks, test: TestResult) -> TestView:
    """A test that was fitted; `peaks` are the factors of the run."""
    posterior, stored, trace = test.posterior, test.stored, test.trace
    values, facts, tolerances = stored.values(), stored.facts, manifest.settings.tolerances
    replicas = replicate(posterior, values, np.random.default_rng(0))
    prior = _prior_values(posterior)
    noises = noise_rows(test.id, posterior, values, facts)
    rows = _parameters(test, stored, prior, noises)
    densities = (stored.stats[name].to_numpy() for name in ("log_prior", "log_likelihood"))
    draws = {name: stored.draws[name].to_numpy() for name in posterior.names}
    identifiability = identify(posterior, draws, prior, *densities)
    measured = measured_of(manifest, test.id)
    properties = properties_of(trace, replicas.observed, peaks, smooth=replicas.force)
    score = score_of(test.id, "calibrate", trace, replicas.observed, posterior.first)
    arguments = test.id, posterior, replicas, measured, properties, tolerances
    predictive = checks.predictive_checks(*arguments)
    level, settings = trace.reference_actuation, manifest.settings
    drawn = properties | of_parameters(posterior.model, replicas.values, level, settings)
    stage, travel = _stages(posterior, values)
    return TestView(
        id=test.id,
        role="calibrate",
        actuation=US.actuation(trace, manifest.settings.actuation_unit),
        trace=trace,
        first=posterior.first,
        device=fan_of("this_test", replicas.force),
        observation=fan_of("observation", replicas.observed),
        rows=rows,
        marginals=_marginals(posterior, values, prior, rows, len(manifest.tests) > MANY),
        chains={name: _by_step(stored, name) for name in posterior.names},
        corner=tuple(
            name
            for name in _CORNER
            if any(r.name == name and r.contraction >= checks.INFORMED for r in rows)
        ),
        checks=(
            *checks.convergence_checks(test.id, rows, manifest.effort),
            checks.length_check(test.id, facts, manifest.effort),
            *predictive,
            *checks.coverage_checks(score, tolerances),
            *checks.slip_checks(test.id, posterior, values, measured),
            *checks.notes(test.id, rows, facts),
            *checks.identifiability_checks(test.id, identifiability),
        ),
        score=score,
        identifiability=identifiability,
        derived=property_rows(test.id, "calibrate", trace, drawn, measured_properties(measured)),
        loop_estimates=checks.loop_estimates(predictive, properties),
        noises=noises,
        modes=_modes(facts),
        stage=stage,
        travel=travel,
    )


def held_out_view(run: Run, name: str, trace: Trace) -> TestView:
    """A test that was predicted from the others."""
    session = run.session(name)
    before = run.sequence.before(name, trace, Forecast(draws=HELD_OUT_DRAWS, session=session))
    how: dict[str, Any] = {"draws": HELD_OUT_DRAWS, "session": session, "after": before or ""}
    seen = run.predict(trace, "observation", explain=True, **how)
    test = run.predict(trace, "new_test", **how)
    drawn = device_properties(run, trace, seen, test)
    measured = measured_properties(measured_of(run.manifest, name))
    return TestView(
        id=name,
        role="validate",
        actuation=US.actuation(trace, run.actuation_unit),
        trace=trace,
        first=0,
        observation=fan_of("observation", seen.draws),
        score=score_of(name, "validate", trace, seen.draws, 0),
        derived=property_rows(name, "validate", trace, drawn, measured),
        shares=seen.explained,
        begun=before.words if before else "",
    )


# --- parameters


def _parameters(
    test: TestResult, stored: StoredTest, prior: Mapping[str, Array], noises: Sequence[NoiseRow]
) -> tuple[Row, ...]:
    """Table I of one test: every parameter with its uncertainty and convergence."""
    rows, kinds = [], units(test.posterior.model)
    for name, draws in stored.values().items():
        shrunk = float("nan")
        if name not in SCALE_ONLY and np.ptp(prior[name]) > 0:  # what is fixed has no spread
            before, after = log_if_positive(prior[name], draws)
            shrunk = float(contraction(np.array([before.std()]), after[:, None])[0])
        note = SCALE_NOTE if name in SCALE_ONLY else ""
        if shrunk < checks.INFORMED:
            note = checks.NOT_INFORMED
        r_hat, bulk, tail = stored.facts["convergence"].get(name, (np.nan, np.nan, np.nan))
        rows.append(
            Row(
                subject=test.id,
                name=name,
                unit=kinds[name],
                **spread_of(draws),
                # None, for JSON has no infinity: walkers that never moved, or too few draws
                r_hat=np.inf if r_hat is None else r_hat,
                ess_bulk=0.0 if bulk is None else bulk,
                ess_tail=0.0 if tail is None else tail,
                contraction=shrunk,
                note=note,
                other_noises=tuple(n for n in noises if n.decides and n.name == name),
            )
        )
    return tuple(rows)


def with_joint(run: Run, view: TestView) -> TestView:
    """A fitted test with each parameter's interval in the joint posterior of all tests."""
    if not view.rows or not run.sequence.pooled(view.id):
        return view
    values, model = run.sequence.values(view.id), run.tests[view.id].posterior.model
    joint = {**values} | dict(zip(model.parameters, model.theta(values).T, strict=True))
    rows = []
    for row in view.rows:
        draws = joint.get(row.name)
        if draws is None or row.name in SCALE_ONLY or not np.ptp(draws) > 0.0:
            rows.append(row)
            continue
        low, middle, high = np.quantile(draws, [0.025, 0.5, 0.975]).tolist()
        of_device = row.name in (*model.parameters, "ell") and row.contraction >= checks.INFORMED
        apart = of_device and (low > row.upper or high < row.lower)
        apart = apart and abs(middle - row.median) > FAR_APART * abs(row.median)
        joint_row = {"joint_lower": low, "joint_median": middle, "joint_upper": high}
        rows.append(replace(row, **joint_row, disagrees=apart))
    return replace(view, rows=tuple(rows))


def _prior_values(posterior: Posterior, n: int = 2000) -> dict[str, Array]:
    """Prior draws of every stored quantity."""
    drawn = posterior.draw_prior(np.random.default_rng(0), n)
    theta = posterior.theta(drawn)
    return drawn | dict(zip(posterior.model.parameters, theta.T, strict=True))


def _stages(
    posterior: Posterior, values: Mapping[str, Array]
) -> tuple[NDArray[np.int8] | None, Array | None]:
    """Stage, and travel in the gap, at each sample for the posterior medians."""
    medians = {name: np.atleast_1d(np.median(draws)) for name, draws in values.items()}
    at = posterior.theta(medians), posterior.trace, medians.get("start")
    stage = posterior.model.stages(*at)
    return (None, None) if stage is None else (stage[0], posterior.model.travel(*at)[0])


def _modes(facts: Mapping[str, Any]) -> tuple[Mapping[str, float], ...]:
    """Medians and share of each mode with draws, the largest first; empty with one mode."""
    shares = np.atleast_2d(facts.get("mode_shares", [[]])).mean(axis=0)
    kept = [k for k in np.argsort(-shares).tolist() if shares[k] >= checks.SMALLEST_MODE]
    values = facts.get("mode_values", [])
    if len(kept) < 2 or len(values) != len(shares):
        return ()
    return tuple({**values[k], "share": float(shares[k])} for k in kept)


def _marginals(
    posterior: Posterior,
    values: Mapping[str, Array],
    prior: Mapping[str, Array],
    rows: Iterable[Row],
    many: bool,
) -> tuple[Marginal, ...]:
    kinds = units(posterior.model)
    shrunk, most = {row.name: row.contraction for row in rows}, FEWER if many else MAX_PLOTTED_DRAWS
    return tuple(
        Marginal(n, kinds[n], _once(_some(prior[n], most)), _some(values[n], most), shrunk[n])
        for n in posterior.names
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
    return np.asarray(draws[:: -(-len(draws) // most)], dtype=np.float32)


def _by_step(stored: StoredTest, name: str) -> Array:
    """Mean over walkers at each kept step, (chain, step)."""
    draws = stored.draws[name].to_numpy()
    mean: Array = draws.reshape(len(draws), stored.facts["walkers"], -1).mean(axis=1)
    return mean


# --- other noises


def noise_rows(
    test: str, posterior: Posterior, values: Mapping[str, Array], facts: Mapping[str, Any]
) -> tuple[NoiseRow, ...]:
    """Every quantity of a test under its own noise and under others; empty where not checked.

    Parameters
    ----------
    values : mapping of str to (n,)
        Posterior draws of all quantities.
    facts : mapping
        Stored facts of the test.
    """
    fits = [fit for fit in facts.get("other_noises", ()) if fit["quantities"]]
    if not fits:
        return ()
    own, kinds = quantiles_of(posterior, values), {"gap": "in"} | units(posterior.model)
    first = (*posterior.model.slip_forces, *_FIRST)
    ordered = sorted(own, key=lambda name: first.index(name) if name in first else len(first))
    rows = []
    for fit in fits:
        for name in ordered:
            other = fit["quantities"].get(name, [None])
            if None in other:
                continue
            (low, middle, high), (below, there, above) = own[name], other
            decides = moves(own[name], other)
            head = test, name, kinds[name], posterior.noise.name
            rows.append(
                NoiseRow(*head, low, middle, high, fit["noise"], below, there, above, decides)
            )
    return tuple(rows)
