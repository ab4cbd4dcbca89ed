"""A run under other priors: weights in closed form, and the command on a finished run."""

import csv
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

import mfd_bayes as mb
from mfd_bayes.applications.reweighing.reweighing import JOINT, reweigh
from mfd_bayes.applications.reweighing.weights import check_same_parameters, weights_of_test
from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.priors import Prior, load_priors
from mfd_bayes.calibration.sampling import sample
from mfd_bayes.errors import PriorError
from tests.command_line import refusal, said
from tests.statistical.test_linear_gaussian import NOISE, PRIORS, Linear, design_of, make_posterior

EFFORT = Effort(ess=800, limit=3000)


def linear(**priors) -> Posterior:
    """The linear posterior with some other priors."""
    file = replace(PRIORS, parameters={**PRIORS.parameters, **priors})
    return Posterior(make_posterior().trace, file, "iid", Linear())


def normal(mean: float, sd: float) -> Prior:
    return Prior("normal", {"mean": mean, "sd": sd})


def closed_form(posterior: Posterior) -> tuple[np.ndarray, np.ndarray]:
    """Mean and sd of (sigma2, k2, offset) under normal priors."""
    design, force = design_of(posterior), np.asarray(posterior.trace.force)
    figures = [posterior.priors[name].figures for name in posterior.names]
    means, sds = np.array([(f["mean"], f["sd"]) for f in figures]).T
    covariance = np.linalg.inv(design.T @ design / NOISE**2 + np.diag(sds**-2.0))
    mean = covariance @ (design.T @ force / NOISE**2 + means / sds**2)
    return mean, np.sqrt(np.diag(covariance))


@pytest.fixture(scope="module")
def draws():
    return sample(make_posterior(), EFFORT, seed=3)


def test_weights_take_draws_to_the_posterior_under_the_other_priors(draws) -> None:
    posterior = draws.posterior
    other = linear(k2=normal(1.2, 0.1), offset=normal(0.1, 0.02))
    weights = weights_of_test(posterior, other, draws.values, 0.1)
    assert not weights.reason
    assert weights.pareto_k < 0.7
    q, (mean, sd) = draws.q.reshape(-1, 3), closed_form(other)
    error = 4.0 * sd / np.sqrt(weights.efficiency * draws.convergence.worst_ess)
    assert np.all(np.abs(np.exp(weights.log) @ q - mean) < error)
    picked = q[weights.pick(np.random.default_rng(0))]
    np.testing.assert_allclose(picked.std(axis=0), sd, rtol=0.1)
    # the controls: without weights, and with those of no change
    assert np.any(np.abs(q.mean(axis=0) - mean) > error)
    same = weights_of_test(posterior, linear(), draws.values, 0.1)
    assert same.efficiency == pytest.approx(1.0)
    np.testing.assert_array_equal(same.pick(np.random.default_rng(0)), np.arange(len(q)))


def test_a_family_with_other_coordinates_has_the_ratio_of_the_densities_themselves(draws) -> None:
    bounds = {"mean": 1.0, "sd": 0.5, "lower": 0.5, "upper": 5.0}
    other = linear(k2=Prior("truncated_normal", bounds))  # a normal with hardly any mass outside
    weights = weights_of_test(draws.posterior, other, draws.values, 0.1)
    assert weights.efficiency > 0.99
    # the way back leaves the support of what was sampled
    back = weights_of_test(other, draws.posterior, draws.values, 0.1)
    assert "the other prior of k2 allows what the run's excludes" in back.reason


def test_weights_that_cannot_be_trusted_are_refused_and_sampling_from_the_draws_is_right(
    draws,
) -> None:
    far = linear(k2=normal(3.0, 0.02))
    weights = weights_of_test(draws.posterior, far, draws.values, 0.1)
    assert weights.reason.startswith("Pareto k")
    begin = draws.q.reshape(-1, 3)[::5000]
    again = sample(far, EFFORT, seed=4, begin=begin)
    mean, sd = closed_form(far)
    error = 4.0 * sd / np.sqrt(again.convergence.worst_ess)
    assert np.all(np.abs(again.q.reshape(-1, 3).mean(axis=0) - mean) < error)
    assert np.any(np.abs(draws.q.reshape(-1, 3).mean(axis=0) - mean) > 10.0 * error)


def test_few_effective_draws_are_too_few(draws) -> None:
    other = linear(k2=normal(1.2, 0.1))
    assert not weights_of_test(draws.posterior, other, draws.values, 0.1).reason
    assert (
        "worth would be left" in weights_of_test(draws.posterior, other, draws.values, 0.999).reason
    )


def test_priors_of_other_parameters_are_refused() -> None:
    for other, words in (
        (linear(k2=Prior("fixed", {"value": 1.0})), "fixes k2, which the run sampled"),
        (linear(noise_sd=Prior("fixed", {"value": 0.3})), "fixes noise_sd at another value"),
    ):
        with pytest.raises(PriorError, match=words):
            check_same_parameters(linear(), other, "other.toml")
    check_same_parameters(linear(), linear(k2=normal(5.0, 1.0)), "other.toml")


