"""Rehearsals: truths among the draws of calibrations of their own records."""

import json
import shutil
from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd
import pytest

import mfd_bayes as mb
from mfd_bayes.applications.rehearsal import rehearsal as rehearsals
from mfd_bayes.applications.rehearsal.rehearsal import (
    ALONE,
    ANOTHER_TEST,
    LEVELS,
    MEAN,
    POOLED,
    SCATTERS,
    Position,
    Rehearsal,
    StoredRehearsal,
    recalibrate,
    simulate,
)
from mfd_bayes.applications.rehearsal.summary import NOT_TESTED, RehearsalSummary
from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.priors import Prior
from mfd_bayes.calibration.sampling import sample
from mfd_bayes.population.peaks import PeakExcess
from mfd_bayes.runs.folder import POPULATION, REHEARSED, remove_stale
from mfd_bayes.runs.run import sequence_of
from tests.command_line import contents, refusal, said
from tests.pipeline.test_interruption import Process

RUNS = 40


def results_of(ranks, of=ANOTHER_TEST, quantity="slip force forward"):
    """Stored results with the same ranks (runs, n) at n conditions."""
    return [
        StoredRehearsal(
            key={},
            error="",
            positions=tuple(
                Position(of=of, quantity=quantity, condition=f"at {k}", pit=rank, rank=rank)
                for k, rank in enumerate(row)
            ),
        )
        for row in ranks
    ]


def test_even_ranks_pass_and_others_are_said_to_deviate_as_they_do():
    ranks = np.random.default_rng(1).random((RUNS, 20))
    summary = RehearsalSummary(results_of(ranks))
    assert summary.deviating.empty
    assert "Nothing speaks against the bounds" in summary.verdict
    (sentence,) = summary.sentences
    assert sentence.startswith("Bounds of slip force forward held another test in 3")
    assert "of 40 rehearsals at each of 20 conditions" in sentence
    for transform, words in (
        (lambda u: 0.5 + 0.4 * (u - 0.5), "too wide"),
        (lambda u: np.where(u < 0.5, 0.2 * u, 0.8 + 0.2 * u), "too narrow"),
        (lambda u: u**0.4, "the truth lies mostly above the middle"),
        (lambda u: u**2.5, "the truth lies mostly below the middle"),
    ):
        summary = RehearsalSummary(results_of(transform(ranks)))
        assert len(summary.deviating) > 10, words
        assert words in summary.sentences[0]
        assert "bounds of the data sheet are not right" in summary.verdict


def test_what_deviates_of_the_parameters_is_named_with_its_fault():
    even = (np.arange(RUNS) + 0.5) / RUNS
    narrow = np.where(even < 0.5, 0.2 * even, 0.8 + 0.2 * even)
    results = results_of(np.column_stack([narrow, even]), of=ALONE, quantity="Fc_fwd")
    assert RehearsalSummary([*results, *results_of(even[:, None])]).parameters == [
        "Of tests, each by itself, 2 quantities: Fc_fwd too narrow in 1 test."
    ]


def test_a_small_p_value_among_many_quantities_is_chance_and_alone_it_is_not():
    even = (np.arange(RUNS) + 0.5) / RUNS
    uneven = even**1.8
    alone = RehearsalSummary(results_of(uneven[:, None]))
    among = RehearsalSummary(results_of(np.column_stack([uneven, *[even] * 200])))
    assert alone.table["p_value"].min() == among.table["p_value"].min()
    assert len(alone.deviating) == 1
    assert among.deviating.empty


def test_ranks_of_normal_posteriors_are_as_far_from_even_as_their_prior_counts():
    # the formula of rehearsal.py, and that both records together would have no such fault
    rng, n = np.random.default_rng(3), 200_000
    for share, distance in ((0.01, 2.0), (0.2, -1.0), (0.5, 1.5)):
        precision = 1.0 / share - 1.0  # of the record; the prior is N(0, 1)
        truth = distance + np.sqrt(share) * rng.standard_normal(n)
        record = truth + rng.standard_normal(n) / np.sqrt(precision)
        score = (truth - (1.0 - share) * record) / np.sqrt(share)
        spread = 1.0 - share + share**2
        assert abs(score.mean() - np.sqrt(share) * distance) < 4.0 * np.sqrt(spread / n)
        assert abs(score.var() - spread) < 4.0 * spread * np.sqrt(2.0 / n)
        both = 1.0 / (1.0 / share + precision)
        measured = distance / (1.0 - share)  # the first record, whose posterior the truth is from
        score = (truth - both * precision * (measured + record)) / np.sqrt(both)
        assert abs(score.mean()) < 4.0 / np.sqrt(n)
        assert abs(score.var() - 1.0) < 4.0 * np.sqrt(2.0 / n)


