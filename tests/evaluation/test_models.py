"""Which model is favoured, by how much, and the warnings where that cannot be trusted."""

import json
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import mfd_bayes as mb
from mfd_bayes.calibration.diagnostics import Effort
from mfd_bayes.calibration.evidence import Evidence
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.cli.commands import app
from mfd_bayes.errors import CampaignError, FitError
from mfd_bayes.evaluation import compare as comparison
from mfd_bayes.evaluation.compare import ALL, CrossValidation, candidates, compare_runs
from mfd_bayes.friction.bouc_wen import BoucWen
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.tables import comparison_csv

CYCLES = 6
RNG = np.random.default_rng(0)
HARD = {name: RNG.normal(100, 30, CYCLES) for name in ("a", "b")}
BETTER = {"lugre": 0.0, "bouc_wen": 4.0, "three_stage": 10.0}
CAMPAIGN = """\
[campaign]
priors = "brfd"
rate = "40 Hz"

[columns]
time = { name = "time_s", unit = "s" }
displacement = { name = "displacement_in", unit = "in" }
force = { name = "force_kip", unit = "kip" }

[laws]
Fc_fwd = "power"
Fs_fwd = "power"

[[test]]
id = "slow"
file = "slow.csv"
actuation = "30 lbf"
"""
EFFORT = Effort(r_hat=1.03, ess=100, limit=2400)


def validation_of(name, model, *, psis_k=0.3, k=0.3, scale=1.0):
    ripple = np.random.default_rng([len(model), ord(name)]).normal(0, 1, CYCLES)
    elpd = HARD[name] + scale * BETTER[model] + ripple
    return CrossValidation(elpd, elpd + 2.0, np.full(CYCLES, psis_k), np.full(CYCLES, k))


def run_of(model, tests=("a", "b"), r_hat=1.0, k=0.4):
    """Stand-in for a run: enough of one to be compared."""
    time = np.arange(0, 6, 1 / 32)
    trace = Trace.from_arrays(time, np.sin(2 * np.pi * time), 0.03, np.cos(2 * np.pi * time))
    posterior = Posterior(trace, load_priors("brfd"), "ou", model)
    values = posterior.draw_prior(np.random.default_rng(1), 40)
    facts = {"seed": [1, 2], "walkers": 10}
    facts["convergence"] = {name: [r_hat, 500.0, 500.0] for name in posterior.names}
    draws = SimpleNamespace(sizes={"chain": 4})
    stored = SimpleNamespace(values=lambda: values, facts=facts, draws=draws)
    results = {
        name: SimpleNamespace(
            id=name,
            posterior=posterior,
            stored=stored,
            trace=trace,
            log_evidence=lambda: Evidence(BETTER[model], 0.02, k),
        )
        for name in tests
    }
    return SimpleNamespace(tests=results, manifest=SimpleNamespace(effort=EFFORT))


@pytest.fixture
def compared(monkeypatch):
    """Function that compares stand-ins with given figures."""

    def compare(runs=None, **figures):
        runs = runs or {model: run_of(model) for model in BETTER}
        queue = [
            validation_of(name, model, **figures.get(model, {}))
            for model, run in runs.items()
            for name in run.tests
            if all(name in other.tests for other in runs.values())
        ]
        monkeypatch.setattr(comparison, "cross_validate", lambda *_: queue.pop(0))
        return compare_runs(runs)

    return compare


def test_the_best_model_is_favoured_and_stands_first(compared):
    found = compared()
    assert [row.subject for row in found.rows] == ["a"] * 3 + ["b"] * 3 + [ALL] * 3
    overall = found.rows[-3:]
    assert [row.model for row in overall] == ["three_stage", "bouc_wen", "lugre"]
    assert (overall[0].difference, overall[0].difference_se) == (0.0, 0.0)
    assert overall[1].difference == pytest.approx(-6.0 * 2 * CYCLES, abs=15.0)
    # paired over cycles, what is hard for all models does not count
    apart = np.sum(validation_of("a", "bouc_wen").elpd - validation_of("a", "three_stage").elpd)
    other = np.sum(validation_of("b", "bouc_wen").elpd - validation_of("b", "three_stage").elpd)
    assert overall[1].difference_se >= abs(apart - other)  # as far as its tests differ
    assert overall[1].difference_se < 10.0 < 50.0 < overall[1].elpd_se
    assert overall[0].cycles == 2 * CYCLES
    assert overall[0].p_loo == pytest.approx(2.0 * 2 * CYCLES)
    for row in found.rows:
        assert row.rrse > 0
    assert found.sentence.startswith("The records favour three_stage over bouc_wen: elpd higher")
    assert (
        "over 2 tests of 12 cycles in all (a rough estimate of the error, from so few)."
        in found.sentence
    )
    assert "about another cycle of the same tests, not about another test" in found.sentence
    assert found.sentence.count("The diagnostics of this comparison are good.") == 1


