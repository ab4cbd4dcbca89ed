"""Checks of tests, and tests that stand apart from the others."""

import multiprocessing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mfd_bayes.calibration.diagnostics import TAIL_SHARE, Convergence
from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.errors import StoreError
from mfd_bayes.evaluation.checks import (
    contradicted_order,
    convergence_checks,
    length_check,
    scatter_checks,
    slip_checks,
    standing_out,
    uncommon_device_values,
)
from mfd_bayes.evaluation.laws import convergence_rows
from mfd_bayes.evaluation.summary import assess, verdict_sentences, views_of_tests
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.jobs import local
from mfd_bayes.population.design import TestConditions
from mfd_bayes.records.cycles import measured_cycles
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.symbols import Symbols
from mfd_bayes.reporting.tables import paper_sheets
from mfd_bayes.runs.run import open_run
from mfd_bayes.store.netcdf import StoredTest
from mfd_bayes.units import DAMPER
from tests.population.made import THREE_STAGE, make_population


def row(name, r_hat=1.0, ess=900.0, contraction=0.9):
    row = {"name": name, "r_hat": r_hat, "contraction": contraction}
    return row | dict.fromkeys(("ess_bulk", "ess_tail"), ess)


def test_an_ensemble_that_is_stuck_fails_the_verdict():
    effort = Effort(r_hat=1.01, ess=400.0, length=5.0, limit=8000)
    rows = [row("k2"), row("k3", 1.31, 40.0), row("d2", np.inf, 0.0), row("sigma1", np.nan)]
    verdicts = {(c.check, c.feature): c.status for c in convergence_checks("p500", rows, effort)}
    assert [verdicts["R-hat", name] for name in ("k2", "k3", "d2")] == ["pass", "fail", "fail"]
    assert verdicts["bulk ESS", "d2"] == "fail"
    assert not any(target == "sigma1" for _, target in verdicts)
    facts = {"autocorrelation": {"k2": 10.0, "d2": None}, "steps": 500, "discarded": 100}
    check = length_check("p500", facts, effort)
    assert (check.feature, check.observed, check.status) == ("d2", 0.0, "fail")


def test_levels_are_checked_and_a_quarter_is_enough_for_a_tail_that_no_table_shows():
    population = make_population([TestConditions(1.0)] * 6, shape=(4, 25))
    design, measured = population.design, population.convergence
    tail = measured.ess_tail[-design.tabled.size :].copy()
    for name, ess in {"k3": 150.0, "k2": 50.0, "Fc_fwd": 150.0, "d3": 50.0}.items():
        tail[design.names.index(name)] = ess
    share = np.where(design.tabled, 1.0, TAIL_SHARE)
    measured = Convergence(np.ones(tail.size), np.full(tail.size, 900.0), tail, share)
    rows = convergence_rows(replace(population, convergence=measured), [row("d3")])
    checks = convergence_checks("population", rows, Effort(ess=400.0, limit=8000))
    failed = {(c.check, c.feature) for c in checks if c.status == "fail"}
    assert failed == {("tail ESS", "k2"), ("tail ESS", "Fc_fwd")}
    assert "d3" not in {c.feature for c in checks}  # the table has its own row of it


SECONDS = np.arange(0.0, 10.0, 1 / 128)
FORCE = 0.3 + 2.0 * np.tanh(8.0 * np.cos(np.pi * SECONDS))
SLIP = Trace.from_arrays(SECONDS, np.sin(np.pi * SECONDS), 0.03, FORCE)
POSTERIOR = Posterior(SLIP, "brfd", "ou")


def test_a_slip_force_that_is_not_the_measured_one_fails():
    for level, names in ((1.9, []), (0.4, ["Fc_fwd"]), (5.0, ["Fc_fwd"])):
        values = {"Fc_fwd": np.full(9, level), "Fc_bwd": np.full(9, 2.1), "offset": np.full(9, 0.3)}
        checks = slip_checks("a", POSTERIOR, values, measured_cycles(SLIP))
        assert [check.feature for check in checks] == names
        assert all(check.status == "fail" for check in checks)


# --- tests that stand apart from the others