def test_a_drawn_excess_of_peaks_predicts_what_the_posterior_does():
    rng, speed = np.random.default_rng(2), 2.0
    excess = PeakExcess(rate=0.3, rate_variance=0.2, scatter=0.1, tests=8.0)
    several = [excess.draw(rng) for _ in range(20_000)]
    values = [e.rate * speed + e.scatter * rng.standard_normal() for e in several]
    freedom = 3.0 + 8.0 - 1.0
    variance = float(excess.scale(speed)) ** 2 * freedom / (freedom - 2.0)
    assert np.mean(values) == pytest.approx(0.6, abs=4.0 * np.sqrt(variance / 20_000))
    assert np.var(values) == pytest.approx(variance, rel=4.0 * np.sqrt(3.0 / 20_000))


def test_the_truth_is_one_joint_draw_and_its_records_follow_it(run):
    truth = simulate(run, np.random.default_rng(5))
    population, pooled = run.population, sequence_of(run).pooled
    (name, trace), *_ = truth.traces.items()
    (pick,) = np.flatnonzero(pooled(name)["Fc_fwd"] == truth.tests[name]["Fc_fwd"].item())
    single = truth.run.population
    assert single.size == 1
    flat = population.draws.z.reshape(population.size, -1)
    assert np.array_equal(single.draws.z[0, 0], flat[pick])
    names = list(truth.traces)
    for test, following in zip(names, names[1:] + names[:1], strict=True):
        record, posterior = truth.traces[test], run.tests[test].posterior
        assert np.array_equal(record.displacement, posterior.trace.displacement)
        stored = run.tests[test].stored.values()
        medians = {k: np.full(1, np.median(v)) for k, v in stored.items()}
        sizes = []
        for source in (test, following):  # the control: parameters of another test
            values = medians | {k: v[[pick]] for k, v in pooled(source).items()}
            force = posterior.force(values)[0] + values["offset"]
            sizes.append(np.std(np.asarray(record.force) - force))
        discrepancy = np.abs(single.residual.mean).max()
        assert sizes[0] < 1.5 * truth.tests[test]["noise_sd"].item() + discrepancy
        assert sizes[1] > 3.0 * sizes[0]
    again = simulate(run, np.random.default_rng(5))
    assert np.array_equal(again.traces[name].force, trace.force)
    other = simulate(run, np.random.default_rng(6))
    assert not np.array_equal(other.traces[name].force, trace.force)


# --- the command, with results that are stored


@pytest.fixture
def copy(out, tmp_path):
    return shutil.copytree(out, tmp_path / "out")


def store(folder, run, ranks, **changes):
    """Store a result for each row of ranks of a mean property and another test."""
    manifest = run.manifest
    for number, row in enumerate(ranks, start=1):
        key = {"number": number, "effort": "quick", "seed": manifest.seed}
        key |= {"rests_on": manifest.keys[POPULATION]} | changes
        positions = [
            {"of": of, "quantity": "gap", "condition": "500 psi", "pit": rank, "rank": rank}
            for of, rank in zip((ANOTHER_TEST, MEAN), row, strict=True)
        ]
        content = {"key": key, "error": "", "positions": positions}
        path = folder / Rehearsal(number, "quick", 1, "").file
        path.parent.mkdir(exist_ok=True)
        path.write_text(json.dumps(content))


def test_the_command_writes_table_picture_and_page_of_what_is_stored(copy, run):
    ranks = np.random.default_rng(4).random((RUNS, 2))
    store(copy, run, ranks)
    words = said("rehearse", copy, "--runs", RUNS)
    table = pd.read_csv(copy / "rehearsal.csv", comment="#")
    assert list(table["of"]) == [ANOTHER_TEST, MEAN]
    for column, share in (("held_50", 0.5), ("held_80", 0.8), ("held_95", 0.95)):
        assert list(table[column]) == list(np.sum(np.abs(ranks - 0.5) <= 0.5 * share, axis=0))
    count = table["held_95"][0]
    assert f"Bounds of gap held another test in {count} of {RUNS} rehearsals" in words
    assert "Nothing speaks against the bounds" in words
    page = " ".join((copy / "rehearsal.html").read_text("utf-8").split())
    assert NOT_TESTED in page
    assert (copy / "rehearsal.png").read_bytes().startswith(b"\x89PNG")
    store(copy, run, ranks * 0.3)
    words = said("rehearse", copy, "--runs", RUNS, code=1)
    assert "the truth lies mostly below the middle (another test)" in words
    assert "2 of 2 bounds of the data sheet are not right" in words


def test_rehearsals_with_other_settings_are_refused_before_anything_is_written(copy, run):
    ranks = np.full((2, 2), 0.4)
    for changes, words in (
        ({"effort": "standard"}, "another effort (--effort standard)"),
        ({"rests_on": "other"}, "another calibration of this run"),
    ):
        store(copy, run, ranks, **changes)
        before = contents(copy)
        sentence = refusal("rehearse", copy, "--runs", 2)
        assert words in sentence
        assert "--force to replace the rehearsals" in sentence
        assert contents(copy) == before
    store(copy, run, ranks)
    said("rehearse", copy, "--runs", 2)  # the control


