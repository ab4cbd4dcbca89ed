"""Which model is favoured, by how much, and the warnings where that cannot be trusted."""

import json
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import mfd_bayes as mb
from mfd_bayes.applications.comparison.models import (
    ALL,
    LARGEST_K,
    Validation,
    candidates,
    compare_runs,
    comparison_of,
    log_evidence,
    psis_loo,
    standard_error,
)
from mfd_bayes.calibration.diagnostics import psis
from mfd_bayes.calibration.proposal import Evidence
from mfd_bayes.errors import CampaignError, FitError
from mfd_bayes.friction.bouc_wen import BoucWen
from mfd_bayes.reporting.tables import comparison_csv
from tests.command_line import said, write_csv

CYCLES = 6
RNG = np.random.default_rng(0)
HARD = {name: RNG.normal(100, 30, CYCLES) for name in ("a", "b")}
BETTER = {"lugre": 0.0, "bouc_wen": 4.0, "three_stage": 10.0}
CAMPAIGN = """\
[campaign]
priors = "brfd"
rate = "40 Hz"

[laws]
Fc_fwd = "power"
Fs_fwd = "power"

[[test]]
id = "slow"
file = "slow.csv"
actuation = "30 lbf"
"""


def validation(name, model, *, psis_k=0.3, k=0.3, scale=1.0, short=False, evidence_k=0.4):
    ripple = np.random.default_rng([len(model), ord(name)]).normal(0, 1, CYCLES)
    elpd = HARD[name] + scale * BETTER[model] + ripple
    cycles = {"test": name, "elpd": elpd, "lppd": elpd + 2.0, "psis_k": psis_k, "k": k}
    evidence = Evidence(BETTER[model], 0.02, evidence_k)
    return Validation(pd.DataFrame(cycles), 1.0, 4.0, (name,) * short, evidence)


def compared(tests="ab", lost=(), **figures):
    scores = {
        model: {name: validation(name, model, **figures.get(model, {})) for name in tests}
        for model in BETTER
    }
    return comparison_of(scores, lost)


def test_the_best_model_is_favoured_and_stands_first():
    comparison = compared()
    assert [row.subject for row in comparison.rows] == ["a"] * 3 + ["b"] * 3 + [ALL] * 3
    best, second, third = comparison.rows[-3:]
    assert [best.model, second.model, third.model] == ["three_stage", "bouc_wen", "lugre"]
    assert (best.difference, best.difference_se) == (0.0, 0.0)
    assert second.difference == pytest.approx(-6.0 * 2 * CYCLES, abs=15.0)
    # paired over cycles, what is hard for all models does not count
    assert second.difference_se < 10.0 < 50.0 < second.elpd_se
    assert (best.cycles, best.rrse) == (2 * CYCLES, 0.5)
    assert best.p_loo == pytest.approx(2.0 * 2 * CYCLES)
    assert (best.log_evidence, best.log_evidence_se) == (20.0, pytest.approx(0.02 * np.sqrt(2)))
    lines = comparison_csv(comparison.rows).splitlines()
    assert lines[0].split(",")[:6] == ["test", "model", "cycles", "elpd", "elpd_se", "p_loo"]
    assert len(lines) == 1 + len(comparison.rows)


GOOD, ROUGH = "The diagnostics of this comparison are good.", "(a rough estimate of the error"


FAVOURED = (
    "The records favour three_stage over bouc_wen: elpd higher",
    f"over 2 tests of 12 cycles in all {ROUGH}, from so few).",
    "about another cycle of the same tests, not about another test",
    "Log evidence of three_stage is higher than that of bouc_wen by 12 ± 0.04",
)


@pytest.mark.parametrize(
    ("figures", "words"),
    [
        ({}, FAVOURED),
        ({m: {"scale": 0.0} for m in BETTER}, ("The records cannot decide between ",)),
        ({"three_stage": {"psis_k": 1.2}}, ("12 of 12 cycles of three_stage (worst 1.20)", GOOD)),
        ({"bouc_wen": {"psis_k": 1.2, "k": 0.9}}, ("Do not rely on this result as it is",)),
        ({"lugre": {"psis_k": 1.2, "k": 0.9}}, (GOOD,)),  # which is neither best nor second
        ({"bouc_wen": {"short": True}}, ("the sampling of bouc_wen fell short in a, b",)),
        ({"lugre": {"evidence_k": 1.2}}, ("Do not trust the log evidence of lugre",)),
        ({"tests": "a", "lost": ["b"]}, ("not every model could be calibrated: b.",)),
    ],
)
def test_the_comparison_says_what_it_rests_on(figures, words):
    sentence = compared(**figures).sentence
    assert all(text in sentence for text in words)
    assert "Do not" not in compared().sentence