@pytest.mark.parametrize("count", [5, 20])
def test_a_gap_half_as_large_again_stands_apart_and_no_other_does(count):
    rng = np.random.default_rng(1)
    deviations = rng.normal(scale=[0.05, 0.05, 0.02], size=(count, 3))
    deviations[2, 2] += np.log(1.5)
    if count == 5:  # with four others, only what is far beyond all doubt
        deviations[2, 2] += np.log(2.0)
    ((test, quantity, distance),) = standing_out(deviations, np.zeros_like(deviations))
    assert (test, quantity) == (2, 2)
    assert distance > 8.0


def test_tests_stand_apart_by_chance_as_rarely_as_stated():
    rng = np.random.default_rng(2)
    campaigns = rng.normal(size=(2000, 8, 4))
    share = np.mean(
        [any(True for _ in standing_out(values, 0.1 * np.abs(values))) for values in campaigns]
    )
    assert share < 0.02


def test_a_distance_is_counted_in_sds_of_the_tests_own_posteriors():
    pooled = np.log([0.1594, 0.1714, 0.1579, 0.1592, 0.1580, 0.1592])[:, None]  # of one device
    gaps = np.log([0.1629, 0.1682, 0.1601, 0.1571, 0.1613, 0.1549])[:, None]
    sds = np.array([0.0008, 0.0014, 0.0012, 0.0019, 0.0013, 0.0023])[:, None] / 0.16
    assert list(standing_out(pooled, 0.0 * sds))  # shrunken values scatter too little
    assert not list(standing_out(gaps, sds))
    gaps[1] += np.log(1.5)
    assert [test for test, *_ in standing_out(gaps, sds)] == [1]


def test_a_scatter_beyond_that_of_the_priors_is_a_warning_of_the_verdict():
    def checks(scatter):
        scatters = {"sigma0": np.full((4, 9), 0.5), "Fc_fwd": np.full((4, 9), scatter)}
        population = SimpleNamespace(scatters=scatters, scatter_scales=np.array([0.3, 0.1]))
        run = SimpleNamespace(tests=range(6), model=ThreeStage(), population=population)
        return scatter_checks(run)

    assert checks(0.1) == []
    ((check),) = checks(0.29)
    assert (check.test, check.status) == ("population", "warning")
    sentences = verdict_sentences(
        SimpleNamespace(effort=Effort(r_hat=1.01, ess=400.0, length=5.0, limit=8000), axes=DAMPER),
        [check],
        [],
    )
    assert "forward slip force: 29%, the priors expect about 10%" in " ".join(map(str, sentences))


# --- views of many tests

DATA = Path(__file__).parents[1] / "data" / "run"


def test_several_processes_make_the_views_that_one_makes(monkeypatch):
    monkeypatch.setattr(local, "FEWEST", 2)
    run, views = open_run(DATA), []
    for jobs in (1, 2):
        test_views, lost = views_of_tests(run, jobs)
        assert lost == {}
        assert [view.id for view in test_views] == list(run.manifest.tests)
        views.append(test_views)
    assert not multiprocessing.active_children()
    for view_a, view_b in zip(*views, strict=True):
        np.testing.assert_array_equal(view_a.observation.median, view_b.observation.median)
        for a, b in zip(view_a.marginals, view_b.marginals, strict=True):
            np.testing.assert_array_equal(a.prior, b.prior)
            np.testing.assert_array_equal(a.posterior, b.posterior)
        assert repr((view_a.rows, view_a.checks)) == repr((view_b.rows, view_b.checks))


@pytest.mark.parametrize(
    ("raw", "filtered", "missed"),
    [(1.0, 1.0, False), (1 / 1.19, 1 / 1.19, True), (1.3, 1.0, False), (1.3, 1.25, True)],
    ids=["as it is", "computed 19 % too high", "filter took it", "computed too low"],
)
def test_peaks_that_all_tests_miss_alike_are_no_less_missed(raw, filtered, missed):
    run = open_run(DATA)
    tests, manifest = {}, run.manifest
    for name, test in run.tests.items():
        trace = replace(test.trace, force=filtered * np.asarray(test.trace.force))
        settings = run.manifest.settings
        posterior = Posterior(trace, run.priors, settings.noise, settings.model)
        tests[name] = replace(test, posterior=posterior)
        measured = {
            key: tuple(raw * np.array(values)) if "largest" in key or "peak" in key else values
            for key, values in manifest.tests[name].measured.items()
        }
        manifest = manifest.with_test(name, measured=measured)
    learned = {"rate": 0.15, "rate_variance": 0.1, "scatter": 0.1, "tests": 2.0}
    manifest = manifest.changed(peak_excess=dict.fromkeys(("fwd", "bwd"), learned))
    views, _ = views_of_tests(replace(run, tests=tests, manifest=manifest))
    checks = [check for view in views for check in view.checks if "peak" in check.feature]
    assert len(checks) == 4
    assert {check.status == "warning" for check in checks} == {missed}


