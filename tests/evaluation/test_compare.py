"""Which model is favoured, by how much, and the warnings where that cannot be trusted."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import mfd_bayes as mb
from mfd_bayes.calibration.diagnostics import Effort, psis
from mfd_bayes.calibration.posterior import Posterior, load_priors
from mfd_bayes.calibration.proposal import Evidence
from mfd_bayes.calibration.sampling import sample
from mfd_bayes.errors import CampaignError, FitError
from mfd_bayes.evaluation.crossvalidate import (
    ALL,
    LARGEST_K,
    Validation,
    candidates,
    compare_runs,
    comparison_of,
    cross_validate,
    difference,
    log_evidence,
    psis_loo,
    standard_error,
)
from mfd_bayes.records.trace import Trace
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


def validation(name, model, *, psis_k=0.3, k=0.3, scale=1.0, short=False, evidence_k=0.4):
    ripple = np.random.default_rng([len(model), ord(name)]).normal(0, 1, CYCLES)
    elpd = HARD[name] + scale * BETTER[model] + ripple
    cycles = {"test": name, "elpd": elpd, "lppd": elpd + 2.0, "psis_k": psis_k, "k": k}
    evidence = Evidence(BETTER[model], 0.02, evidence_k)
    return Validation(pd.DataFrame(cycles), 1.0, 4.0, (name,) * short, evidence)


def compared(tests="ab", lost=(), **figures):
    """Comparison of three models on given tests, with changed figures of some models."""
    scores = {
        model: {name: validation(name, model, **figures.get(model, {})) for name in tests}
        for model in BETTER
    }
    return comparison_of(scores, lost)


def test_the_best_model_is_favoured_and_stands_first():
    found = compared()
    assert [row.subject for row in found.rows] == ["a"] * 3 + ["b"] * 3 + [ALL] * 3
    best, second, third = found.rows[-3:]
    assert [best.model, second.model, third.model] == ["three_stage", "bouc_wen", "lugre"]
    assert (best.difference, best.difference_se) == (0.0, 0.0)
    assert second.difference == pytest.approx(-6.0 * 2 * CYCLES, abs=15.0)
    # paired over cycles, what is hard for all models does not count
    assert second.difference_se < 10.0 < 50.0 < second.elpd_se
    assert (best.cycles, best.rrse) == (2 * CYCLES, 0.5)
    assert best.p_loo == pytest.approx(2.0 * 2 * CYCLES)
    assert (best.log_evidence, best.log_evidence_se) == (20.0, pytest.approx(0.02 * np.sqrt(2)))
    lines = comparison_csv(found.rows).splitlines()
    assert lines[0].split(",")[:6] == ["test", "model", "cycles", "elpd", "elpd_se", "p_loo"]
    assert len(lines) == 1 + len(found.rows)


GOOD, ROUGH = "The diagnostics of this comparison are good.", "(a rough estimate of the error"


@pytest.mark.parametrize(
    ("figures", "words"),
    [
        (
            {},
            (
                "The records favour three_stage over bouc_wen: elpd higher",
                f"over 2 tests of 12 cycles in all {ROUGH}, from so few).",
                "about another cycle of the same tests, not about another test",
                "Log evidence of three_stage is higher than that of bouc_wen by 12 ± 0.04",
            ),
        ),
        ({m: {"scale": 0.0} for m in BETTER}, ("The records cannot decide between ",)),
        ({"three_stage": {"psis_k": 1.2}}, ("12 of 12 cycles of three_stage (worst 1.20)", GOOD)),
        ({"bouc_wen": {"psis_k": 1.2, "k": 0.9}}, ("Do not rely on this result as it is",)),
        ({"bouc_wen": {"k": 0.9}}, ("k stays above 0.7 in 12 cycles of bouc_wen",)),
        ({"lugre": {"psis_k": 1.2, "k": 0.9}}, (GOOD,)),  # which is neither best nor second
        ({"bouc_wen": {"short": True}}, ("the sampling of bouc_wen fell short in a, b",)),
        ({"lugre": {"evidence_k": 1.2}}, ("Do not trust the log evidence of lugre",)),
        ({"tests": "a"}, (f"6 cycles of 1 test {ROUGH}, from so few)",)),
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


def test_runs_without_a_test_in_common_are_refused():
    class Nothing:
        def __init__(self, *tests):
            self.tests = dict.fromkeys(tests)

    with pytest.raises(FitError, match="nothing to compare"):
        compare_runs({"lugre": Nothing("a"), "bouc_wen": Nothing("b")})


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_the_command_compares_and_samples_nothing_twice(tmp_path):
    # Bouc-Wen's force with white noise, which LuGre cannot follow in its spring behind the knee
    trace = record_of("bouc_wen", "iid", seed=2)
    write_csv(tmp_path / "slow.csv", trace.time, trace.displacement, trace.force)
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    out = tmp_path / "out"
    words = ["compare", tmp_path / "campaign.toml", "-o", out, "--effort", "quick"]
    words += ["--models", "lugre, bouc_wen", "--jobs", "2"]
    printed = said(*words)
    assert "The records favour bouc_wen over lugre" in printed
    found = pd.read_csv(out / "comparison.csv").set_index(["test", "model"])
    assert list(found.index) == [(s, m) for s in ("slow", ALL) for m in ("bouc_wen", "lugre")]
    assert found.elpd_difference["slow", "lugre"] < -20
    assert found.rrse_in_sample["slow", "bouc_wen"] < 0.05
    assert found.log_evidence["slow", "lugre"] < found.log_evidence["slow", "bouc_wen"] - 20
    assert found.log_evidence_se.max() < 0.1
    stored = mb.open_run(out / "lugre").tests["slow"].log_evidence()
    assert stored.value == pytest.approx(found.log_evidence["slow", "lugre"])
    assert "Log evidence of bouc_wen is higher than that of lugre" in printed
    laws = json.loads((out / "bouc_wen" / "manifest.json").read_text())["settings"]["laws"]
    assert (laws["Fy_fwd"], laws["Fy_bwd"]) == ("power", "proportional")  # as F_c's
    assert (out / "lugre" / "report.html").is_file()

    files = [*out.glob("*/tests/slow/posterior.nc"), out / "comparison.csv"]
    before = {path: path.read_bytes() for path in files}
    made = {path: path.stat().st_mtime_ns for path in files[:-1]}
    assert len(made) == 2
    said(*words, "--resume")
    assert {path: path.read_bytes() for path in files} == before
    assert {path: path.stat().st_mtime_ns for path in files[:-1]} == made


def test_candidates_are_every_model_with_every_noise():
    for models, noises, expected in (
        (["lugre", "three_stage"], [], ["three_stage", "lugre"]),
        ([], ["staged", "ou"], ["ou", "staged"]),
        (["lugre"], ["iid", "ou"], ["ou", "iid"]),
        (["lugre", "three_stage"], ["staged"], ["three_stage_staged", "lugre_staged"]),
    ):
        found = candidates(models, noises)
        assert [candidate.name for candidate in found] == expected
        assert {candidate.model for candidate in found} == (set(models) or {None})
        assert {candidate.noise for candidate in found} == (set(noises) or {None})


def test_what_cannot_be_compared_is_refused():
    for models, noises, offender in (
        ([], ["ou", "white"], "--noises must name .* got 'ou', 'white'"),
        ([], ["ou", "ou"], "--noises .* each once"),
        ([], ["ou"], "--noises must name two or more"),
        (["lugre"], ["ou"], "--noises must name two or more"),
        (["lugree"], ["ou", "iid"], "--models must name .* got 'lugree'"),
        (["lugre"], [], "--models must name two or more"),
    ):
        with pytest.raises(CampaignError, match=offender):
            candidates(models, noises)


# --- leave-one-cycle-out where the truth is known

FILE = load_priors("brfd")
SHORT = Effort(ess=60, limit=400, r_hat=1.1, length=2.0, ensembles=2, walkers=32, kept=800)
THETA = {
    "bouc_wen": np.array([[40.0, 0.02, 2.0, 1.7, 0.7, 2.0, 0.01]]),
    "lugre": np.array([[60.0, 0.02, 0.01, 2.2, 2.0, 1.9, 1.7, 0.5]]),
}


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


def normal_mean(blocks, n=4000, seed=0):
    """Draws of a mean with prior N(0, 10²), the blocks' log densities, and their exact elpd."""
    rng = np.random.default_rng(seed)
    every = np.concatenate(blocks)

    def posterior(data):
        precision = 0.01 + data.size
        return data.sum() / precision, precision**-0.5

    mean, sd = posterior(every)
    draws = rng.normal(mean, sd, n)
    given = np.stack([stats.norm.logpdf(b[:, None], draws).sum(axis=0) for b in blocks], axis=1)
    exact = []
    for i, block in enumerate(blocks):
        mean, sd = posterior(np.concatenate([b for j, b in enumerate(blocks) if j != i]))
        cov = np.eye(block.size) + sd**2
        exact.append(stats.multivariate_normal(np.full(block.size, mean), cov).logpdf(block))
    return draws, given, np.array(exact)