def test_cycles_without_a_trusted_score_are_counted():
    bad = compared(bouc_wen={"psis_k": 1.2, "k": 0.9}, lugre={"psis_k": 1.2, "evidence_k": 1.2})
    figures = [(row.bad, row.unsettled, row.evidence_trusted) for row in bad.rows[-3:]]
    assert figures == [(0.0, 0.0, True), (1.0, 1.0, True), (1.0, 0.0, False)]
    with pytest.raises(FitError, match="nothing to compare"):
        compare_runs({m: SimpleNamespace(tests={m: None}) for m in BETTER})


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_the_command_compares_and_samples_nothing_twice(tmp_path):
    # Bouc-Wen's force with white noise, which LuGre cannot follow in its spring behind the knee
    time = np.arange(0, 4, 1 / 40)
    trace = mb.Trace.from_arrays(time, np.sin(2 * np.pi * time), 0.03)
    force = BoucWen().force(np.array([[40.0, 0.02, 2.0, 1.7, 0.7, 2.0, 0.01]]), trace)[0]
    noisy = force + 0.05 * np.random.default_rng(2).normal(size=time.size)
    write_csv(tmp_path / "slow.csv", time, trace.displacement, noisy)
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    folder = tmp_path / "out"
    words = ["compare", tmp_path / "campaign.toml", "-o", folder, "--effort", "quick"]
    words += ["--models", "lugre, bouc_wen", "--jobs", "2"]
    printed = said(*words)
    assert "The records favour bouc_wen over lugre" in printed
    scores = pd.read_csv(folder / "comparison.csv").set_index(["test", "model"])
    assert list(scores.index) == [(s, m) for s in ("slow", ALL) for m in ("bouc_wen", "lugre")]
    assert scores.elpd_difference["slow", "lugre"] < -20
    assert scores.rrse_in_sample["slow", "bouc_wen"] < 0.05
    assert scores.log_evidence["slow", "lugre"] < scores.log_evidence["slow", "bouc_wen"] - 20
    sheet = pd.read_csv(folder / "datasheet_models.csv", comment="#")
    assert set(sheet.model) == {"lugre", "bouc_wen", "mixture"}
    slip = sheet[sheet.quantity == "slip_force"].set_index(["direction", "model"])
    own = pd.read_csv(folder / "lugre" / "datasheet.csv", comment="#")
    own = own[(own.quantity == "slip_force") & (own.direction == "forward")].iloc[0]
    for key in ("nominal", "lower", "upper"):
        assert slip[key]["forward", "lugre"] == pytest.approx(own[key], rel=1e-4)
    assert "Every model has the same weight" in " ".join(printed.split())
    assert "depend on the model?" in (folder / "lugre" / "report.html").read_text()
    stored = mb.open_run(folder / "lugre").tests["slow"].log_evidence()
    assert stored.value == pytest.approx(scores.log_evidence["slow", "lugre"])
    laws = json.loads((folder / "bouc_wen" / "manifest.json").read_text())["settings"]["laws"]
    assert (laws["Fy_fwd"], laws["Fy_bwd"]) == ("power", "proportional")  # as F_c's
    assert (folder / "lugre" / "report.html").is_file()
    estimates = json.loads((folder / "lugre" / "manifest.json").read_text())["comparison"]
    estimates = {(e["model"], e["name"]): e["median"] for e in estimates["estimates"]}
    assert {model for model, _ in estimates} == {"lugre", "bouc_wen"}
    draws = mb.open_run(folder / "lugre").tests["slow"].draws
    assert estimates["lugre", "Fc_fwd"] == pytest.approx(float(draws["Fc_fwd"].median()))
    mtimes = {p: p.stat().st_mtime_ns for p in folder.glob("*/tests/slow/posterior.nc")}
    table = (folder / "comparison.csv").read_bytes()
    said(*words, "--resume")
    assert {path: path.stat().st_mtime_ns for path in mtimes} == mtimes
    assert (folder / "comparison.csv").read_bytes() == table


def test_models_and_noises_make_candidates_or_are_refused():
    choices = candidates(["lugre", "three_stage"], ["staged"])
    assert [candidate.name for candidate in choices] == ["three_stage_staged", "lugre_staged"]
    assert [candidate.name for candidate in candidates([], ["staged", "ou"])] == ["ou", "staged"]
    assert {candidate.noise for candidate in candidates(["lugre", "three_stage"], [])} == {None}
    for models, noises, offender in (
        ([], ["ou", "white"], "--noises must name .* got 'ou', 'white'"),
        ([], ["ou", "ou"], "--noises .* each once"),
        (["lugre"], ["ou"], "--noises must name two or more"),
        (["lugree"], ["ou", "iid"], "--models must name .* got 'lugree'"),
        (["lugre"], [], "--models must name two or more"),
    ):
        with pytest.raises(CampaignError, match=offender):
            candidates(models, noises)


# --- leave-one-cycle-out where the truth is known