def test_a_stored_file_that_is_gone_is_no_fault_of_its_test(tmp_path):
    run = open_run(DATA)
    name, test = next(iter(run.tests.items()))
    tests = {**run.tests, name: replace(test, path=tmp_path / "gone.nc", sha256="")}
    with pytest.raises(StoreError, match=r"gone\.nc"):
        views_of_tests(replace(run, tests=tests))


@pytest.mark.parametrize(("moved", "named"), [(0, []), (2, []), (4, ["gap", "Fc_bwd"])])
def test_a_device_value_that_most_tests_do_not_have_is_named(moved, named):
    population = make_population([TestConditions(1.0)] * 6, scatter=0.05, shape=(4, 25))
    tests = {}
    for number in range(6):
        factors = {"Fc_bwd": 1.6, "d2": 2.0} if number < moved else {}
        middles = {name: value * factors.get(name, 1.0) for name, value in THREE_STAGE.items()}
        intervals = {name: (m, 0.95 * m, 1.05 * m) for name, m in middles.items()}
        tests[f"t{number}"] = SimpleNamespace(intervals=intervals)
    findings = uncommon_device_values(
        SimpleNamespace(tests=tests, model=ThreeStage(), population=population)
    )
    assert sorted(str(finding.message).split()[0] for finding in findings) == sorted(named)


# --- tests that do not begin where the one before ended, by posteriors that are made up


def run_of(folder, start, direction=1.0, predecessor="a"):
    """The run whose test a ends in slip forward, and b begins at a place with some spread."""
    run = open_run(folder)
    test, time = run.tests["a"], np.arange(201) / 50
    values = test.stored.values()
    spread = 0.02 * np.random.default_rng(0).normal(size=len(values["start"]))
    ended = Trace.from_arrays(time, 5.0 - 5.0 * np.cos(0.25 * np.pi * time))  # to 10 in
    motion = Trace.from_arrays(time, 10.0 + direction * np.sin(np.pi * time))
    tests = {}
    for name, trace, w0 in (
        ("a", ended, values["start"]),
        ("b", motion, np.clip(start + spread, 0.0, 1.0)),
    ):
        draws = values | {"start": w0}
        posterior = SimpleNamespace(
            model=test.posterior.model, names=test.posterior.names, noise=None, trace=trace
        )
        stored = SimpleNamespace(values=lambda draws=draws: draws)
        tests[name] = SimpleNamespace(id=name, posterior=posterior, stored=stored, trace=trace)
    settings = run.manifest.settings.with_test("b", after=predecessor)
    return replace(run, tests=tests, manifest=run.manifest.changed(settings=settings))


def test_a_start_far_from_the_end_of_the_test_before_is_a_question(made_run):
    for start, direction in ((0.2, 1.0), (0.8, -1.0)):
        (finding,) = contradicted_order(run_of(made_run, start, direction))
        assert (finding.subject, finding.name) == ("b", "start in the gap")
    for start, direction in ((1.0, 1.0), (0.0, -1.0), (0.88, 1.0)):
        assert contradicted_order(run_of(made_run, start, direction)) == []
    assert contradicted_order(run_of(made_run, 0.2, predecessor="")) == []


def test_intervals_alone_and_together_that_do_not_overlap_disagree(monkeypatch):
    run, values = open_run(DATA), StoredTest.values

    def higher(stored):  # jointly 0.828 [0.788, 0.872] kip in the first test
        return (draws := values(stored)) | {"Fc_bwd": 0.9 + 0.01 * np.tanh(draws["Fc_bwd"])}

    monkeypatch.setattr(StoredTest, "values", higher)
    view = assess(run)
    assert [row["name"] for row in view.tests[0].rows if row["joint_conflict"]] == ["Fc_bwd"]
    table, _ = paper_sheets(view, Symbols(run.model))
    middle, ends, separate = next(r.cells[0].lines for r in table.rows if r.name == "Fc_bwd")
    assert [middle.text(), ends.text()] == ["0.828", "[0.788, 0.872]"]
    assert separate.marked
    assert separate.text().startswith("alone: 0.90")