def test_elpd_is_exact_where_every_block_tells_little():
    rng = np.random.default_rng(2)
    _, given, exact = normal_mean([rng.normal(size=5) for _ in range(12)])
    found = np.array([psis_loo(column) for column in given.T])
    np.testing.assert_allclose(found[:, 0], exact, atol=0.02)
    assert np.all(found[:, 1] > found[:, 0])
    assert np.all(found[:, 2] < LARGEST_K)


def test_a_block_that_moves_the_posterior_far_has_a_large_k():
    rng = np.random.default_rng(3)
    blocks = [rng.normal(size=5), rng.normal(size=5), rng.normal(6.0, 1.0, size=20)]
    draws, given, exact = normal_mean(blocks)
    elpd, _, k = psis_loo(given[:, 2])
    assert k > LARGEST_K
    assert elpd > exact[2] + 3.0  # and PSIS is far too good to be true

    # from both evidences it is right, and says so
    def density(data):
        return lambda q: (
            stats.norm.logpdf(q[:, 0], 0, 10) + stats.norm.logpdf(data[:, None], q[:, 0]).sum(0)
        )

    start, flat, found = draws[:, None], np.zeros(draws.size), []
    for _ in range(8):  # each by itself has an error of about 0.06
        whole, first_k = log_evidence(density(np.concatenate(blocks)), start, flat, rng)
        rest, second_k = log_evidence(density(np.concatenate(blocks[:2])), start, -given[:, 2], rng)
        assert max(first_k, second_k) < LARGEST_K
        found.append(whole - rest)
    assert np.mean(found) == pytest.approx(exact[2], abs=0.05)