def test_models_that_the_records_do_not_tell_apart_are_called_so(compared):
    found = compared(**{model: {"scale": 0.0} for model in BETTER})
    assert found.sentence.startswith("The records cannot decide between ")


def test_cycles_that_psis_could_not_do_are_told(compared):
    found = compared(three_stage={"psis_k": 1.2})
    assert "k of PSIS exceeds 0.7 in 12 of 12 cycles of three_stage (worst 1.20)" in found.sentence
    assert found.sentence.count("The diagnostics of this comparison are good.") == 1
    best = found.rows[-3]
    assert (best.worst_k, best.bad, best.unsettled) == (1.2, 1.0, 0.0)


def test_a_k_that_stays_too_large_is_not_hidden(compared):
    found = compared(bouc_wen={"psis_k": 1.2, "k": 0.9})
    assert "Do not rely on this result as it is" in found.sentence
    assert "k stays above 0.7 in 12 cycles of bouc_wen" in found.sentence
    assert found.rows[-2].unsettled == 1.0
    # it does not concern the best two, so that the sentence does not mention it
    other = compared(lugre={"psis_k": 1.2, "k": 0.9})
    assert other.sentence.count("The diagnostics of this comparison are good.") == 1
    assert other.rows[-1].unsettled == 1.0


def test_sampling_that_fell_short_is_told(compared):
    runs = {model: run_of(model, r_hat=1.2 if model == "bouc_wen" else 1.0) for model in BETTER}
    assert "the sampling of bouc_wen fell short in a, b" in compared(runs).sentence


def test_evidence_is_summed_over_tests_and_not_trusted_where_its_weights_are_bad(compared):
    found = compared()
    assert found.rows[-3].log_evidence == 2 * BETTER["three_stage"]
    assert found.rows[-3].log_evidence_se == pytest.approx(0.02 * np.sqrt(2))
    assert "Log evidence of three_stage is higher than that of bouc_wen by 12 ± 0.04" in (
        found.sentence
    )
    assert "depends on the priors" in found.sentence
    assert "Do not trust" not in found.sentence
    bad = compared({model: run_of(model, k=1.2 if model == "lugre" else 0.4) for model in BETTER})
    assert "Do not trust the log evidence of lugre" in bad.sentence
    assert [row.evidence_trusted for row in bad.rows[-3:]] == [True, True, False]


def test_tests_that_one_model_lacks_are_left_out_and_named(compared):
    runs = {model: run_of(model, ("a",) if model == "lugre" else ("a", "b")) for model in BETTER}
    found = compared(runs)
    assert {row.subject for row in found.rows} == {"a", ALL}
    assert "6 cycles of 1 test (a rough estimate of the error, from so few)" in found.sentence
    assert found.sentence.endswith("not every model could be calibrated: b.")


def test_runs_without_a_test_in_common_are_refused(compared):
    runs = {"lugre": run_of("lugre", ("a",)), "bouc_wen": run_of("bouc_wen", ("b",))}
    with pytest.raises(FitError, match="nothing to compare"):
        compared(runs)