def test_psis_weights_are_normalised_and_k_is_the_tail_of_the_weights():
    ratios = np.random.default_rng(0).normal(5.0, 0.3, 4000)
    log_weights, k = psis(ratios, 0.8)
    assert np.exp(log_weights).sum() == pytest.approx(1.0)
    assert k < 0.3
    small = ratios < np.quantile(ratios, 0.9)  # the largest weights are smoothed, these are not
    assert np.ptp((log_weights - ratios)[small]) < 1e-9
    for tail in (0.5, 1.0):  # the control: weights whose variance, or mean, is infinite
        weights = np.random.default_rng(1).pareto(1 / tail, 20000) + 1.0
        k = psis(np.log(weights))[1]
        assert k == pytest.approx(tail, abs=0.12)
        assert (k > LARGEST_K) == (tail > LARGEST_K)


@pytest.mark.parametrize(
    "ratios",
    [
        np.append(np.zeros(500), np.full(500, -50.0)),  # all values of the tail are the same
        np.append(0.0, np.full(999, -1e4)),  # one draw has all of the weight
        np.append(0.0, np.full(999, -np.inf)),
    ],
)
def test_weights_without_a_tail_to_fit_are_as_they_were_and_not_trusted(ratios):
    log_weights, k = psis(ratios)
    assert k == np.inf
    np.testing.assert_allclose(np.exp(log_weights), np.exp(ratios) / np.exp(ratios).sum())


def normal_mean(blocks, n=4000, seed=0):
    """Draws of a mean with prior N(0, 10²), the blocks' log densities, and their exact elpd."""
    rng = np.random.default_rng(seed)
    pooled = np.concatenate(blocks)

    def posterior(data):
        precision = 0.01 + data.size
        return data.sum() / precision, precision**-0.5

    mean, sd = posterior(pooled)
    draws = rng.normal(mean, sd, n)
    terms = np.stack([stats.norm.logpdf(b[:, None], draws).sum(axis=0) for b in blocks], axis=1)
    exact = []
    for i, block in enumerate(blocks):
        mean, sd = posterior(np.concatenate([b for j, b in enumerate(blocks) if j != i]))
        cov = np.eye(block.size) + sd**2
        exact.append(stats.multivariate_normal(np.full(block.size, mean), cov).logpdf(block))
    return draws, terms, np.array(exact)


def test_elpd_is_exact_where_every_block_tells_little():
    rng = np.random.default_rng(2)
    _, log_densities, exact = normal_mean([rng.normal(size=5) for _ in range(12)])
    estimates = np.array([psis_loo(column) for column in log_densities.T])
    np.testing.assert_allclose(estimates[:, 0], exact, atol=0.02)
    assert np.all(estimates[:, 1] > estimates[:, 0])
    assert np.all(estimates[:, 2] < LARGEST_K)


def test_a_block_that_moves_the_posterior_far_has_a_large_k():
    rng = np.random.default_rng(3)
    blocks = [rng.normal(size=5), rng.normal(size=5), rng.normal(6.0, 1.0, size=20)]
    draws, terms, exact = normal_mean(blocks)
    elpd, _, k = psis_loo(terms[:, 2])
    assert k > LARGEST_K
    assert elpd > exact[2] + 3.0  # and PSIS is far too good to be true

    # from both evidences it is right, and says so
    def density(data):
        return lambda q: (
            stats.norm.logpdf(q[:, 0], 0, 10) + stats.norm.logpdf(data[:, None], q[:, 0]).sum(0)
        )

    start, flat, estimates = draws[:, None], np.zeros(draws.size), []
    for _ in range(8):  # each by itself has an error of about 0.06
        complete, first_k = log_evidence(density(np.concatenate(blocks)), start, flat, rng)
        reduced, second_k = log_evidence(
            density(np.concatenate(blocks[:2])), start, -terms[:, 2], rng
        )
        assert max(first_k, second_k) < LARGEST_K
        estimates.append(complete - reduced)
    assert np.mean(estimates) == pytest.approx(exact[2], abs=0.05)


def test_the_error_of_a_sum_is_that_of_tests_whose_cycles_resemble_each_other():
    rng = np.random.default_rng(6)
    test = np.repeat(np.arange(12), 30)
    ungrouped = np.zeros(test.size)
    totals, errors, wrong = [], [], []
    for _ in range(400):  # a model is better or worse in a whole test at once
        figures = rng.normal(0.0, 1.0, 12)[test] + rng.normal(0.0, 1.0, test.size)
        totals.append(figures.sum())
        errors.append(standard_error(figures, test))
        wrong.append(standard_error(figures, ungrouped))
    assert np.mean(errors) == pytest.approx(np.std(totals), rel=0.1)
    assert np.std(totals) > 3.0 * np.mean(wrong)  # the control
    figures = rng.normal(size=test.size)  # independent cycles
    assert 1.0 <= standard_error(figures, test) / standard_error(figures, ungrouped) < 1.5
    balanced = np.tile([1.0, -1.0], test.size // 2)  # whose tests agree by chance
    assert standard_error(balanced, test) == standard_error(balanced, ungrouped)