def test_the_error_of_a_sum_is_that_of_tests_whose_cycles_resemble_each_other():
    rng = np.random.default_rng(6)
    test = np.repeat(np.arange(12), 30)
    alone = np.zeros(test.size)
    totals, errors, wrong = [], [], []
    for _ in range(400):  # a model is better or worse in a whole test at once
        figures = rng.normal(0.0, 1.0, 12)[test] + rng.normal(0.0, 1.0, test.size)
        totals.append(figures.sum())
        errors.append(standard_error(figures, test))
        wrong.append(standard_error(figures, alone))
    assert np.mean(errors) == pytest.approx(np.std(totals), rel=0.1)
    assert np.std(totals) > 3.0 * np.mean(wrong)  # the control
    figures = rng.normal(size=test.size)  # independent cycles
    assert 1.0 <= standard_error(figures, test) / standard_error(figures, alone) < 1.5
    balanced = np.tile([1.0, -1.0], test.size // 2)  # whose tests agree by chance
    assert standard_error(balanced, test) == standard_error(balanced, alone)


def record_of(model, noise="ou", seed=5):
    """Four cycles of a model's force with some noise."""
    time = np.arange(0, 4, 1 / 40)
    motion = np.sin(2 * np.pi * time)
    trace = Trace.from_arrays(time, motion, 0.03, np.zeros(time.size))
    posterior = Posterior(trace, FILE, noise, model)
    force = posterior.model.force(THETA[model], trace)[0]
    values = {"noise_sd": np.array([0.05]), "noise_time": np.array([0.03])}
    noise = posterior.noise.draw(np.random.default_rng(seed), time, values)[0]
    return Trace.from_arrays(time, motion, 0.03, force + noise)


@pytest.mark.slow
def test_the_model_that_a_record_is_from_predicts_its_cycles_best():
    found, trace = {}, record_of("lugre")  # the command above has a record of Bouc-Wen
    for model in ("lugre", "bouc_wen"):
        posterior = Posterior(trace, FILE, "ou", model)
        draws = sample(posterior, SHORT, 1)
        values = {name: column.reshape(-1) for name, column in draws.values.items()}
        how = len(draws.q), draws.chains.walkers, np.random.default_rng(0)
        found[model] = cross_validate(posterior, values, *how)
        assert np.all(found[model]["k"] <= LARGEST_K)
        assert np.all(found[model]["lppd"] >= found[model]["elpd"])
    apart, error = difference(found["lugre"].assign(test="a"), found["bouc_wen"])
    assert apart > 2 * error
    assert apart > 5.0
