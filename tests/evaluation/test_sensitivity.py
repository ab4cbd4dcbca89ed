"""What a finished run says of prior and data: rows, sentences, and whose draws they are of."""

import csv

import numpy as np
import pytest

import mfd_bayes as mb
from mfd_bayes.calibration.sensitivity import Follows
from mfd_bayes.evaluation.bounds import draw_index, places_of
from mfd_bayes.evaluation.sensitivity import (
    DESIGN,
    JointDensity,
    design_rows,
    law_rows,
    sentences,
    summaries,
)


@pytest.fixture(scope="module")
def run(finished_run):
    return mb.open_run(finished_run.out)


def test_the_report_has_a_row_of_each_value_for_design_constant_and_parameter(finished_run, run):
    with (finished_run.out / "sensitivity.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["group"] for row in rows} == {DESIGN, "population", *run.tests}
    assert {row["verdict"] for row in rows} <= {verdict.value for verdict in Follows}
    slip = [row for row in rows if row["quantity"] == "slip force forward"]
    assert {row["of"] for row in slip} == {"nominal value", "bounds"}
    assert all(0.0 <= float(row["prior_sensitivity"]) < 2.0 for row in rows)
    assert "Prior or data?" in (finished_run.out / "report.html").read_text("utf-8")


def test_values_for_design_have_the_densities_of_the_draws_that_they_are_of(run):
    test = next(iter(run.tests.values()))
    places = places_of(run)
    index = draw_index(run, test.trace, places)
    band = run.predict(test.trace, "mean", draws=index.size // len(places), session=places[0][0])
    population = run.population
    stored = population.values(
        population.draws.z[..., : len(population.design.names)].reshape(population.size, -1)
    )["k3"][index]
    assert np.corrcoef(band.values["k3"], stored)[0, 1] > 0.9
    assert abs(np.corrcoef(band.values["k3"], np.roll(stored, 1))[0, 1]) < 0.5


def test_a_value_of_the_prior_alone_follows_it_and_the_report_says_which(run):
    joint, rng = JointDensity.of(run), np.random.default_rng(0)
    assert joint.log_prior.shape == run.population.shape
    index = np.arange(run.population.size)
    # as if the prior of one quantity, which no test knows, were all that varies
    value = rng.standard_normal(index.size)
    prior = JointDensity(-0.5 * value.reshape(run.population.shape) ** 2, joint.log_likelihood)
    rows = design_rows(
        prior, index, "1 in", {("gap", "bounds"): value, ("energy", "bounds"): value}
    )
    assert {row["verdict"] for row in rows} <= {Follows.PRIOR, Follows.BOTH}
    text = " ".join(map(str, sentences(tuple(r | {"verdict": Follows.PRIOR} for r in rows))))
    assert "2 follow the prior" in text
    assert "bounds of gap at 1 in" in text
    (gap, _) = summaries(rows, design=True)
    assert gap.notable
    assert not summaries(rows, design=False)
    # the control: the same values where the prior is flat
    flat = JointDensity(0.001 * prior.log_prior, joint.log_likelihood)
    (row,) = design_rows(flat, index, "1 in", {("gap", "bounds"): value})
    assert row["prior"] < 0.05
    assert not design_rows(None, index, "1 in", {("gap", "bounds"): value})


def test_a_run_of_an_earlier_version_has_no_rows_of_laws(made_run):
    old = mb.open_run(made_run)
    assert JointDensity.of(old) is None
    assert law_rows(old, None) == ()