def test_a_new_population_takes_the_rehearsals_of_the_old_one_away(copy, run):
    store(copy, run, np.full((2, 2), 0.4))
    for name in REHEARSED:
        (copy / name).write_text("")
    (copy / "rehearsal" / "mine.txt").write_text("")
    remove_stale(copy, draws=False)
    assert not any((copy / name).exists() for name in REHEARSED)
    assert [path.name for path in (copy / "rehearsal").iterdir()] == ["mine.txt"]


def test_a_calibration_that_fails_is_a_result(copy, monkeypatch):
    def fails(*_, **__):
        raise rehearsals.FitError("a: no")

    monkeypatch.setattr(rehearsals, "recalibrate", fails)
    job = Rehearsal(1, "quick", 1, "")
    assert job.run(copy, lambda _: None).error == ""
    assert job.stored(copy).error == "a: no"
    even = results_of(np.full((3, 1), 0.5))
    summary = RehearsalSummary([*even, job.stored(copy)])
    assert (summary.runs, summary.errors) == (3, ["a: no"])


# --- whole rehearsals

FAST = Effort(ess=60, limit=600, r_hat=1.1, length=1.0, ensembles=2, starts=6, name="quick")


def rehearsed(run, folder, count, other=None):
    """Summary of rehearsals of a run, calibrated as if it were another."""
    results = []
    for number in range(count):
        truth = simulate(run, np.random.default_rng([number, 1]))
        calibrated = recalibrate(other or run, truth, folder / str(number), FAST, (number,))
        rng = np.random.default_rng([number, 2])
        positions = tuple(rehearsals.positions_of(run, truth, calibrated, rng))
        results.append(StoredRehearsal(key={}, error="", positions=positions))
    return RehearsalSummary(results)


def smallest(summary):
    """Smallest p of a group, corrected for their number, by group."""
    return summary.table.groupby("of")["p_family"].min()


@pytest.mark.slow
def test_a_right_calibration_passes(run, tmp_path):
    p_values = smallest(rehearsed(run, tmp_path / "right", 5))
    # what scatters between three tests follows its prior, which counts twice; of five groups one
    # would be below by chance in 1 % of cases
    assert p_values.drop(SCATTERS).min() > 0.002


@pytest.mark.slow
def test_noise_that_is_taken_for_independent_is_seen_in_the_records(run):
    held = {"iid": [], "ou": []}
    for number in range(6):
        truth = simulate(run, np.random.default_rng([number, 1]))
        for (name, trace), noise in product(truth.traces.items(), held):
            posterior = mb.Posterior(trace, run.priors, noise, run.model)
            values = sample(posterior, FAST, number).values
            for quantity in ("Fc_fwd", "Fc_bwd", "sigma2", "offset"):  # which noise blurs
                lower, upper = np.quantile(values[quantity], [0.1, 0.9])
                held[noise].append(lower <= truth.tests[name][quantity].item() <= upper)
    # of 16 truths they held 36 and 76 %; the difference of six is 0.40 ± 0.09 (standard error)
    assert np.mean(held["iid"]) < np.mean(held["ou"]) - 0.05


@pytest.mark.slow
def test_priors_ten_times_too_narrow_are_seen(run, tmp_path):
    narrow = {
        name: Prior(p.family, {**p.figures, "sigma": 0.1 * p.figures["sigma"]})
        if p.family == "lognormal"
        else p
        for name, p in run.priors.parameters.items()
    }
    variant = replace(run, priors=replace(run.priors, parameters=narrow))
    p_values = smallest(rehearsed(run, tmp_path / "narrow", 6, variant))
    assert max(p_values[LEVELS], p_values[POOLED], p_values[MEAN]) < 0.001


@pytest.mark.slow
def test_a_killed_command_goes_on_to_the_same_bits(out, tmp_path, without_figures):
    folders = {}
    for name in ("whole", "killed"):
        (tmp_path / name / "disk").mkdir(parents=True)
        folders[name] = shutil.copytree(out, tmp_path / name / "disk" / "out")
    words = (*without_figures, "rehearse")
    with Process(folders["whole"], *words, folders["whole"], "--runs", 2, "--jobs", 2) as command:
        code, complaint = command.end()
    assert (code in (0, 1), complaint) == (True, "")
    folder = folders["killed"]
    with Process(folder, *words, folder, "--runs", 2, "--jobs", 1) as command:
        assert command.until(lambda: command.says("rehearsal 2: "))
        command.process.kill()
        command.end()
    assert sorted(path.name for path in (folder / "rehearsal").iterdir()) == ["run_001.json"]
    with Process(folder, *words, folder, "--runs", 2, "--jobs", 1) as command:
        assert command.end()[0] == code
        assert command.says("rehearsal 1: done before")
    for path in (*folder.glob("rehearsal/*"), *(folder / name for name in REHEARSED)):
        whole = folders["whole"] / path.relative_to(folder)
        assert path.read_bytes() == whole.read_bytes(), path.name
