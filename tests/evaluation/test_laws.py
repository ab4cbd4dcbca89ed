"""Constants of laws that are compared, which law predicts best, and tests at zero actuation."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mfd_bayes.evaluation.laws import (
    FEWEST,
    law_choices,
    law_label,
    law_score_rows,
    law_views,
    mixed_rows,
)
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.population.design import LAW_NAMES
from mfd_bayes.population.law_scores import LawScore
from mfd_bayes.runs.run import open_run
from mfd_bayes.runs.tested_range import FAR
from mfd_bayes.runs.unit_system import US

REFERENCE = 2.0  # ksi
NUMBER = {name: number for number, name in enumerate(LAW_NAMES)}


class Mixed:
    """Population of 4 chains × 50 draws; a quarter of the chains has each of four laws."""

    laws = ("proportional", "affine", "power", "constant")

    def __init__(self, name="Fc_fwd", draws=50):
        laws = {"sigma0": "proportional", name: "compare"}
        self.design = SimpleNamespace(laws=laws, reference=REFERENCE)
        self.law_weights = {name: dict.fromkeys(self.laws, 0.25)}
        of_chain = np.array([[NUMBER[law]] * draws for law in self.laws])
        self.choice = np.stack([np.zeros_like(of_chain), of_chain], axis=-1)

    def median(self, name, actuation):
        level = np.array([3.0, 4.0, 5.0, 6.0])  # kip at the reference, by chain
        return np.broadcast_to(level[:, None, None], (*self.choice.shape[:2], 1))

    def shapes(self, name):
        share = np.broadcast_to(np.array([1.0, 0.75, 1.0, 0.0])[:, None], self.choice.shape[:2])
        exponent = np.broadcast_to(np.array([1.0, 1.0, 0.6, 1.0])[:, None], self.choice.shape[:2])
        return share, exponent


def test_each_law_has_its_own_constants():
    def rows_of(population):
        run = {"actuation_unit": "ksi", "system": US, "model": ThreeStage()}
        return mixed_rows(SimpleNamespace(population=population, **run), "2 ksi")

    constants = {(row["note"].split(" law")[0], row["name"]): row for row in rows_of(Mixed())}
    medians = {key: row["median"] for key, row in constants.items()}
    assert medians == pytest.approx(
        {
            ("proportional", "K_c_fwd"): 1.5,
            ("affine", "K_c_fwd"): 1.5,  # 4 · 0.75 / 2
            ("affine", "Fc_fwd_0"): 1.0,
            ("power", "Fc_fwd"): 5.0,
            ("power", "exponent_Fc_fwd"): 0.6,
            ("constant", "Fc_fwd"): 6.0,
        }
    )
    assert constants["affine", "Fc_fwd_0"]["note"] == "affine law, weight 0.25"
    assert constants["power", "Fc_fwd"]["note"] == "power law, weight 0.25; at 2 ksi"
    units = {name: row["unit"] for (_, name), row in constants.items()}
    assert units == {"K_c_fwd": "in^2", "Fc_fwd_0": "kip", "Fc_fwd": "kip", "exponent_Fc_fwd": "1"}
    assert all(np.isnan(row["r_hat"]) for row in constants.values())  # a part of the chains
    assert rows_of(Mixed(draws=FEWEST - 1)) == []


def scores(**levels):
    return [
        LawScore("Fc_fwd", law, sum(terms), 0.5, 1.0 / len(levels), tuple(terms))
        for law, terms in levels.items()
    ]


def choice(scores, law):
    rows = law_score_rows(scores, {"Fc_fwd": law})
    return rows, law_choices(rows, {"Fc_fwd": law})["Fc_fwd"]


def test_the_best_law_stands_first_and_others_are_measured_by_it():
    law_scores = scores(proportional=[1.0, 2.0, 0.0], power=[2.0, 3.0, 1.5])
    (best, rival), sentence = choice(law_scores, "proportional")
    assert (best["law"], best["difference"], best["difference_se"]) == ("power", 0.0, 0.0)
    assert rival["difference"] == pytest.approx(-3.5)
    assert rival["difference_se"] == pytest.approx(0.5)  # √3 times the sd of −1, −1, −1.5
    assert (best["chosen"], rival["chosen"]) == (False, True)
    assert "the campaign's own, proportional, is worse by 3.5 ± 0.5" in sentence
    rows, sentence = choice(law_scores, "compare")
    assert sentence.endswith("mix them (compared: power 0.5, proportional 0.5).")
    assert not any(row["chosen"] for row in rows)
    # a difference within its standard error
    close = scores(proportional=[1.0, 2.0, 0.0], power=[2.0, 1.0, 0.5], constant=[-9.0, -8.0, -9.0])
    _, sentence = choice(close, "proportional")
    assert sentence.startswith("the power law predicts levels that were left out best, but")
    assert "the 3 levels cannot separate it from proportional:" in sentence


def test_a_score_that_cannot_be_trusted_is_named_and_never_best():
    law_scores = [*scores(proportional=[1.0, 2.0, 0.0]), *scores(power=[9.0, 9.0, 9.0])]
    law_scores[1] = replace(law_scores[1], pareto_k=0.93, weight=0.0)
    rows, sentence = choice(law_scores, "compare")
    assert [row["law"] for row in rows] == ["proportional", "power"]
    assert sentence.startswith("the proportional law predicts")
    assert "the score of power (Pareto k 0.93) cannot be trusted" in sentence
    _, control = choice([replace(s, pareto_k=0.6) for s in law_scores], "compare")
    assert "trusted" not in control  # the control


@pytest.mark.parametrize(
    ("law", "pareto_k", "label"),
    [
        ("affine", 0.84, "affine, the campaign's; constant predicts best"),
        ("affine", 0.2, "affine, the campaign's; constant predicts best"),
        ("constant", 0.2, "constant"),
        ("power", 0.2, "power"),  # within the standard error
    ],
)
def test_the_figure_says_what_the_sentence_says(law, pareto_k, label):
    terms = {"constant": [2.0, 3.0, 1.5], "power": [2.1, 2.8, 1.5], "affine": [1.0, 2.0, 0.0]}
    law_scores = scores(**terms)
    law_scores[2] = replace(law_scores[2], pareto_k=pareto_k)
    rows = law_score_rows(law_scores, {"Fc_fwd": law})
    assert law_label(law, {law: 1.0}, rows) == label


def test_the_figure_ends_where_predictions_are_refused(made_run):
    (view, *_) = law_views(open_run(made_run))
    lowest = min(level for _, level, *_ in view.tested)
    assert view.actuation[0] == pytest.approx(lowest / FAR)