def test_the_table_has_a_line_for_each_test_and_model(compared):
    text = comparison_csv(compared().rows)
    head, *lines = text.splitlines()
    assert head.split(",")[:6] == ["test", "model", "cycles", "elpd", "elpd_se", "p_loo"]
    assert len(lines) == 9
    assert all(len(line.split(",")) == len(head.split(",")) for line in lines)


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_the_command_compares_and_samples_nothing_twice(tmp_path):
    # Bouc-Wen's force with white noise, which LuGre cannot follow in its spring behind the knee
    time = np.arange(0, 4, 1 / 40)
    motion = np.sin(2 * np.pi * time)
    trace = Trace.from_arrays(time, motion, 0.03, np.zeros(time.size))
    theta = np.array([[40.0, 0.02, 2.0, 1.7, 0.7, 2.0, 0.01]])
    force = BoucWen().force(theta, trace)[0] + np.random.default_rng(2).normal(0, 0.05, time.size)
    table = np.column_stack([time, motion, force])
    head = "time_s,displacement_in,force_kip"
    np.savetxt(tmp_path / "slow.csv", table, delimiter=",", header=head, comments="")
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    out = tmp_path / "out"
    arguments = ["compare", tmp_path / "campaign.toml", "-o", out, "--effort", "quick"]
    arguments += ["--models", "lugre, bouc_wen", "--jobs", "2"]
    outcome = CliRunner().invoke(app, [str(a) for a in arguments])
    assert outcome.exit_code == 0, outcome.output
    assert "The records favour bouc_wen over lugre" in outcome.stdout
    found = pd.read_csv(out / "comparison.csv").set_index(["test", "model"])
    assert list(found.index) == [(s, m) for s in ("slow", ALL) for m in ("bouc_wen", "lugre")]
    assert found.elpd_difference["slow", "lugre"] < -20
    assert found.rrse_in_sample["slow", "bouc_wen"] < 0.05
    assert found.log_evidence["slow", "lugre"] < found.log_evidence["slow", "bouc_wen"] - 20
    assert found.log_evidence_se.max() < 0.1
    stored = mb.open_run(out / "lugre").tests["slow"].log_evidence()
    assert stored.value == pytest.approx(found.log_evidence["slow", "lugre"])
    assert "Log evidence of bouc_wen is higher than that of lugre" in outcome.stdout
    laws = json.loads((out / "bouc_wen" / "manifest.json").read_text())["settings"]["laws"]
    assert (laws["Fy_fwd"], laws["Fy_bwd"]) == ("power", "proportional")  # as F_c's
    assert (out / "lugre" / "report.html").is_file()

    files = [*out.glob("*/tests/slow/posterior.nc"), out / "comparison.csv"]
    before = {path: path.read_bytes() for path in files}
    made = {path: path.stat().st_mtime_ns for path in files[:-1]}
    assert len(made) == 2
    outcome = CliRunner().invoke(app, [str(a) for a in (*arguments, "--resume")])
    assert outcome.exit_code == 0, outcome.output
    assert {path: path.read_bytes() for path in files} == before
    assert {path: path.stat().st_mtime_ns for path in files[:-1]} == made


@pytest.mark.parametrize(
    ("models", "noises", "expected"),
    [
        (["lugre", "three_stage"], [], [("three_stage",) * 2, ("lugre",) * 2]),
        ([], ["staged", "ou"], [("ou", None), ("staged", None)]),
        (["lugre"], ["iid", "ou"], [("ou", "lugre"), ("iid", "lugre")]),
        (
            ["lugre", "three_stage"],
            ["staged"],
            [("three_stage_staged", "three_stage"), ("lugre_staged", "lugre")],
        ),
    ],
)
def test_candidates_are_every_model_with_every_noise(models, noises, expected):
    found = candidates(models, noises)
    assert [(one.name, one.model) for one in found] == expected
    assert {one.noise for one in found} == (set(noises) or {None})


@pytest.mark.parametrize(
    ("models", "noises", "words"),
    [
        ([], ["ou", "white"], "--noises must name noises of ou, iid"),
        ([], ["ou", "ou"], "each once"),
        ([], ["ou"], "--noises must name two or more of ou, iid.* got 'ou' alone"),
        (["lugre"], ["ou"], "--noises must name two or more"),
        (["lugree"], ["ou", "iid"], "--models must name models of three_stage"),
        (["lugre", "lugre+travel"], [], "--models must name two or more"),
        (["lugre"], [], "--models must name two or more"),
    ],
)
def test_what_cannot_be_compared_is_refused(models, noises, words):
    with pytest.raises(CampaignError, match=words):
        candidates(models, noises)