# --- a finished run


def other_priors(run, path, **medians):
    """Its prior file with other medians of some lognormal priors, as factors."""
    text = (run / "priors.toml").read_text("utf-8")
    for name, factor in medians.items():
        head, _, table = text.partition(f"[parameters.{name}]\n")
        line = next(line for line in table.splitlines() if line.startswith("median"))
        number = line.split('"')[1].partition(" ")[0]
        changed = line.replace(number, repr(float(number) * factor), 1)
        text = f"{head}[parameters.{name}]\n{table.replace(line, changed, 1)}"
    path.write_text(text, "utf-8")
    return path


@pytest.fixture(scope="module")
def out(finished_run, tmp_path_factory):
    folder = tmp_path_factory.mktemp("reweigh") / "out"
    shutil.copytree(finished_run.out, folder)
    return folder


def test_the_command_shows_both_priors_and_writes_a_run_of_the_other(out, tmp_path) -> None:
    path, target = other_priors(out, tmp_path / "other.toml", k3=1.3), tmp_path / "out2"
    printed = said("reweigh", out, "--priors", path, "-o", target, "--jobs", "1")
    assert "Of 3 tests, none had to be sampled again; the population was weighted" in printed
    with (target / "reweighed.csv").open() as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    assert {row["part"] for row in rows} == {"data sheet", "laws", "bands"}
    assert "under other priors" in (target / "reweighed.html").read_text("utf-8")
    before, after = mb.open_run(out), mb.open_run(target)
    manifest = json.loads((target / "manifest.json").read_text())
    assert "Pareto k" in manifest["reweighed"][JOINT]
    assert manifest["verdicts"]["campaign"] in printed.lower()
    # its draws are some of the run's, and its levels are where they were
    for name, test in after.tests.items():
        stored = before.tests[name].draws["k3"].to_numpy().ravel()
        assert np.isin(test.draws["k3"].to_numpy().ravel(), stored).all()
        assert test.posterior.priors["k3"].median == pytest.approx(
            1.3 * before.tests[name].posterior.priors["k3"].median
        )
    for name in ("Fc_fwd", "k3"):
        level = after.population.median(name, [1.0]).ravel()
        stored = before.population.median(name, [1.0]).ravel()
        distance = np.abs(level[:, None] / stored - 1.0).min(axis=1)
        assert distance.max() < 1e-9
    assert len(np.unique(after.population.draws.h)) < before.population.draws.h.size
    assert f"{target} exists" in refusal("reweigh", out, "--priors", path, "-o", target)


def test_the_same_priors_change_nothing(out) -> None:
    run = mb.open_run(out)
    reweighing = reweigh(run, out / "priors.toml", jobs=1)
    assert reweighing.sampled == ()
    test = next(iter(run.tests))
    for name in ("k3", "offset", "Fs_fwd"):
        np.testing.assert_allclose(
            reweighing.reweighed.tests[test].draws[name], run.tests[test].draws[name], rtol=1e-12
        )
    np.testing.assert_allclose(reweighing.reweighed.population.draws.z, run.population.draws.z)


def test_what_weights_cannot_reach_is_sampled(out, tmp_path) -> None:
    path = tmp_path / "bounded.toml"
    text = (out / "priors.toml").read_text("utf-8")
    head, _, table = text.partition("[parameters.v_s]\n")
    _, _, remainder = table.partition("\n[")
    bounded = 'family = "uniform"\nlower = "0.01 in/s"\nupper = "6 in/s"\n'
    path.write_text(f"{head}[parameters.v_s]\n{bounded}\n[{remainder}", "utf-8")
    reweighing = reweigh(mb.open_run(out), path, jobs=1)
    joint = reweighing.weights[JOINT]
    assert "the prior of v_s has other bounds" in joint.words
    assert JOINT in reweighing.sampled
    after = reweighing.reweighed
    assert after.population.design.coordinates.priors["v_s"].upper == pytest.approx(6.0)
    assert np.all(np.isfinite(after.population.draws.h))
    # of a test whose parameters stay within the bounds the draws are weighted
    weighted = [w for name, w in reweighing.weights.items() if name != JOINT]
    assert all(w.pareto_k < 0.7 or w.reason for w in weighted)


def test_priors_of_another_model_are_refused_in_one_sentence(out, tmp_path) -> None:
    path, target = tmp_path / "short.toml", tmp_path / "out3"
    text = (out / "priors.toml").read_text("utf-8")
    head, _, table = text.partition("[parameters.k3]\n")
    path.write_text(f"{head}[{table.partition(chr(10) + '[')[2]}", "utf-8")
    sentence = refusal("reweigh", out, "--priors", path, "-o", target)
    assert "the run is of three_stage with ou noise" in sentence
    assert "no prior for k3" in sentence
    assert "no prior file" in refusal("reweigh", out, "--priors", "nowhere.toml", "-o", target)
    assert not target.exists()
    assert not list(tmp_path.glob(".reweighed*"))
    assert load_priors(str(out / "priors.toml")).parameters["k3"].family == "lognormal"
